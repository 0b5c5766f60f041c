"""Inspection: the intersections of one pixel's ray with each primitive, and the work that a render took."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from caster.aovs import BY_NAME
from caster.description.transform import dot_rows, row_lengths
from caster.geometry.packing import Kind, Packed, rejected_faces
from caster.kernels.nearest import Rays, intersect_each
from caster.rendering.bvh_construction import bvh_of, has_bvh, uses_bvh
from caster.rendering.hits import RayHits
from caster.rendering.images import RenderResult, trace_film
from caster.scene.model import Scene

MAX_PRIMITIVES_PROBED = 256  # of more primitives, those whose boxes are nearest to the ray


@dataclass(frozen=True)
class PrimitiveResult:
    """The intersection of a ray with one primitive."""

    shape_id: int
    prim_id: int  # within its shape
    t: float  # the exact first hit in range, rounded to float64; inf on a miss
    error: float  # error bound of t in float64; inf if float64 cannot decide
    away: float  # distance of the ray from the sphere around it, by which misses are ordered

    @property
    def decided_by(self) -> str:
        return "float64" if math.isfinite(self.error) else "integers"


def intersect_each_primitive(packed: Packed, rays: Rays) -> tuple[PrimitiveResult, ...]:
    """Intersections of rays[0] with the nearest primitives: hits by t, then misses by distance. Without a ray: none."""
    if not rays.t_min[0] < rays.t_max[0]:
        return ()
    found = [tried for kind in packed.kinds for tried in _try(packed, kind, rays)]
    order = sorted(found, key=lambda each: (each.t, each.away, each.shape_id, each.prim_id))
    return tuple(order[:MAX_PRIMITIVES_PROBED])


def ray_box_distances(o: np.ndarray, d: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(n,) distances of the bounding spheres of boxes from a ray, 0 for those that it enters."""
    with np.errstate(all="ignore"):
        center, radius = 0.5 * low + 0.5 * high, 0.5 * row_lengths(high - low)
        ahead = np.maximum(dot_rows(center - o, d) / dot_rows(d[None], d), 0.0)
        away = row_lengths(o + ahead[:, None] * d - center) - radius
    return np.where(np.isfinite(away), np.maximum(away, 0.0), np.inf)


def _try(packed: Packed, kind: Kind, rays: Rays) -> Iterator[PrimitiveResult]:
    """Intersections with the nearest primitives of a kind."""
    away = np.zeros(len(kind.ids))
    if kind.bounded:
        away = ray_box_distances(rays.o[0], rays.d[0], *kind.boxes())
    rows = np.sort(np.argsort(away, kind="stable")[:MAX_PRIMITIVES_PROBED])
    t, error = np.full(len(rows), np.inf), np.zeros(len(rows))
    intersect_each(kind.prims, rows.astype(np.int64), rays, t, error, 0, len(rows))
    ids = kind.ids[rows]
    shapes, numbers = packed.shape_of(ids), packed.index_in_shape(ids)
    for j, k in enumerate(rows.tolist()):
        yield PrimitiveResult(int(shapes[j]), int(numbers[j]), float(t[j]), float(error[j]), float(away[k]))


# One pixel: its ray, its hit, and the intersection with each primitive alone.


class Probe(NamedTuple):
    """The ray through a pixel's centre and its hits."""

    view: RayHits  # the one ray, d of length 1, t_max < 0 where the camera has none; and its hit, as `render` finds it
    tried: tuple[PrimitiveResult, ...]  # hits by t, then misses by distance; of many primitives, the nearest


def probe(scene: Scene, x: int, y: int) -> Probe:
    """Cast the ray of one pixel, once as `render` does and once at each primitive without culling.

    Raises SceneError for a pixel outside the film.
    """
    view = trace_film(scene.with_pixel(x, y), threads=1)
    return Probe(view, intersect_each_primitive(view.packed, view.rays))


# ---- the work of a render ----


def account(rendered: RenderResult, aovs: Sequence[str]) -> dict[str, Any]:
    """The work done, for `caster render --json`."""
    plan, scene, kinds, on_film = rendered.plan, rendered.scene, rendered.packed.kinds, rendered.on_film
    x0, y0, x1, y1 = scene.film.window
    return {
        "camera_rays": {
            "cast": (x1 - x0) * (y1 - y0),
            "camera": scene.camera.type,
            "share_origin": scene.camera.shares_origin,
            "window": [x0, y0, x1, y1],
            "film": [scene.film.width, scene.film.height],
        },
        "culling": {"name": plan.culling, "reason": plan.reason},
        "primitives": [
            {
                "kind": type(kind.prims).__name__.lower(),
                "count": len(kind.ids),
                "looked_for": int(on_film[i].sum()) if on_film else len(kind.ids),
                "way": _way(kind, plan.culling),
                "nodes": len(bvh_of(kind).links) if has_bvh(kind) else 0,
            }
            for i, kind in enumerate(kinds)
        ],
        "never_hit": rejected_faces(scene),
        "trees": {**plan.trees._asdict(), "grown": sum(has_bvh(kind) for kind in kinds)},
        "decided_exactly": rendered.decided_exactly,
        "surfaces": {
            "hits": rendered.hits if plan.surfaces else 0,
            "worked_out": list(plan.surfaces),
            "reason": plan.surfaces_reason,
        },
        "shading": plan.shading._asdict(),
        "shadow_rays": {**plan.shadows._asdict(), "cast": rendered.shadow_rays},
        "aovs": list(aovs),
        "skipped_aovs": [name for name in BY_NAME if name not in aovs],
    }


def _way(kind: Kind, culling: str) -> str:
    if culling == "brute-force":
        return "tested by every ray"
    if not kind.bounded:
        return "tested by every ray, since they have no bounds"
    if culling == "raster":
        return "tested in the pixels of their screen bounds"
    return f"a BVH of {len(bvh_of(kind).links)} nodes" if uses_bvh(kind) else "too few for a tree"


def explain(rendered: RenderResult, aovs: Sequence[str]) -> str:
    """The account in words, a line for each part, for `caster render --explain`."""
    return "\n".join(f"{_spaced(name):<16} {_words(part)}" for name, part in account(rendered, aovs).items())


def _words(part: Any) -> str:
    if isinstance(part, dict):
        return ", ".join(f"{_spaced(name)} {_words(each)}" for name, each in part.items()) or "none"
    if isinstance(part, list):
        return ("; " if part and isinstance(part[0], dict) else " ").join(map(_words, part)) or "none"
    return {True: "yes", False: "no"}[part] if isinstance(part, bool) else str(part)


def _spaced(name: str) -> str:
    return name.replace("_", " ")

"""Inspection: the intersections of one pixel's ray with each primitive, and the work of a render."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import rejected_faces
from caster.kernels.nearest import intersect_each, ray_at
from caster.kernels.raster.tile import NORMALS, SURFACES, SURFACES_WITH_UV
from caster.rendering.bvh_construction import bvh_of, has_bvh
from caster.rendering.hits import RayHits
from caster.rendering.images import RenderResult, trace_film
from caster.scene.model import Scene


class PrimitiveResult(NamedTuple):
    """The intersection of a ray with one primitive."""

    t: float  # the exact first hit in range, rounded to float64; inf on a miss
    shape_id: int
    prim_id: int  # within its shape
    error: float  # error bound of t in float64; inf where integers decided


class Probe(NamedTuple):
    """The ray through a pixel's centre and its hits."""

    view: RayHits  # the one ray, d of length 1, t_max < 0 where the camera has none; and its hit, as `render` finds it
    alone: list[PrimitiveResult]  # by t: primitives that the ray hits, tested alone, or that float64 cannot decide


def probe(scene: Scene, x: int, y: int) -> Probe:
    """Cast the ray of one pixel, once as `render` does and once at each primitive without culling.

    Raises SceneError for a pixel outside the film.
    """
    view = trace_film(scene.with_pixel(x, y), threads=1)
    packed, alone = view.packed, list[PrimitiveResult]()
    for kind in packed.kinds if view.rays.t_min[0] < view.rays.t_max[0] else ():
        count = len(kind.ids)
        t, error = np.full(count, np.inf), np.zeros(count)
        intersect_each(kind.prims, ray_at(view.rays, 0), t, error)
        shown = np.isfinite(t) | np.isinf(error)
        ids = kind.ids[shown]
        columns = t[shown], packed.shape_of(ids), packed.index_in_shape(ids), error[shown]
        alone += map(PrimitiveResult, *(column.tolist() for column in columns))
    return Probe(view, sorted(alone))


# ---- the work of a render ----


SURFACE_PARTS = {
    None: [],
    NORMALS: ["normals"],
    SURFACES: ["position", "normals"],
    SURFACES_WITH_UV: ["position", "normals", "uv"],
}


def account(rendered: RenderResult, aovs: Sequence[str]) -> dict[str, Any]:
    """The work done, for `caster render --json`."""
    scene, kinds, on_film = rendered.scene, rendered.packed.kinds, rendered.on_film
    x0, y0, x1, y1 = scene.film.window
    return {
        "camera_rays": {"cast": (x1 - x0) * (y1 - y0), "camera": scene.camera.type},
        "culling": rendered.culling,
        "primitives": [
            {
                "kind": type(kind.prims).__name__.lower(),
                "count": len(kind.ids),
                "looked_for": int(on_film[i].sum()) if on_film else len(kind.ids),
                "nodes": len(bvh_of(kind).links) if has_bvh(kind) else 0,
            }
            for i, kind in enumerate(kinds)
        ],
        "never_hit": rejected_faces(scene),
        "decided_exactly": rendered.decided_exactly,
        "surfaces": {
            "hits": rendered.hits if rendered.surfaces is not None else 0,
            "worked_out": SURFACE_PARTS[rendered.surfaces],
        },
        "shadow_rays": rendered.shadow_rays,
        "aovs": list(aovs),
    }


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

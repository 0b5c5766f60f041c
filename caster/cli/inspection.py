"""Inspection: the intersections of one pixel's ray with each primitive, and the work of a render."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from caster.geometry.packing import rejected_faces
from caster.kernels.nearest import intersect_each, ray_at
from caster.kernels.raster.tile import NORMALS, SURFACES, SURFACES_WITH_UV
from caster.rendering.bvh_construction import bvh_of, has_bvh
from caster.rendering.images import RenderResult, trace_film
from caster.scene.model import Scene

SURFACE = ("p", "n", "sh_n", "uv")  # names of RayHits.surfaces


def probe(scene: Scene, x: int, y: int) -> dict[str, Any]:
    """Cast the ray of one pixel, once as `render` does and once at each primitive without culling.

    For JSON, whose numbers are exact. ray: None where the camera has none. hit: what `render` finds. alone: by t, the
    primitives that the ray hits, or that float64 cannot decide; t is exact and rounded to float64, None on a miss, and
    t_off its error bound in float64, None where integers decided.
    Raises SceneError for a pixel outside the film.
    """
    view = trace_film(scene.with_pixel(x, y), threads=1)
    o, d, t_min, t_max = (numbers[0].tolist() for numbers in view.rays)
    packed, names = view.packed, scene.shape_names()

    def at(t: float, shape_id: int, prim_id: int) -> dict[str, Any]:
        kind = scene.shapes[shape_id].type
        return {"shape": names[shape_id], "type": kind, "shape_id": shape_id, "prim_id": prim_id, "t": _finite(t)}

    hit = None
    if view.hit[0]:
        hit = at(float(view.nearest.t[0]), int(view.shape_id[0]), int(view.prim_id[0]))
        hit |= {name: rows[0].tolist() for name, rows in zip(SURFACE, view.surfaces.values(), strict=True)}
    alone: list[tuple[float, int, int, float]] = []
    for kind in packed.kinds if t_min < t_max else ():
        count = len(kind.ids)
        t, error = np.full(count, np.inf), np.zeros(count)
        intersect_each(kind.prims, ray_at(view.rays, 0), t, error)
        shown = np.isfinite(t) | np.isinf(error)
        ids = kind.ids[shown]
        columns = t[shown], packed.shape_of(ids), packed.index_in_shape(ids), error[shown]
        alone += zip(*(column.tolist() for column in columns), strict=True)
    return {
        "ray": {"o": o, "d": d, "t_min": t_min, "t_max": _finite(t_max)} if t_max >= 0.0 else None,
        "hit": hit,
        "tried": {"prims": int(packed.first[-1]), "shapes": len(scene.shapes)},
        "alone": [{**at(t, shape_id, prim_id), "t_off": _finite(e)} for t, shape_id, prim_id, e in sorted(alone)],
    }


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None


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
    done = account(rendered, aovs)
    surfaces, rays, kinds = done["surfaces"], done["camera_rays"], done["primitives"]
    skipped = [part for part in SURFACE_PARTS[SURFACES_WITH_UV] if part not in surfaces["worked_out"]]
    skipped += [] if done["shadow_rays"] else ["shadow rays"]
    skipped += [f"BVH of {kind['kind']}" for kind in kinds if not kind["nodes"]]
    parts = {
        "camera rays": f"{rays['cast']}, camera {rays['camera']}",
        "culling": done["culling"],
        **{kind["kind"]: f"{kind['count']}, of which {kind['looked_for']} may be on the film" for kind in kinds},
        **{f"BVH of {kind['kind']}": f"{kind['nodes']} nodes" for kind in kinds if kind["nodes"]},
        "never hit": ", ".join(f"{count} faces of {name}" for name, count in done["never_hit"].items()) or "none",
        "decided exactly": f"{done['decided_exactly']} rays",
        "surfaces": f"{' '.join(surfaces['worked_out']) or 'nothing'} of {surfaces['hits']} hits",
        "shadow rays": done["shadow_rays"],
        "AOVs": " ".join(aovs),
        "skipped": ", ".join(skipped) or "nothing",
    }
    return "\n".join(f"{name:<20} {part}" for name, part in parts.items())

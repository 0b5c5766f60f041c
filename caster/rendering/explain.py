"""Account of a render: what ran, why, and what was skipped, as data and as text."""

from collections.abc import Iterator, Sequence
from typing import Any

from caster.aovs import BY_NAME
from caster.geometry.packing import Kind, in_words, rejected_faces
from caster.rendering.bvh import bvh_of, has_bvh
from caster.rendering.casting import uses_bvh
from caster.rendering.images import RenderResult
from caster.rendering.plan import Step


def account(rendered: RenderResult, aovs: Sequence[str]) -> dict[str, Any]:
    """All of it, for `caster render --json`: numbers are counts of work done; None where nothing was counted."""
    plan, counts = rendered.plan, rendered.counts
    hits = int(rendered.aovs.hit.sum())
    return {
        "camera_rays": _camera_rays(rendered),
        "culling": {"name": plan.culling, "reason": plan.reason},
        "primitives": _primitives(rendered),
        "never_hit": {name: found.total for name, found in rejected_faces(rendered.scene).items()},
        "trees": {**_step(plan.trees), "grown": sum(has_bvh(kind) for kind in rendered.packed.kinds)},
        "decided_exactly": counts.decided_exactly if counts else None,
        "surfaces": {
            "hits": hits if plan.surfaces else 0,
            "worked_out": list(plan.surfaces),
            "reason": plan.surfaces_reason,
        },
        "shading": _step(plan.shading),
        "shadow_rays": {**_step(plan.shadows), "cast": counts.shadow_rays if counts else None},
        "aovs": list(aovs),
        "skipped_aovs": [name for name in BY_NAME if name not in aovs],
    }


def _step(step: Step) -> dict[str, Any]:
    return {"runs": step.runs, "reason": step.reason}


def _camera_rays(rendered: RenderResult) -> dict[str, Any]:
    camera, film = rendered.scene.camera, rendered.scene.film
    x0, y0, x1, y1 = film.window
    return {
        "cast": (x1 - x0) * (y1 - y0),
        "camera": camera.type,
        "share_origin": camera.shares_origin,
        "window": [x0, y0, x1, y1],
        "film": [film.width, film.height],
    }


def _primitives(rendered: RenderResult) -> list[dict[str, Any]]:
    on_film = rendered.counts.on_film if rendered.counts else None
    return [
        {
            "kind": type(kind.prims).__name__.lower(),
            "count": len(kind.ids),
            "looked_for": on_film[i] if on_film is not None else len(kind.ids),
            "way": _way(kind, rendered.plan.culling),
            "nodes": len(bvh_of(kind).links) if has_bvh(kind) else 0,
        }
        for i, kind in enumerate(rendered.packed.kinds)
    ]


def _way(kind: Kind, culling: str) -> str:
    if culling == "brute-force":
        return "tested by every ray"
    if not kind.bounded:
        return "tested by every ray, since they have no bounds"
    if culling == "raster":
        return "tested in the pixels of their screen bounds"
    return f"a BVH of {len(bvh_of(kind).links)} nodes" if uses_bvh(kind) else "too few for a tree"


def explain(rendered: RenderResult, aovs: Sequence[str]) -> str:
    """Lines for `caster render --explain`."""
    return "\n".join(f"{what:<12} {text}" for what, text in _lines(rendered, account(rendered, aovs)))


def _lines(rendered: RenderResult, counted: dict[str, Any]) -> Iterator[tuple[str, str]]:
    rays, (width, height) = counted["camera_rays"], counted["camera_rays"]["film"]
    x0, y0, x1, y1 = rays["window"]
    start = "from one point" if rays["share_origin"] else "from a point each"
    size = f"{x1 - x0} x {y1 - y0} of a film of {width} x {height}"
    yield "camera rays", f"{rays['cast']} {start}: {rays['camera']}, {size}"
    yield "culling", f"{counted['culling']['name']}: {counted['culling']['reason']}"
    for kind in counted["primitives"]:
        culled = kind["count"] - kind["looked_for"]
        beside = f"; {culled} of them behind the camera or off the film" if culled else ""
        yield "primitives", f"{kind['kind']}, {kind['count']}: {kind['way']}{beside}"
    if not counted["primitives"]:
        yield "primitives", "none: every ray misses"
    if words := in_words(rendered.scene):
        yield "never hit", words
    yield "trees", _trees(counted)
    if counted["decided_exactly"] is not None:
        yield "decided", f"{counted['decided_exactly']} pixels exactly, where float64 leaves them open"
    found = counted["surfaces"]
    done = f"computed for {found['hits']} hits: {', '.join(found['worked_out'])}"
    yield "surfaces", done if found["worked_out"] else f"skipped: {found['reason']}"
    shadows = counted["shadow_rays"]
    number = "" if shadows["cast"] is None else f"{shadows['cast']} "
    yield (
        "shadow rays",
        f"{number}{shadows['reason']}" if shadows["runs"] else f"skipped: {shadows['reason']}",
    )
    yield "AOVs", ", ".join(counted["aovs"])
    yield "skipped", ", ".join(counted["skipped_aovs"]) or "no AOV"


def _trees(counted: dict[str, Any]) -> str:
    trees = counted["trees"]
    if trees["grown"] and not trees["runs"]:
        return f"{trees['grown']} grown: for the many pixels that had to be decided exactly"
    if not trees["runs"]:
        return f"skipped: {trees['reason']}"
    return f"{trees['grown']} grown: {trees['reason']}"

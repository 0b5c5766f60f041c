"""A probe in words and as data: every number in decimal, and in hex to the bit."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from caster.rendering.edge_distances import EDGE_ON, UNIT_RADII, EdgeDistance
from caster.rendering.pixel_probe import Candidate, PrimitiveResult, Probe
from caster.scene.model import Scene

MAX_LISTED = 8  # candidates on the terminal; --json has all


def probe_to_json(found: Probe, path: str) -> dict[str, Any]:
    """For JSON. A key with _hex holds the number beside it, exact; null stands for an infinite t_max."""
    ray = _with_hex("o", found.o) | _with_hex("d", found.d) | _with_hex("t_min", found.t_min)
    ray |= _with_hex("t_max", found.t_max) if math.isfinite(found.t_max) else {"t_max": None}
    film = found.scene.film
    return {
        "scene": path,
        "pixel": [found.x, found.y],
        "film": [film.width, film.height],
        "ray": ray if found.t_max >= 0.0 else None,
        "hit": found.hit and _candidate(found.hit, found.scene) | _surface(found),
        "candidates": [_candidate(candidate, found.scene) for candidate in found.candidates],
        "tried": {"prims": found.prims, "shapes": len(found.scene.shapes), "missed": found.missed},
        "near": [_tried(tried, found.scene) for tried in found.tried],
        "pixel_size": found.pixel,
    }


def probe_to_text(found: Probe, path: str) -> str:
    """For a terminal."""
    film = found.scene.film
    head = f"pixel ({found.x}, {found.y}) of {path}, film {film.width} x {film.height}"
    if found.t_max < 0.0:
        return (
            f"{head}\nno ray: the pixel lies outside the image circle of the {found.scene.camera.type} camera"
        )
    lines = [head, *_ray_lines(found), *_hit_lines(found), *_tried_lines(found), *near_lines(found)]
    return "\n".join(lines)


def _with_hex(name: str, value: Any) -> dict[str, Any]:
    if isinstance(value, np.ndarray):
        return {name: value.tolist(), f"{name}_hex": [x.hex() for x in value.tolist()]}
    return {name: value, f"{name}_hex": value.hex()}


def _candidate(candidate: Candidate, scene: Scene) -> dict[str, Any]:
    return {**_ids(candidate.shape_id, candidate.prim_id, scene), **_with_hex("t", candidate.t)}


def _ids(shape_id: int, prim_id: int, scene: Scene) -> dict[str, Any]:
    shape, name = scene.shapes[shape_id], scene.shape_names()[shape_id]
    return {"shape": name, "type": shape.type, "shape_id": shape_id, "prim_id": prim_id}


def _tried(tried: PrimitiveResult, scene: Scene) -> dict[str, Any]:
    """One primitive alone; t null: missed. span: t at which the ray enters and leaves the box, null: passes by."""
    margins = [{"of": m.of, "unit": m.unit, **_with_hex("inside", m.inside)} for m in tried.margins]
    hit = math.isfinite(tried.t)
    return {
        **_ids(tried.shape_id, tried.prim_id, scene),
        **(_with_hex("t", tried.t) if hit else {"t": None}),
        "decided_by": tried.decided_by,
        "t_off": tried.off if hit and math.isfinite(tried.off) else None,
        "margins": margins,
        "box": tried.box and [corner.tolist() for corner in tried.box],
        "span": tried.span and [t if math.isfinite(t) else None for t in tried.span],
    }


def _surface(found: Probe) -> dict[str, Any]:
    return {
        key: item for name, value in found.surface.items() for key, item in _with_hex(name, value).items()
    }


def _ray_lines(found: Probe) -> Iterator[str]:
    yield from _vector("ray    o", found.o)
    yield from _vector("       d", found.d)
    yield f"       t      {found.t_min!r} to {found.t_max!r}"


def _hit_lines(found: Probe) -> Iterator[str]:
    if found.hit is None:
        yield "miss   nothing lies on this ray"
        return
    yield f"hit    {_name(found.hit, found.scene)}"
    yield from _vector("       t", [found.hit.t])
    for name, value in found.surface.items():
        yield from _vector(f"       {name}", value)


def _tried_lines(found: Probe) -> Iterator[str]:
    shapes = len(found.scene.shapes)
    yield f"tried  {found.prims} primitives of {shapes} shapes, each shape alone: {found.missed} missed"
    first = found.candidates[0].t if found.candidates else 0.0
    for candidate in found.candidates[:MAX_LISTED]:
        behind = f"+{candidate.t - first:.3g}"
        name = _name(candidate, found.scene)
        yield f"       t {candidate.t!r:<24} {candidate.t.hex():<24} {behind:<10} {name}"
    if len(found.candidates) > MAX_LISTED:
        yield f"       and {len(found.candidates) - MAX_LISTED} shapes farther away (--json lists them)"


def near_lines(found: Probe) -> Iterator[str]:
    """Every primitive by itself, in two lines: t, and how far inside its outline and its box the ray passes."""
    if not found.tried:
        return
    wide = f"; a pixel is {found.pixel:.3g} wide at the hit" if found.pixel else ""
    yield f"near   {len(found.tried)} of {found.prims} primitives, each by itself; + is inside its outline{wide}"
    for tried in found.tried[:MAX_LISTED]:
        where = f"t {tried.t!r:<24} {tried.t.hex():<24}" if math.isfinite(tried.t) else missed_words(tried)
        doubt = "" if math.isfinite(tried.off) else " (by integers: float64 cannot tell)"
        yield f"       {where:<51} {_name(tried, found.scene)}{doubt}"
        yield f"         {', '.join([*map(margin_words, tried.margins), box_words(tried)])}"
    if len(found.tried) > MAX_LISTED:
        yield f"       and {len(found.tried) - MAX_LISTED} less near (--json lists them)"


def missed_words(tried: PrimitiveResult) -> str:
    return "missed: not within the range of t, or its ends" if tried.out_of_range else "missed"


def margin_words(margin: EdgeDistance) -> str:
    """Such as `edge 0-1 +0.0125`."""
    if margin.inside == 0.0:
        return f"{margin.of} 0, exactly on it" if margin.of != EDGE_ON else "the ray runs along it"
    return f"{margin.of} {margin.inside:+.6g}" + (" radii" if margin.unit == UNIT_RADII else "")


def box_words(tried: PrimitiveResult) -> str:
    """Where the ray is in the box of a primitive."""
    if tried.box is None:
        return "no bounds"
    return (
        "passes its box by" if tried.span is None else "in its box for t {:.6g} to {:.6g}".format(*tried.span)
    )


def _name(candidate: Candidate | PrimitiveResult, scene: Scene) -> str:
    shape = scene.shapes[candidate.shape_id]
    label = f' "{shape.name}"' if shape.name else ""
    return f"shapes[{candidate.shape_id}] ({shape.type}{label}), prim {candidate.prim_id}"


def _vector(label: str, values: Iterable[float]) -> Iterator[str]:
    numbers = [float(value) for value in values]
    yield f"{label:<14}{'  '.join(map(repr, numbers))}"
    yield f"{'':<14}{'  '.join(number.hex() for number in numbers)}"

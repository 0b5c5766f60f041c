"""A probe in words and as data: every number in decimal, and in hex to the bit."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from caster.probing import Candidate, Probe
from caster.scene import Scene

SHOWN = 8  # candidates on the terminal; --json has all


def as_data(found: Probe, path: str) -> dict[str, Any]:
    """For JSON. A key with _hex holds the number beside it, exact; null stands for an infinite t_max."""
    ray = _both("o", found.o) | _both("d", found.d) | _both("t_min", found.t_min)
    ray |= _both("t_max", found.t_max) if math.isfinite(found.t_max) else {"t_max": None}
    film = found.scene.film
    return {
        "scene": path,
        "pixel": [found.x, found.y],
        "film": [film.width, film.height],
        "ray": ray if found.t_max >= 0.0 else None,
        "hit": found.hit and _candidate(found.hit, found.scene) | _surface(found),
        "candidates": [_candidate(candidate, found.scene) for candidate in found.candidates],
        "tried": {"prims": found.prims, "shapes": len(found.scene.shapes), "missed": found.missed},
    }


def as_text(found: Probe, path: str) -> str:
    """For a terminal."""
    film = found.scene.film
    head = f"pixel ({found.x}, {found.y}) of {path}, film {film.width} x {film.height}"
    if found.t_max < 0.0:
        return (
            f"{head}\nno ray: the pixel lies outside the image circle of the {found.scene.camera.type} camera"
        )
    return "\n".join([head, *_ray_lines(found), *_hit_lines(found), *_tried_lines(found)])


def _both(name: str, value: Any) -> dict[str, Any]:
    if isinstance(value, np.ndarray):
        return {name: value.tolist(), f"{name}_hex": [x.hex() for x in value.tolist()]}
    return {name: value, f"{name}_hex": value.hex()}


def _candidate(candidate: Candidate, scene: Scene) -> dict[str, Any]:
    shape = scene.shapes[candidate.shape_id]
    name = scene.shape_names()[candidate.shape_id]
    ids = {"shape_id": candidate.shape_id, "prim_id": candidate.prim_id}
    return {"shape": name, "type": shape.type, **ids, **_both("t", candidate.t)}


def _surface(found: Probe) -> dict[str, Any]:
    return {key: item for name, value in found.surface.items() for key, item in _both(name, value).items()}


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
    for candidate in found.candidates[:SHOWN]:
        behind = f"+{candidate.t - first:.3g}"
        name = _name(candidate, found.scene)
        yield f"       t {candidate.t!r:<24} {candidate.t.hex():<24} {behind:<10} {name}"
    if len(found.candidates) > SHOWN:
        yield f"       and {len(found.candidates) - SHOWN} shapes farther away (--json lists them)"


def _name(candidate: Candidate, scene: Scene) -> str:
    shape = scene.shapes[candidate.shape_id]
    label = f' "{shape.name}"' if shape.name else ""
    return f"shapes[{candidate.shape_id}] ({shape.type}{label}), prim {candidate.prim_id}"


def _vector(label: str, values: Iterable[float]) -> Iterator[str]:
    numbers = [float(value) for value in values]
    yield f"{label:<14}{'  '.join(map(repr, numbers))}"
    yield f"{'':<14}{'  '.join(number.hex() for number in numbers)}"

"""`caster probe`: the ray, the hit and the per-primitive intersections of one pixel, exact to the bit."""

from __future__ import annotations

import json
import math
from argparse import Namespace
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from caster.cli.shared_arguments import Adder, add_pixel, add_scene, load
from caster.description.errors import error_prefix
from caster.system.process import OK

if TYPE_CHECKING:
    from caster.scene.model import Scene

MAX_LISTED = 8  # primitives in the text; --json lists all


def add_arguments(add: Adder) -> None:
    add_scene(add)
    add_pixel(add)
    add("--json", bool, "as JSON, with all primitives that are hit")


def run(args: Namespace) -> int:
    """Print the intersections of the pixel's ray. Raises SceneError for a pixel outside the film."""
    scene = load(args)
    from caster.cli.inspection import probe

    found = {"scene": args.scene, "pixel": [args.x, args.y], "film": [scene.film.width, scene.film.height]}
    with error_prefix(args.scene):
        found |= probe(scene, args.x, args.y)
    print(json.dumps(found, indent=2) if args.json else "\n".join(text_lines(found, scene)))
    return OK


def text_lines(found: dict[str, Any], scene: Scene) -> Iterator[str]:
    """The same as text."""
    (x, y), (width, height), ray, hit = found["pixel"], found["film"], found["ray"], found["hit"]
    yield f"pixel ({x}, {y}) of {found['scene']}, film {width} x {height}"
    if ray is None:
        yield f"no ray: the pixel lies outside the image circle of the {scene.camera.type} camera"
        return
    yield from _vector("ray    o", ray["o"])
    yield from _vector("       d", ray["d"])
    yield f"       t      {ray['t_min']!r} to {math.inf if ray['t_max'] is None else ray['t_max']!r}"
    if hit is None:
        yield "miss   nothing lies on this ray"
    else:
        yield f"hit    {_name(hit, scene)}"
        yield from _vector("       t", [hit["t"]])
        for name, numbers in hit.items():
            if isinstance(numbers, list):
                yield from _vector(f"       {name}", numbers)
    alone = found["alone"]
    yield f"alone  {len(alone)} of {found['tried']['prims']} primitives are hit, or not decided by float64"
    for tried in alone[:MAX_LISTED]:
        where = "missed" if tried["t"] is None else f"t {tried['t']!r:<24} {tried['t'].hex():<24}"
        exactly = " (by integers: undecided in float64)" if tried["t_off"] is None else ""
        yield f"       {where:<51} {_name(tried, scene)}{exactly}"
    if len(alone) > MAX_LISTED:
        yield f"       and {len(alone) - MAX_LISTED} more (--json lists them)"


def _name(found: dict[str, Any], scene: Scene) -> str:
    shape = scene.shapes[found["shape_id"]]
    label = f' "{shape.name}"' if shape.name else ""
    return f"shapes[{found['shape_id']}] ({shape.type}{label}), prim {found['prim_id']}"


def _vector(label: str, numbers: Sequence[float]) -> tuple[str, str]:
    return f"{label:<14}{'  '.join(map(repr, numbers))}", f"{'':<14}{'  '.join(map(float.hex, numbers))}"

"""`caster probe`: the ray, the hit and the per-primitive intersections of one pixel, exact to the bit."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from caster.cli.shared_arguments import add_pixel, add_scene, load
from caster.description.errors import error_prefix
from caster.system.process import OK

if TYPE_CHECKING:
    from caster.geometry.edge_distances import EdgeDistance
    from caster.rendering.inspection import PixelHit, PrimitiveResult, Probe
    from caster.scene.model import Scene

MAX_LISTED = 8  # primitives in the text; --json lists more


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add_pixel(parser)
    parser.add_argument("--json", action="store_true", help="as JSON, with more primitives")


def run(args: argparse.Namespace) -> int:
    """Print the intersections of the pixel's ray. Raises SceneError for a pixel outside the film."""
    scene = load(args)
    from caster.rendering.inspection import probe

    with error_prefix(args.scene):
        found = probe(scene, args.x, args.y)
    if args.json:
        print(json.dumps(probe_to_json(found, args.scene), indent=2))
    else:
        print(probe_to_text(found, args.scene))
    return OK


# ---- as JSON ----


def probe_to_json(found: Probe, path: str) -> dict[str, Any]:
    """A probe for JSON, whose numbers are exact. null: no limit of t, or a miss."""
    scene, film = found.scene, found.scene.film
    ray = {"o": found.o.tolist(), "d": found.d.tolist(), "t_min": found.t_min, "t_max": _finite(found.t_max)}
    surface = {name: value.tolist() for name, value in found.surface.items()}
    return {
        "scene": path,
        "pixel": [found.x, found.y],
        "film": [film.width, film.height],
        "ray": ray if found.t_max >= 0.0 else None,
        "hit": found.hit and {**_ids(found.hit, scene), "t": found.hit.t, **surface},
        "tried": {"prims": found.prims, "shapes": len(scene.shapes)},
        "near": [_tested(tried, scene) for tried in found.tried],
    }


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _ids(found: PixelHit | PrimitiveResult, scene: Scene) -> dict[str, Any]:
    shape, name = scene.shapes[found.shape_id], scene.shape_names()[found.shape_id]
    return {"shape": name, "type": shape.type, "shape_id": found.shape_id, "prim_id": found.prim_id}


def _tested(tried: PrimitiveResult, scene: Scene) -> dict[str, Any]:
    """One primitive tested alone."""
    return {
        **_ids(tried, scene),
        "t": _finite(tried.t),
        "decided_by": tried.decided_by,
        "t_off": _finite(tried.error) if math.isfinite(tried.t) else None,
        "margins": [margin._asdict() for margin in tried.margins],
    }


# ---- as text ----


def probe_to_text(found: Probe, path: str) -> str:
    """A probe as text."""
    film = found.scene.film
    head = f"pixel ({found.x}, {found.y}) of {path}, film {film.width} x {film.height}"
    if found.t_max < 0.0:
        return f"{head}\nno ray: the pixel lies outside the image circle of the {found.scene.camera.type} camera"
    return "\n".join([head, *_ray_lines(found), *_hit_lines(found), *_near_lines(found)])


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


def _near_lines(found: Probe) -> Iterator[str]:
    """Two lines for each primitive tested alone: t, and signed distances to its edges."""
    if not found.tried:
        return
    yield f"near   {len(found.tried)} of {found.prims} primitives, each tested alone; + is inside its outline"
    for tried in found.tried[:MAX_LISTED]:
        where = f"t {tried.t!r:<24} {tried.t.hex():<24}" if math.isfinite(tried.t) else _miss_text(tried)
        exactly = "" if math.isfinite(tried.error) else " (by integers: undecided in float64)"
        yield f"       {where:<51} {_name(tried, found.scene)}{exactly}"
        yield f"         {', '.join(map(_distance_text, tried.margins))}"
    if len(found.tried) > MAX_LISTED:
        yield f"       and {len(found.tried) - MAX_LISTED} less near (--json lists them)"


def _miss_text(tried: PrimitiveResult) -> str:
    return "missed: not within the range of t, or its ends" if tried.out_of_range else "missed"


def _distance_text(margin: EdgeDistance) -> str:
    """A signed edge distance, such as `edge 0-1 +0.0125`."""
    from caster.geometry.edge_distances import EDGE_ON, UNIT_RADII

    if margin.inside == 0.0:
        return f"{margin.of} 0, exactly on it" if margin.of != EDGE_ON else "the ray runs along it"
    return f"{margin.of} {margin.inside:+.6g}" + (" radii" if margin.unit == UNIT_RADII else "")


def _name(found: PixelHit | PrimitiveResult, scene: Scene) -> str:
    shape = scene.shapes[found.shape_id]
    label = f' "{shape.name}"' if shape.name else ""
    return f"shapes[{found.shape_id}] ({shape.type}{label}), prim {found.prim_id}"


def _vector(label: str, values: Iterable[float]) -> Iterator[str]:
    numbers = [float(value) for value in values]
    yield f"{label:<14}{'  '.join(map(repr, numbers))}"
    yield f"{'':<14}{'  '.join(number.hex() for number in numbers)}"

"""One pixel as a scene file of its own: the ray and the primitives it has to do with, every number to the bit."""

import re
import tomllib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from caster.cameras.ray import Ray
from caster.packing import Packed, pack
from caster.placing import as_float32
from caster.scene import Film, Scene
from caster.scene_export import ORDER
from caster.toml_text import toml_of
from caster.wording import SceneError
from mitsuba_ref.judge import Judge
from mitsuba_ref.lambert import way
from mitsuba_ref.rebuilding import rebuilt, same_numbers

TRAILING_ZEROS = re.compile(r"\.?0+(?=p)")  # of a hex float's digits behind the point, which there always is


class Reproducer(NamedTuple):
    """A scene of one pixel, and what of it is not as it was."""

    scene: Scene
    prims: tuple[int, ...]  # numbers of its primitives in the scene it was taken from
    notes: tuple[str, ...]

    def text(self, head: Sequence[str]) -> str:
        """A scene file. head: lines of comment to begin with, the first of which says what the file is for."""
        lines = [*head, *(f"note: {note}" for note in self.notes)]
        comment = "".join(f"# {line}".rstrip() + "\n" for line in lines)
        return comment + "\n" + toml_of(to_the_bit(tomllib.loads(self.scene.to_toml())), ORDER)


def to_the_bit(value: Any) -> Any:
    """Floats as hex floats, in whatever holds them."""
    if isinstance(value, dict):
        return {key: to_the_bit(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_the_bit(each) for each in value]
    return TRAILING_ZEROS.sub("", value.hex()) if isinstance(value, float) else value


def reproducer(judge: Judge, row: int, *, lit: bool = False) -> Reproducer:
    """The ray of one row of the picture, and what it may hit. lit: with lights, and what may cast a shadow on the hit.

    Raises SceneError for a pixel without a ray.
    """
    rays, scene = judge.pair.rays, judge.scene
    if rays.t_max[row] < 0.0:
        raise SceneError("there is no ray through this pixel, so there is nothing to reproduce")
    t_max = float(rays.t_max[row])
    camera = Ray(
        origin=rays.o[row], direction=rays.d[row], t_max=t_max if np.isfinite(t_max) and t_max > 0.0 else None
    )
    prims = tuple(sorted(involved(judge, row, lit)))
    shapes: list[dict[str, Any]] = []
    notes: list[str] = []
    for prim in prims:
        shape, note = shape_of(judge, prim)
        if shape not in shapes:
            shapes.append(shape)
        notes += note
    used = {shape["material"] for shape in shapes if shape.get("material")}
    parts: dict[str, Any] = {
        "film": Film(width=1, height=1),
        "camera": camera,
        "lights": scene.lights if lit else (),
        "materials": {name: scene.materials[name] for name in scene.materials if name in used},
        "shapes": shapes,
        "shading": scene.shading,
        "checks": scene.checks,
    }
    return Reproducer(Scene(**parts), prims, tuple(dict.fromkeys(notes)))


def involved(judge: Judge, row: int, lit: bool = False) -> set[int]:
    """Numbers of the primitives that float32 may hit, that are hit exactly, and that either side names."""
    o, d, t_max = judge.o[row : row + 1], judge.d[row : row + 1], judge.t_max[row : row + 1]
    found = set(judge.theirs.possible_hits(o, d, t_max).prim.tolist())
    for answer in judge.oracle.ask_all(o, d, 0.0, t_max):
        found |= {hit.prim for hit in answer.ties}
    found |= {int(judge.pair.prim[row]), judge.named_by_reference(row)}
    if lit and judge.pair.prim[row] >= 0:
        for light in judge.scene.lights:
            if light.type != "ambient":
                to_light, reach = way(light, judge.point[row : row + 1])
                found |= set(
                    judge.theirs.possible_hits(judge.point[row : row + 1], to_light, reach).prim.tolist()
                )
    return found - {-1}


def shape_of(judge: Judge, prim: int) -> tuple[dict[str, Any], list[str]]:
    """(a description of one primitive that packs to the very same numbers, what could not be kept)."""
    packed = judge.model.packed
    i = int(packed.shape_of(np.array([prim]))[0])
    k = int(prim - packed.first[i])
    name = f"{judge.scene.shape_names()[i]}, prim {k}"
    whole = judge.scene.shapes[i]
    try:
        shape = rebuilt(packed.parts[i], k)
        kept = same_numbers(packed.parts[i], k, pack_one(shape))
    except (SceneError, LookupError):
        shape, kept = {}, False
    if not kept:  # as it was described, with all its primitives
        note = f"{judge.scene.shape_names()[i]} is here as a whole, as it was described"
        return whole.model_dump(by_alias=True, exclude_none=True), [note]
    notes = []
    if type(packed.parts[i]).__name__ == "Planes":
        notes.append(
            "in place of a plane Mitsuba gets a patch of triangles, cut to the rays: here, to this ray alone"
        )
    return shape | {"name": name, "material": whole.material}, notes


def pack_one(shape: dict[str, Any]) -> Packed:
    """The float32 numbers of a description. Raises SceneError."""
    return pack(Scene(camera=Ray(origin=(0, 0, 0), direction=(0, 0, 1)), shapes=[shape]), as_float32)

"""Diffuse shading of a film, tile by tile: a ray from each hit to each light that it faces."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from caster.casting import by_trees, ids_by_place
from caster.kernels.shade import (
    RADIANCE,
    add_ambient,
    add_light,
    aim_at_light,
    find_materials,
    new_shade,
    paint_fields,
)
from caster.kernels.tile import WIDTH, Box, new_tile
from caster.packing import Packed
from caster.plan import Plan
from caster.scene import Scene


@dataclass(frozen=True)
class Room:
    """The numbers of the tile that a thread works on, and of what only some tiles need."""

    tile: np.ndarray = field(default_factory=new_tile)

    @cached_property
    def shade(self) -> np.ndarray:
        return new_shade()

    @cached_property
    def beam(self) -> np.ndarray:
        """A tile of shadow rays."""
        return new_tile()


class Shading:
    """Lambert's law for a scene; `shadow_rays` counts what was cast for it."""

    def __init__(self, scene: Scene, packed: Packed, plan: Plan, image: np.ndarray) -> None:
        self.lights = [light.pack() for light in scene.lights if light.type != "ambient"]
        self.ambient = np.array(
            [light.radiance for light in scene.lights if light.type == "ambient"]
        ).reshape(-1, 3)
        self.cast = by_trees(packed, any_hit=True) if plan.shadows.runs else None
        self.shapes = packed.shape_of(ids_by_place(packed))
        self.tables = material_tables(scene)
        self.image = image
        self._aimed: list[int] = []  # one a tile and light: threads only append

    @property
    def shadow_rays(self) -> int:
        return sum(self._aimed)

    def __call__(self, room: Room, box: Box) -> None:
        """Paint the image of a tile whose hits and, if there are lights, surfaces are known."""
        tile, shade = room.tile, room.shade
        find_materials(tile, box, self.shapes, *self.tables, shade)
        for light in self.lights:
            count = aim_at_light(light, tile, box, shade, room.beam)
            if count and self.cast:
                self._aimed.append(count)
                self.cast((box[3] - box[1]) * WIDTH, room.beam)
            if count:
                add_light(tile, box, shade, room.beam)
        if len(self.ambient):
            add_ambient(tile, box, shade, self.ambient)
        paint_fields(tile, box, shade, int(RADIANCE), self.image)


def material_tables(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """By shape: reflectance (n, 3), and whether both sides are lit (n,)."""
    materials = [scene.material_of(shape) for shape in scene.shapes]
    reflectance = np.array([material.reflectance for material in materials]).reshape(-1, 3)
    return reflectance, np.array([material.two_sided for material in materials], bool)

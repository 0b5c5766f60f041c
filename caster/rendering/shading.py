"""AOVs of the nearest hits of a tile: surfaces, materials, shadow rays, per-hit kernels.

A film consists of tiles of its camera's rays; an array of rays is shaded as a film that is WIDTH pixels wide.
"""

import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from caster.aovs import BY_NAME, KERNELS
from caster.geometry.packing import Packed
from caster.jit.command_list import Command, command
from caster.kernels.nearest import Rays
from caster.kernels.raster.screen_bounds import Window
from caster.kernels.raster.tile import (
    BOX,
    COUNT,
    DX,
    DY,
    DZ,
    NORMALS,
    OX,
    OY,
    OZ,
    SURFACES,
    SURFACES_WITH_UV,
    T_MAX,
    T_MIN,
    UNCERTAIN,
    Box,
    T,
    kind_numbers,
)
from caster.kernels.surface.lighting import add_ambient, add_light, materials_in_tile, shadow_rays_in_tile
from caster.kernels.surface.per_hit import NO_IDS, PrimitiveIds, flip_normals_in_tile, surfaces_in_tile, write_aov
from caster.kernels.surface.texturing import textures_in_tile
from caster.rendering.casting import exact_nearest
from caster.rendering.ray_tiles import TileCaster, TileWorkspace, placed_kinds
from caster.rendering.threads import unwritten_array
from caster.scene.model import Scene
from caster.scene.textures import texture_arrays


def new_image(name: str, window: Window, dtype: type[np.floating]) -> np.ndarray:
    """The image of an AOV, (h, w), or (h, w, c) for several channels; a TileShader writes all of its pixels."""
    aov = BY_NAME[name]
    shape = (window.height, window.width)
    channels = () if len(aov.CHANNELS) == 1 else (len(aov.CHANNELS),)
    return unwritten_array(shape + channels, aov.DTYPE if aov.DTYPE is np.int32 else dtype)


class TileShader:
    """Writes the AOVs of tiles whose rays and nearest hits are known.

    images: by AOV, uninitialised. of_rays: the tiles are those of an array of rays, whose depth counts from T_MIN, and
    uncertain shadows are decided at once; otherwise depth counts from 0, and their pixels become UNCERTAIN.
    """

    def __init__(
        self, scene: Scene, packed: Packed, images: Mapping[str, np.ndarray], *, of_rays: bool = False
    ) -> None:
        self.images, self._packed, self._of_rays = images, packed, of_rays
        needs = {field for name in images for field in BY_NAME[name].NEEDS}
        self._ids = NO_IDS
        if packed.kinds and needs & {"shape_id", "prim_id"}:
            self._ids = PrimitiveIds(packed.prim_shapes, packed.index_in_shape(packed.prim_ids))
        shaded = packed.kinds and needs & {"albedo", "radiance"}
        self._materials = None
        if shaded:
            materials = [scene.material_of(shape) for shape in scene.shapes]
            reflectance = np.array([material.color for material in materials]).reshape(-1, 3)
            self._materials = reflectance, np.array([material.two_sided for material in materials], bool)
        self._textures = None
        if shaded and any(scene.textures):
            derived = packed.kinds[0].derived  # goes with the packed numbers
            if "textures" not in derived:
                derived["textures"] = texture_arrays(scene.textures, packed)
            self._textures = derived["textures"]
        self._shadow_rays: list[np.ndarray] = []  # one a thread and light: threads only append
        lights = scene.lights if "radiance" in needs and packed.kinds else ()
        pixels = max((math.prod(image.shape[:2]) for image in images.values()), default=0)
        self._lights: list[tuple[Any, TileCaster | None]] = []  # and the casters of their shadow rays
        for light in (each.pack() for each in lights if each.type != "ambient"):
            caster = TileCaster(packed, any_hit=True, light=light, rays=pixels) if scene.shading.shadows else None
            self._lights.append((light, caster))
        self._ambient = np.array([light.radiance for light in lights if light.type == "ambient"]).reshape(-1, 3)
        # what is computed of each hit's surface: NORMALS, SURFACES or SURFACES_WITH_UV; None: nothing
        self.surfaces: int | None = None
        if self._textures is not None or "uv" in needs:
            self.surfaces = SURFACES_WITH_UV
        elif self._lights or needs & {"position", "shading_normal"}:
            self.surfaces = SURFACES
        elif "normal" in needs:
            self.surfaces = NORMALS

    @property
    def shadow_rays(self) -> int:
        """Shadow rays cast so far."""
        return sum(int(total[0]) for total in self._shadow_rays)

    def prepare(self, threads: int | None) -> None:
        """Prepare the casters of shadow rays on all threads, since the first tile would prepare them on one."""
        for _, caster in self._lights:
            if caster is not None:
                caster.prepare(threads)

    def commands(self, ws: TileWorkspace) -> Iterator[Command]:
        """Commands that write the AOVs of tiles in a workspace."""
        packed = self._packed
        if not packed.kinds:
            yield from self.miss_commands()
            return
        if self.surfaces is not None:
            for k, (kind, first) in enumerate(placed_kinds(packed)):
                about = kind.prims, (first, first + len(kind.ids)), ws.tile, BOX, ws.surface, ws.lanes
                yield command(surfaces_in_tile, *about, self.surfaces, when=kind_numbers(k).present)
            if packed.flipped is not None:
                yield command(flip_normals_in_tile, ws.tile, BOX, packed.flipped[packed.prim_shapes], ws.surface)
        if self._materials is not None:
            yield command(materials_in_tile, ws.tile, BOX, packed.prim_shapes, *self._materials, ws.surface)
        if self._textures is not None:
            yield command(textures_in_tile, ws.tile, BOX, packed.prim_shapes, self._textures, ws.surface)
        for light, caster in self._lights:
            yield from self._add_light(light, caster, ws)
        if len(self._ambient):
            yield command(add_ambient, ws.tile, BOX, ws.surface, self._ambient)
        for name, image in self.images.items():
            yield command(write_aov, KERNELS[name], ws.tile, BOX, ws.surface, self._ids, self._of_rays, image)

    def miss_commands(self) -> list[Command]:
        """Commands that write the AOVs of tiles without hits."""

        def fill(box: Box) -> None:
            x0, y0, x1, y1 = box
            for name, image in self.images.items():
                image[y0:y1, x0:x1] = BY_NAME[name].MISS

        return [Command(fill, (BOX,))]

    def _add_light(self, light: Any, caster: TileCaster | None, ws: TileWorkspace) -> Iterator[Command]:
        """Add a light at the hits that it reaches; without shadows if there is no caster."""
        packed, total = self._packed, np.zeros(1, np.int64)
        about = light, ws.tile, BOX, packed.prim_shapes, packed.shape_extents, ws.surface, ws.shadow_tile, total
        find = command(shadow_rays_in_tile, *about)
        yield find
        any_ray = find.call.answered
        if caster is not None:
            self._shadow_rays.append(total)
            yield from caster.commands(ws.shadow_tile, ws.ray_groups, any_ray)
            if self._of_rays:
                yield Command(partial(decide_shadows, packed, ws.shadow_tile), (COUNT,), any_ray)
        yield command(add_light, ws.tile, BOX, ws.surface, ws.shadow_tile, when=any_ray)


def decide_shadows(packed: Packed, shadow_tile: np.ndarray, count: int) -> None:
    """Decide exactly which of the first `count` shadow rays of a tile are blocked where float64 is uncertain."""

    def values(field: Any) -> np.ndarray:
        return shadow_tile[int(field) : int(field) + count]

    rows = np.flatnonzero((values(UNCERTAIN) != 0.0) & (values(T) == np.inf))
    if len(rows):
        o, d = (np.stack([values(axis)[rows] for axis in axes], axis=1) for axes in ((OX, OY, OZ), (DX, DY, DZ)))
        blocked = exact_nearest(packed, Rays(o, d, values(T_MIN)[rows], values(T_MAX)[rows]), 1).prim >= 0
        values(T)[rows] = np.where(blocked, 0.0, np.inf)
        values(UNCERTAIN)[rows] = 0.0

"""From the nearest hits of a tile to AOVs: surfaces, materials, shadow rays, per-hit kernels.

One way for all rays: a film is tiles of its camera's rays; an array of rays is a film that is WIDTH pixels wide.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np

from caster.aovs import BY_NAME, kernel_of
from caster.geometry.packing import Packed
from caster.jit.decorators import implements
from caster.kernels.nearest import Rays
from caster.kernels.protocol import fast_surface
from caster.kernels.raster.screen_bounds import Window
from caster.kernels.raster.tile import (
    DX,
    DY,
    DZ,
    OX,
    OY,
    OZ,
    T_MAX,
    T_MIN,
    UNCERTAIN,
    WIDTH,
    Box,
    T,
    new_tile,
)
from caster.kernels.surface.lanes import new_lanes
from caster.kernels.surface.lighting import add_ambient, add_light, materials_in_tile, shadow_rays_in_tile
from caster.kernels.surface.normals import normals_in_tile
from caster.kernels.surface.per_hit import (
    NO_IDS,
    PrimitiveIds,
    fill_miss,
    new_surface_buffer,
    surfaces_in_tile,
    surfaces_in_tile_by_lanes,
    write_aov,
)
from caster.rendering.casting import exact_nearest, prim_offsets, scene_prim_ids, tile_caster
from caster.rendering.plan import Plan
from caster.scene.model import Scene

NO_START = np.empty((0, 0))

# Shared by all AOVs that need no field of it, and never written.
UNUSED_SURFACE = new_surface_buffer()


@dataclass(frozen=True)
class TileWorkspace:
    """Buffers of one thread: the tile it works on, and what only some AOVs need."""

    tile: np.ndarray = field(default_factory=new_tile)

    @cached_property
    def surface(self) -> np.ndarray:
        return new_surface_buffer()

    @cached_property
    def lanes(self) -> np.ndarray:
        return new_lanes()

    @cached_property
    def shadow_tile(self) -> np.ndarray:
        return new_tile()


Step = Callable[[TileWorkspace, Box], None]


def new_image(name: str, window: Window, dtype: type[np.floating]) -> np.ndarray:
    """The image of an AOV, (h, w), or (h, w, c) for several channels; a TileShader writes all of its pixels."""
    aov = BY_NAME[name]
    shape = (window.height, window.width)
    channels = () if len(aov.CHANNELS) == 1 else (len(aov.CHANNELS),)
    return np.empty(shape + channels, aov.DTYPE if aov.DTYPE is np.int32 else dtype)


class TileShader:
    """Writes the AOVs of tiles whose rays and nearest hits are known.

    images: by AOV, new ones. reach: no coordinate of an origin is larger; inf where d need not be of length 1.
    start: (h, w) what depth counts from. exact_shadows: decide at once where float64 leaves open whether a point is
    lit; otherwise its pixel gets UNCERTAIN.
    """

    def __init__(
        self,
        scene: Scene,
        packed: Packed,
        plan: Plan,
        images: Mapping[str, np.ndarray],
        *,
        reach: float = np.inf,
        start: np.ndarray = NO_START,
        exact_shadows: bool = False,
    ) -> None:
        self.images, self.start, self.reach = images, start, reach
        self._shadow_rays: list[int] = []  # one a tile and light: threads only append
        self.normals_alone = plan.surfaces == ("normals",) and not start.size
        self.ids = _primitive_ids(packed, plan.needs)
        self.steps: list[Step] = []
        if packed.kinds:
            self.steps += self._surface_steps(packed, plan)
            if plan.needs & {"albedo", "radiance"}:
                self.steps += self._material_steps(scene, packed)
            if "radiance" in plan.needs:
                self.steps += self._light_steps(scene, packed, plan, exact_shadows)
            self.steps += [step for name in images for step in self._writers(name, packed, plan)]
        else:
            self.steps.append(lambda workspace, box: self.fill_miss(box))

    @property
    def shadow_rays(self) -> int:
        """Shadow rays cast so far."""
        return sum(self._shadow_rays)

    def __call__(self, workspace: TileWorkspace, box: Box) -> None:
        for step in self.steps:
            step(workspace, box)

    def fill_miss(self, box: Box) -> None:
        """AOVs of a tile where nothing is hit."""
        for name, image in self.images.items():
            fill_miss(kernel_of(name), box, image)

    def _surface_steps(self, packed: Packed, plan: Plan) -> list[Step]:
        if not plan.surfaces or self.normals_alone:
            return []
        wants_uv = "uv" in plan.surfaces
        return [_surface_step(prims, numbers, wants_uv) for prims, numbers in kind_ranges(packed)]

    def _material_steps(self, scene: Scene, packed: Packed) -> list[Step]:
        shapes, (reflectance, two_sided) = shape_by_primitive(packed), material_tables(scene)
        return [lambda ws, box: materials_in_tile(ws.tile, box, shapes, reflectance, two_sided, ws.surface)]

    def _light_steps(self, scene: Scene, packed: Packed, plan: Plan, exact: bool) -> list[Step]:
        cast = tile_caster(packed, any_hit=True) if plan.shadows.runs else None
        steps: list[Step] = [
            partial(self._add_light, light.pack(), cast, packed if exact else None)
            for light in scene.lights
            if light.type != "ambient"
        ]
        ambient = np.array([light.radiance for light in scene.lights if light.type == "ambient"]).reshape(
            -1, 3
        )
        if len(ambient):
            steps.append(lambda ws, box: add_ambient(ws.tile, box, ws.surface, ambient))
        return steps

    def _add_light(
        self, light: Any, cast: Any, exact: Packed | None, workspace: TileWorkspace, box: Box
    ) -> None:
        """Radiance of what a light reaches."""
        tile, surface, shadow_tile = workspace.tile, workspace.surface, workspace.shadow_tile
        count = shadow_rays_in_tile(light, tile, box, surface, shadow_tile)
        if count and cast:
            self._shadow_rays.append(count)
            cast((box[3] - box[1]) * WIDTH, shadow_tile)
            if exact:
                decide_shadows(exact, shadow_tile, (box[3] - box[1]) * WIDTH)
        if count:
            add_light(tile, box, surface, shadow_tile)

    def _writers(self, name: str, packed: Packed, plan: Plan) -> list[Step]:
        kernel, image, ids, start = kernel_of(name), self.images[name], self.ids, self.start
        if self.normals_alone and "normal" in BY_NAME[name].NEEDS:
            return [
                _normal_step(kernel, prims, numbers, self.reach, image)
                for prims, numbers in kind_ranges(packed)
            ]
        if set(BY_NAME[name].NEEDS) <= {"shape_id", "prim_id"}:
            return [lambda ws, box: write_aov(kernel, ws.tile, box, UNUSED_SURFACE, ids, start, image)]
        return [lambda ws, box: write_aov(kernel, ws.tile, box, ws.surface, ids, start, image)]


def kind_ranges(packed: Packed) -> list[tuple[Any, tuple[int, int]]]:
    """(primitives, their numbers in a tile: first, last + 1) of each kind."""
    offsets = zip(packed.kinds, prim_offsets(packed), strict=True)
    return [(kind.prims, (first, first + len(kind.ids))) for kind, first in offsets]


def _surface_step(prims: Any, numbers: tuple[int, int], wants_uv: bool) -> Step:
    if implements(fast_surface, type(prims)) and not wants_uv:
        return lambda ws, box: surfaces_in_tile_by_lanes(prims, numbers, ws.tile, box, ws.surface, ws.lanes)
    return lambda ws, box: surfaces_in_tile(prims, numbers, ws.tile, box, ws.surface, wants_uv)


def _normal_step(kernel: Any, prims: Any, numbers: tuple[int, int], reach: float, image: np.ndarray) -> Step:
    return lambda ws, box: normals_in_tile(kernel, prims, numbers, reach, ws.tile, box, image)


def decide_shadows(packed: Packed, shadow_tile: np.ndarray, count: int) -> None:
    """Of the first `count` shadow rays of a tile, decide exactly those that float64 left open."""

    def values(field: Any) -> np.ndarray:
        return shadow_tile[int(field) : int(field) + count]

    rows = np.flatnonzero((values(UNCERTAIN) != 0.0) & (values(T) == np.inf))
    if len(rows):
        o, d = (
            np.stack([values(axis)[rows] for axis in axes], axis=1) for axes in ((OX, OY, OZ), (DX, DY, DZ))
        )
        blocked = exact_nearest(packed, Rays(o, d, values(T_MIN)[rows], values(T_MAX)[rows]), 1).prim >= 0
        values(T)[rows] = np.where(blocked, 0.0, np.inf)
        values(UNCERTAIN)[rows] = 0.0


def shape_by_primitive(packed: Packed) -> np.ndarray:
    """Shape of each primitive, by its number in a tile: int32."""
    return packed.shape_of(scene_prim_ids(packed))


def _primitive_ids(packed: Packed, needs: frozenset[str]) -> PrimitiveIds:
    if not packed.kinds or not needs & {"shape_id", "prim_id"}:
        return NO_IDS
    ids = scene_prim_ids(packed)
    shapes = packed.shape_of(ids)
    numbers = (ids - packed.first[shapes]).astype(np.int32)
    return PrimitiveIds(
        shapes if "shape_id" in needs else NO_IDS.shape, numbers if "prim_id" in needs else NO_IDS.prim
    )


def material_tables(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """By shape: reflectance (n, 3), and whether both sides are lit (n,)."""
    materials = [scene.material_of(shape) for shape in scene.shapes]
    reflectance = np.array([material.reflectance for material in materials]).reshape(-1, 3)
    return reflectance, np.array([material.two_sided for material in materials], bool)

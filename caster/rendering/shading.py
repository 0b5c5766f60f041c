"""From the nearest hits of a tile to AOVs: surfaces, materials, shadow rays, per-hit kernels.

One way for all rays: a film is tiles of its camera's rays; an array of rays is a film that is WIDTH pixels wide.
"""

import ctypes
import math
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import compress
from typing import Any

import numpy as np

from caster.aovs import BY_NAME, kernel_of
from caster.geometry.packing import Packed
from caster.jit.decorators import implements
from caster.kernels.bvh.fans import RayGroups
from caster.kernels.nearest import Rays
from caster.kernels.protocol import fast_surface, fast_uv
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
    new_lanes,
    new_tile,
)
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
from caster.rendering.casting import (
    ShadowCaster,
    exact_nearest,
    new_ray_groups,
    prim_offsets,
    scene_prim_ids,
)
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

    @cached_property
    def ray_groups(self) -> RayGroups:
        return new_ray_groups()


MAX_SPARE_WORKSPACES = 16  # 3 MB each

_SPARE_WORKSPACES: list[TileWorkspace] = []


@contextmanager
def spare_workspaces() -> Iterator[Callable[[], TileWorkspace]]:
    """Gives a function that returns a workspace, with what an earlier film left in it; they are spare afterwards."""
    taken: list[TileWorkspace] = []

    def take() -> TileWorkspace:
        workspace = None
        with suppress(IndexError):
            workspace = _SPARE_WORKSPACES.pop()
        taken.append(workspace or TileWorkspace())
        return taken[-1]

    yield take
    _SPARE_WORKSPACES.extend(taken[: max(MAX_SPARE_WORKSPACES - len(_SPARE_WORKSPACES), 0)])


# Memory of images that nobody holds any more is written again by later ones: for new memory, the system clears and maps
# each page when it is first written, which takes longer than most AOVs.
MAX_SPARE_BYTES = 1 << 27  # five images of 1024 x 1024 vectors in float64
MIN_SPARE_BYTES = 1 << 17  # of one image; smaller ones come from memory that the process has anyway

_SPARE_BLOCKS: dict[int, np.ndarray] = {}  # by id, oldest first


def unwritten_array(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Any numbers; once nothing refers to the array or a view of it, its memory may become that of another."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < MIN_SPARE_BYTES:
        return np.empty(shape, dtype)
    block = _take_block(size)
    owner = (ctypes.c_char * size).from_address(block.ctypes.data)
    weakref.finalize(owner, _give_back_block, block).atexit = False
    return np.frombuffer(owner, dtype).reshape(shape)


def _take_block(size: int) -> np.ndarray:
    for key, block in list(_SPARE_BLOCKS.items()):
        if block.nbytes == size and _SPARE_BLOCKS.pop(key, None) is not None:  # else another thread took it
            return block
    return np.empty(size, np.uint8)


def _give_back_block(block: np.ndarray) -> None:
    """Keep it as long as newer ones leave space. Called by whatever drops an image, in any thread, at any time."""
    _SPARE_BLOCKS[id(block)] = block
    spare = list(_SPARE_BLOCKS.items())
    excess = sum(each.nbytes for _, each in spare) - MAX_SPARE_BYTES
    for key, each in spare:
        if excess > 0:
            excess -= each.nbytes
            _SPARE_BLOCKS.pop(key, None)


Present = Sequence[bool]  # by the place of a kind in Packed.kinds: whether it may be hit in a tile
Step = Callable[[TileWorkspace, Box, Present], None]


def new_image(name: str, window: Window, dtype: type[np.floating]) -> np.ndarray:
    """The image of an AOV, (h, w), or (h, w, c) for several channels; a TileShader writes all of its pixels."""
    aov = BY_NAME[name]
    shape = (window.height, window.width)
    channels = () if len(aov.CHANNELS) == 1 else (len(aov.CHANNELS),)
    return unwritten_array(shape + channels, aov.DTYPE if aov.DTYPE is np.int32 else dtype)


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
        self.steps: list[Step] = [partial(_fill_misses, images)]
        self._anywhere = [True] * len(packed.kinds)
        if packed.kinds:
            self.steps = self._surface_steps(packed, plan)
            if plan.needs & {"albedo", "radiance"}:
                self.steps += self._material_steps(scene, packed)
            if "radiance" in plan.needs:
                self.steps += self._light_steps(scene, packed, plan, exact_shadows)
            self.steps += [self._writer(name, packed) for name in images]

    @property
    def shadow_rays(self) -> int:
        """Shadow rays cast so far."""
        return sum(self._shadow_rays)

    def __call__(self, workspace: TileWorkspace, box: Box, present: Present | None = None) -> None:
        """present: None: any kind may be hit."""
        for step in self.steps:
            step(workspace, box, present or self._anywhere)

    def fill_miss(self, box: Box) -> None:
        """AOVs of a tile where nothing is hit."""
        _fill_misses(self.images, None, box, ())

    def _surface_steps(self, packed: Packed, plan: Plan) -> list[Step]:
        if not plan.surfaces or self.normals_alone:
            return []
        wants_uv = "uv" in plan.surfaces
        return [partial(_find_surfaces, kind_ranges(packed), wants_uv)]

    def _material_steps(self, scene: Scene, packed: Packed) -> list[Step]:
        shapes, (reflectance, two_sided) = shape_by_primitive(packed), material_tables(scene)
        return [
            lambda ws, box, _: materials_in_tile(ws.tile, box, shapes, reflectance, two_sided, ws.surface)
        ]

    def _light_steps(self, scene: Scene, packed: Packed, plan: Plan, exact: bool) -> list[Step]:
        pixels = max((math.prod(image.shape[:2]) for image in self.images.values()), default=0)
        shapes, extents = shape_by_primitive(packed), packed.shape_extents
        steps: list[Step] = [
            partial(
                _add_light,
                light,
                ShadowCaster(packed, light, pixels) if plan.shadows.runs else None,
                packed if exact else None,
                self._shadow_rays,
                shapes,
                extents,
            )
            for light in (each.pack() for each in scene.lights if each.type != "ambient")
        ]
        ambient = np.array([light.radiance for light in scene.lights if light.type == "ambient"]).reshape(
            -1, 3
        )
        if len(ambient):
            steps.append(lambda ws, box, _: add_ambient(ws.tile, box, ws.surface, ambient))
        return steps

    def _writer(self, name: str, packed: Packed) -> Step:
        kernel, image, ids, start = kernel_of(name), self.images[name], self.ids, self.start
        if self.normals_alone and "normal" in BY_NAME[name].NEEDS:
            return partial(_write_normals, kernel, kind_ranges(packed), self.reach, image)
        if set(BY_NAME[name].NEEDS) <= {"shape_id", "prim_id"}:
            return lambda ws, box, _: write_aov(kernel, ws.tile, box, UNUSED_SURFACE, ids, start, image)
        return lambda ws, box, _: write_aov(kernel, ws.tile, box, ws.surface, ids, start, image)


def _fill_misses(images: Mapping[str, np.ndarray], workspace: Any, box: Box, present: Present) -> None:
    for name, image in images.items():
        fill_miss(kernel_of(name), box, image)


KindRange = tuple[Any, tuple[int, int]]


def kind_ranges(packed: Packed) -> list[KindRange]:
    """(primitives, their numbers in a tile: first, last + 1) of each kind."""
    offsets = zip(packed.kinds, prim_offsets(packed), strict=True)
    return [(kind.prims, (first, first + len(kind.ids))) for kind, first in offsets]


def _add_light(
    light: Any,
    cast: ShadowCaster | None,
    exact: Packed | None,
    counts: list[int],
    shapes: np.ndarray,
    extents: np.ndarray,
    workspace: TileWorkspace,
    box: Box,
    present: Present,
) -> None:
    """Radiance of what a light reaches; `counts` gets the number of shadow rays."""
    tile, surface, shadow_tile = workspace.tile, workspace.surface, workspace.shadow_tile
    count = shadow_rays_in_tile(light, tile, box, shapes, extents, surface, shadow_tile)
    if count and cast:
        counts.append(count)
        cast((box[3] - box[1]) * WIDTH, shadow_tile, workspace.ray_groups)
        if exact:
            decide_shadows(exact, shadow_tile, (box[3] - box[1]) * WIDTH)
    if count:
        add_light(tile, box, surface, shadow_tile)


def _find_surfaces(
    kinds: list[KindRange], wants_uv: bool, workspace: TileWorkspace, box: Box, present: Present
) -> None:
    for prims, numbers in compress(kinds, present):
        tile, surface = workspace.tile, workspace.surface
        if implements(fast_surface, type(prims)) and (implements(fast_uv, type(prims)) or not wants_uv):
            surfaces_in_tile_by_lanes(prims, numbers, tile, box, surface, workspace.lanes, wants_uv)
        else:
            surfaces_in_tile(prims, numbers, tile, box, surface, wants_uv)


def _write_normals(
    kernel: Any,
    kinds: list[KindRange],
    reach: float,
    image: np.ndarray,
    workspace: TileWorkspace,
    box: Box,
    present: Present,
) -> None:
    """An AOV of normals alone, kind by kind; the first writes the misses."""
    for n, (prims, numbers) in enumerate(compress(kinds, present)):
        normals_in_tile(kernel, prims, numbers, reach, workspace.tile, box, n == 0, image)


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

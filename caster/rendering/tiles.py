"""Diffuse shading of a film, tile by tile: a ray from each hit to each light that it faces."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np

from caster.aovs import BY_NAME
from caster.description.errors import SceneError, listed
from caster.description.fields import Camera
from caster.geometry.packing import Packed
from caster.kernels.nearest import new_rays
from caster.kernels.raster.screen_bounds import Window
from caster.kernels.raster.tile import WIDTH, Box, generate_camera_rays, new_tile
from caster.kernels.raster.tile_casting import cast_own_origins, cast_shared_origin
from caster.kernels.surface.lighting import (
    RADIANCE,
    SH_N,
    UV,
    N,
    P,
    add_ambient,
    add_light,
    materials_in_tile,
    new_shade,
    paint_fields,
    shadow_rays_in_tile,
    surfaces_in_tile,
)
from caster.kernels.surface.normals import (
    film_from_one_point,
    film_in_one_direction,
    paint_albedo,
    paint_normals,
    paint_nothing,
    paint_numbers,
    paint_seen,
)
from caster.kernels.surface.surfaces import generate_rays_at
from caster.rendering.casting import exact_nearest, prim_offsets, scene_prim_ids, tile_caster
from caster.rendering.plan import Plan
from caster.rendering.rasterization import (
    BinnedKind,
    bin_kinds,
    cast_tile,
    parallel_for_tiles,
    release_workspace,
)
from caster.rendering.threads import parallel_for_pieces, thread_count
from caster.rendering.view import View
from caster.scene.model import Scene


@dataclass(frozen=True)
class TileWorkspace:
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
        self.cast = tile_caster(packed, any_hit=True) if plan.shadows.runs else None
        self.shapes = packed.shape_of(scene_prim_ids(packed))
        self.tables = material_tables(scene)
        self.image = image
        self._aimed: list[int] = []  # one a tile and light: threads only append

    @property
    def shadow_rays(self) -> int:
        return sum(self._aimed)

    def __call__(self, room: TileWorkspace, box: Box) -> None:
        """Paint the image of a tile whose hits and, if there are lights, surfaces are known."""
        tile, shade = room.tile, room.shade
        materials_in_tile(tile, box, self.shapes, *self.tables, shade)
        for light in self.lights:
            count = shadow_rays_in_tile(light, tile, box, shade, room.beam)
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


# AOVs of a film, tile by tile: rays, hits and what is asked about them, while they are in a core's cache.
#
# The same bits as `rendering.evaluate` gives, which takes one step after the other for the whole film.


CHANNELS = {"position": 3, "normal": 3, "shading_normal": 3, "uv": 2, "albedo": 3, "diffuse": 3}
ID_AOVS = ("shape_id", "prim_id")
FIELDS = {"position": P, "normal": N, "shading_normal": SH_N, "uv": UV}
COMPUTED = ("hit", "depth", *CHANNELS, *ID_AOVS)

Painter = Callable[[TileWorkspace, Box], None]
# Hears of the pixels that have been painted, a number at a time, from any thread.
OnProgress = Callable[[int], None] | None


@dataclass(frozen=True)
class FilmResult:
    """A film with all its pixels."""

    images: dict[str, np.ndarray]
    hit: np.ndarray  # (h, w) bool
    doubtful: int  # pixels whose answer had to be found exactly
    shadow_rays: int
    on_film: (
        tuple[int, ...] | None
    )  # of each kind, the primitives that some pixel was tried for; None: no such list


@dataclass(frozen=True)
class FilmTarget:
    """A film in the making."""

    scene: Scene
    packed: Packed
    camera: Any  # packed
    window: Window
    images: dict[str, np.ndarray]  # by AOV, but for hit
    hit: np.ndarray  # (h, w) bool
    doubt: np.ndarray  # (h, w) bool, pixels that have to be found exactly
    threads: int | None
    told: OnProgress

    def image(self, name: str, channels: tuple[int, ...] = ()) -> np.ndarray:
        """The image of an AOV; one without size if it was not asked for. channels: (3,) where it has three."""
        return self.images[name] if name in self.images else np.empty((0, 0, *channels))


def render_tiles(
    scene: Scene,
    packed: Packed,
    window: Window,
    aovs: Sequence[str],
    plan: Plan,
    threads: int | None = None,
    dtype: type[np.floating] = np.float64,
    told: OnProgress = None,
) -> FilmResult:
    """The AOVs as planned, by the cullings "screen" (for cameras that can tell where they show a ball) or "bvh".

    Raises SceneError for an AOV of the registry that is not computed here: its image would stay unset.
    """
    for name in aovs:
        if name not in COMPUTED:
            known = listed(COMPUTED, "and")
            raise SceneError(f"aov {name!r}: render does not compute it for a film; it computes {known}")
    camera = scene.camera.pack(scene.film.width, scene.film.height)
    hit, doubt = (np.zeros((window.height, window.width), bool) for _ in range(2))
    images = {name: _blank(name, window, dtype) for name in aovs if name != "hit"}
    canvas = FilmTarget(scene, packed, camera, window, images, hit, doubt, threads, told)
    reach, shadow_rays = _farthest_origin(camera, window), 0
    kinds = bin_kinds(packed, camera, window, reach, threads) if plan.culling == "screen" else None
    if kinds and len(kinds) == 1 and images.keys() <= {"depth", "normal"}:
        _render_depth_normal(canvas, kinds[0], reach)
    else:
        shadow_rays = _render_aovs(canvas, plan, kinds, reach)
    doubtful = _resolve_uncertain(canvas)
    if "hit" in aovs:
        images["hit"] = hit.astype(dtype)
    on_film = None if kinds is None else tuple(it.seen for it in kinds)
    release_workspace(kinds or [])
    return FilmResult(images, hit, doubtful, shadow_rays, on_film)


CHUNKS_PER_THREAD = (
    8  # for each thread: so few that steps of Python do not count, enough to share the work evenly
)


def _render_depth_normal(canvas: FilmTarget, it: BinnedKind, reach: float) -> None:
    """Depth and normals of a scene of one kind."""
    camera, window = canvas.camera, canvas.window
    film = film_from_one_point if canvas.scene.camera.shares_origin else film_in_one_direction
    images = canvas.hit, canvas.doubt, canvas.image("depth"), canvas.image("normal", (3,))
    kind = it.kind.prims, it.order, it.runs, it.spans
    workers, count = thread_count(canvas.threads), len(it.runs) - 1
    edges = np.linspace(0, count, min(count, workers * CHUNKS_PER_THREAD) + 1).astype(int).tolist()

    def begin() -> Callable[[tuple[int, int]], None]:
        tile = new_tile()
        return lambda tiles: film(camera, window, kind, reach, tiles, tile, images)

    told, pixels = canvas.told, window.width * window.height

    def done(tiles: tuple[int, int]) -> None:
        assert told is not None
        told(
            pixels * tiles[1] // count - pixels * tiles[0] // count
        )  # their share; all of them together are all

    parallel_for_pieces(begin, list(pairwise(edges)), workers, done if told else None)


def _render_aovs(canvas: FilmTarget, plan: Plan, kinds: list[BinnedKind] | None, reach: float) -> int:
    """Anything else, one step after the other for each tile; how many shadow rays that took. kinds: None for trees."""
    scene, packed, images = canvas.scene, canvas.packed, canvas.images
    seek, depth = _seeker(canvas, kinds), canvas.image("depth")
    painters = _painters(scene, packed, reach, images, plan.surfaces)
    shading = (
        Shading(scene, packed, plan, images["diffuse"]) if "diffuse" in images and packed.kinds else None
    )
    if shading:
        painters.append(shading)

    def work(number: int, box: Box, room: TileWorkspace) -> None:
        if kinds is not None and not any(it.runs[number] < it.runs[number + 1] for it in kinds):
            paint_nothing(box, depth)
            return
        generate_camera_rays(canvas.camera, canvas.window, box, room.tile)
        seek(number, box, room.tile)
        for paint in painters:
            paint(room, box)
        paint_seen(room.tile, box, canvas.hit, canvas.doubt, depth)  # last: shading has doubts of its own

    parallel_for_tiles(work, canvas.window, canvas.threads, TileWorkspace, canvas.told)
    return shading.shadow_rays if shading else 0


def _seeker(canvas: FilmTarget, kinds: list[BinnedKind] | None) -> Callable[[int, Box, np.ndarray], None]:
    """What finds the hits of a tile, given its number, its box and its rays."""
    if kinds is not None:
        cast = cast_shared_origin if canvas.scene.camera.shares_origin else cast_own_origins
        return partial(cast_tile, cast, kinds)
    cast_rows = tile_caster(canvas.packed)
    return lambda number, box, tile: cast_rows((box[3] - box[1]) * WIDTH, tile)


def _resolve_uncertain(canvas: FilmTarget) -> int:
    """Paint the pixels that float64 could not tell, exactly; how many."""
    pixels = np.flatnonzero(canvas.doubt)
    if len(pixels):
        rays = new_rays(len(pixels))
        generate_rays_at(canvas.camera, canvas.window, rays, pixels)
        nearest = exact_nearest(canvas.packed, rays, canvas.threads)
        view = View(canvas.scene, canvas.packed, rays, nearest, np.zeros(len(pixels)), canvas.threads)
        canvas.hit.reshape(-1)[pixels] = view.hit
        for name, image in canvas.images.items():
            with np.errstate(over="ignore", under="ignore"):
                image.reshape(canvas.doubt.size, *image.shape[2:])[pixels] = BY_NAME[name].evaluate(view)
    return len(pixels)


def _blank(name: str, window: Window, dtype: type[np.floating]) -> np.ndarray:
    """An image of nothing; depth is written everywhere."""
    shape = window.height, window.width
    if name in ID_AOVS:
        return np.full(shape, -1, np.int32)
    return np.zeros((*shape, CHANNELS[name]), dtype) if name in CHANNELS else np.empty(shape, dtype)


def _farthest_origin(camera: Any, window: Window) -> float:
    """The largest |coordinate| of an origin, which is one point or linear over the film: at a corner of it."""
    rays = new_rays(4)
    right, bottom = window.width - 1, (window.height - 1) * window.width
    generate_rays_at(camera, window, rays, np.array([0, right, bottom, bottom + right]))
    return float(np.abs(rays.o).max())


def _painters(
    scene: Scene, packed: Packed, reach: float, images: dict[str, np.ndarray], surfaces: tuple[str, ...]
) -> list[Painter]:
    """What finds surfaces or normals and paints the images, but for depth, diffuse and the normals found alone."""
    painters: list[Painter] = []
    for kind, base in zip(packed.kinds, prim_offsets(packed), strict=True):
        places = base, base + len(kind.ids)
        if "position" in surfaces:
            painters.append(_surface_finder(kind.prims, places, "uv" in surfaces))
        elif surfaces:
            # Normals without a branch are for d of length 1, which a camera that looks nowhere may not have.
            far = reach if isinstance(scene.camera, Camera) else np.inf
            painters.append(_normal_painter(kind.prims, places, far, images["normal"]))
    fields = FIELDS if "position" in surfaces else {}
    painters.extend(_field_painter(field, images[name]) for name, field in fields.items() if name in images)
    if packed.kinds and images.keys() & {*ID_AOVS, "albedo"}:
        painters.extend(_number_painters(scene, packed, images))
    return painters


def _surface_finder(prims: Any, places: tuple[int, int], wants_uv: bool) -> Painter:
    return lambda room, box: surfaces_in_tile(prims, places, room.tile, box, room.shade, wants_uv)


def _normal_painter(prims: Any, places: tuple[int, int], reach: float, image: np.ndarray) -> Painter:
    return lambda room, box: paint_normals(prims, places, reach, room.tile, box, image)


def _field_painter(field: Any, image: np.ndarray) -> Painter:
    first = int(field)
    return lambda room, box: paint_fields(room.tile, box, room.shade, first, image)


def _number_painters(scene: Scene, packed: Packed, images: dict[str, np.ndarray]) -> list[Painter]:
    ids = scene_prim_ids(packed)
    shapes = packed.shape_of(ids)
    painters: list[Painter] = []
    if "shape_id" in images:
        painters.append(lambda room, box: paint_numbers(room.tile, box, shapes, images["shape_id"]))
    if "prim_id" in images:
        numbers = (ids - packed.first[shapes]).astype(np.int32)
        painters.append(lambda room, box: paint_numbers(room.tile, box, numbers, images["prim_id"]))
    if "albedo" in images:
        table = material_tables(scene)[0]
        painters.append(lambda room, box: paint_albedo(room.tile, box, shapes, table, images["albedo"]))
    return painters

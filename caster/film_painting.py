"""AOVs of a film, tile by tile: rays, hits and what is asked about them, while they are in a core's cache.

The same bits as `rendering.evaluate` gives, which takes one step after the other for the whole film.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from caster.aovs import BY_NAME
from caster.casting import bases, by_trees, decide, ids_by_place
from caster.fields import Camera, SceneError
from caster.film_casting import Sorted, cast_tile, give_back, in_tiles, sorted_kinds
from caster.film_shading import Room, Shading, material_tables
from caster.kernels.film import film_from_one_point, film_in_one_direction
from caster.kernels.gather import shoot_at
from caster.kernels.nearest import new_rays
from caster.kernels.paint import paint_albedo, paint_normals, paint_nothing, paint_numbers, paint_seen
from caster.kernels.screen import cast_own_origins, cast_shared_origin
from caster.kernels.shade import SH_N, UV, N, P, find_surfaces_in_tile, paint_fields
from caster.kernels.spans import Window
from caster.kernels.tile import WIDTH, Box, new_tile, shoot_rays
from caster.packing import Packed
from caster.plan import Plan
from caster.scene import Scene
from caster.threads import in_turns, thread_count
from caster.view import View
from caster.wording import listed

CHANNELS = {"position": 3, "normal": 3, "shading_normal": 3, "uv": 2, "albedo": 3, "diffuse": 3}
NUMBERS = ("shape_id", "prim_id")
FIELDS = {"position": P, "normal": N, "shading_normal": SH_N, "uv": UV}
COMPUTED = ("hit", "depth", *CHANNELS, *NUMBERS)

Painter = Callable[[Room, Box], None]
# Hears of the pixels that have been painted, a number at a time, from any thread.
Told = Callable[[int], None] | None


@dataclass(frozen=True)
class Painted:
    """A film with all its pixels."""

    images: dict[str, np.ndarray]
    hit: np.ndarray  # (h, w) bool
    doubtful: int  # pixels whose answer had to be found exactly
    shadow_rays: int
    on_film: (
        tuple[int, ...] | None
    )  # of each kind, the primitives that some pixel was tried for; None: no such list


@dataclass(frozen=True)
class Canvas:
    """A film in the making."""

    scene: Scene
    packed: Packed
    camera: Any  # packed
    window: Window
    images: dict[str, np.ndarray]  # by AOV, but for hit
    hit: np.ndarray  # (h, w) bool
    doubt: np.ndarray  # (h, w) bool, pixels that have to be found exactly
    threads: int | None
    told: Told

    def image(self, name: str, channels: tuple[int, ...] = ()) -> np.ndarray:
        """The image of an AOV; one without size if it was not asked for. channels: (3,) where it has three."""
        return self.images[name] if name in self.images else np.empty((0, 0, *channels))


def paint_film(
    scene: Scene,
    packed: Packed,
    window: Window,
    aovs: Sequence[str],
    plan: Plan,
    threads: int | None = None,
    dtype: type[np.floating] = np.float64,
    told: Told = None,
) -> Painted:
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
    canvas = Canvas(scene, packed, camera, window, images, hit, doubt, threads, told)
    reach, shadow_rays = _farthest_origin(camera, window), 0
    kinds = sorted_kinds(packed, camera, window, reach, threads) if plan.culling == "screen" else None
    if kinds and len(kinds) == 1 and images.keys() <= {"depth", "normal"}:
        _paint_at_once(canvas, kinds[0], reach)
    else:
        shadow_rays = _paint_by_steps(canvas, plan, kinds, reach)
    doubtful = _decide_the_rest(canvas)
    if "hit" in aovs:
        images["hit"] = hit.astype(dtype)
    on_film = None if kinds is None else tuple(it.seen for it in kinds)
    give_back(kinds or [])
    return Painted(images, hit, doubtful, shadow_rays, on_film)


TURNS = 8  # for each thread: so few that steps of Python do not count, enough to share the work evenly


def _paint_at_once(canvas: Canvas, it: Sorted, reach: float) -> None:
    """Depth and normals of a scene of one kind."""
    camera, window = canvas.camera, canvas.window
    film = film_from_one_point if canvas.scene.camera.shares_origin else film_in_one_direction
    images = canvas.hit, canvas.doubt, canvas.image("depth"), canvas.image("normal", (3,))
    kind = it.kind.prims, it.order, it.runs, it.spans
    workers, count = thread_count(canvas.threads), len(it.runs) - 1
    edges = np.linspace(0, count, min(count, workers * TURNS) + 1).astype(int).tolist()

    def begin() -> Callable[[tuple[int, int]], None]:
        tile = new_tile()
        return lambda tiles: film(camera, window, kind, reach, tiles, tile, images)

    told, pixels = canvas.told, window.width * window.height

    def done(tiles: tuple[int, int]) -> None:
        assert told is not None
        told(
            pixels * tiles[1] // count - pixels * tiles[0] // count
        )  # their share; all of them together are all

    in_turns(begin, list(pairwise(edges)), workers, done if told else None)


def _paint_by_steps(canvas: Canvas, plan: Plan, kinds: list[Sorted] | None, reach: float) -> int:
    """Anything else, one step after the other for each tile; how many shadow rays that took. kinds: None for trees."""
    scene, packed, images = canvas.scene, canvas.packed, canvas.images
    seek, depth = _seeker(canvas, kinds), canvas.image("depth")
    painters = _painters(scene, packed, reach, images, plan.surfaces)
    shading = (
        Shading(scene, packed, plan, images["diffuse"]) if "diffuse" in images and packed.kinds else None
    )
    if shading:
        painters.append(shading)

    def work(number: int, box: Box, room: Room) -> None:
        if kinds is not None and not any(it.runs[number] < it.runs[number + 1] for it in kinds):
            paint_nothing(box, depth)
            return
        shoot_rays(canvas.camera, canvas.window, box, room.tile)
        seek(number, box, room.tile)
        for paint in painters:
            paint(room, box)
        paint_seen(room.tile, box, canvas.hit, canvas.doubt, depth)  # last: shading has doubts of its own

    in_tiles(work, canvas.window, canvas.threads, Room, canvas.told)
    return shading.shadow_rays if shading else 0


def _seeker(canvas: Canvas, kinds: list[Sorted] | None) -> Callable[[int, Box, np.ndarray], None]:
    """What finds the hits of a tile, given its number, its box and its rays."""
    if kinds is not None:
        cast = cast_shared_origin if canvas.scene.camera.shares_origin else cast_own_origins
        return partial(cast_tile, cast, kinds)
    cast_rows = by_trees(canvas.packed)
    return lambda number, box, tile: cast_rows((box[3] - box[1]) * WIDTH, tile)


def _decide_the_rest(canvas: Canvas) -> int:
    """Paint the pixels that float64 could not tell, exactly; how many."""
    pixels = np.flatnonzero(canvas.doubt)
    if len(pixels):
        rays = new_rays(len(pixels))
        shoot_at(canvas.camera, canvas.window, rays, pixels)
        nearest = decide(canvas.packed, rays, canvas.threads)
        view = View(canvas.scene, canvas.packed, rays, nearest, np.zeros(len(pixels)), canvas.threads)
        canvas.hit.reshape(-1)[pixels] = view.hit
        for name, image in canvas.images.items():
            with np.errstate(over="ignore", under="ignore"):
                image.reshape(canvas.doubt.size, *image.shape[2:])[pixels] = BY_NAME[name].evaluate(view)
    return len(pixels)


def _blank(name: str, window: Window, dtype: type[np.floating]) -> np.ndarray:
    """An image of nothing; depth is written everywhere."""
    shape = window.height, window.width
    if name in NUMBERS:
        return np.full(shape, -1, np.int32)
    return np.zeros((*shape, CHANNELS[name]), dtype) if name in CHANNELS else np.empty(shape, dtype)


def _farthest_origin(camera: Any, window: Window) -> float:
    """The largest |coordinate| of an origin, which is one point or linear over the film: at a corner of it."""
    rays = new_rays(4)
    right, bottom = window.width - 1, (window.height - 1) * window.width
    shoot_at(camera, window, rays, np.array([0, right, bottom, bottom + right]))
    return float(np.abs(rays.o).max())


def _painters(
    scene: Scene, packed: Packed, reach: float, images: dict[str, np.ndarray], surfaces: tuple[str, ...]
) -> list[Painter]:
    """What finds surfaces or normals and paints the images, but for depth, diffuse and the normals found alone."""
    painters: list[Painter] = []
    for kind, base in zip(packed.kinds, bases(packed), strict=True):
        places = base, base + len(kind.ids)
        if "position" in surfaces:
            painters.append(_surface_finder(kind.prims, places, "uv" in surfaces))
        elif surfaces:
            # Normals without a branch are for d of length 1, which a camera that looks nowhere may not have.
            far = reach if isinstance(scene.camera, Camera) else np.inf
            painters.append(_normal_painter(kind.prims, places, far, images["normal"]))
    fields = FIELDS if "position" in surfaces else {}
    painters.extend(_field_painter(field, images[name]) for name, field in fields.items() if name in images)
    if packed.kinds and images.keys() & {*NUMBERS, "albedo"}:
        painters.extend(_number_painters(scene, packed, images))
    return painters


def _surface_finder(prims: Any, places: tuple[int, int], wants_uv: bool) -> Painter:
    return lambda room, box: find_surfaces_in_tile(prims, places, room.tile, box, room.shade, wants_uv)


def _normal_painter(prims: Any, places: tuple[int, int], reach: float, image: np.ndarray) -> Painter:
    return lambda room, box: paint_normals(prims, places, reach, room.tile, box, image)


def _field_painter(field: Any, image: np.ndarray) -> Painter:
    first = int(field)
    return lambda room, box: paint_fields(room.tile, box, room.shade, first, image)


def _number_painters(scene: Scene, packed: Packed, images: dict[str, np.ndarray]) -> list[Painter]:
    ids = ids_by_place(packed)
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

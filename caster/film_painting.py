"""AOVs of a film, tile by tile: rays, hits and what is asked about them, while they are in a core's cache.

The same bits as `rendering.evaluate` gives, which takes one step after the other for the whole film.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from caster.aovs import BY_NAME
from caster.casting import Culling, bases, by_trees, decide, ids_by_place
from caster.fields import Camera
from caster.film_casting import cast_tile, in_tiles, sorted_kinds
from caster.kernels.gather import shoot_at
from caster.kernels.nearest import new_rays
from caster.kernels.paint import (
    find_normals,
    paint_albedo,
    paint_numbers,
    paint_seen,
    paint_surfaces,
)
from caster.kernels.screen import Window, cast_own_origins, cast_shared_origin
from caster.kernels.tile import WIDTH, Box, shoot_rays
from caster.packing import Packed
from caster.scene import Scene
from caster.view import View

CHANNELS = {"position": 3, "normal": 3, "shading_normal": 3, "uv": 2, "albedo": 3}
NUMBERS = ("shape_id", "prim_id")
FROM_SURFACES = {"position", "shading_normal", "uv"}
PAINTED = {"hit", "depth", *CHANNELS, *NUMBERS}

Painter = Callable[[np.ndarray, Box], None]
Caster = Callable[[int, Box, np.ndarray], None]  # number of the tile, its box, its numbers


@dataclass(frozen=True)
class Painted:
    """A film with all its pixels."""

    images: dict[str, np.ndarray]
    hit: np.ndarray  # (h, w) bool
    surfaces: tuple[str, ...]  # what was worked out of each hit's surface
    doubtful: int  # pixels whose answer had to be found exactly


def paint_film(
    scene: Scene,
    packed: Packed,
    window: Window,
    aovs: Sequence[str],
    culling: Culling,
    threads: int | None = None,
    dtype: type[np.floating] = np.float64,
) -> Painted:
    """The AOVs, all of PAINTED, by the cullings "screen" (for cameras that keep straight lines straight) and "bvh"."""
    camera = scene.camera.pack(scene.film.width, scene.film.height)
    reach = _farthest_origin(camera, window)
    hit, doubt = (np.zeros((window.height, window.width), bool) for _ in range(2))
    images = {name: _blank(name, window, dtype) for name in aovs if name != "hit"}
    painters = _painters(scene, packed, reach, images, (hit, doubt))
    seek: Caster
    if culling == "screen":
        kinds = sorted_kinds(packed, camera, window, reach, threads)
        cast = cast_shared_origin if scene.camera.shares_origin else cast_own_origins
        seek = partial(cast_tile, cast, kinds)
    else:
        cast_rows = by_trees(packed)

        def seek(number: int, box: Box, tile: np.ndarray) -> None:
            cast_rows((box[3] - box[1]) * WIDTH, tile)

    def work(number: int, box: Box, tile: np.ndarray) -> None:
        shoot_rays(camera, window, box, tile)
        seek(number, box, tile)
        for paint in painters:
            paint(tile, box)

    in_tiles(work, window, threads)
    pixels = np.flatnonzero(doubt)
    if len(pixels):
        view = _decided(scene, packed, window, camera, pixels, threads)
        hit.reshape(-1)[pixels] = view.hit
        for name, image in images.items():
            with np.errstate(over="ignore", under="ignore"):
                image.reshape(doubt.size, *image.shape[2:])[pixels] = BY_NAME[name].evaluate(view)
    if "hit" in aovs:
        images["hit"] = hit.astype(dtype)
    return Painted(images, hit, _worked_out(aovs), len(pixels))


def _worked_out(aovs: Sequence[str]) -> tuple[str, ...]:
    if FROM_SURFACES.intersection(aovs):
        return "position", "normals", "uv"
    return ("normals",) if "normal" in aovs else ()


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
    scene: Scene, packed: Packed, reach: float, images: dict[str, np.ndarray], seen: tuple[np.ndarray, ...]
) -> list[Painter]:
    """What paints the images and `seen`, which are hit and doubt; and nothing else."""
    painters: list[Painter] = []
    kinds = [
        (kind.prims, (base, base + len(kind.ids)))
        for kind, base in zip(packed.kinds, bases(packed), strict=True)
    ]
    normals = None
    if images.keys() & FROM_SURFACES:
        wanted = [images.get(name) for name in ("position", "normal", "shading_normal", "uv")]
        painters.extend(partial(_surfaces, *kind, wanted) for kind in kinds)
    elif "normal" in images:
        normals = images["normal"]
        if not isinstance(scene.camera, Camera):  # its d may be of any length: no normals for d of length 1
            reach = np.inf
        painters.extend(partial(find_normals, *kind, reach) for kind in kinds)
    if packed.kinds and images.keys() & {*NUMBERS, "albedo"}:
        painters.extend(_number_painters(scene, packed, images))
    depth = images.get("depth")
    painters.append(lambda tile, box: paint_seen(tile, box, *seen, depth, normals))
    return painters


def _surfaces(
    prims: Any, places: tuple[int, int], wanted: list[np.ndarray | None], tile: np.ndarray, box: Box
) -> None:
    paint_surfaces(prims, places, tile, box, *wanted)


def _number_painters(scene: Scene, packed: Packed, images: dict[str, np.ndarray]) -> list[Painter]:
    ids = ids_by_place(packed)
    shapes = packed.shape_of(ids)
    painters: list[Painter] = []
    if "shape_id" in images:
        painters.append(lambda tile, box: paint_numbers(tile, box, shapes, images["shape_id"]))
    if "prim_id" in images:
        numbers = (ids - packed.first[shapes]).astype(np.int32)
        painters.append(lambda tile, box: paint_numbers(tile, box, numbers, images["prim_id"]))
    if "albedo" in images:
        table = np.array([scene.material_of(shape).reflectance for shape in scene.shapes])
        painters.append(lambda tile, box: paint_albedo(tile, box, shapes, table, images["albedo"]))
    return painters


def _decided(
    scene: Scene, packed: Packed, window: Window, camera: Any, pixels: np.ndarray, threads: int | None
) -> View:
    """What is seen in some pixels, found exactly where float64 cannot tell."""
    rays = new_rays(len(pixels))
    shoot_at(camera, window, rays, pixels)
    return View(scene, packed, rays, decide(packed, rays, threads), np.zeros(len(pixels)), threads)

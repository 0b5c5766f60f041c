"""Films of a scene: its AOVs as images."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from caster.aovs import BY_NAME, Aovs
from caster.description.errors import SceneError, suggestion
from caster.geometry.packing import Packed, packed
from caster.jit.command_list import Command, command
from caster.jit.decorators import implements
from caster.kernels.nearest import Rays, generate_rays
from caster.kernels.protocol import project
from caster.kernels.raster.screen_bounds import Window
from caster.kernels.raster.tile import BOX, HEIGHT, generate_camera_rays, kind_numbers, tile_rows
from caster.kernels.raster.tile_casting import cast_in_bounds
from caster.kernels.surface.per_hit import store_hits
from caster.rendering.casting import BVH_MIN_RAYS, Culling, exact_nearest, find_nearest, trees_of
from caster.rendering.hits import RayHits
from caster.rendering.rasterization import BinnedKind, bin_kinds, parallel_for_tiles
from caster.rendering.ray_tiles import MIN_RAYS_PER_THREAD, TileCaster, TileWorkspace
from caster.rendering.shading import TileShader, new_image
from caster.rendering.threads import parallel_for
from caster.scene.model import Scene

__all__ = ["camera_rays", "check_names", "evaluate", "film_window", "render", "trace_film"]

DEFAULT_AOVS = ("hit", "depth", "normal", "position", "diffuse")


# Is called with the number of pixels that have just been done, from any thread.
OnProgress = Callable[[int], None] | None


def render(
    scene: Scene,
    aovs: Sequence[str] = DEFAULT_AOVS,
    *,
    threads: int | None = None,
    culling: Culling | None = None,
    dtype: type[np.floating] = np.float64,
) -> Aovs:
    """Render the film, or its crop window.

    aovs: names of `caster.Aovs`. Returns images of `dtype` (ids int32); depth is inf and ids are -1 on a
    miss, everything else 0. `culling` overrides the plan; no culling and no number of threads changes a bit.
    All is computed in float64; with dtype np.float32 numbers are rounded once at the end, those beyond it to inf.
    Raises SceneError for an AOV that does not exist.
    """
    return render_film(scene, aovs, threads=threads, culling=culling, dtype=dtype).aovs


@dataclass(frozen=True)
class RenderResult:
    """What was rendered, how, and the work it took."""

    scene: Scene
    packed: Packed
    aovs: Aovs
    culling: Culling
    surfaces: int | None  # what was computed of each hit's surface: see TileShader
    hits: int
    decided_exactly: int  # pixels whose answer had to be found exactly
    shadow_rays: int
    on_film: tuple[np.ndarray, ...]  # of each kind, (n,) bool: tested for some pixel; () where nothing is rasterized


# Pixels of a film that are rendered, and written, at a time: more take more memory, and fewer more time, in which
# primitives are sorted into tiles once for each band.
BAND_PIXELS = 1 << 21


def render_bands(scene: Scene, bands: Iterable[RenderResult]) -> Iterator[RenderResult]:
    """The rendered bands of a scene's film, from the top; each result has the counts of all bands so far."""
    before: RenderResult | None = None
    for found in bands:
        if before is not None:
            found = replace(
                found,
                hits=before.hits + found.hits,
                decided_exactly=before.decided_exactly + found.decided_exactly,
                shadow_rays=before.shadow_rays + found.shadow_rays,
                on_film=tuple(map(np.logical_or, before.on_film, found.on_film)),
            )
        before = replace(found, scene=scene)
        yield before


def bands_of(scene: Scene) -> Iterator[Scene]:
    """The scene with each band of its film, of whole tiles."""
    return scene.bands(BAND_PIXELS, HEIGHT)


def render_film(
    scene: Scene,
    aovs: Sequence[str],
    *,
    threads: int | None = None,
    culling: Culling | None = None,
    dtype: type[np.floating] = np.float64,
    on_progress: OnProgress = None,
) -> RenderResult:
    """The same as `render`, with counts of the work. on_progress: is called with the number of pixels just done."""
    check_names(aovs)
    arrays, window = packed(scene), film_window(scene)
    camera = scene.camera.pack(scene.film.width, scene.film.height)
    hit, uncertain = (np.zeros((window.height, window.width), bool) for _ in range(2))
    images = {name: new_image(name, window, dtype) for name in aovs}
    culling = culling or culling_for(camera)
    shader = TileShader(scene, arrays, images)
    binned: list[BinnedKind] | None = None  # None where nothing is rasterized
    if culling == "raster":
        # origins are linear over the film, so that the largest coordinate is at a corner
        right, bottom = window.width - 1, (window.height - 1) * window.width
        origins = rays_through(camera, window, np.array([0, right, bottom, bottom + right])).o
        binned = bin_kinds(arrays, camera, window, float(np.abs(origins).max()), threads)

    def commands() -> Iterator[Command]:
        """Commands for tiles with primitives."""
        workspace = TileWorkspace()
        tile = workspace.tile
        yield command(generate_camera_rays, camera, window, BOX, tile)
        if binned is not None:
            for k, it in enumerate(binned):
                at = kind_numbers(k)
                about = it.kind.prims, it.order, at.run, it.bounds, it.base, BOX, tile, scene.camera.shares_origin
                yield command(cast_in_bounds, *about, when=at.present)
        else:
            caster = TileCaster(arrays, any_hit=False, uses_tree=trees_of(culling))
            yield from caster.commands(tile, workspace.ray_groups)
        yield from shader.commands(workspace)
        # at the end, since shadows may be uncertain, too
        yield command(store_hits, tile, BOX, hit, uncertain)

    number = len(arrays.kinds)
    rows = tile_rows(window.width, window.height, number, [it.runs for it in binned] if binned is not None else None)
    seen = rows[:, [kind_numbers(k).present for k in range(number)]].any(axis=1)
    if seen.any():
        shader.prepare(threads)
    parallel_for_tiles(commands, rows[seen], threads, on_progress)
    parallel_for_tiles(shader.miss_commands, rows[~seen], threads, on_progress)
    pixels = np.flatnonzero(uncertain)
    if len(pixels):  # decide them exactly
        rays = rays_through(camera, window, pixels, threads)
        nearest = exact_nearest(arrays, rays, threads, trees=culling != "brute-force")
        hits = RayHits(scene, arrays, rays, nearest, np.zeros(len(pixels)), threads)
        hit.reshape(-1)[pixels] = hits.hit
        for name, values in hits.evaluate(tuple(images)).items():
            with np.errstate(over="ignore", under="ignore"):
                images[name].reshape(uncertain.size, *images[name].shape[2:])[pixels] = values
    on_film = () if binned is None else tuple(it.on_film for it in binned)
    counts = int(hit.sum()), len(pixels), shader.shadow_rays
    return RenderResult(scene, arrays, Aovs(images, hit), culling, shader.surfaces, *counts, on_film)


def culling_for(camera: Any) -> Culling:
    """The culling for a packed camera's own rays; those of one that projects no points traverse the BVHs."""
    return "raster" if implements(project, type(camera)) else "bvh"


def rays_through(camera: Any, window: Window, pixels: np.ndarray, threads: int | None = 1) -> Rays:
    """Rays through the centres of pixels (n,), numbered row by row through the window."""
    count = len(pixels)
    rays = Rays(np.empty((count, 3)), np.empty((count, 3)), np.empty(count), np.empty(count))
    parallel_for(partial(generate_rays, camera, window, pixels, rays), count, threads, least=MIN_RAYS_PER_THREAD)
    return rays


def check_names(aovs: Sequence[str]) -> None:
    for name in aovs:
        if name not in BY_NAME:
            what = f"unknown{suggestion(name, BY_NAME)}" if name else "no name between two commas"
            raise SceneError(f"aov {name!r}: {what}; known are {', '.join(BY_NAME)}")


def film_window(scene: Scene) -> Window:
    """The pixels to render: the crop, or the whole film."""
    x0, y0, x1, y1 = scene.film.window
    return Window(x0, y0, x1 - x0, y1 - y0)


def camera_rays(scene: Scene, threads: int | None = None) -> Rays:
    """Rays through the pixel centres of the window, row by row from the top left; float64, d of length 1."""
    window = film_window(scene)
    camera = scene.camera.pack(scene.film.width, scene.film.height)
    return rays_through(camera, window, np.arange(window.width * window.height), threads)


def trace_film(scene: Scene, threads: int | None = None) -> RayHits:
    """Cast the camera's rays; up to BVH_MIN_RAYS of them by brute force, without building a BVH."""
    rays, arrays = camera_rays(scene, threads), packed(scene)
    culling: Culling = "bvh" if len(rays.t_min) > BVH_MIN_RAYS else "brute-force"
    nearest = find_nearest(arrays, rays, culling, threads)
    return RayHits(scene, arrays, rays, nearest, np.zeros(len(rays.t_min)), threads)


def evaluate(hits: RayHits, aovs: Sequence[str], window: Window, dtype: type[np.floating] = np.float64) -> Aovs:
    """AOVs of the rays of a window, as images."""
    shape = (window.height, window.width)
    images = {name: rows.reshape(shape + rows.shape[1:]) for name, rows in hits.evaluate(aovs, dtype).items()}
    return Aovs(images, hits.hit.reshape(shape))

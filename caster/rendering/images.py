"""Films of a scene: its AOVs as images."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from caster.aovs import BY_NAME, Aovs
from caster.description.errors import SceneError, suggestion
from caster.geometry.packing import Packed, packed
from caster.jit.command_list import BoundCall, Command
from caster.kernels.nearest import Rays, generate_rays, new_rays
from caster.kernels.raster.screen_bounds import Window
from caster.kernels.raster.tile import BOX, generate_camera_rays, kind_numbers, tile_rows
from caster.kernels.surface.per_hit import store_hits
from caster.rendering.bvh_construction import uses_bvh
from caster.rendering.casting import BVH_MIN_RAYS, Culling, exact_nearest, find_nearest
from caster.rendering.hits import RayHits
from caster.rendering.plan import Plan, plan
from caster.rendering.rasterization import BinnedKind, bin_kinds, cast_commands, parallel_for_tiles
from caster.rendering.ray_tiles import MIN_RAYS_PER_THREAD, TileWorkspace, kind_command, prim_offsets
from caster.rendering.shading import NO_BOX, TileShader, new_image
from caster.rendering.threads import parallel_for, unwritten_array
from caster.scene.model import Scene

__all__ = ["camera_rays", "evaluate", "film_window", "render", "trace_film"]

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

    aovs: names from `caster.aovs.AOVS`. Returns images of `dtype` (ids int32); depth is inf and ids are -1 on a
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
    plan: Plan
    decided_exactly: int  # pixels whose answer had to be found exactly
    shadow_rays: int
    on_film: tuple[int, ...] | None  # primitives of each kind that some pixel was tested for; None: no such list


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
    return FilmRenderer(scene, plan(scene, aovs, culling), aovs, threads, dtype, on_progress).render()


class FilmRenderer:
    """Renders a film tile by tile: rays, their nearest hits by rasterization, trees or brute force, their AOVs."""

    def __init__(
        self,
        scene: Scene,
        plan: Plan,
        aovs: Sequence[str],
        threads: int | None,
        dtype: type[np.floating],
        on_progress: OnProgress,
    ) -> None:
        self.scene, self.packed, self.window, self.plan = scene, packed(scene), film_window(scene), plan
        self.threads, self.on_progress = threads, on_progress
        window = self.window
        self.camera = scene.camera.pack(scene.film.width, scene.film.height)
        self.hit, self.uncertain = (unwritten_array((window.height, window.width), bool) for _ in range(2))
        self.hit[:], self.uncertain[:] = False, False
        self.images = {name: new_image(name, window, dtype) for name in aovs}
        self.shader = TileShader(scene, self.packed, plan, self.images)

    def render(self) -> RenderResult:
        """Render all pixels, and those that float64 leaves uncertain again, exactly."""
        kinds = None
        if self.plan.culling == "raster":
            reach = _farthest_origin(self.camera, self.window)
            kinds = bin_kinds(self.packed, self.camera, self.window, reach, self.threads)
        self._render_tiles(kinds)
        decided = self._decide_uncertain()
        on_film = None if kinds is None else tuple(it.binned for it in kinds)
        images = Aovs(self.images, self.hit)
        return RenderResult(self.scene, self.packed, images, self.plan, decided, self.shader.shadow_rays, on_film)

    def _render_tiles(self, kinds: list[BinnedKind] | None) -> None:
        """kinds: None where nothing is rasterized."""
        runs, number = None if kinds is None else [it.runs for it in kinds], len(self.packed.kinds)
        rows = tile_rows(self.window.width, self.window.height, number, runs)
        seen = rows[:, [kind_numbers(k).present for k in range(number)]].any(axis=1)
        if seen.any():
            self.shader.prepare(self.threads)
        parallel_for_tiles(partial(self._commands, kinds), rows[seen], self.threads, self.on_progress)
        parallel_for_tiles(self.shader.miss_commands, rows[~seen], self.threads, self.on_progress)

    def _commands(self, kinds: list[BinnedKind] | None) -> Iterator[Command]:
        """Commands for tiles with primitives."""
        workspace = TileWorkspace()
        tile = workspace.tile
        yield Command(BoundCall(generate_camera_rays, self.camera, self.window, NO_BOX, tile, given=(2,)), (BOX,))
        if kinds is not None:
            yield from cast_commands(kinds, tile, self.scene.camera.shares_origin)
        else:
            for kind, base in zip(self.packed.kinds, prim_offsets(self.packed), strict=True):
                yield kind_command(kind, base, tile, self.plan.culling == "bvh" and uses_bvh(kind))
        yield from self.shader.commands(workspace)
        # at the end, since shadows may be uncertain, too
        yield Command(BoundCall(store_hits, tile, NO_BOX, self.hit, self.uncertain, given=(1,)), (BOX,))

    def _decide_uncertain(self) -> int:
        """Decide uncertain pixels exactly; returns their number."""
        pixels = np.flatnonzero(self.uncertain)
        if len(pixels):
            rays = rays_through(self.camera, self.window, pixels, self.threads)
            nearest = exact_nearest(self.packed, rays, self.threads, trees=self.plan.culling != "brute-force")
            hits = RayHits(self.scene, self.packed, rays, nearest, np.zeros(len(pixels)), self.threads)
            self.hit.reshape(-1)[pixels] = hits.hit
            for name, rows in hits.evaluate(tuple(self.images)).items():
                image = self.images[name]
                with np.errstate(over="ignore", under="ignore"):
                    image.reshape(self.uncertain.size, *image.shape[2:])[pixels] = rows
        return len(pixels)


def _farthest_origin(camera: Any, window: Window) -> float:
    """The largest |coordinate| of a ray's origin; origins are linear over the film, so it is at a corner."""
    right, bottom = window.width - 1, (window.height - 1) * window.width
    return float(np.abs(rays_through(camera, window, np.array([0, right, bottom, bottom + right])).o).max())


def rays_through(camera: Any, window: Window, pixels: np.ndarray, threads: int | None = 1) -> Rays:
    """Rays through the centres of pixels (n,), numbered row by row through the window."""
    rays = new_rays(len(pixels))
    parallel_for(partial(generate_rays, camera, window, pixels, rays), len(pixels), threads, least=MIN_RAYS_PER_THREAD)
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

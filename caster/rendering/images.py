"""Scene in, AOVs out."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from caster.aovs import BY_NAME
from caster.description.errors import SceneError, suggestion
from caster.geometry.packing import Packed, pack, packed
from caster.geometry.world_space import Rounding, as_given
from caster.kernels.nearest import Rays, new_rays
from caster.kernels.raster.screen_bounds import Window
from caster.kernels.surface.surfaces import generate_rays
from caster.rendering.casting import Culling, find_nearest
from caster.rendering.plan import Plan, culling_for, plan
from caster.rendering.rasterization import find_nearest_on_film
from caster.rendering.threads import parallel_for
from caster.rendering.tiles import FilmResult, render_tiles
from caster.rendering.view import View
from caster.scene.model import Scene

__all__ = ["Aovs", "camera_rays", "evaluate", "film_window", "render", "trace_film", "trace_rays"]

DEFAULT_AOVS = ("hit", "depth", "normal", "position", "diffuse")


class Aovs(Mapping[str, np.ndarray]):
    """Images by AOV name, (h, w) or (h, w, c) each. `hit` is there whether it was asked for or not."""

    def __init__(self, images: Mapping[str, np.ndarray], hit: np.ndarray):
        self._images = dict(images)
        self.hit = hit  # (h, w) bool

    def __getitem__(self, name: str) -> np.ndarray:
        return self._images[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._images)

    def __len__(self) -> int:
        return len(self._images)


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
    All is worked out in float64; with dtype np.float32 numbers are rounded once at the end, those beyond it to inf.
    Raises SceneError for an AOV that does not exist.
    """
    return render_film(scene, aovs, threads=threads, culling=culling, dtype=dtype).aovs


@dataclass(frozen=True)
class RenderResult:
    """What was rendered, and how."""

    scene: Scene
    packed: Packed
    aovs: Aovs
    plan: Plan
    painted: FilmResult | None  # None: without culling there is no count of what was done


def render_film(
    scene: Scene,
    aovs: Sequence[str],
    *,
    threads: int | None = None,
    culling: Culling | None = None,
    dtype: type[np.floating] = np.float64,
    told: Callable[[int], None] | None = None,
) -> RenderResult:
    """The same as `render`, with an account of it. told: hears of the pixels that are done, a number at a time."""
    check_names(aovs)
    window, planned = film_window(scene), plan(scene, aovs, culling)
    if planned.culling != "everything":
        arrays = packed(scene)
        painted = render_tiles(scene, arrays, window, aovs, planned, threads, dtype, told)
        return RenderResult(scene, arrays, Aovs(painted.images, painted.hit), planned, painted)
    view = trace_film(scene, threads=threads, culling=culling)
    return RenderResult(scene, view.packed, evaluate(view, aovs, window, dtype), planned, None)


def check_names(aovs: Sequence[str]) -> None:
    for name in aovs:
        if name not in BY_NAME:
            raise SceneError(
                f"aov {name!r}: unknown{suggestion(name, BY_NAME)}; known are {', '.join(BY_NAME)}"
            )


def film_window(scene: Scene) -> Window:
    """The pixels to render: the crop, or the whole film."""
    x0, y0, x1, y1 = scene.film.window
    return Window(x0, y0, x1 - x0, y1 - y0)


def camera_rays(scene: Scene, threads: int | None = None) -> Rays:
    """Rays through the pixel centres of the window, row by row from the top left; float64, d of length 1."""
    window = film_window(scene)
    camera = scene.camera.pack(scene.film.width, scene.film.height)
    rays = new_rays(window.width * window.height)
    parallel_for(lambda start, stop: generate_rays(camera, window, rays, start, stop), window.height, threads)
    return rays


def trace_film(
    scene: Scene, *, rounded: Rounding = as_given, threads: int | None = None, culling: Culling | None = None
) -> View:
    """Cast the camera's rays."""
    packed, rays = pack(scene, rounded), camera_rays(scene, threads)
    camera = scene.camera.pack(scene.film.width, scene.film.height)
    culling = culling or culling_for(camera)[0]
    if culling == "screen":
        nearest = find_nearest_on_film(
            packed, rays, camera, film_window(scene), scene.camera.shares_origin, threads
        )
    else:
        nearest = find_nearest(packed, rays, culling, threads)
    return View(scene, packed, rays, nearest, np.zeros(len(rays.t_min)), threads)


def trace_rays(
    scene: Scene, packed: Packed, rays: Rays, start: np.ndarray, threads: int | None = None
) -> View:
    """Cast given rays; `start` (n,) is what the depth of each counts from, beyond its origin."""
    return View(scene, packed, rays, find_nearest(packed, rays, threads=threads), start, threads)


def evaluate(view: View, aovs: Sequence[str], window: Window, dtype: type[np.floating] = np.float64) -> Aovs:
    """The AOVs of a view, as images of the window."""
    shape = (window.height, window.width)
    images = {}
    for name in aovs:
        flat = BY_NAME[name].evaluate(view)
        if flat.dtype == np.float64:
            with np.errstate(over="ignore", under="ignore"):
                flat = flat.astype(dtype, copy=False)
        images[name] = flat.reshape(shape + flat.shape[1:])
    return Aovs(images, view.hit.reshape(shape))

"""A pixel and what lies around it, as PNG: classes of its neighbours, what is hit within it, and around its ray.

All that is drawn is cast: edges are where neighbouring rays hit different primitives, so every shape and camera shows.
"""

import io
from dataclasses import dataclass
from typing import Any

import numpy as np

from caster.geometry.packing import Packed
from caster.geometry.world_space import as_float32
from caster.rendering.hits import trace
from caster.rendering.images import trace_film
from caster.scene.model import MAX_FILM_SIDE, Scene
from mitsuba_ref.judge.classification import CLASS_CODE, Judge, scene_judge
from mitsuba_ref.judge.verdict import CLASSES, UNDECIDED
from mitsuba_ref.probe.pixel import stand_in_rays
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.rendering import ReferenceResult, trace_reference
from mitsuba_ref.reference.shared_input import SharedRays, shared_rays
from mitsuba_ref.report.evidence import hex_color

NEIGHBOR_PIXELS = 3  # pixels on each side whose classes are shown
RAYS_ACROSS_PIXEL = 81  # rays across a pixel, odd, so that one of them is the pixel's own
DIRECTION_STEPS = 12  # of the direction, each way
MISS = -1

SURFACES = ("#8cc8ec", "#f0c060", "#6fc7a8", "#dfb0c8", "#f5ee9a", "#7aa6c9", "#e79a68", "#bbbbbb")
NOTHING = "#ffffff"

Extent = tuple[float, float, float, float]  # left, right, bottom, top


class MissingPlots(ImportError):  # noqa: N818 - what is missing is the subject
    """Matplotlib is not installed; str(): what to install."""


def check_available() -> None:
    """Raise MissingPlots unless Matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401 - whether it is there
    except ImportError as error:
        raise MissingPlots("plots need matplotlib: pip install 'ray-reference[plots]'") from error


@dataclass(frozen=True)
class Patch:
    """What a square of rays meets: (n, n) numbers of primitives through the scene, MISS; row 0 on top."""

    prims: np.ndarray
    packed: Packed


def picture(judge: Judge, scene: Scene, x: int, y: int) -> bytes:
    """The PNG; judge: of that one pixel, scene: with its whole film. Raises MissingPlots without Matplotlib."""
    check_available()
    import matplotlib
    from matplotlib.figure import Figure

    has_film = scene.film.width * scene.film.height > 1 and scene.camera.type != "ray"
    with matplotlib.rc_context({"font.size": 8.5, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(13.0 if has_film else 5.2, 5.8), layout="constrained")
        panels = figure.subplots(1, 3 if has_film else 1, squeeze=False)[0]
        if has_film:
            legend(panels[0], draw_classes(panels[0], scene, x, y))
            legend(panels[1], draw_inside(panels[1], scene, x, y))
        legend(panels[-1], draw_beside(panels[-1], judge, scene, x, y))
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()


def draw_classes(ax: Any, scene: Scene, x: int, y: int) -> dict[str, str]:
    """The pixels around, each in the colour of its class. This and its like: what each colour means."""
    film = scene.film
    x0, y0 = max(0, x - NEIGHBOR_PIXELS), max(0, y - NEIGHBOR_PIXELS)
    x1, y1 = min(film.width, x + NEIGHBOR_PIXELS + 1), min(film.height, y + NEIGHBOR_PIXELS + 1)
    judge = scene_judge(scene.with_film(crop=(x0, y0, x1, y1)), whole=stand_in_rays(scene))
    if isinstance(judge, Crash):
        classes, hit = np.full((y1 - y0, x1 - x0), CLASS_CODE[UNDECIDED]), np.ones((y1 - y0, x1 - x0), bool)
    else:
        hit = judge.pair.any_hit.reshape(judge.pair.shape)
        classes = judge.judge().classes.reshape(hit.shape)
    seen = {}
    for row, column in np.ndindex(hit.shape):
        name = CLASSES[classes[row, column]] if hit[row, column] or classes[row, column] else "miss"
        color = NOTHING if name == "miss" else hex_color(name)
        seen[name.replace("_", " ")] = color
        ax.add_patch(square(x0 + column, y0 + row, 1.0, facecolor=color, edgecolor="white", lw=1.0))
    ax.add_patch(square(x, y, 1.0, fill=False, edgecolor="black", lw=1.5))
    frame(ax, (x0, x1), (y1, y0), "class of each pixel", "x, pixels", "y, pixels")
    return seen


def draw_inside(ax: Any, scene: Scene, x: int, y: int) -> dict[str, str]:
    """One pixel from edge to edge: which primitive each of many rays meets, and lines between different ones."""
    rays = min(RAYS_ACROSS_PIXEL, MAX_FILM_SIDE // max(scene.film.width, scene.film.height))
    rays -= 1 - rays % 2
    fine = scene.with_film(width=scene.film.width * rays, height=scene.film.height * rays)
    fine = fine.with_film(crop=(x * rays, y * rays, (x + 1) * rays, (y + 1) * rays))
    view = trace_film(fine, rounded=as_float32)
    patch = Patch(view.nearest.prim.reshape(rays, rays), view.packed)
    named = draw_patch(ax, patch, scene, (x, x + 1.0, y + 1.0, y))
    for line in np.arange(1, 8) / 8.0:
        ax.axvline(x + line, color="black", lw=0.3, alpha=0.25)
        ax.axhline(y + line, color="black", lw=0.3, alpha=0.25)
    ax.plot([x + 0.5], [y + 0.5], "+", color="black", ms=14, mew=1.6)
    frame(ax, (x, x + 1), (y + 1, y), "this pixel: what our rays hit in it", "x, pixels", "y, pixels")
    return named


def draw_beside(ax: Any, judge: Judge, scene: Scene, x: int, y: int) -> dict[str, str]:
    """The ray itself and those beside it, by single roundings of its direction: ours in colour, Mitsuba in marks."""
    right = to_the_right(scene, x, y)
    rays, unit = beside(judge.pair.rays, right)
    view = trace(judge.scene, rays.o, rays.d, rays.t_max, rays.start, rounded=as_float32)
    side = 2 * DIRECTION_STEPS + 1
    patch = Patch(view.nearest.prim.reshape(side, side), view.packed)
    reach = DIRECTION_STEPS + 0.5
    named = draw_patch(ax, patch, judge.scene, (-reach, reach, reach, -reach))
    witness = trace_reference(judge.scene, judge.model, rays, lights=False)
    if not isinstance(witness, Crash):
        mark_differences(ax, view.shape_id, witness)
    ax.plot([0], [0], "s", mfc="none", color="black", ms=10, mew=1.6)
    wide = float(np.linalg.norm(right))
    label = f"steps of d, {unit:.3g} each: a unit of its last place in float32"
    label += f"\n(of a pixel: {unit / wide:.2g})" if wide > 0.0 else ""
    frame(ax, (-reach, reach), (reach, -reach), f"beside the ray of ({x}, {y}), by single roundings", label, "")
    return named


def to_the_right(scene: Scene, x: int, y: int) -> np.ndarray:
    """(3,) how d changes towards the pixel on the right; 0 where it does not, or where there is none beside it."""
    x0 = min(x, scene.film.width - 2)
    if x0 < 0:
        return np.zeros(3)
    d = shared_rays(scene.with_film(crop=(x0, y, x0 + 2, y + 1))).d.astype(np.float64)
    return np.asarray(d[1] - d[0])


def beside(rays: SharedRays, right: np.ndarray) -> tuple[SharedRays, float]:
    """(a square of float32 rays, moved across d by whole steps, row by row from the top left; one step)."""
    d = rays.d[0].astype(np.float64)
    step = float(np.spacing(np.abs(rays.d[0]).max()))
    right = right - d * (right @ d) / (d @ d)
    if not np.linalg.norm(right) > 0.0:
        right = np.cross(d, np.eye(3)[np.argmin(np.abs(d))])
    right = right / np.linalg.norm(right)
    down = np.cross(d, right) / np.linalg.norm(d)  # a film's x, y and the way into it are right-handed
    steps = np.arange(-DIRECTION_STEPS, DIRECTION_STEPS + 1) * step
    moved = d + (steps[:, None, None] * down + steps[None, :, None] * right)
    count = (2 * DIRECTION_STEPS + 1) ** 2
    same = [np.repeat(a[:1], count, axis=0) for a in (rays.t_max, rays.start)]
    directions = np.ascontiguousarray(moved.reshape(-1, 3), np.float32)
    return SharedRays(np.repeat(rays.o[:1], count, axis=0), directions, *same), step


def mark_differences(ax: Any, ours: np.ndarray, witness: ReferenceResult) -> None:
    """A cross where Mitsuba misses what ours hits, a dot where it hits another shape; (n,) shapes of a square."""
    side = 2 * DIRECTION_STEPS + 1
    rows, columns = np.divmod(np.arange(side * side), side)
    lost, other = (witness.shape_id < 0) & (ours >= 0), (witness.shape_id >= 0) & (witness.shape_id != ours)
    for which, marker, label in ((lost, "x", "Mitsuba misses"), (other, "o", "Mitsuba hits another shape")):
        if which.any():
            spots = columns[which] - DIRECTION_STEPS, rows[which] - DIRECTION_STEPS
            ax.plot(*spots, marker, color="#990000", ms=3.5, mew=1.0, ls="none", label=f"{label}: {which.sum()}")


def draw_patch(ax: Any, patch: Patch, scene: Scene, extent: Extent) -> dict[str, str]:
    """Colours for primitives, the most frequent first; dark lines between them."""
    from matplotlib.colors import to_rgb

    prims, counts = np.unique(patch.prims, return_counts=True)
    order = [int(prim) for prim in prims[np.argsort(-counts, kind="stable")] if prim != MISS]
    image = np.empty((*patch.prims.shape, 3))
    image[patch.prims == MISS] = to_rgb(NOTHING)
    named = {}
    for i, prim in enumerate(order):
        color = SURFACES[min(i, len(SURFACES) - 1)]
        image[patch.prims == prim] = to_rgb(color)
        if i < len(SURFACES) - 1:
            named[name_of(patch.packed, scene, prim)] = color
    if len(order) >= len(SURFACES):
        named[f"{len(order) - len(SURFACES) + 1} more primitives"] = SURFACES[-1]
    if (patch.prims == MISS).any():
        named["nothing"] = NOTHING
    ax.imshow(image, extent=extent, interpolation="nearest", aspect="equal")
    outline(ax, patch.prims, extent)
    return named


def outline(ax: Any, prims: np.ndarray, extent: Extent) -> None:
    """A line along every side between two cells of different primitives."""
    from matplotlib.collections import LineCollection

    left, right, bottom, top = extent
    across, down = (right - left) / prims.shape[1], (bottom - top) / prims.shape[0]
    lines = []
    for row, column in np.argwhere(prims[:, 1:] != prims[:, :-1]):
        at = left + (column + 1) * across
        lines.append([(at, top + row * down), (at, top + (row + 1) * down)])
    for row, column in np.argwhere(prims[1:] != prims[:-1]):
        at = top + (row + 1) * down
        lines.append([(left + column * across, at), (left + (column + 1) * across, at)])
    ax.add_collection(LineCollection(lines, colors="#333333", linewidths=0.9))


def name_of(packed: Packed, scene: Scene, prim: int) -> str:
    which = np.array([prim])
    shape, number = int(packed.shape_of(which)[0]), int(packed.index_in_shape(which)[0])
    return f"{scene.shape_names()[shape]}, prim {number}"


def square(x: float, y: float, size: float, **style: Any) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x, y), size, size, **style)


def frame(ax: Any, across: tuple[float, float], down: tuple[float, float], title: str, x: str, y: str) -> None:
    ax.set(xlim=across, ylim=down, title=title, xlabel=x, ylabel=y, aspect="equal")


def legend(ax: Any, named: dict[str, str]) -> None:
    """Below the axes, so that it hides nothing: colours, then the marks that were drawn with a label."""
    from matplotlib.patches import Patch as Swatch

    swatches = [Swatch(facecolor=color, edgecolor="#888888", label=name) for name, color in named.items()]
    marks, _ = ax.get_legend_handles_labels()
    ax.legend(handles=[*swatches, *marks], loc="upper center", bbox_to_anchor=(0.5, -0.19), ncols=2, frameon=False)

"""Plots of a benchmark run, as PNG."""

import io
import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from mitsuba_ref.bench.contestants import BY_KEY
from mitsuba_ref.bench.result import Run, SceneResult, Series, Sweep

# Colours after Okabe and Ito (2008), which people of any colour vision tell apart; markers differ as well.
STYLE: dict[str, tuple[str, str]] = {
    "ours": ("#0072B2", "o"),
    "ours-bvh": ("#0072B2", "s"),
    "ours-1-thread": ("#0072B2", "v"),
    "ours-python": ("#0072B2", "x"),
    "raw-robust": ("#009E73", "o"),
    "raw-default": ("#D55E00", "o"),
    "raw-robust-incoherent": ("#009E73", "D"),
    "aov-robust": ("#009E73", "^"),
    "aov-default": ("#D55E00", "^"),
    "scalar-aov": ("#E69F00", "^"),
    "scalar-loop": ("#E69F00", "x"),
    "open3d": ("#CC79A7", "P"),
    "embreex": ("#000000", "*"),
    "trimesh": ("#000000", "+"),
    "copy": ("#888888", "_"),
}
Point = tuple[float, float]  # nanoseconds a ray, float32 ulps
MIN_DRAWN_ULPS = 1e-9  # float32 units in the last place: an error of nothing shows as this
PLOT_FORMAT = "png"
COLUMNS = 3
DPI = 110


def plots(run: Run) -> dict[str, bytes]:
    """Every plot that the run has numbers for, by name."""
    found: dict[str, bytes] = {}
    scored = [scene for scene in run.scenes if scored_points(scene)]
    if scored:
        found["pareto"] = figure_bytes(partial(pareto, scored), 3.1 * math.ceil(len(scored) / COLUMNS) + 1.6)
    for sweep in run.sweeps:
        found[sweep.name] = figure_bytes(partial(plot_sweep, sweep), 4.6)
    films = [scene for scene in run.films if scene.ratio("copy") is not None]
    if films:
        found["copying"] = figure_bytes(partial(copying, films), 0.4 * len(films) + 1.6)
    return found


def figure_bytes(draw: Callable[[Any], None], height: float) -> bytes:
    """One figure; the same bytes for the same numbers and the same Matplotlib."""
    with matplotlib.rc_context({"font.size": 8.5, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(9.0, height), layout="constrained")
        draw(figure)
        out = io.BytesIO()
        figure.savefig(out, format=PLOT_FORMAT, dpi=DPI, metadata={"Software": None})
    return out.getvalue()


def pareto(scenes: Sequence[SceneResult], figure: Any) -> None:
    """Largest error of t against time for a ray, and a line through those whom nobody beats in both."""
    axes = figure.subplots(math.ceil(len(scenes) / COLUMNS), COLUMNS, squeeze=False, sharey=True)
    shown: dict[str, Any] = {}
    for scene, ax in zip(scenes, axes.flat, strict=False):
        points = scored_points(scene)
        ax.plot(*zip(*front(points.values()), strict=True), color="#999999", lw=1.0, drawstyle="steps-post")
        for key, (x, y) in points.items():
            color, marker = STYLE[key]
            (mark,) = ax.plot([x], [y], marker, color=color, mfc="none", ms=7)
            shown.setdefault(BY_KEY[key].title, mark)
        ax.set(xscale="log", yscale="log", title=scene.name, xlabel="nanoseconds a ray")
        whole_decades(ax)
        light_grid(ax)
    for ax in axes.flat[len(scenes) :]:
        ax.set_visible(False)
    figure.supylabel("largest error of t on rays of the image, float32 ulps", fontsize=9)
    figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=3, frameon=False)


def scored_points(scene: SceneResult) -> dict[str, Point]:
    """Time and error of every row that has both, by key."""
    return {
        row.key: (row.ns, max(row.score.ulps, MIN_DRAWN_ULPS))
        for row in scene.rows
        if row.ns is not None and row.score is not None and row.score.ulps is not None
    }


def front(points: Iterable[Point]) -> list[Point]:
    """The points that no other is both faster and more right than, fastest first (Pareto's front)."""
    kept: list[Point] = []
    for point in sorted(points):
        if not kept or point[1] < kept[-1][1]:
            kept.append(point)
    return kept


def plot_sweep(sweep: Sweep, figure: Any) -> None:
    """Seconds of an image against what grows, with the slope of the power law that fits best."""
    ax = figure.subplots()
    for one in sweep.series:
        if one.x:
            color, marker = STYLE[one.key]
            ax.plot(one.x, one.seconds, marker=marker, color=color, mfc="none", label=labelled(one))
    ax.set(xscale="log", yscale="log", xlabel=sweep.quantity, ylabel="seconds of an image")
    if sweep.name == "threads":
        every = sorted({x for one in sweep.series for x in one.x})
        ax.set_xticks(every, [f"{x:g}" for x in every])
        ax.minorticks_off()
    light_grid(ax)
    ax.legend(frameon=False)


def labelled(one: Series) -> str:
    return one.title if one.slope is None else f"{one.title}: slope {one.slope:.2f}"


def copying(scenes: Sequence[SceneResult], figure: Any) -> None:
    """How many times as long as copying its images ours takes."""
    ax = figure.subplots()
    names = [scene.name for scene in scenes]
    values = [1.0 / ratio for scene in scenes if (ratio := scene.ratio("copy"))]
    ax.barh(names, values, color=STYLE["ours"][0], height=0.6)
    for i, value in enumerate(values):
        ax.text(value, i, f" {value:.1f}", va="center")
    ax.axvline(1.0, color=STYLE["copy"][0], lw=1.5)
    ax.invert_yaxis()
    ax.set(xscale="log", xlabel="time of ours over the time of copying arrays as large as its images")
    light_grid(ax)


def whole_decades(ax: Any) -> None:
    """An x axis that begins and ends with a power of ten, and names no other numbers."""
    low, high = (math.log10(end) for end in ax.get_xlim())
    first, last = math.floor(low), math.ceil(high)
    ax.set_xlim(10.0**first, 10.0**last)
    ax.set_xticks([10.0**k for k in range(first, last + 1)])
    ax.minorticks_off()


def light_grid(ax: Any) -> None:
    ax.grid(True, color="#dddddd", lw=0.5)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)

"""What our caster is meant to reach beside the others, and whether it does in a run."""

import io
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from caster.image.atomic_files import check_folder, write_bytes, write_text
from mitsuba_ref.bench import table
from mitsuba_ref.bench.contestants import BY_KEY
from mitsuba_ref.bench.result import REFERENCE_ROW, Row, Run, SceneResult, Series, Sweep
from mitsuba_ref.bench.work import SHADING
from mitsuba_ref.stress.page import MissingPlots, check_available

ALONE = "one-sphere"  # a picture of almost nothing, with a target of its own beside raw rays


@dataclass(frozen=True)
class Outcome:
    """One target: how many times as fast as somebody we are to be, and how many times we are."""

    what: str
    target: float
    reached: float | None  # None: not measured
    where: str = ""  # the scene it is, where the least of several counts
    least: bool = True  # whether more is better

    @property
    def ok(self) -> bool | None:
        if self.reached is None:
            return None
        return self.reached >= self.target if self.least else self.reached <= self.target


Measure = Callable[[SceneResult], float | None]


def outcomes(run: Run) -> Iterator[Outcome]:
    """Every target, in the order of the page."""
    films = run.films
    rest = [scene for scene in films if scene.name != ALONE]
    alone = [scene for scene in films if scene.name == ALONE]
    lit = [scene for scene in run.scenes if scene.asks == "shading"]
    yield least("Mitsuba LLVM, robust, AOV integrator: each scene", 5.0, films, times("aov-robust"))
    yield mean("Mitsuba LLVM, robust, AOV integrator: geometric mean", 7.0, films, times("aov-robust"))
    raw = "Mitsuba LLVM, robust, `ray_intersect`"
    yield least(f"{raw}: each scene but one sphere", 1.5, rest, times("raw-robust"))
    yield mean("the same: geometric mean", 2.2, rest, times("raw-robust"))
    yield least("the same: one sphere", 1.0, alone, times("raw-robust"))
    yield least("Open3D: each scene of triangles", 4.0, films, times("open3d"))
    yield least("trimesh + embreex: each scene of triangles", 10.0, films, times("trimesh"))
    yield least("Mitsuba scalar, AOV integrator: each scene", 40.0, films, times("scalar-aov"))
    yield least("Open3D: any rays, coherent", 1.0, named(run, "rays-coherent"), times("open3d"))
    yield least(
        f"{raw} without `coherent`: any rays, incoherent",
        0.5,
        named(run, "rays-incoherent"),
        times("raw-robust-incoherent"),
    )
    shadowed = between("shade-shadowed", "shade-unshadowed")
    yield most("ours: one shadowed light costs, beside one without shadows", 2.5, lit, shadowed)
    diffuse = between("shade-unshadowed", "shade-depth")
    yield least("ours: depth alone, beside depth, normal and diffuse without shadows", 1.3, lit, diffuse)


def named(run: Run, name: str) -> list[SceneResult]:
    return [scene for scene in run.scenes if scene.name == name]


def times(key: str) -> Measure:
    """How many times as fast as this row we are."""
    return lambda scene: scene.ratio(key, REFERENCE_ROW)


def between(above: str, below: str) -> Measure:
    """How many times as long one of our rows takes as another."""
    return lambda scene: scene.ratio(above, below)


def measured(scenes: Sequence[SceneResult], measure: Measure) -> list[tuple[float, str]]:
    found = [(measure(scene), scene.name) for scene in scenes]
    return [(value, name) for value, name in found if value is not None]


def least(what: str, target: float, scenes: Sequence[SceneResult], measure: Measure) -> Outcome:
    value, where = min(measured(scenes, measure), default=(None, ""))
    return Outcome(what, target, value, where)


def most(what: str, target: float, scenes: Sequence[SceneResult], measure: Measure) -> Outcome:
    value, where = max(measured(scenes, measure), default=(None, ""))
    return Outcome(what, target, value, where, least=False)


def mean(what: str, target: float, scenes: Sequence[SceneResult], measure: Measure) -> Outcome:
    """The geometric mean: of ratios, the only mean that does not depend on which way round they are."""
    values = [value for value, _ in measured(scenes, measure)]
    if not values:
        return Outcome(what, target, None)
    return Outcome(what, target, math.exp(sum(map(math.log, values)) / len(values)), f"{len(values)} scenes")


# Pictures of a run, as PNG; Matplotlib is imported when the first is drawn.


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


def pictures(run: Run) -> dict[str, bytes]:
    """Every picture that the run has numbers for, by name. Raises MissingPlots."""
    check_available()
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
    import matplotlib
    from matplotlib.figure import Figure

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
    figure.supylabel("largest error of t on rays of the picture, float32 ulps", fontsize=9)
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
    """Seconds of a picture against what grows, with the slope of the power law that fits best."""
    ax = figure.subplots()
    for one in sweep.series:
        if one.x:
            color, marker = STYLE[one.key]
            ax.plot(one.x, one.seconds, marker=marker, color=color, mfc="none", label=labelled(one))
    ax.set(xscale="log", yscale="log", xlabel=sweep.quantity, ylabel="seconds of a picture")
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


# docs/performance.md: every number in it comes from the run; what is written by hand is taken in from another file.


PAGE, IMAGE_FOLDER, NOTES = "performance.md", "performance", "performance-notes.md"
WIDTH = 120  # of lines of prose
MIN_ROUNDS = 7  # alternations that a report is to have

HEAD = """# Run time against error

<!-- written by `make bench`; change mitsuba_ref/bench/page.py, or performance-notes.md for what is said by hand -->

The same scenes, in the same float32 numbers, by everybody: our caster, Mitsuba 3 and others that cast rays from Python.
Each contestant has a process of its own; they take turns, so that what else the machine does hits all of them.
"""

READING = """## How to read it

- **What is timed**: a picture of depth and normal, delivered as float32 arrays in memory; or t and normal along rays
  that were on hand, or whether anything lies on them. All have loaded the scene and built what they build before; ours
  makes the rays and sorts the primitives onto the film in every picture, while for `ray_intersect`, Open3D and embreex
  the rays were made before, too. All that has to be compiled has been compiled. Shadow rays go through
  `caster.occluded`, Mitsuba's `ray_test`, and what others have in its place.
- **ours, as planned** is `caster.render`: by the screen for pinhole and orthographic cameras, by the tree for others;
  for rays that are handed over, `caster.cast` with the surface it knows of each hit. **by the tree** is the same
  picture through the tree. **plain Python** runs the same source without Numba.
- **rays** of one cast: pictures of those who would take longer than {longest:g} s are made smaller.
- **build**: seconds from the numbers to where rays can be cast, the second time it is done in a process; Mitsuba reads
  its own files, and for the others the numbers are in memory.
- **ns/ray**, **Mray/s**: the median of all alternations; casts of less than {least:g} s are repeated within a turn, and
  their median is the turn's. **x ours** is the median of the ratios of each alternation: above 1, ours is faster.
- **t: ulps**: the largest error of t on {sample:,} rays of the picture, the same float32 rays for everybody, against
  exact arithmetic (`mitsuba_ref/oracle/oracle.py`), in float32 units in the last place of the exact t.
  **t: bounds**: in units
  of the bound that is derived for each ray, that of float64 for ours and that of float32 for all others
  ([method.md](method.md)). Ours is asked through `caster.cast`, float64; no culling changes a bit, and images of
  float32 add half a unit. Mitsuba's AOV integrator takes no rays from outside, so `ray_intersect` of the same scene is
  asked for it, which is what it calls.
- **wrong** on those rays, **wrong at edges** on as many that are aimed at edges and silhouettes: hits where there is
  exactly nothing and misses where there is something; behind a `+`, hits farther off than their bound, mostly those of
  another surface.
- **MB**: the most memory that the process had (VmHWM), Python, all libraries and the rays included.
- **copying the images**: arrays as large as ours' depth and normal, copied by as many threads.
"""


def write_report(run: Run, folder: Path) -> None:
    """The page and its pictures. Raises OutputError; without Matplotlib there is the page without pictures."""
    images = check_folder(folder / IMAGE_FOLDER)
    drawn: set[str] = set()
    try:
        for name, content in pictures(run).items():
            write_bytes(images / f"{name}.{PLOT_FORMAT}", content)
            drawn.add(name)
    except MissingPlots:
        pass
    notes = folder / NOTES
    by_hand = notes.read_text(encoding="utf-8") if notes.exists() else ""
    write_text(folder / PAGE, "\n".join(lines(run, drawn, by_hand)) + "\n")


def lines(run: Run, drawn: set[str], by_hand: str) -> Iterator[str]:
    yield HEAD
    yield from conditions(run)
    yield from of_targets(run)
    if by_hand:
        yield by_hand.strip() + "\n"
    yield from overview(run)
    yield from image_link(drawn, "pareto", "Error against time, for each scene")
    for scene in run.scenes:
        yield from section(scene)
    for sweep in run.sweeps:
        yield from of_sweep(sweep, drawn)
    yield from of_copying(run, drawn)
    yield from footnote_on_coherence(run)
    yield reading(run)


def reading(run: Run) -> str:
    from mitsuba_ref.bench.measuring import MAX_CAST_S, MIN_TURN_S
    from mitsuba_ref.bench.scoring import EXACT_RAYS_PER_SORT

    return READING.format(least=MIN_TURN_S, longest=MAX_CAST_S, sample=EXACT_RAYS_PER_SORT)


def conditions(run: Run) -> Iterator[str]:
    """The machine, and how often."""
    it = run.settings
    few = (
        "" if it["alternations"] >= MIN_ROUNDS else f", fewer than the {MIN_ROUNDS} that a report is to have"
    )
    yield textwrap.fill(
        f"{len(run.scenes)} scenes of {it['size']} x {it['size']} pixels or as many rays, {it['threads']} threads, "
        f"medians of {it['alternations']} alternations{few}. Seed {it['seed']}.",
        WIDTH,
    )
    missing = [name for name in run.asked if run.scene(name) is None]
    if missing:
        yield f"\nNot timed: {', '.join(missing)}."
    yield "\n| machine | |\n|---|---|"
    yield from (f"| {name} | {value} |" for name, value in run.machine.items())
    yield ""


def of_targets(run: Run) -> Iterator[str]:
    yield "## Targets\n"
    yield "Times as fast as the other, unless it says otherwise; the worst scene counts.\n"
    yield "| beside | target | measured | where | |"
    yield "|---|---:|---:|---|---|"
    for it in outcomes(run):
        mark = {True: "reached", False: "**missed**", None: "not measured"}[it.ok]
        sign = ">=" if it.least else "<="
        yield f"| {it.what} | {sign} {it.target:g} | {table.number(it.reached, 2)} | {it.where} | {mark} |"
    yield ""


OVERVIEW = (
    "raw-robust",
    "raw-robust-incoherent",
    "raw-default",
    "aov-robust",
    "aov-default",
    "scalar-aov",
    "open3d",
    "embreex",
    "trimesh",
)


def overview(run: Run) -> Iterator[str]:
    """How many times as fast as each of the others ours is, scene by scene."""
    rows = {
        scene.name: [scene.ratio(key) for key in OVERVIEW] for scene in run.scenes if scene.asks != SHADING
    }
    if not rows:
        return
    yield "## Times as fast as the others\n"
    yield "Above 1 ours is faster; nothing where there is nothing to compare.\n"
    yield "| | " + " | ".join(BY_KEY[key].title for key in OVERVIEW) + " |"
    yield "|---|" + "---:|" * len(OVERVIEW)
    for name, ratios in rows.items():
        yield f"| [{name}](#{name}) | {' | '.join(table.number(ratio, 2) for ratio in ratios)} |"
    yield ""


def section(scene: SceneResult) -> Iterator[str]:
    yield f"## {scene.name}\n"
    yield f"{scene.title[0].upper()}{scene.title[1:]}; {scene.primitives:,} primitives.\n"
    yield table.as_markdown(scene)
    yield ""


def of_sweep(sweep: Sweep, drawn: set[str]) -> Iterator[str]:
    """Milliseconds of a picture, a line for each contestant, and the slope."""
    yield f"## Time against {sweep.name}\n"
    yield from image_link(drawn, sweep.name, f"Time against {sweep.name}")
    every = sorted({x for one in sweep.series for x in one.x})
    yield textwrap.fill(
        f"Milliseconds of a picture over the {sweep.quantity}. The slope is that of time ~ quantity^slope, fitted to "
        "all of them, and between the last two.",
        WIDTH,
    )
    yield "\n| | " + " | ".join(f"{x:,.0f}" for x in every) + " | slope | at the end |"
    yield "|---|" + "---:|" * (len(every) + 2)
    for one in sweep.series:
        at = dict(zip(one.x, one.seconds, strict=True))
        found = [table.number(1e3 * at[x] if x in at else None, 1) for x in every]
        why = f" ({one.why})" if one.why else ""
        slopes = [table.number(slope, 2) for slope in (one.slope, one.end_slope)]
        yield f"| {one.title}{why} | {' | '.join([*found, *slopes])} |"
    yield ""


def of_copying(run: Run, drawn: set[str]) -> Iterator[str]:
    """How far ours is from the machine's bandwidth."""
    found = [(scene, ours, copy) for scene in run.films for ours, copy in [both(scene)] if ours and copy]
    if not found:
        return
    yield "## Distance to the machine's bandwidth\n"
    yield textwrap.fill(
        f"The images of depth and normal take {run.bytes_of_pixel} bytes a pixel. Copying arrays as large is what "
        "delivering them costs at least; the share is that of copying in the time of ours.",
        WIDTH,
    )
    yield ""
    yield from image_link(drawn, "copying", "Time of ours over that of copying its images")
    yield "| scene | copying, GB/s | ours, GB/s | ours / copying | share |"
    yield "|---|---:|---:|---:|---:|"
    for scene, ours, copy in found:
        ratio = scene.ratio("copy")
        rates = [run.bytes_of_pixel / row.ns for row in (copy, ours) if row.ns]
        times = table.number(1.0 / ratio if ratio else None, 1)
        share = "-" if ratio is None else f"{100.0 * ratio:.1f} %"
        yield f"| {scene.name} | {' | '.join(table.number(rate, 2) for rate in rates)} | {times} | {share} |"
    yield ""


def both(scene: SceneResult) -> tuple[Row | None, Row | None]:
    """Rows of ours and of copying, where they ran."""
    rows = [scene.row(key) for key in ("ours", "copy")]
    ours, copy = (row if row and row.ran else None for row in rows)
    return ours, copy


def footnote_on_coherence(run: Run) -> Iterator[str]:
    """What Mitsuba's hint is worth."""
    found = [
        (scene.name, ratio)
        for scene in run.scenes
        if (ratio := scene.ratio("raw-robust-incoherent", "raw-robust")) is not None
    ]
    if found:
        told = ", ".join(f"{name} {ratio:.2f}" for name, ratio in found)
        yield textwrap.fill(
            f"Mitsuba's hint `coherent`: without it, `ray_intersect` takes so many times as long: {told}.",
            WIDTH,
        )
        yield ""


def image_link(drawn: set[str], name: str, words: str) -> Iterator[str]:
    if name in drawn:
        yield f"![{words}]({IMAGE_FOLDER}/{name}.{PLOT_FORMAT})\n"

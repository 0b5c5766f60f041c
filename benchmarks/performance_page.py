"""docs/performance.md and its plots, from the JSON that `mitsuba-ref bench --sweeps --json` wrote.

    python benchmarks/performance_page.py RUN.json FOLDER

`make bench` runs both. Every number on the page comes from the run; FOLDER/performance-notes.md is included. The tables
of README.md beside FOLDER are those of the run as well.
"""

import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import performance_plots
import performance_targets as targets
from pages import WIDTH, write_page

from caster.system.atomic_files import write_text
from mitsuba_ref.bench.contestants import ALL_TASKS, BY_KEY
from mitsuba_ref.bench.entries import AOVS
from mitsuba_ref.bench.measuring import MAX_CAST_S, MIN_TURN_S
from mitsuba_ref.bench.result import COLUMNS, Row, Run, SceneResult, Sweep, overview, processes, rows
from mitsuba_ref.bench.scoring import EXACT_RAYS_PER_SORT
from mitsuba_ref.report.results import markdown, number, read_result

PAGE, IMAGE_FOLDER, NOTES = "performance.md", "performance", "performance-notes.md"
README, README_SECTION = "README.md", "## How fast\n"  # whose tables are those of the run
MIN_ROUNDS = 7  # alternations; a page of fewer has a note
RIGHT_ALIGNED = "|---|" + "---:|" * (len(COLUMNS) - 1)

HEAD = """# Run time against error

<!-- written by `make bench`; change benchmarks/performance_page.py, or performance-notes.md for the notes -->

The same scenes, in the same float32 numbers, by everybody: our caster, Mitsuba 3 and others that cast rays from Python.
Each contestant has a process of its own; they take turns, so that what else the machine does hits all of them.
"""

READING = """## How to read it

- **What is timed**: an image of some AOVs, depth and normal unless others are named, delivered as float32 arrays in
  memory; or t and normal along rays
  that were on hand, or whether anything lies on them. All have loaded the scene and built what they build before; ours
  makes the rays and sorts the primitives onto the film in every image, while for `ray_intersect`, Open3D and embreex
  the rays were made before, too. All that has to be compiled has been compiled. Shadow rays go through
  `caster.occluded`, Mitsuba's `ray_test`, and what others have in its place.
- **ours, as planned** is `caster.render`: by the screen for pinhole and orthographic cameras, by the tree for others;
  for rays that are handed over, `caster.cast` with the surface of each hit. **by BVH** is the same
  image through the tree. **plain Python** runs the same source without Numba.
- **diffuse** is light with shadows. `ray_intersect` is followed by a shadow ray to each emitter and the BSDF's value,
  written by hand; the AOV integrator has `direct` inside. Ours adds ambient light to it. Other casters give depth and
  normal alone.
- **whole processes** begin with Python and end with an EXR file, or with the verdicts of the installed scenes; byte
  code and kernels are compiled before.
- **rays** of one cast: images of those who would take longer than {longest:g} s are made smaller.
- **build**: seconds from the numbers to where rays can be cast, the second time it is done in a process; Mitsuba reads
  its own files, and for the others the numbers are in memory.
- **ns/ray**, **Mray/s**: the median of all alternations; casts of less than {least:g} s are repeated within a turn, and
  their median is the turn's. **x ours** is the median of the ratios of each alternation: above 1, ours is faster.
- **t: ulps**: the largest error of t on {sample:,} rays of the image, the same float32 rays for everybody, against
  exact arithmetic (`mitsuba_ref/oracle/oracle.py`), in float32 units in the last place of the exact t.
  **t: bounds**: in units
  of the bound that is derived for each ray, that of float64 for ours and that of float32 for all others
  ([method.md](method.md)). Ours is called through `caster.cast`, float64; no culling changes a bit, and images of
  float32 add half a unit. Mitsuba's AOV integrator takes no rays from outside, so `ray_intersect`, which it calls,
  is timed on the same scene.
- **wrong** on those rays, **wrong at edges** on as many that are aimed at edges and silhouettes: hits where there is
  exactly nothing and misses where there is something; behind a `+`, hits farther off than their bound, mostly those of
  another surface.
- **MB**: the most memory that the process had (VmHWM), Python, all libraries and the rays included.
- **copying the images**: arrays as large as ours' depth and normal, copied by as many threads.
"""


def main() -> None:
    file, folder = sys.argv[1:]
    write_report(read_result(Run, file, "mitsuba-ref bench"), Path(folder))


def write_report(run: Run, folder: Path) -> None:
    """Write the page and its plots. Raises OutputError."""
    plots = performance_plots.plots(run)
    notes = folder / NOTES
    by_hand = notes.read_text(encoding="utf-8") if notes.exists() else ""
    files = {f"{name}.{performance_plots.PLOT_FORMAT}": content for name, content in plots.items()}
    write_page(folder, PAGE, lines(run, set(plots), by_hand), IMAGE_FOLDER, files)
    readme = folder.parent / README
    if readme.exists():
        write_text(readme, with_tables(readme.read_text(encoding="utf-8"), run))


def with_tables(text: str, run: Run) -> str:
    """The README with the tables of a run in place of those that stand in its section."""
    before, head, rest = text.partition(README_SECTION)
    section, rule, after = rest.partition("\n## ")
    blocks = section.split("\n\n")
    kept = [block for block in blocks if not block.startswith("|")]
    place = next((i for i, block in enumerate(blocks) if block.startswith("|")), len(kept))
    new = [*kept[:place], *(markdown_table(table) for table in tables(run)), *kept[place:]]
    return before + head + "\n\n".join(new) + rule + after


def tables(run: Run) -> list[list[list[str]]]:
    """Everything that was asked for, and whole processes; tables without a line are left out."""
    return [table for table in (overview(run), processes(run)) if len(table) > 1]


def markdown_table(table: list[list[str]]) -> str:
    return markdown(table, rule="|---|---|" + "---:|" * (len(table[0]) - 2))


def lines(run: Run, drawn: set[str], by_hand: str) -> Iterator[str]:
    yield HEAD
    yield from conditions(run)
    for table in tables(run):
        yield markdown_table(table) + "\n"
    yield from of_targets(run)
    if by_hand:
        yield by_hand.strip() + "\n"
    yield from all_ratios(run)
    yield from image_link(drawn, "pareto", "Error against time, for each scene")
    for scene in run.scenes:
        yield from section(scene)
    for sweep in run.sweeps:
        yield from of_sweep(sweep, drawn)
    yield from of_copying(run, drawn)
    yield from footnote_on_coherence(run)
    yield reading()


def reading() -> str:
    return READING.format(least=MIN_TURN_S, longest=MAX_CAST_S, sample=EXACT_RAYS_PER_SORT)


def conditions(run: Run) -> Iterator[str]:
    """The machine, and how often."""
    it = run.settings
    few = "" if it["alternations"] >= MIN_ROUNDS else f", fewer than the {MIN_ROUNDS} that a report is to have"
    yield textwrap.fill(
        f"{len(run.scenes)} scenes of {it['size']} x {it['size']} pixels or as many rays, {it['threads']} threads, "
        f"medians of {it['alternations']} alternations{few}. Seed {it['seed']}.",
        WIDTH,
    )
    missing = [name for name in run.requested if run.scene(name) is None]
    if missing:
        yield f"\nNot timed: {', '.join(missing)}."
    yield "\n| machine | |\n|---|---|"
    yield from (f"| {name} | {value} |" for name, value in run.machine.items())
    yield ""


def of_targets(run: Run) -> Iterator[str]:
    yield "## Targets\n"
    yield "Times as fast as the other, unless stated otherwise; the worst scene counts.\n"
    yield "| beside | target | measured | where | |"
    yield "|---|---:|---:|---|---|"
    for it in targets.outcomes(run):
        mark = {True: "reached", False: "**missed**", None: "not measured"}[it.ok]
        sign = ">=" if it.least else "<="
        yield f"| {it.what} | {sign} {it.target:g} | {number(it.reached, 2)} | {it.where} | {mark} |"
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


def all_ratios(run: Run) -> Iterator[str]:
    """How many times as fast as each of the others ours is, scene by scene."""
    rows = {
        scene.name: [scene.ratio(key) for key in OVERVIEW]
        for scene in run.scenes
        if scene.workload in ALL_TASKS and scene.aovs in ((), AOVS)
    }
    if not rows:
        return
    yield "## Times as fast as the others\n"
    yield "Above 1 ours is faster; nothing where there is nothing to compare.\n"
    yield "| | " + " | ".join(BY_KEY[key].title for key in OVERVIEW) + " |"
    yield "|---|" + "---:|" * len(OVERVIEW)
    for name, ratios in rows.items():
        yield f"| [{name}](#{name}) | {' | '.join(number(ratio, 2) for ratio in ratios)} |"
    yield ""


def section(scene: SceneResult) -> Iterator[str]:
    yield f"## {scene.name}\n"
    details = [f"{scene.primitives:,} primitives"] if scene.primitives else []
    details += [", ".join(scene.aovs)] if scene.aovs else []
    yield "; ".join([f"{scene.title[0].upper()}{scene.title[1:]}", *details]) + ".\n"
    yield markdown(rows(scene), rule=RIGHT_ALIGNED)
    yield ""


def of_sweep(sweep: Sweep, drawn: set[str]) -> Iterator[str]:
    """Milliseconds of an image, a line for each contestant, and the slope."""
    yield f"## Time against {sweep.name}\n"
    yield from image_link(drawn, sweep.name, f"Time against {sweep.name}")
    every = sorted({x for one in sweep.series for x in one.x})
    yield textwrap.fill(
        f"Milliseconds of an image over the {sweep.quantity}. The slope is that of time ~ quantity^slope, fitted to "
        "all of them, and between the last two.",
        WIDTH,
    )
    yield "\n| | " + " | ".join(f"{x:,.0f}" for x in every) + " | slope | at the end |"
    yield "|---|" + "---:|" * (len(every) + 2)
    for one in sweep.series:
        at = dict(zip(one.x, one.seconds, strict=True))
        found = [number(1e3 * at[x] if x in at else None, 1) for x in every]
        why = f" ({one.why})" if one.why else ""
        slopes = [number(slope, 2) for slope in (one.slope, one.end_slope)]
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
        times = number(1.0 / ratio if ratio else None, 1)
        share = "-" if ratio is None else f"{100.0 * ratio:.1f} %"
        yield f"| {scene.name} | {' | '.join(number(rate, 2) for rate in rates)} | {times} | {share} |"
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
        ratios = ", ".join(f"{name} {ratio:.2f}" for name, ratio in found)
        yield textwrap.fill(
            f"Mitsuba's hint `coherent`: without it, `ray_intersect` takes so many times as long: {ratios}.", WIDTH
        )
        yield ""


def image_link(drawn: set[str], name: str, words: str) -> Iterator[str]:
    if name in drawn:
        yield f"![{words}]({IMAGE_FOLDER}/{name}.{performance_plots.PLOT_FORMAT})\n"


if __name__ == "__main__":
    main()

"""docs/internals/performance.md and its plot, from the JSON that `mitsuba-ref bench --json` wrote.

    python benchmarks/performance_page.py RUN.json FOLDER

`make bench` runs both. Every number on the page comes from the run. The table of README.md two
folders above FOLDER is that of the run as well.
"""

import io
import math
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from pages import WIDTH, markdown, read_result, write_page

from caster.system.atomic_files import write_text
from mitsuba_ref.bench.casters import BY_KEY
from mitsuba_ref.bench.drivers import FILM
from mitsuba_ref.bench.machine import CORES
from mitsuba_ref.bench.measuring import EXACT_RAYS, MAX_CAST_S, MIN_TURN_S
from mitsuba_ref.bench.result import COLUMNS, Run, SceneResult, overview, rows

PAGE, IMAGE_FOLDER = "performance.md", "performance"
README, README_SECTION = "README.md", "## How fast\n"  # whose table has these scenes of the run
README_SCENES = ("one-sphere", "spheres-200", "rays-incoherent", "bunny", "bunny-lit")

HEAD = """# Run time against error

<!-- written by `make bench`; change benchmarks/performance_page.py -->

The same scenes, in the same float32 numbers: our caster and Mitsuba 3; other ray casters are timed as candidates.
Each caster has a process of its own; they take turns, so that what else the machine does hits all of them. What
bounds our times, and what was tried: [notes](performance-notes.md).
"""

READING = """## How to read it

- **What is timed**: an image of some AOVs, depth and normal unless others are named, delivered as float32 arrays in
  memory; or t and normal along rays that were on hand. All have loaded the scene and
  built what they build before, and everything is compiled; ours makes the rays and sorts the primitives onto the film
  in every image, while for `ray_intersect` the rays were made before, too.
- **ours** is `caster.render`: by rasterization for pinhole and orthographic cameras, by the BVH for others; for rays
  that are handed over, `caster.cast` with the surface of each hit.
- **diffuse** is light with shadows: the AOV integrator has `direct` inside. Ours adds ambient light to it.
- A size behind a name: images of those who would take longer than {longest:g} s are made smaller.
- **build**: milliseconds from the numbers to where rays can be cast, the second time it is done in a process; Mitsuba
  reads its own files, and for ours the numbers are in memory.
- **ns/ray**: the median of all alternations; casts of less than {least:g} s are repeated within a turn, and their
  median is the turn's. **times as fast** is ours as this row, by the median of the ratios of each alternation.
- **ulps**: the largest error of t on {sample:,} rays of the image, the same float32 rays for everybody, against exact
  arithmetic (`mitsuba_ref/oracle/oracle.py`), in float32 units in the last place of the exact t. **bounds**: in units
  of the bound that is derived for each ray, in the precision of the caster: float64 for ours, float32 for Mitsuba
  ([method.md](../method.md)). Ours is called through `caster.cast`, float64; no culling changes a bit, and images of
  float32 add half a unit. Mitsuba's AOV integrator takes no rays from outside, so `ray_intersect`, which it calls, is
  judged on the same scene.
- **wrong** on those rays: hits where there is exactly nothing and misses where there is something; behind a `+`, hits
  farther off than their bound, mostly those of another surface. At edges and silhouettes: [stress](stress.md).
"""

# Colours after Okabe and Ito (2008), which people of any colour vision tell apart; markers differ as well.
STYLE: dict[str, tuple[str, str]] = {
    "ours": ("#0072B2", "o"),
    "raw-robust": ("#009E73", "o"),
    "raw-default": ("#D55E00", "o"),
    "aov-robust": ("#009E73", "^"),
    "scalar-aov": ("#E69F00", "^"),
}
MIN_DRAWN_ULPS = 1e-9  # float32 units in the last place: an error of nothing shows as this
PLOTS_A_ROW, DPI = 3, 110

Point = tuple[float, float]  # nanoseconds a ray, float32 ulps


def main() -> None:
    file, folder = sys.argv[1:]
    write_report(read_result(Run, file, "mitsuba-ref bench"), Path(folder))


def write_report(run: Run, folder: Path) -> None:
    """Write the page and its plot, and the table of the README. Raises OutputError."""
    scored = [scene for scene in run.scenes if points(scene)]
    write_page(folder, PAGE, lines(run), IMAGE_FOLDER, {"pareto.png": pareto(scored)})
    readme = folder.resolve().parents[1] / README
    if readme.exists():
        write_text(readme, with_tables(readme.read_text(encoding="utf-8"), run))


def with_tables(text: str, run: Run) -> str:
    """The README with the table of a run in place of the one that stands in its section."""
    before, head, rest = text.partition(README_SECTION)
    section, rule, after = rest.partition("\n## ")
    few = table(replace(run, scenes=[scene for scene in run.scenes if scene.name in README_SCENES]))
    blocks = [few if block.startswith("|") else block for block in section.split("\n\n")]
    return before + head + "\n\n".join(blocks) + rule + after


def table(run: Run) -> str:
    cells = overview(run)
    return markdown(cells, rule="|---|---|" + "---:|" * (len(cells[0]) - 2))


def lines(run: Run) -> Iterator[str]:
    it = run.settings
    yield HEAD
    yield textwrap.fill(
        f"{len(run.scenes)} scenes of {it['size']} x {it['size']} pixels or as many rays, "
        f"{run.machine[CORES]} processors, medians of {it['alternations']} alternations.",
        WIDTH,
    )
    if missing := sorted({*run.requested} - {scene.name for scene in run.scenes}):
        yield f"\nNot timed: {', '.join(missing)}."
    yield "\n| machine | |\n|---|---|"
    yield from (f"| {name} | {value} |" for name, value in run.machine.items())
    yield "\nMilliseconds of ours, and how many times as fast as each of the others it is.\n"
    yield table(run)
    yield f"\n![Error against time, for each scene]({IMAGE_FOLDER}/pareto.png)\n"
    for scene in run.scenes:
        yield f"## {scene.name}\n"
        aovs = f"; {', '.join(scene.aovs)}" if scene.workload == FILM else ""
        yield f"{scene.title[0].upper()}{scene.title[1:]}; {scene.primitives:,} primitives{aovs}.\n"
        yield markdown(rows(scene), rule="|---|" + "---:|" * (len(COLUMNS) - 1)) + "\n"
    yield READING.format(least=MIN_TURN_S, longest=MAX_CAST_S, sample=EXACT_RAYS)


def pareto(scenes: Sequence[SceneResult]) -> bytes:
    """PNG: largest error of t against time for a ray, and a line through those whom nobody beats in both."""
    height = 3.1 * math.ceil(len(scenes) / PLOTS_A_ROW) + 1.6
    with matplotlib.rc_context({"font.size": 8.5, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(9.0, height), layout="constrained")
        axes = figure.subplots(max(1, math.ceil(len(scenes) / PLOTS_A_ROW)), PLOTS_A_ROW, squeeze=False, sharey=True)
        shown: dict[str, Any] = {}
        for scene, ax in zip(scenes, axes.flat, strict=False):
            found = points(scene)
            ax.plot(*zip(*front(found.values()), strict=True), color="#999999", lw=1.0, drawstyle="steps-post")
            for key, (x, y) in found.items():
                color, marker = STYLE[key]
                (mark,) = ax.plot([x], [y], marker, color=color, mfc="none", ms=7)
                shown.setdefault(BY_KEY[key].title, mark)
            ax.set(xscale="log", yscale="log", title=scene.name, xlabel="nanoseconds a ray")
            ax.grid(True, color="#dddddd", lw=0.5)
        for ax in axes.flat[len(scenes) :]:
            ax.set_visible(False)
        figure.supylabel("largest error of t on rays of the image, float32 ulps", fontsize=9)
        figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=3, frameon=False)
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=DPI, metadata={"Software": None})
    return out.getvalue()


def points(scene: SceneResult) -> dict[str, Point]:
    """Time and error of every row that has both, by key."""
    return {
        row.key: (row.ns, max(row.score.ulps, MIN_DRAWN_ULPS))
        for row in scene.rows
        if row.key in STYLE and row.ns is not None and row.score is not None and row.score.ulps is not None
    }


def front(points: Iterable[Point]) -> list[Point]:
    """The points that no other is both faster and more right than, fastest first (Pareto's front)."""
    kept: list[Point] = []
    for point in sorted(points):
        if not kept or point[1] < kept[-1][1]:
            kept.append(point)
    return kept


if __name__ == "__main__":
    main()

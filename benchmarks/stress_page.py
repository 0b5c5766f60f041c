"""docs/stress.md and its plots, from the JSON that `mitsuba-ref stress --json` wrote.

    python benchmarks/stress_page.py RUN.json FOLDER

`make stress` runs both. Every number on the page comes from the run.
"""

import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import stress_plots
from pages import WIDTH, write_page

from mitsuba_ref.report.results import markdown, read_result
from mitsuba_ref.stress import sweeps
from mitsuba_ref.stress.score import WITNESSES, Score
from mitsuba_ref.stress.sweeps import OUR_KEYS, StressRun, SweepResult

PAGE, IMAGE_FOLDER = "stress.md", "stress"

HEAD = """# Numerical stability

<!-- written by `make stress`; change benchmarks/stress_page.py instead -->

Each sweep makes one quantity more extreme, decade by decade; all witnesses cast the same rays through the same
geometry, in the same float32 numbers. Right answers come from arithmetic in whole numbers, without any rounding
(`mitsuba_ref/oracle/oracle.py`), for the numbers as they are given. So an error here is arithmetic alone.
"""

READING = """## How to read it

- **Errors** are the largest of a setting, relative to the exact distance, or as the table's head states. A `!` means
  that some ray is beyond the bound of its own, which is worked out for each ray as in
  [method.md](method.md); `bound 32` and `bound 64` are the largest bounds of a setting for Mitsuba and for ours.
- **Wrong** are hits where there is exactly none, and misses where there is exactly one; behind a `+`, hits of another
  primitive than any of those that are exactly nearest (`ties` counts rays that have several), in a closed mesh of the
  rays that exact arithmetic decided.
- A witness **breaks down** at the first setting, on either side of the easiest one, where a hit or miss is wrong or an
  error beyond its bound. That is ringed in the plots. Not every breakdown is a mistake: beyond the reach of
  float32, a ray may come out either way. And naming the wrong one of two surfaces that are almost equally near is none
  by this measure; the plots show it by diamonds.
- Mitsuba runs in three configurations: its scalar variant with Embree's robust mode, which `validate` uses for
  spheres, disks and cylinders; its LLVM variant as it comes; and its LLVM variant with the robust mode, which
  `validate` uses for triangles. Whatever it gets wrong is reported; only faults of ours fail the run.
- A line that ends has nothing to compare there: its rays all miss. A bound that ends is none: float32 does not resolve
  these rays at all.
- Images are cast along our camera's rays, rounded to float32; our caster also rasterizes them. How
  far Mitsuba's own sensors are off is another matter, and part of `validate`.
- Rays are aimed at random by a seed. Every setting is checked to have exact hits, and misses, too, but for those inside
  a closed mesh. There every ray hits, which exact arithmetic confirms for a sample and for reported misses.
"""


def main() -> None:
    file, folder = sys.argv[1:]
    write_report(read_result(StressRun, file, "mitsuba-ref stress"), Path(folder))


def write_report(run: StressRun, folder: Path) -> None:
    """Write stress.md and its plots. Raises OutputError."""
    plots = {f"{sweep.name}.{stress_plots.FORMAT}": stress_plots.as_svg(sweep) for sweep in run.families}
    write_page(folder, PAGE, lines(run), IMAGE_FOLDER, plots)


def lines(run: StressRun) -> Iterator[str]:
    yield HEAD
    yield from outcome(run)
    yield from summary(run)
    yield READING
    for sweep in run.families:
        yield from section(sweep)


def outcome(run: StressRun) -> Iterator[str]:
    settings = [setting for sweep in run.families for setting in sweep.settings]
    rays, adjudicated = sum(each.rays for each in settings), sum(each.exact.adjudicated for each in settings)
    scores = [each.witnesses[key] for each in settings for key in OUR_KEYS]
    own = [score for score in scores if isinstance(score, Score)]
    counts = ("wrong_masks", "wrong_primitives", "beyond")
    wrong, other, beyond = (sum(getattr(score, name) for score in own) for name in counts)
    worst = max((score.worst for score in own if score.worst is not None), default=0.0)
    yield textwrap.fill(
        f"In {len(run.families)} sweeps, {len(settings)} settings and {rays:,} rays, {adjudicated:,} of them "
        f"decided by exact arithmetic, ours has **{wrong} wrong hits or misses, {other} wrong primitives and "
        f"{beyond} errors beyond their bound**. Its largest error is {worst:.2f} of the bound of its ray.",
        WIDTH,
    )
    yield f"\nSeed {run.seed}; {', '.join(f'{name} {version}' for name, version in run.versions.items())}.\n"


def summary(run: StressRun) -> Iterator[str]:
    yield "## Where each breaks down\n"
    witnesses = [witness for witness in WITNESSES if witness.key != "screen"]
    rows = [["sweep", "stressed quantity", *(witness.title for witness in witnesses)]]
    for sweep in run.families:
        found = [sweeps.breakdown(sweep, witness.key) for witness in witnesses]
        rows.append([f"[{sweep.name}](#{sweep.name})", sweep.quantity, *found])
    yield markdown(rows)
    yield ""


def section(sweep: SweepResult) -> Iterator[str]:
    name = sweep.name
    yield f"## {name}\n"
    yield f"{sweep.title[0].upper()}{sweep.title[1:]}: {sweep.error}, and wrong hits or misses.\n"
    image = f"{IMAGE_FOLDER}/{name}.{stress_plots.FORMAT}"
    yield f"![{name}: errors and wrong answers over the {sweep.quantity}]({image})\n"
    yield from (f"FAIL: {problem}\n" for problem in sweep.problems)
    if not sweep.misses:
        yield f"{sweeps.leaks(sweep).capitalize()}.\n"
    yield "<details><summary>numbers</summary>\n"
    yield markdown(sweeps.rows(sweep))
    yield "\n</details>\n"


if __name__ == "__main__":
    main()

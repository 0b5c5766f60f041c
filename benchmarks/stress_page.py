"""docs/internals/stress.md and its plots, from the JSON that `mitsuba-ref stress --json` wrote.

    python benchmarks/stress_page.py RUN.json FOLDER

`make stress` runs both. Every number on the page comes from the run.
"""

import io
import math
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from pages import WIDTH, markdown, read_result, write_page

from mitsuba_ref.stress.origins import OriginSweep
from mitsuba_ref.stress.sweeps import CASTERS, OURS, Score, SettingResult, StressRun, SweepResult

PAGE, IMAGE_FOLDER = "stress.md", "stress"

HEAD = """# Numerical stability

<!-- written by `make stress`; change benchmarks/stress_page.py instead -->

Each sweep makes one quantity more extreme, decade by decade; all casters cast the same rays through the same
geometry, in the same float32 numbers. Right answers come from arithmetic in whole numbers, without any rounding
(`mitsuba_ref/oracle/oracle.py`), for the numbers as they are given. So an error here is arithmetic alone.
"""

# Colours after Okabe and Ito (2008), which people of any colour vision tell apart; markers and dashes differ as well.
STYLE: dict[str, dict[str, Any]] = {
    "ours": {"color": "#0072B2", "marker": "o", "ms": 5, "lw": 2.0, "zorder": 6},
    "scalar": {"color": "#E69F00", "marker": "s", "ms": 8, "lw": 3.0, "mfc": "none", "zorder": 3},
    "llvm": {"color": "#D55E00", "marker": "x", "ms": 7, "lw": 1.5, "ls": "-.", "zorder": 4},
    "llvm-robust": {"color": "#009E73", "marker": "^", "ms": 4, "lw": 1.2, "zorder": 5},
}
BOUNDS = {"bound32": ("predicted bound of float32", "--"), "bound64": ("predicted bound of ours, float64", ":")}
AXIS_LOW, AXIS_HIGH = 1e-18, 1e3  # errors of nothing, and those by which all digits are lost, show as these
FONT, OTHERS = "'DejaVu Sans'", ", Verdana, sans-serif"  # the one that Matplotlib measures with; a viewer's

READING = """## How to read it

- **Errors** are the largest of a setting, relative to the exact distance, or as the table's head states. A `!` means
  that some ray is beyond the bound of its own, which is worked out for each ray as in
  [method.md](../method.md); `bound 32` and `bound 64` are the largest bounds of a setting for Mitsuba and for ours.
- **Wrong** are hits where there is exactly none, and misses where there is exactly one. Ours also has to name the
  first of the primitives that are exactly nearest (`ties` counts rays that have several).
- A caster **breaks down** at the first setting, on either side of the easiest one, where a hit or miss is wrong or an
  error beyond its bound. Not every breakdown is a mistake: beyond the reach of float32, a ray may come out either way.
- Mitsuba runs in three configurations: its scalar variant with Embree's robust mode, which `validate` uses for
  spheres, disks and cylinders; its LLVM variant as it comes; and its LLVM variant with the robust mode, which
  `validate` uses for triangles. Whatever it gets wrong is reported; only faults of ours fail the run.
- A line that ends has nothing to compare there: its rays all miss. A bound that ends is none: float32 does not resolve
  these rays at all.
- Rays are aimed at random by a seed. Every setting is checked to have exact hits, and misses, too, but for those inside
  a closed mesh. There every ray hits, which exact arithmetic confirms for a sample and for reported misses.
"""


def main() -> None:
    file, folder = sys.argv[1:]
    write_report(read_result(StressRun, file, "mitsuba-ref stress"), Path(folder))


def write_report(run: StressRun, folder: Path) -> None:
    """Write stress.md and its plots. Raises OutputError."""
    plots = {f"{sweep.name}.svg": plot(sweep) for sweep in casts(run)}
    write_page(folder, PAGE, lines(run), IMAGE_FOLDER, plots)


def casts(run: StressRun) -> list[SweepResult]:
    """The sweeps of ray casters."""
    return [sweep for sweep in run.families if isinstance(sweep, SweepResult)]


def lines(run: StressRun) -> Iterator[str]:
    yield HEAD
    yield from outcome(run)
    yield from summary(run)
    yield READING
    for sweep in casts(run):
        yield from section(sweep)
    for sweep in run.families:
        if isinstance(sweep, OriginSweep):
            yield f"## {sweep.name}\n\n{sweep.title[0].upper()}{sweep.title[1:]}. Each cell counts self-hits/skipped"
            yield "surfaces/wrong sides of secondary rays ([method.md](../method.md#origins-of-secondary-rays)).\n"
            yield f"{markdown(sweep.rows())}\n"


def outcome(run: StressRun) -> Iterator[str]:
    settings = [setting for sweep in casts(run) for setting in sweep.settings]
    rays, adjudicated = sum(each.rays for each in settings), sum(each.adjudicated for each in settings)
    own = [score for each in settings if isinstance(score := each.witnesses[OURS.key], Score)]
    wrong, beyond = (sum(getattr(score, name) for score in own) for name in ("wrong_masks", "beyond"))
    worst = max((score.worst for score in own if score.worst is not None), default=0.0)
    yield textwrap.fill(
        f"In {len(casts(run))} sweeps, {len(settings)} settings and {rays:,} rays, {adjudicated:,} of them "
        f"decided by exact arithmetic, ours has **{wrong} wrong hits or misses, and "
        f"{beyond} hits of a wrong primitive or beyond their bound**. Its largest error is {worst:.2f} of the bound of "
        "its ray.",
        WIDTH,
    )
    if spawned := [f"[{sweep.name}](#{sweep.name})" for sweep in run.families if isinstance(sweep, OriginSweep)]:
        yield f"\n{len(spawned)} more sweeps judge where secondary rays start:\n{', '.join(spawned)}."
    yield f"\nSeed {run.seed}; {', '.join(f'{name} {version}' for name, version in run.versions.items())}.\n"


def summary(run: StressRun) -> Iterator[str]:
    yield "## Where each breaks down\n"
    rows = [["sweep", "stressed quantity", *(caster.title for caster in CASTERS)]]
    for sweep in casts(run):
        found = [sweep.breakdown(caster.key) for caster in CASTERS]
        rows.append([f"[{sweep.name}](#{sweep.name})", sweep.quantity, *found])
    yield markdown(rows)
    yield ""


def section(sweep: SweepResult) -> Iterator[str]:
    name = sweep.name
    yield f"## {name}\n"
    yield f"{sweep.title[0].upper()}{sweep.title[1:]}: {sweep.error}, and wrong hits or misses.\n"
    image = f"{IMAGE_FOLDER}/{name}.svg"
    yield f"![{name}: errors and wrong answers over the {sweep.quantity}]({image})\n"
    yield from (f"FAIL: {problem}\n" for problem in sweep.problems)
    if not sweep.misses:
        yield f"{sweep.leaks().capitalize()}.\n"
    yield "<details><summary>numbers</summary>\n"
    yield markdown(sweep.rows())
    yield "\n</details>\n"


def plot(sweep: SweepResult) -> bytes:
    """SVG: errors above, shares of wrong answers below, over the stressed quantity; the same bytes for the same result.

    Letters stay letters, so that the file is small. A quantity of 0 stands a decade before the least other.
    """
    x = np.array([setting.x for setting in sweep.settings])
    ticks = x[x > 0.0]
    x = np.where(x > 0.0, x, ticks.min(initial=1.0) / 10.0)
    floor = 0.3 / max(setting.rays for setting in sweep.settings)
    settings: Any = {"svg.fonttype": "none", "svg.hashsalt": sweep.name, "font.size": 9.0, "font.family": "DejaVu Sans"}
    with matplotlib.rc_context(settings):
        figure = Figure(figsize=(8.4, 6.2), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3.0, 1.8])
        for name, (label, dashes) in BOUNDS.items():
            bound = numbers([getattr(setting, name) for setting in sweep.settings])
            above.plot(x, np.clip(bound, AXIS_LOW, AXIS_HIGH), lw=1.3, color="#444444", ls=dashes, label=label)
        for caster in sweep.casters:
            key, style = caster.key, STYLE[caster.key]
            place = sweep.breakdown(key)
            label = f"{caster.title}: {'' if sweep.absence(key) else 'breaks down at '}{place}"
            error = numbers([value(setting, key, "error") for setting in sweep.settings])
            above.plot(x, np.clip(error, AXIS_LOW, AXIS_HIGH), label=label, **style)
            wrong = numbers([value(setting, key, "wrong_masks") for setting in sweep.settings])
            below.plot(x, np.maximum(wrong / [setting.rays for setting in sweep.settings], floor), **style)
        above.set(yscale="log", ylim=(AXIS_LOW / 3.0, AXIS_HIGH * 3.0), ylabel=f"largest {sweep.error}")
        below.set(xscale="log", yscale="log", ylim=(floor / 2.0, 2.0), ylabel="share of wrong hits and misses")
        below.set_xlabel(sweep.quantity + (" (first setting: 0)" if sweep.settings[0].x == 0.0 else ""))
        above.set_title(f"{sweep.name}: {sweep.title}", loc="left", fontsize=10)
        for axes in (above, below):
            axes.grid(True, color="#dddddd", lw=0.5)
        figure.legend(loc="outside lower left", ncols=2, frameon=False)
        out = io.BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue().decode().replace(FONT, FONT + OTHERS)
    return "".join(f"{line.strip()}\n" for line in text.splitlines()).encode()


def value(setting: SettingResult, key: str, what: str) -> float | None:
    score = setting.witnesses[key]
    return getattr(score, what) if isinstance(score, Score) else None


def numbers(values: list[float | None]) -> np.ndarray:
    """NaN for what is not there, so that lines have a gap."""
    return np.array([math.nan if value is None else value for value in values], float)


if __name__ == "__main__":
    main()

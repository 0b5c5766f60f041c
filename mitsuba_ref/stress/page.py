"""A sweep as a picture: errors above, wrong answers below, over the stressed quantity; all axes logarithmic."""

import io
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from caster.image.atomic_files import check_folder, write_bytes, write_text
from mitsuba_ref.stress import table
from mitsuba_ref.stress.score import Score
from mitsuba_ref.stress.sweeps import OUR_KEYS, Outcome, Sweep, broken
from mitsuba_ref.stress.table import breakdown, shown_witnesses
from mitsuba_ref.stress.witnesses import WITNESSES, Witness

# Colours after Okabe and Ito (2008), which people of any colour vision tell apart; markers and dashes differ as well.
STYLE: dict[str, dict[str, Any]] = {
    "ours": {"color": "#0072B2", "marker": "o", "ms": 5, "lw": 2.0, "zorder": 6},
    "screen": {"color": "#CC79A7", "marker": "+", "ms": 9, "lw": 1.0, "zorder": 7},
    "scalar": {"color": "#E69F00", "marker": "s", "ms": 8, "lw": 3.0, "mfc": "none", "zorder": 3},
    "llvm": {"color": "#D55E00", "marker": "x", "ms": 7, "lw": 1.5, "ls": "-.", "zorder": 4},
    "llvm-robust": {"color": "#009E73", "marker": "^", "ms": 4, "lw": 1.2, "zorder": 5},
}
BOUNDS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("float32", "predicted bound of float32", {"color": "#444444", "ls": "--"}),
    ("float64", "predicted bound of ours, float64", {"color": "#444444", "ls": ":"}),
)
RING: dict[str, Any] = {"marker": "o", "ls": "none", "mfc": "none", "mew": 1.5, "ms": 15, "zorder": 20}
DIAMONDS: dict[str, Any] = {"ls": (0, (1, 2)), "lw": 1.5, "marker": "D", "ms": 4, "mfc": "white"}

# Errors of nothing, and errors that say no more than that all is lost, show as these.
LEAST, MOST = 1e-18, 1e3
FORMAT = "svg"
FONT, OTHERS = "'DejaVu Sans'", ", Verdana, sans-serif"  # the one that Matplotlib brings along; a viewer's


class MissingPlots(ImportError):  # noqa: N818 - what is missing is the subject
    """Matplotlib is not there; str() says what to install."""


def check_available() -> None:
    """Raise MissingPlots unless pictures can be drawn."""
    try:
        import matplotlib  # noqa: F401 - whether it is there
    except ImportError as error:
        text = "pictures need matplotlib, tables and JSON do not: pip install 'ray-reference[plots]'"
        raise MissingPlots(text) from error


def as_svg(sweep: Sweep) -> bytes:
    """The picture; the same bytes for the same result. Raises MissingPlots."""
    check_available()
    import matplotlib
    from matplotlib.figure import Figure

    # Letters stay letters, so that the file is small; the viewer's font may be wider than the one measured here.
    settings: Any = {"svg.fonttype": "none", "svg.hashsalt": sweep.family.name, "font.size": 9.0}
    settings |= {"font.family": FONT.strip("'"), "mathtext.default": "regular"}
    with matplotlib.rc_context(settings):
        figure = Figure(figsize=(8.4, 6.2))
        above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": [3.0, 1.8], "hspace": 0.1})
        draw_errors(above, sweep)
        draw_wrong(below, sweep)
        draw_x_axis(above, sweep, named=False)
        draw_x_axis(below, sweep, named=True)
        draw_legend(figure, above)
        above.set_title(f"{sweep.family.name}: {sweep.family.title}", loc="left", fontsize=10)
        figure.subplots_adjust(left=0.1, right=0.98, top=0.95, bottom=0.26)
        out = io.BytesIO()
        figure.savefig(out, format=FORMAT, metadata={"Date": None, "Creator": None})
    text = out.getvalue().decode().replace(FONT, FONT + OTHERS)
    return "".join(f"{line.strip()}\n" for line in text.splitlines()).encode()


def x_positions(sweep: Sweep) -> np.ndarray:
    """Where settings go on the x axis; 0 stands a decade before the least other."""
    x = np.array([outcome.x for outcome in sweep.outcomes])
    return np.where(x > 0.0, x, x[x > 0.0].min(initial=np.inf) / 10.0 if (x > 0.0).any() else 1.0)


def draw_errors(axes: Any, sweep: Sweep) -> None:
    x = x_positions(sweep)
    for name, label, style in BOUNDS:
        y = numbers([getattr(outcome.bound, name) for outcome in sweep.outcomes])
        axes.plot(x, np.clip(y, LEAST, MOST), lw=1.3, label=label, zorder=2, **style)
    for witness in shown_witnesses(sweep):
        y = numbers([value(outcome, witness.key, "error") for outcome in sweep.outcomes])
        axes.plot(x, np.clip(y, LEAST, MOST), label=legend_text(sweep, witness), **STYLE[witness.key])
        draw_rings(axes, sweep, witness, np.clip(y, LEAST, MOST), "beyond")
    axes.set_yscale("log")
    axes.set_ylim(LEAST / 3.0, MOST * 3.0)
    powers = range(-15, 1, 3)
    words = ["0", *(power_of_ten(k) for k in powers), "1000+"]
    axes.set_yticks([LEAST, *(10.0**k for k in powers), MOST], words)
    axes.minorticks_off()
    axes.set_ylabel(f"largest {sweep.family.error}")


def draw_wrong(axes: Any, sweep: Sweep) -> None:
    """Shares of rays: wrong hits and misses as lines, wrong primitives as thin dashes."""
    x = x_positions(sweep)
    floor = 0.3 / max(outcome.rays for outcome in sweep.outcomes)
    for witness in shown_witnesses(sweep):
        style = STYLE[witness.key]
        masks = shares(sweep, witness, "wrong_masks", floor)
        axes.plot(x, masks, **style)
        draw_rings(axes, sweep, witness, masks, "wrong_masks")
        others = shares(sweep, witness, "wrong_primitives", floor)
        others[others <= floor] = math.nan
        axes.plot(x, others, color=style["color"], zorder=style["zorder"] + 10, **DIAMONDS)
    axes.set_yscale("log")
    axes.set_ylim(floor / 2.0, 2.0)
    ticks = [floor, *(10.0**k for k in range(math.ceil(math.log10(2.0 * floor)), 1))]
    axes.set_yticks(ticks, ["0", *(f"{100.0 * tick:g} %" for tick in ticks[1:])])
    axes.set_ylabel("wrong hits and misses")
    axes.minorticks_off()


def shares(sweep: Sweep, witness: Witness, what: str, floor: float) -> np.ndarray:
    found = numbers([value(outcome, witness.key, what) for outcome in sweep.outcomes])
    count = [outcome.rays if what == "wrong_masks" else outcome.asked for outcome in sweep.outcomes]
    return np.maximum(found / np.maximum(count, 1), floor)


def draw_rings(axes: Any, sweep: Sweep, witness: Witness, y: np.ndarray, what: str) -> None:
    """A ring around the first settings at which the witness breaks down, where it is this that does it."""
    for place in sweep.breakdowns(witness.key):
        i = next(i for i, outcome in enumerate(sweep.outcomes) if outcome.x == place)
        if broken(sweep.outcomes[i], witness.key) and value(sweep.outcomes[i], witness.key, what):
            axes.plot(x_positions(sweep)[i], y[i], mec=STYLE[witness.key]["color"], **RING)


def draw_x_axis(axes: Any, sweep: Sweep, *, named: bool) -> None:
    """The x axis; its name and its numbers below the lower plot only."""
    x = x_positions(sweep)
    axes.set_xscale("log")
    margin = (x.max() / x.min()) ** MARGIN
    axes.set_xlim(x.min() / margin, x.max() * margin)
    zero = sweep.outcomes[0].x == 0.0
    least, most = (math.log10(end) for end in (x[int(zero)] * 0.99, x.max() * 1.01))
    every = max(1, math.ceil((most - least) / TICKS))
    powers = [k for k in range(math.ceil(least), math.floor(most) + 1) if k % every == 0]
    ticks, words = [10.0**k for k in powers], [power_of_ten(k) for k in powers]
    if zero:
        ticks, words = [x.min(), *ticks], ["0", *words]
    axes.set_xticks(ticks, words if named else [""] * len(words))
    axes.minorticks_off()
    axes.grid(True, color="#dddddd", lw=0.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if named:
        axes.set_xlabel(sweep.family.quantity)


TICKS = 12  # at most, on the x axis
MARGIN = 0.03  # share of the x axis on either side of the settings


def power_of_ten(k: int) -> str:
    return {0: "1", 1: "10"}.get(k, f"$10^{{{k}}}$")


def draw_legend(figure: Any, axes: Any) -> None:
    """What line is whose and where it breaks down; what the other marks are."""
    from matplotlib.lines import Line2D

    handles, labels = axes.get_legend_handles_labels()
    few = len(BOUNDS)
    marks = [Line2D([], [], mec="black", **RING), Line2D([], [], color="black", **DIAMONDS)]
    words = ["first setting where one breaks down", "wrong primitive"]
    style: dict[str, Any] = {"frameon": False, "handlelength": 3.5, "loc": "upper left", "borderpad": 0.0}
    figure.legend(handles[few:], labels[few:], bbox_to_anchor=(0.02, 0.165), **style)
    figure.legend([*handles[:few], *marks], [*labels[:few], *words], bbox_to_anchor=(0.62, 0.165), **style)


def legend_text(sweep: Sweep, witness: Witness) -> str:
    """A line of the legend."""
    absent = sweep.absence(witness.key)
    place = breakdown(sweep, witness.key)
    return f"{witness.title}: {place}" if absent else f"{witness.title}; breaks: {place}"


def value(outcome: Outcome, key: str, what: str) -> float | None:
    score = outcome.scores[key]
    return getattr(score, what) if isinstance(score, Score) else None


def numbers(values: Sequence[float | None]) -> np.ndarray:
    """NaN for what is not there, so that lines have a gap."""
    return np.array([math.nan if value is None else value for value in values], float)


# docs/stress.md: every number in it comes from the run.


PAGE, PICTURES = "stress.md", "stress"
WIDTH = 120  # of lines of prose

HEAD = """# Numerical stability

<!-- written by `make stress`; change mitsuba_ref/stress/page.py instead -->

Each sweep makes one thing harder, decade by decade, and asks everybody about the same rays through the same geometry,
in the very same float32 numbers. What is right is decided in whole numbers, without any rounding
(`mitsuba_ref/oracle/oracle.py`), for the numbers as they are given. So an error here is arithmetic alone.
"""

READING = """## How to read it

- **Errors** are the largest of a setting, relative to the exact distance, or what the table's head says. A `!` means
  that some ray is beyond the bound of its own, which is worked out for each ray as in
  [method.md](method.md); `bound 32` and `bound 64` are the largest bounds of a setting for Mitsuba and for ours.
- **Wrong** are hits where there is exactly none, and misses where there is exactly one; behind a `+`, hits of another
  primitive than any of those that are exactly nearest (`ties` counts rays that have several), in a closed mesh of the
  rays that exact arithmetic was asked about.
- A witness **breaks down** at the first setting, on either side of the easiest one, where a hit or miss is wrong or an
  error beyond its bound. That is ringed in the pictures. Not every breakdown is a mistake: beyond the reach of
  float32, a ray may come out either way. And naming the wrong one of two surfaces that are almost equally near is none
  by this measure; the pictures show it by diamonds.
- Mitsuba is asked in three ways: its scalar variant with Embree's robust mode, which is what `validate` asks about
  spheres, disks and cylinders; its LLVM variant as it comes; and its LLVM variant with the robust mode, which
  `validate` asks about triangles. Whatever it gets wrong is reported; only faults of ours fail the run.
- A line that ends has nothing to compare there: its rays all miss. A bound that ends is none: float32 does not resolve
  these rays at all.
- Pictures of a camera are cast along our camera's rays, rounded to float32, and ours once more through the screen. How
  far Mitsuba's own sensors are off is another matter, and part of `validate`.
- Rays are aimed at random by a seed. Every setting is checked to have exact hits, and misses, too, but for those inside
  a closed mesh. There every ray hits, which exact arithmetic confirms for a sample and for misses it is told of.
"""


def write_report(sweeps: Sequence[Sweep], seed: int, versions: Mapping[str, str], folder: Path) -> None:
    """stress.md and its pictures. Raises OutputError; without Matplotlib there is the page without pictures."""
    pictures = check_folder(folder / PICTURES)
    try:
        for sweep in sweeps:
            write_bytes(pictures / f"{sweep.family.name}.{FORMAT}", as_svg(sweep))
        drawn = True
    except MissingPlots:
        drawn = False
    write_text(folder / PAGE, "\n".join(lines(sweeps, seed, versions, drawn)) + "\n")


def lines(sweeps: Sequence[Sweep], seed: int, versions: Mapping[str, str], drawn: bool) -> Iterator[str]:
    yield HEAD
    yield from outcome(sweeps, seed, versions)
    yield from summary(sweeps)
    yield READING
    for sweep in sweeps:
        yield from section(sweep, drawn)


def outcome(sweeps: Sequence[Sweep], seed: int, versions: Mapping[str, str]) -> Iterator[str]:
    settings = [outcome for sweep in sweeps for outcome in sweep.outcomes]
    rays, asked = (sum(getattr(each, name) for each in settings) for name in ("rays", "asked"))
    own = [
        score
        for each in settings
        for key in OUR_KEYS
        for score in [each.scores[key]]
        if isinstance(score, Score)
    ]
    counts = ("wrong_masks", "wrong_primitives", "beyond")
    wrong, other, beyond = (sum(getattr(score, name) for score in own) for name in counts)
    worst = max((score.worst for score in own if score.worst is not None), default=0.0)
    yield textwrap.fill(
        f"In {len(sweeps)} sweeps, {len(settings)} settings and {rays:,} rays, of which exact arithmetic looked at "
        f"{asked:,}, ours has **{wrong} wrong hits or misses, {other} wrong primitives and {beyond} errors beyond "
        f"their bound**. Its largest error is {worst:.2f} of the bound of its ray.",
        WIDTH,
    )
    yield f"\nSeed {seed}; {', '.join(f'{name} {version}' for name, version in versions.items())}.\n"


def summary(sweeps: Sequence[Sweep]) -> Iterator[str]:
    yield "## Where each breaks down\n"
    witnesses = [witness for witness in WITNESSES if witness.key != "screen"]
    yield "| sweep | stressed quantity | " + " | ".join(witness.title for witness in witnesses) + " |"
    yield "|---|---|" + "---|" * len(witnesses)
    for sweep in sweeps:
        found = [table.breakdown(sweep, witness.key) for witness in witnesses]
        name = sweep.family.name
        yield f"| [{name}](#{name}) | {sweep.family.quantity} | {' | '.join(found)} |"
    yield ""


def section(sweep: Sweep, drawn: bool) -> Iterator[str]:
    family = sweep.family
    yield f"## {family.name}\n"
    yield f"{family.title[0].upper()}{family.title[1:]}: {family.error}, and wrong hits or misses.\n"
    if drawn:
        yield f"![{family.name}: errors and wrong answers over the {family.quantity}]({PICTURES}/{family.name}.svg)\n"
    yield from (f"FAIL: {problem}\n" for problem in sweep.problems)
    if any(outcome.closed for outcome in sweep.outcomes):
        yield f"{table.leaks(sweep).capitalize()}.\n"
    yield "<details><summary>numbers</summary>\n"
    yield markdown(sweep)
    yield "\n</details>\n"


def markdown(sweep: Sweep) -> str:
    rows = [table.columns(sweep), *table.cells(sweep)]
    head, *body = ("| " + " | ".join(row) + " |" for row in rows)
    return "\n".join([head, "|" + "---|" * len(rows[0]), *body])

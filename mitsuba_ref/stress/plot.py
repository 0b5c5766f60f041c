"""A sweep as a picture: errors above, wrong answers below, over the stressed quantity; all axes logarithmic."""

import io
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mitsuba_ref.stress.result import Outcome, Sweep, broken
from mitsuba_ref.stress.score import Score
from mitsuba_ref.stress.table import breakdown, shown
from mitsuba_ref.stress.witnesses import Witness

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
        over(above, sweep, named=False)
        over(below, sweep, named=True)
        explain(figure, above)
        above.set_title(f"{sweep.family.name}: {sweep.family.title}", loc="left", fontsize=10)
        figure.subplots_adjust(left=0.1, right=0.98, top=0.95, bottom=0.26)
        out = io.BytesIO()
        figure.savefig(out, format=FORMAT, metadata={"Date": None, "Creator": None})
    text = out.getvalue().decode().replace(FONT, FONT + OTHERS)
    return "".join(f"{line.strip()}\n" for line in text.splitlines()).encode()


def places(sweep: Sweep) -> np.ndarray:
    """Where settings go on the x axis; 0 stands a decade before the least other."""
    x = np.array([outcome.x for outcome in sweep.outcomes])
    return np.where(x > 0.0, x, x[x > 0.0].min(initial=np.inf) / 10.0 if (x > 0.0).any() else 1.0)


def draw_errors(axes: Any, sweep: Sweep) -> None:
    x = places(sweep)
    for name, label, style in BOUNDS:
        y = numbers([getattr(outcome.bound, name) for outcome in sweep.outcomes])
        axes.plot(x, np.clip(y, LEAST, MOST), lw=1.3, label=label, zorder=2, **style)
    for witness in shown(sweep):
        y = numbers([value(outcome, witness.key, "error") for outcome in sweep.outcomes])
        axes.plot(x, np.clip(y, LEAST, MOST), label=named(sweep, witness), **STYLE[witness.key])
        ringed(axes, sweep, witness, np.clip(y, LEAST, MOST), "beyond")
    axes.set_yscale("log")
    axes.set_ylim(LEAST / 3.0, MOST * 3.0)
    powers = range(-15, 1, 3)
    words = ["0", *(power_of_ten(k) for k in powers), "1000+"]
    axes.set_yticks([LEAST, *(10.0**k for k in powers), MOST], words)
    axes.minorticks_off()
    axes.set_ylabel(f"largest {sweep.family.error}")


def draw_wrong(axes: Any, sweep: Sweep) -> None:
    """Shares of rays: wrong hits and misses as lines, wrong primitives as thin dashes."""
    x = places(sweep)
    floor = 0.3 / max(outcome.rays for outcome in sweep.outcomes)
    for witness in shown(sweep):
        style = STYLE[witness.key]
        masks = shares(sweep, witness, "wrong_masks", floor)
        axes.plot(x, masks, **style)
        ringed(axes, sweep, witness, masks, "wrong_masks")
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


def ringed(axes: Any, sweep: Sweep, witness: Witness, y: np.ndarray, what: str) -> None:
    """A ring around the first settings at which the witness breaks down, where it is this that does it."""
    for place in sweep.breakdowns(witness.key):
        i = next(i for i, outcome in enumerate(sweep.outcomes) if outcome.x == place)
        if broken(sweep.outcomes[i], witness.key) and value(sweep.outcomes[i], witness.key, what):
            axes.plot(places(sweep)[i], y[i], mec=STYLE[witness.key]["color"], **RING)


def over(axes: Any, sweep: Sweep, *, named: bool) -> None:
    """The x axis; its name and its numbers below the lower plot only."""
    x = places(sweep)
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


def explain(figure: Any, axes: Any) -> None:
    """What line is whose and where it breaks down; what the other marks are."""
    from matplotlib.lines import Line2D

    handles, labels = axes.get_legend_handles_labels()
    few = len(BOUNDS)
    marks = [Line2D([], [], mec="black", **RING), Line2D([], [], color="black", **DIAMONDS)]
    words = ["first setting where one breaks down", "wrong primitive"]
    style: dict[str, Any] = {"frameon": False, "handlelength": 3.5, "loc": "upper left", "borderpad": 0.0}
    figure.legend(handles[few:], labels[few:], bbox_to_anchor=(0.02, 0.165), **style)
    figure.legend([*handles[:few], *marks], [*labels[:few], *words], bbox_to_anchor=(0.62, 0.165), **style)


def named(sweep: Sweep, witness: Witness) -> str:
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

"""Plot of a stress sweep: errors above, shares of wrong answers below, over the stressed quantity, logarithmic."""

import io
import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mitsuba_ref.stress.score import Score, Witness
from mitsuba_ref.stress.sweeps import SettingResult, SweepResult, breakdown, shown_witnesses

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

# Errors of nothing, and errors so large that all digits are lost, show as these.
AXIS_LOW, AXIS_HIGH = 1e-18, 1e3
FORMAT = "svg"
FONT, OTHERS = "'DejaVu Sans'", ", Verdana, sans-serif"  # the one that Matplotlib brings along; a viewer's


def as_svg(sweep: SweepResult) -> bytes:
    """The plot as SVG; the same bytes for the same result."""
    # Letters stay letters, so that the file is small; the viewer's font may be wider than the one measured here.
    settings: Any = {"svg.fonttype": "none", "svg.hashsalt": sweep.name, "font.size": 9.0}
    settings |= {"font.family": FONT.strip("'"), "mathtext.default": "regular"}
    with matplotlib.rc_context(settings):
        figure = Figure(figsize=(8.4, 6.2))
        above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": [3.0, 1.8], "hspace": 0.1})
        draw_errors(above, sweep)
        draw_wrong(below, sweep)
        draw_x_axis(above, sweep, named=False)
        draw_x_axis(below, sweep, named=True)
        draw_legend(figure, above)
        above.set_title(f"{sweep.name}: {sweep.title}", loc="left", fontsize=10)
        figure.subplots_adjust(left=0.1, right=0.98, top=0.95, bottom=0.26)
        out = io.BytesIO()
        figure.savefig(out, format=FORMAT, metadata={"Date": None, "Creator": None})
    text = out.getvalue().decode().replace(FONT, FONT + OTHERS)
    return "".join(f"{line.strip()}\n" for line in text.splitlines()).encode()


def x_positions(sweep: SweepResult) -> np.ndarray:
    """Where settings go on the x axis; 0 stands a decade before the least other."""
    x = np.array([setting.x for setting in sweep.settings])
    return np.where(x > 0.0, x, x[x > 0.0].min(initial=np.inf) / 10.0 if (x > 0.0).any() else 1.0)


def draw_errors(axes: Any, sweep: SweepResult) -> None:
    x = x_positions(sweep)
    for name, label, style in BOUNDS:
        y = numbers([getattr(setting.bound, name) for setting in sweep.settings])
        axes.plot(x, np.clip(y, AXIS_LOW, AXIS_HIGH), lw=1.3, label=label, zorder=2, **style)
    for witness in shown_witnesses(sweep):
        y = numbers([value(setting, witness.key, "error") for setting in sweep.settings])
        axes.plot(x, np.clip(y, AXIS_LOW, AXIS_HIGH), label=legend_text(sweep, witness), **STYLE[witness.key])
        draw_rings(axes, sweep, witness, np.clip(y, AXIS_LOW, AXIS_HIGH), "beyond")
    axes.set_yscale("log")
    axes.set_ylim(AXIS_LOW / 3.0, AXIS_HIGH * 3.0)
    powers = range(-15, 1, 3)
    words = ["0", *(power_of_ten(k) for k in powers), "1000+"]
    axes.set_yticks([AXIS_LOW, *(10.0**k for k in powers), AXIS_HIGH], words)
    axes.minorticks_off()
    axes.set_ylabel(f"largest {sweep.error}")


def draw_wrong(axes: Any, sweep: SweepResult) -> None:
    """Shares of rays: wrong hits and misses as lines, wrong primitives as thin dashes."""
    x = x_positions(sweep)
    floor = 0.3 / max(setting.rays for setting in sweep.settings)
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


def shares(sweep: SweepResult, witness: Witness, what: str, floor: float) -> np.ndarray:
    found = numbers([value(setting, witness.key, what) for setting in sweep.settings])
    count = [setting.rays if what == "wrong_masks" else setting.exact.adjudicated for setting in sweep.settings]
    return np.maximum(found / np.maximum(count, 1), floor)


def draw_rings(axes: Any, sweep: SweepResult, witness: Witness, y: np.ndarray, what: str) -> None:
    """A ring around the first settings at which the witness breaks down, where it is this that does it."""
    for place in sweep.breakdowns[witness.key]:
        i = next(i for i, setting in enumerate(sweep.settings) if setting.x == place)
        if sweep.settings[i].breaks(witness.key) and value(sweep.settings[i], witness.key, what):
            axes.plot(x_positions(sweep)[i], y[i], mec=STYLE[witness.key]["color"], **RING)


def draw_x_axis(axes: Any, sweep: SweepResult, *, named: bool) -> None:
    """The x axis; its name and its numbers below the lower plot only."""
    x = x_positions(sweep)
    axes.set_xscale("log")
    margin = (x.max() / x.min()) ** MARGIN
    axes.set_xlim(x.min() / margin, x.max() * margin)
    zero = sweep.settings[0].x == 0.0
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
        axes.set_xlabel(sweep.quantity)


TICKS = 12  # at most, on the x axis
MARGIN = 0.03  # share of the x axis on either side of the settings


def power_of_ten(k: int) -> str:
    return {0: "1", 1: "10"}.get(k, f"$10^{{{k}}}$")


def draw_legend(figure: Any, axes: Any) -> None:
    """What line is whose and where it breaks down; what the other marks are."""
    handles, labels = axes.get_legend_handles_labels()
    few = len(BOUNDS)
    marks = [Line2D([], [], mec="black", **RING), Line2D([], [], color="black", **DIAMONDS)]
    words = ["first setting where one breaks down", "wrong primitive"]
    style: dict[str, Any] = {"frameon": False, "handlelength": 3.5, "loc": "upper left", "borderpad": 0.0}
    figure.legend(handles[few:], labels[few:], bbox_to_anchor=(0.02, 0.165), **style)
    figure.legend([*handles[:few], *marks], [*labels[:few], *words], bbox_to_anchor=(0.62, 0.165), **style)


def legend_text(sweep: SweepResult, witness: Witness) -> str:
    """A line of the legend."""
    absent = sweep.absence(witness.key)
    place = breakdown(sweep, witness.key)
    return f"{witness.title}: {place}" if absent else f"{witness.title}; breaks: {place}"


def value(setting: SettingResult, key: str, what: str) -> float | None:
    score = setting.witnesses[key]
    return getattr(score, what) if isinstance(score, Score) else None


def numbers(values: Sequence[float | None]) -> np.ndarray:
    """NaN for what is not there, so that lines have a gap."""
    return np.array([math.nan if value is None else value for value in values], float)

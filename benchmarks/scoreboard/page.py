"""docs/findings/scoreboard.md and its pictures, from results.json."""

import io
import json
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from pages import WIDTH, markdown, write_page

from mitsuba_ref.hard.family import Family
from mitsuba_ref.hard.swept_families import SWEPT

from .judging import BUILTIN, CLOSED_RAYS, COINCIDENT, COLUMNS, FILM, RAYS, SECONDS, ULPS_AT, Cell
from .roster import Entry, entries

Result = dict[str, Any]
GLUE = "../../benchmarks/scoreboard/casters/"
NAMES = {
    "watertight-edges": "edges",
    "watertight-vertices": "vertices",
    "sliver": "slivers",
    "grazing-rectangle": "grazing",
    "scale-mesh": "scale",
    "offset-mesh": "far from the origin",
    "distance-triangle": "distance",
    "length-mesh": "length of d",
    "shadow-mesh": "near starts",
    COINCIDENT: "coincident",
    BUILTIN: "built-in scenes",
}
OTHERS = {
    COINCIDENT: f"sheets of triangles at the same place and from 2^-22 apart, a camera of {FILM[0]} x {FILM[1]} pixels",
    BUILTIN: "the other 11 scenes of `validate --builtin triangles`, seen by such cameras",
}
SWEEPS = {family.name: family for family in SWEPT}
HEAD = """# Scoreboard of ray casters

<!-- written by `make scoreboard`; change benchmarks/scoreboard/ instead -->
"""
# of the share of wrong rays: white where all are right, grey where nothing was answered
RIGHT, ABSENT, COLOURS = "#ffffff", "#bbbbbb", "YlOrRd"


def write(file: Path, folder: Path) -> None:
    """Write findings/scoreboard.md and its pictures. Raises OutputError."""
    read = json.loads(file.read_text())
    known = {entry.name: entry for entry in entries()}
    casters = [(known[each["name"]], each) for each in read["casters"]]
    pictures = {"wrong.svg": plot_wrong(casters), "speed.svg": plot_speed(casters)}
    write_page(folder / "findings", "scoreboard.md", lines(casters, read["machine"]), "scoreboard", pictures)


def cells(result: Result, column: str) -> list[Cell]:
    return [Cell(**each) for each in result["cells"] if each["column"] == column]


def text(entry: Entry, result: Result, column: str) -> str:
    """A cell of the first table."""
    found = cells(result, column)
    asked = [cell for cell in found if not cell.absent]
    wrong, rays, absent = sum(c.wrong for c in asked), sum(c.rays for c in asked), len(found) - len(asked)
    words = [f"{wrong:,} of {rays:,}"] if wrong else ["right"] if asked else []
    words += [span] if wrong and (span := right_span(column, found)) else []
    words += [f"{absent} of {len(found)} settings without an answer"] if absent else []
    words += ["by design"] if column in entry.by_design and wrong else []
    shown = "; ".join(words)
    return f"[{shown}](#{entry.name})" if wrong or absent else shown


def right_span(column: str, found: list[Cell]) -> str:
    """The settings around the easiest one of an open sweep in which all is right; "" if there are none."""
    family = SWEEPS.get(column)
    if family is None or family.closed:
        return ""
    bad = [cell.x for cell in found if cell.wrong or cell.absent]
    low, high = (
        max((x for x in bad if x < family.easiest), default=None),
        min((x for x in bad if x >= family.easiest), default=None),
    )
    inside = [x for x in family.values if (low is None or x > low) and (high is None or x < high)]
    return f"right {inside[0]:g} to {inside[-1]:g}" if inside else ""


def about_sweep(family: Family) -> str:
    return f"{family.title}; {family.quantity} {family.values[0]:g} to {family.values[-1]:g}"


def normals(result: Result) -> str:
    counts = [cell["normals"] for cell in result["cells"] if cell["normals"] is not None]
    rays = sum(cell["rays"] for cell in result["cells"] if cell["normals"] is not None)
    if not counts:
        return "none, or made by the glue"
    return f"[{sum(counts):,} of {rays:,}](#{result['name']})" if sum(counts) else "right"


def lines(casters: list[tuple[Entry, Result]], machine: dict[str, str]) -> Iterator[str]:
    yield HEAD
    ran = [pair for pair in casters if not pair[1]["absent"]]
    about = (
        f"{len(ran)} ray casters, most of them of PyPI, npm and Debian, along the same float32 rays through the same "
        "triangles, each with at most 25 lines of glue ([how](#how-it-was-measured)). A ray is wrong if it hits where "
        "exact arithmetic misses, or the reverse, or if t is beyond the bound of the caster's own arithmetic (float32 "
        "or float64) there; what rounding may do is right. `make scoreboard` writes this page."
    )
    yield textwrap.fill(about, WIDTH)
    yield f"\n{machine['processor']}, {machine['system']}; revision {machine['revision']}.\n"
    yield "## Wrong rays\n"
    rows = [["caster", *NAMES.values()]]
    for entry, result in casters:
        shown = [result["absent"]] if result["absent"] else [text(entry, result, column) for column in COLUMNS]
        rows.append([entry.title, *shown])
    yield markdown(rows)
    yield "\n![Shares of wrong rays by caster and column](scoreboard/wrong.svg)\n"
    for name, title in NAMES.items():
        yield f"- **{title}**: {OTHERS.get(name) or about_sweep(SWEEPS[name])}."
    yield "\n## What each returns, errors of t, speed\n"
    rows = [
        [
            "caster",
            "version",
            "called",
            "arithmetic",
            "t_min, t_max",
            "normals",
            "t off: median, max ulp",
            "rays/s",
            "of ours",
            "MB",
        ]
    ]
    for entry, result in ran:
        called = f"[{entry.calls}]({GLUE}{entry.file})"
        off = "{:.2g}, {:.3g}".format(*result["ulps"]) if "ulps" in result else "-"
        speed = ["no answer", "-", "-"]
        if "rate" in result:
            ratio = result["rate"] / result["ours_rate"]
            speed = [f"{result['rate']:,.3g}", f"{ratio:.2g}", f"{result['memory']:.0f}"]
        rows.append(
            [
                entry.title,
                result["version"],
                called,
                entry.precision,
                result.get("limits", "-"),
                normals(result),
                off,
                *speed,
            ]
        )
    yield markdown(rows)
    yield "\n![Rays per second of each](scoreboard/speed.svg)\n"
    yield METHOD
    yield "## Wrong rays of each, with one to repeat\n"
    for entry, result in ran:
        yield from section(entry, result)


METHOD = f"""## How it was measured

- Each caster is a program behind `--candidate-serve` ([candidates](../candidates.md#a-program-that-stays)), those in
  Python by [serve.py](../../benchmarks/scoreboard/serve.py). Versions, and why each is called so:
  [casters.toml](../../benchmarks/scoreboard/casters.toml).
- Rays: {RAYS} in each setting of a sweep, {CLOSED_RAYS:,} in those inside the closed mesh; fewer for slow casters.
  Exact arithmetic decides every ray, inside the closed mesh every miss and 1000 others. A setting may
  take {SECONDS:g} s.
- Squares of numbers beyond 1e-19 to 1e+19 leave float32: sweeps of scale and of the length of d go further than any
  caster in float32 can. There it tells more where a caster is right than how often it is wrong.
- Errors of t, in units in the last place of the caster's type, are those of 1000 rays of `{ULPS_AT[0]}` at the origin.
- A library that returns points has t made of them by the glue, in float64. Segments have ends that round.
  Rows of "the glue alone", where they are shown, have the share of that in the errors.
- Rays/s: random rays through the box of the built-in scan of 8100 triangles, which no library was tuned for, on one
  core through a pipe; ours takes turns with the caster, medians of five. The time of 16 rays, in which the library
  builds its structure, is taken off.
- Every count that is a link leads to a ray that was cast again, alone where that is wrong, and judged by
  whole numbers ([exact.py](../../benchmarks/scoreboard/exact.py)) independently of the judge. Its first line
  repeats that, with `PYTHONPATH=.:benchmarks`.
"""


def section(entry: Entry, result: Result) -> Iterator[str]:
    """The wrong settings of a caster and its reproducers."""
    bad = [Cell(**each) for each in result["cells"] if each["absent"] or each["first"] is not None]
    if not bad:
        return
    yield f"### {entry.name}\n\n{entry.title}: {entry.why}.\n"
    for column, reason in entry.by_design.items():
        yield f"- By design, {NAMES[column]}: {reason}."
    for column in COLUMNS:
        here = [cell for cell in bad if cell.column == column]
        if not here:
            continue
        counts = ", ".join(f"{cell.x}: {cell.absent or words(cell)}" for cell in here)
        yield f"- **{NAMES[column]}**: {counts}"
        shown = max(here, key=lambda cell: (bool(cell.reproducer), cell.wrong > 0)).reproducer
        if shown:
            only_normals = not any(cell.wrong for cell in here)
            left_out = ("o ", "d ") if only_normals else ("o ", "d ", "normal: ")
            kept = [line for line in shown.splitlines() if not line.startswith(left_out)]
            yield "\n" + textwrap.indent("\n".join(kept), "      ") + "\n"
    yield ""


def words(cell: Cell) -> str:
    counts = {"missed": cell.false_misses, "hit in vain": cell.false_hits, "t": cell.off, "normals": cell.normals}
    return " ".join(f"{count} {name}" for name, count in counts.items() if count)


def saved(figure: Figure, salt: str) -> bytes:
    out = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": salt}):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return "".join(f"{line.strip()}\n" for line in out.getvalue().decode().splitlines()).encode()


def plot_wrong(casters: list[tuple[Entry, Result]]) -> bytes:
    """The share of wrong rays of each caster in each column, as a colour."""
    casters = [pair for pair in casters if not pair[1]["absent"]]
    share = np.full((len(casters), len(COLUMNS)), np.nan)
    for i, (_, result) in enumerate(casters):
        for j, column in enumerate(COLUMNS):
            asked = [cell for cell in cells(result, column) if not cell.absent]
            if asked:
                share[i, j] = sum(cell.wrong for cell in asked) / sum(cell.rays for cell in asked)
    figure = Figure(figsize=(9.0, 1.4 + 0.22 * len(casters)), layout="constrained")
    axes = figure.subplots()
    colours = matplotlib.colormaps[COLOURS].with_extremes(bad=ABSENT, under=RIGHT)
    norm = matplotlib.colors.LogNorm(1e-5, 1.0)
    drawn = axes.imshow(np.where(share == 0.0, 1e-9, share), cmap=colours, norm=norm, aspect="auto")
    axes.set_xticks(range(len(COLUMNS)), NAMES.values(), rotation=30, ha="right")
    axes.set_yticks(range(len(casters)), [entry.title.replace("`", "") for entry, _ in casters])
    figure.colorbar(drawn, label="share of wrong rays; white: none, grey: no answer")
    return saved(figure, "wrong")


def plot_speed(casters: list[tuple[Entry, Result]]) -> bytes:
    """Rays per second of each caster, the fastest on top."""
    rates = sorted((result["rate"], entry.title.replace("`", "")) for entry, result in casters if "rate" in result)
    figure = Figure(figsize=(9.0, 1.0 + 0.22 * len(rates)), layout="constrained")
    axes = figure.subplots()
    axes.barh([title for _, title in rates], [rate for rate, _ in rates], color="#0072B2")
    axes.set(xscale="log", xlabel="rays per second, one core")
    axes.grid(True, axis="x", color="#dddddd", lw=0.5)
    return saved(figure, "speed")

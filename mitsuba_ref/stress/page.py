"""docs/stress.md: every number in it comes from the run."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from caster.whole_files import check_folder, write_bytes, write_text
from mitsuba_ref.stress import plot, table
from mitsuba_ref.stress.result import OWN, Sweep
from mitsuba_ref.stress.score import Score
from mitsuba_ref.stress.witnesses import WITNESSES

PAGE, PICTURES = "stress.md", "stress"
WIDTH = 120  # of lines of prose

HEAD = """# Numerical stability

<!-- written by `make stress`; change mitsuba_ref/stress/page.py instead -->

Each sweep makes one thing harder, decade by decade, and asks everybody about the same rays through the same geometry,
in the very same float32 numbers. What is right is decided in whole numbers, without any rounding
(`mitsuba_ref/exact.py`), for the numbers as they are given. So an error here is arithmetic alone.
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
            write_bytes(pictures / f"{sweep.family.name}.{plot.FORMAT}", plot.as_svg(sweep))
        drawn = True
    except plot.MissingPlots:
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
        score for each in settings for key in OWN for score in [each.scores[key]] if isinstance(score, Score)
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

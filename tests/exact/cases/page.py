"""Writer of docs/edge-cases.md, from the tables of cases and the recorded data."""

from collections.abc import Mapping, Sequence
from typing import Any

from cases.case import FLOAT32, FLOAT64, MORE, Case, Maker, no_questions

HEAD = f"""# 77 edge cases

Cases in which ray casters are known to fail, with measurements. Each case is made of random shapes under random
rotations and translations, so that no coordinate is round unless the case is about that. Where a ray has to hit an
edge, a rim or a tangent exactly, shapes with integer coordinates are rotated by integer quaternions
(`tests/exact/cases/integer_shapes.py`), which keeps points of their surfaces exact in float64 and in float32.

`tests/exact/test_edge_cases.py` casts every ray twice, through float64 and through float32 numbers, and compares the
caster with the exact oracle (`mitsuba_ref/oracle/oracle.py`):

- hit or miss, and the primitive (the lowest of exact ties);
- t within the error bound that the caster computes beside it, and within 4 ulps times a condition number that is
  computed independently (`cases/conditions.py`); the bound itself within a limit;
- normals of length 1, within a derived bound of the exact ones.

Every case states how many hits, tangents, ties, misses and exactly decided rays it has to contain, and fails if it does
not contain them. `{MORE}=20` casts twenty times as many rays.

The behaviour of Mitsuba 3.9.1 is recorded in `tests/exact/mitsuba_behaviour.json`: a few rays of each case, in float32
numbers and with directions of any length, against exact arithmetic. The counts are those of a CPU with AVX-512, and
differ on others; a test holds ten cases to what is the same with operations fused or not (`make isa`).
This page and the data are written by

    python tests/exact/edge_cases.py

Columns S and L are the variants scalar_rgb and llvm_ad_rgb; "robust" is Embree's robust mode, "default" without it.
Each cell gives hits missed + hits invented, of so many rays, and the largest error of t where both hit, in units of
2^-24 of t; "NaN" counts values of t that are not a number. "-": not measured, since the caster refuses the input, or
since the case is about its own cameras and files.
"""

COLUMNS = ("scalar robust", "scalar default", "llvm robust", "llvm default")


def page(cases: Sequence[Case], behaviour: Mapping[str, Any]) -> str:
    rows = [
        "| # | case | shapes | the caster | S robust | S default | L robust | L default |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case in cases:
        counts = behaviour.get(str(case.number), {})
        cells = " | ".join(cell(counts.get(name)) for name in COLUMNS)
        rows.append(f"| {case.number} | {case.name} | {shapes_of(case)} | {case.ours} | {cells} |")
    return HEAD + "\n" + "\n".join(rows) + "\n" + PROBES + "\n".join(probes(cases, behaviour)) + "\n"


PROBES = """
## Refused input, and cameras

Mitsuba's results for documents of its own, and the distance of its sensors' rays from the caster's: directions in
u = 2^-24, origins in scene units (for a camera without a near plane, they lie on Mitsuba's near plane).

| # | input | S | L |
|---|---|---|---|
"""


def probes(cases: Sequence[Case], behaviour: Mapping[str, Any]) -> list[str]:
    """Rows of the second table."""
    rows = []
    for case in cases:
        counts = behaviour.get(str(case.number), {})
        scalar, llvm = (counts.get(f"{variant} probes", {}) for variant in ("scalar", "llvm"))
        rows += [f"| {case.number} | {name} | {cells} | {llvm.get(name, '-')} |" for name, cells in scalar.items()]
    return rows


def cell(counts: Mapping[str, Any] | None) -> str:
    if not counts:
        return "-"
    wrong = f"{counts['missed']} + {counts['invented']} of {counts['rays']}; t {counts['worst t']:g}"
    more = [
        f"{counts[what]} {name}" for what, name in (("no number", "NaN"), ("refused", "refused")) if counts.get(what)
    ]
    return "; ".join([wrong, *more])


def shapes_of(case: Case) -> str:
    """What the questions hold, by the types of the registry."""
    if case.every_shape:
        return "every shape"
    if case.questions is no_questions:
        return case.shapes
    found: dict[str, None] = {}
    for precision in (FLOAT64, FLOAT32):
        for question in case.questions(Maker(case.number, precision)):
            found |= dict.fromkeys(shape.type for shape in question.scene.shapes)
    return ", ".join(found) or case.shapes

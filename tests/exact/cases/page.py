"""docs/edge-cases.md, written from the tables and the data."""

from collections.abc import Mapping, Sequence
from typing import Any

from cases.case import FLOAT32, FLOAT64, MORE, Case, Maker, no_questions

HEAD = f"""# 77 edge cases

What ray casters get wrong, as cases with numbers. Each is built from random shapes that are turned and stand anywhere,
so that no coordinate is round unless the case is about that; where a ray has to meet an edge, a rim or a tangent
exactly, shapes of whole numbers are turned by integer quaternions (`tests/exact/cases/whole.py`), which keeps points of
their surfaces exact in float64 and in float32.

`tests/exact/test_edge_cases.py` asks every ray twice, in float64 and in float32 numbers, and holds our answer to the
oracle's (`mitsuba_ref/oracle/oracle.py`): hit or miss, the primitive (of exact ties the lowest), t
within the bound that the
caster itself gives beside it and within 4 ulps times a condition worked out apart (`cases/conditions.py`), that bound
within its own limit, normals of length 1 and right within a derived bound of the exact ones. Every question says what
it has to meet, how many tangents, ties, misses, rays left to exact arithmetic, and fails if it does not.
`{MORE}=20` asks twenty times as many rays.

What Mitsuba 3.9.1 does is data, not asserted: `tests/exact/mitsuba_behaviour.json`, few rays of each question in
float32 numbers, directions as long as they come, against exact arithmetic. A test warns where it does something else
now. This page and the data are written by

    python tests/exact/edge_cases.py

Columns S and L are the variants scalar_rgb and llvm_ad_rgb, "robust" Embree's robust mode, "default" without it. In
each: rays missed that hit + hits invented, of so many rays, and the worst error of t over what both hit, in units of
2^-24 of t; "NaN" counts t that are no number. "-": Mitsuba is not asked, since ours refuses it, or it is about our own
cameras and files.
"""

COLUMNS = ("scalar robust", "scalar default", "llvm robust", "llvm default")


def page(cases: Sequence[Case], behaviour: Mapping[str, Any]) -> str:
    rows = [
        "| # | case | asked of | ours | S robust | S default | L robust | L default |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case in cases:
        counts = behaviour.get(str(case.number), {})
        told = " | ".join(cell(counts.get(name)) for name in COLUMNS)
        rows.append(f"| {case.number} | {case.name} | {shapes_of(case)} | {case.ours} | {told} |")
    return HEAD + "\n" + "\n".join(rows) + "\n" + PROBES + "\n".join(probes(cases, behaviour)) + "\n"


PROBES = """
## What ours refuses, and cameras

Mitsuba's answers to documents of its own, and how far the rays of its sensors are from ours: directions in u = 2^-24,
origins in scene units (without a near plane of ours, they stand on one of Mitsuba's).

| # | asked | S | L |
|---|---|---|---|
"""


def probes(cases: Sequence[Case], behaviour: Mapping[str, Any]) -> list[str]:
    """Rows of the second table."""
    rows = []
    for case in cases:
        counts = behaviour.get(str(case.number), {})
        scalar, llvm = (counts.get(f"{variant} probes", {}) for variant in ("scalar", "llvm"))
        rows += [
            f"| {case.number} | {name} | {told} | {llvm.get(name, '-')} |" for name, told in scalar.items()
        ]
    return rows


def cell(counts: Mapping[str, Any] | None) -> str:
    if not counts:
        return "-"
    wrong = f"{counts['missed']} + {counts['invented']} of {counts['rays']}; t {counts['worst t']:g}"
    more = [
        f"{counts[what]} {name}"
        for what, name in (("no number", "NaN"), ("refused", "refused"))
        if counts.get(what)
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

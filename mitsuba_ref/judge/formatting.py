"""What each witness says of a pixel, in words: shape and t, in decimal and to the bit."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from caster.geometry.packing import Packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.adjudication import Adjudication
from mitsuba_ref.judge.classification import Judge, Judgement
from mitsuba_ref.judge.known_defects import defect_name
from mitsuba_ref.judge.verdict import CLASSES, REFERENCE_WRONG, UNLISTED
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle

MAX_TIES_SHOWN = 6  # members of an exact tie set on one line; JSON has all


class TieMember(NamedTuple):
    """One primitive of an exact tie set."""

    shape: str
    prim: int  # within its shape
    where: str


def tie_members(scene: Scene, packed: Packed, answer: ExactAnswer) -> list[TieMember]:
    """The exact tie set in the scene's own names."""
    prims = np.array([hit.prim for hit in answer.ties], np.int64)
    shapes, numbers = packed.shape_of(prims), packed.index_in_shape(prims)
    names = scene.shape_names()
    return [
        TieMember(names[shape], int(number), hit.where)
        for shape, number, hit in zip(shapes, numbers, answer.ties, strict=True)
    ]


def format_exact(scene: Scene, packed: Packed, answer: ExactAnswer | None) -> str:
    """The exact answer on one line."""
    if answer is None or answer.t is None:
        return format_exact_hit(scene, packed, answer)
    at = f"at t {decimal_and_hex(float(answer.t))}"
    return f"{_hit_primitives(scene, packed, answer)} {at}{_flags_text(answer)}"


def format_exact_hit(scene: Scene, packed: Packed, answer: ExactAnswer | None) -> str:
    """The same without t."""
    if answer is None:
        return "no answer"
    return f"{_hit_primitives(scene, packed, answer)}{_flags_text(answer)}"


def _hit_primitives(scene: Scene, packed: Packed, answer: ExactAnswer) -> str:
    if answer.t is None:
        return "miss"
    ties = tie_members(scene, packed, answer)
    shown = [f"{each.shape}, prim {each.prim} ({each.where})" for each in ties[:MAX_TIES_SHOWN]]
    more = [f"{len(ties) - MAX_TIES_SHOWN} more"] if len(ties) > MAX_TIES_SHOWN else []
    return " = ".join([*shown, *more])


def _flags_text(answer: ExactAnswer) -> str:
    return f" ({', '.join(sorted(answer.flags))} on the way)" if answer.flags else ""


def decimal_and_hex(value: float) -> str:
    """Decimal and hex."""
    return f"{value!r} {value.hex()}"


def format_side(judge: Judge, row: int, *, ours: bool) -> str:
    """One side's answer on one line, without its AOVs."""
    pair, packed = judge.pair, judge.model.packed
    prim = int(pair.prim[row]) if ours else judge.reference_prim(row)
    if prim < 0:
        return "miss"
    t = float(pair.t[row] if ours else pair.witness.t[row])
    shape = judge.scene.shape_names()[int(packed.shape_of(np.array([prim]))[0])]
    return f"{shape}, prim {int(packed.index_in_shape(np.array([prim]))[0])} at t {decimal_and_hex(t)}"


def format_defect(case: int | None) -> str:
    """A case with its number."""
    return (
        f"case {case}: {defect_name(case)}"
        if case is not None
        else f"{UNLISTED}: none of the cases that are known"
    )


def reproducer_header(judge: Judge, judgement: Judgement, row: int, source: str) -> Sequence[str]:
    """Comment for a reproducer of a row of the picture: who says what, and how to see it again."""
    return list(_header_lines(judge, judgement, row, source))


def _header_lines(judge: Judge, judgement: Judgement, row: int, source: str) -> Iterator[str]:
    pair, verdict = judge.pair, CLASSES[int(judgement.classes[row])]
    versions = pair.witness.answer.versions
    yield f"One ray that caster and Mitsuba {versions.get('mitsuba', '')} were judged on: {verdict}."
    yield ""
    yield f"from:      {source}"
    if verdict == REFERENCE_WRONG:
        yield f"class:     {verdict}, {format_defect(judgement.cases.get(row))}"
    else:
        yield f"class:     {verdict}"
    yield f"exact:     {format_exact(judge.scene, judge.model.packed, exact_answer(judge, judgement, row))}"
    yield f"caster:    {format_side(judge, row, ours=True)}"
    yield f"Mitsuba:   {format_side(judge, row, ours=False)}"
    if judgement.ratio("diffuse")[row] > 1.0:
        for name, aovs in (("caster", pair.ours), ("Mitsuba", pair.reference)):
            yield f"{name + ':':<11}diffuse {format_float32s(aov_rows(aovs, 'diffuse')[row])}"
    yield f"origin:    {format_float32s(pair.rays.o[row])}"
    yield f"direction: {format_float32s(pair.rays.d[row])}"
    yield f"versions:  {', '.join(f'{name} {version}' for name, version in versions.items())}"
    yield "All numbers below are float32 values, as hex floats. t counts in lengths of the direction."
    yield "See it:    mitsuba-ref probe THIS-FILE 0 0"
    yield "Mitsuba:   scene.ray_intersect; optimize=False; embree_use_robust_intersections=true"
    yield "           mitsuba-ref export THIS-FILE -o DIR writes the XML and the meshes"
    yield ""


class Asking(Protocol):
    """Who judges, ours or a candidate: float64 rays, and the oracle for them."""

    o: np.ndarray
    d: np.ndarray
    t_max: np.ndarray

    @property
    def oracle(self) -> Oracle: ...


class Answered(Protocol):
    """What was judged, with the exact answers that it rests on."""

    @property
    def exact(self) -> Adjudication: ...


def exact_answer(judge: Asking, judgement: Answered, row: int) -> ExactAnswer | None:
    """The exact answer of a row, asked for now if it was not before; none where there is no ray."""
    known = judgement.exact.of(row)
    if known is not None or judge.t_max[row] < 0.0:
        return known
    return judge.oracle.first_hit(judge.o[row], judge.d[row], 0.0, float(judge.t_max[row]))


def format_float32s(values: Any) -> str:
    """Decimals, in float32's shortest digits, of a few numbers."""
    return "  ".join(str(np.float32(value)) for value in values)

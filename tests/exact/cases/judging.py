"""The caster against the exact answer, ray by ray, and counts of what was met."""

import math
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

import caster.rendering.casting
from cases.case import Question
from cases.normals import UNIT_ATOL, bound, normal
from caster import Hits, cast
from caster.geometry.packing import Packed
from mitsuba_ref.error_model.bounds import t_bounds
from mitsuba_ref.oracle.exact_numbers import Root
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle
from mitsuba_ref.reference.shared_input import own_model

NORMALS = 8  # of each question's hits, spread over them: so many normals are worked out exactly
SHOWN = 5  # wrong rays in a message

# `Root.off` rounds once, and so does a comparison's product.
ROUNDED = 1.0 + 4 * 2.0**-53


class Found(NamedTuple):
    """What was met, and what of ours is wrong, each with the ray in hex."""

    met: Counter[str]
    wrong: list[str]


@contextmanager
def doubtful() -> Iterator[list[int]]:
    """Counts the rays that float64 leaves to exact arithmetic."""
    decide, seen = caster.rendering.casting.exact_nearest, []

    def counted(packed: Packed, rays: Any, threads: int | None = None, **options: Any) -> Any:
        seen.append(len(rays.t_min))
        return decide(packed, rays, threads, **options)

    caster.rendering.casting.exact_nearest = counted
    try:
        yield seen
    finally:
        caster.rendering.casting.exact_nearest = decide


def judged(question: Question) -> Found:
    packed = question.scene.derived["packed"]
    with doubtful() as exactly:
        hits = cast(question.scene, question.o, question.d, t_min=question.t_min, t_max=question.t_max)
    answers = Oracle(packed).first_hits(question.o, question.d, question.t_min, question.t_max)
    wrong = [f"{question.name}: {text}" for text in differences(question, packed, hits, answers)]
    met = tally(answers)
    met["exact"] += sum(exactly)
    return Found(met, wrong)


def tally(answers: list[ExactAnswer]) -> Counter[str]:
    """Rays, hits and misses; where on the primitive; ties."""
    met: Counter[str] = Counter()
    for answer in answers:
        met["rays"] += 1
        met["hit" if answer.hit else "miss"] += 1
        met["tie"] += len(answer.ties) > 1
        met.update({hit.where for hit in answer.ties} - {"inside"})
    return met


def differences(question: Question, packed: Packed, hits: Hits, answers: list[ExactAnswer]) -> Iterator[str]:
    nearest = hits.nearest
    yield from of_masks(question, nearest.prim, answers)
    agreed = [i for i, answer in enumerate(answers) if answer.hit and answer.prim == nearest.prim[i]]
    if agreed:
        rows = np.array(agreed)
        yield from of_t(question, packed, hits, answers, rows)
        yield from of_normals(question, packed, hits, answers, rows)


def of_masks(question: Question, prim: np.ndarray, answers: list[ExactAnswer]) -> Iterator[str]:
    for i, answer in enumerate(answers):
        if prim[i] != answer.prim:
            ties = [f"{hit.prim} ({hit.where})" for hit in answer.ties]
            yield f"primitive {prim[i]}, exactly {', '.join(ties) or 'a miss'}: {ray(question, i)}"


def of_t(question: Question, packed: Packed, hits: Hits, answers: list[ExactAnswer], rows: np.ndarray) -> Iterator[str]:
    """t is within the caster's own bound, and within the judge's bound on float64."""
    nearest, rays = hits.nearest, hits.rays
    # `cast` may shorten d by a power of two; the record of its hits counts in lengths of that.
    exponent = powers(question.d[rows]) - powers(rays.d[rows])
    with np.errstate(over="ignore", under="ignore"):  # as in `cast`
        own = np.ldexp(nearest.error[rows], -exponent)
    t = hits.t[rows]
    judges = t_bounds(own_model(packed), (t, nearest.prim[rows]), (question.o[rows], question.d[rows]))
    for j, i in enumerate(rows.tolist()):
        error = exact_t(answers[i]).off(float(t[j]))
        for whose, limit in (("the caster", own[j]), ("the judge", judges[j])):
            if not error <= limit * ROUNDED + math.ulp(0.0):
                yield f"t = {t[j]!r} is off by {error:.3g}, {whose}'s bound is {limit:.3g}: {ray(question, i)}"


def exact_t(answer: ExactAnswer) -> Root:
    assert answer.t is not None
    return answer.t


def powers(d: np.ndarray) -> np.ndarray:
    """Of two, of each row's largest component."""
    exponents: np.ndarray = np.frexp(np.abs(d).max(axis=1))[1]
    return exponents


def of_normals(
    question: Question, packed: Packed, hits: Hits, answers: list[ExactAnswer], rows: np.ndarray
) -> Iterator[str]:
    n = hits.normal[rows]
    length = np.sqrt((n * n).sum(axis=1))
    for j in np.flatnonzero(~(np.abs(length - 1.0) <= UNIT_ATOL)).tolist():
        yield f"the normal {n[j]} has length {float(length[j])!r}: {ray(question, int(rows[j]))}"
    for j in np.unique(np.linspace(0, len(rows) - 1, NORMALS).astype(int)).tolist():
        i = int(rows[j])
        o, d, exact, t = question.o[i], question.d[i], exact_t(answers[i]), float(hits.t[i])
        right = normal(packed, answers[i].prim, o, d, exact)
        limit = bound(packed, answers[i].prim, o, d, t, exact.off(t))
        apart = float(np.linalg.norm(n[j] - right))
        if not apart <= limit:
            yield f"the normal {n[j]} is off by {apart:.3g}, more than {limit:.3g}: {ray(question, i)}"


def ray(question: Question, i: int) -> str:
    """To the bit."""
    o, d = ([float(x).hex() for x in rows[i]] for rows in (question.o, question.d))
    limits = f"t_min = {question.t_min!r}, t_max = {float(question.t_max).hex()}"
    return f"ray {i}, o = {o}, d = {d}, {limits}"


def short_of(question: Question, met: Counter[str]) -> list[str]:
    """What a question wanted to meet and did not, and what it never wanted to."""
    few = [
        f"{question.name}: {met[what]} of {what}, expected {least}"
        for what, least in question.wants.items()
        if met[what] < least
    ]
    return few + [f"{question.name}: {met[what]} of {what}, expected none" for what in question.never if met[what]]

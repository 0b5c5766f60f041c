"""Rays through one scene: every way to cast them, held to the oracle."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from caster import cast
from caster.packing import Packed, pack
from caster.scene import Scene
from mitsuba_ref.exact import ExactAnswer, Oracle, OutsideDomain
from mitsuba_ref.fuzz.aims import Shots
from mitsuba_ref.fuzz.finding import Finding, Tally, shown
from mitsuba_ref.fuzz.routes import Found, by_culling, publicly, together, with_limits
from mitsuba_ref.fuzz.setting import Rng
from mitsuba_ref.fuzz.t_bound import t_bounds

# unit() divides by a rounded length: each component passes at most four roundings, so its square is off by 8 u.
UNIT_ATOL = 16 * 2.0**-53


LARGEST = float(np.finfo(np.float64).max)  # a t beyond it may be told as this or as infinite


class Subject(NamedTuple):
    """A scene that is asked about."""

    scene: Scene
    packed: Packed
    oracle: Oracle


def subject_of(scene: Scene) -> Subject:
    """Raises OutsideDomain where a primitive's numbers are not finite."""
    packed = pack(scene)
    return Subject(scene, packed, Oracle(packed))


def check_rays(subject: Subject, shots: Shots, tally: Tally, rng: Rng | None = None) -> list[Finding]:
    """All that is wrong with these rays; with a generator, some are cast again with other limits."""
    if rng is not None:
        first = by_culling(subject.packed, shots, "bvh")
        shots = together(shots, with_limits(rng, shots, first))
    ours = by_culling(subject.packed, shots, "bvh")
    rows, public = publicly(subject.scene, subject.packed, shots)
    findings = [
        *_differences(shots, ours, by_culling(subject.packed, shots, "everything"), "everything"),
        *_differences(shots.taken(rows), Found(ours.t[rows], ours.prim[rows]), public, "caster.cast"),
        *check_surfaces(subject.scene, shots),
    ]
    return findings + adjudicate(subject, shots, ours, tally)


def adjudicate(subject: Subject, shots: Shots, ours: Found, tally: Tally) -> list[Finding]:
    """Ours against the exact answers: hit or miss, primitive, and t within its bound."""
    try:
        answers = subject.oracle.ask_all(*shots)
    except OutsideDomain:
        tally.outside += len(shots.t_min)
        return []
    bounds = t_bounds(subject.scene, subject.packed, ours, shots.o, shots.d)
    count_exact(tally, answers, bounds)
    rows = list(zip(answers, ours.t.tolist(), ours.prim.tolist(), bounds.tolist(), strict=True))
    tally.worst = max((tally.worst, *(share_of_bound(*row) for row in rows)))
    wrong = ((i, disagreement(answer, *rest)) for i, (answer, *rest) in enumerate(rows))
    return [Finding(kind, what, shots.taken(slice(i, i + 1))) for i, (kind, what) in wrong if kind]


def disagreement(answer: ExactAnswer, t: float, prim: int, bound: float) -> tuple[str, str]:
    """(kind, words) of what is wrong with t and prim; ("", "") if they are right."""
    if answer.t is None:
        what = f"ours hits primitive {prim} at t {shown(t)}, exactly it is a miss"
        return ("", "") if prim < 0 else ("phantom", what)
    if prim == answer.prim:
        off = answer.t.off(t)
        if off <= bound or (t >= LARGEST and answer.t > LARGEST):
            return "", ""
        return "t", f"{in_words(answer, t, prim)}: {off:.3g} off, bound {bound:.3g}"
    return ("missed" if prim < 0 else "prim"), in_words(answer, t, prim)


def share_of_bound(answer: ExactAnswer, t: float, prim: int, bound: float) -> float:
    """The error of t over its bound; 0 where either is no number, and where another primitive is hit."""
    if answer.t is None or prim != answer.prim or not 0.0 < bound < np.inf or t >= LARGEST:
        return 0.0
    return float(answer.t.off(t)) / bound


def in_words(answer: ExactAnswer, t: float, prim: int) -> str:
    ours = f"ours hits primitive {prim} at t {shown(t)}" if prim >= 0 else "ours misses"
    exact = "" if answer.t is None else shown(float(answer.t))
    return f"{ours}, exactly primitive {answer.prim} ({answer.ties[0].where}) is hit at t {exact}"


def count_exact(tally: Tally, answers: list[ExactAnswer], bounds: np.ndarray) -> None:
    tally.rays += len(answers)
    hits = [answer for answer in answers if answer.hit]
    tally.hits += len(hits)
    tally.edges += sum(answer.ties[0].where != "inside" for answer in hits)
    tally.ties += sum(len(answer.ties) > 1 for answer in hits)
    tally.unbounded += int(np.isinf(bounds).sum())


def _differences(shots: Shots, ours: Found, other: Found, name: str) -> Iterator[Finding]:
    differs = (ours.t.view(np.int64) != other.t.view(np.int64)) | (ours.prim != other.prim)
    for i in np.flatnonzero(differs):
        one, two = (f"primitive {found.prim[i]} at t {shown(found.t[i])}" for found in (ours, other))
        yield Finding("culling", f"bvh: {one}; {name}: {two}", shots.taken(slice(i, i + 1)))


def check_surfaces(scene: Scene, shots: Shots) -> Iterator[Finding]:
    """Of every hit: finite positions and normals, geometric normals of length 1, shading normals of 1 or 0."""
    hits = cast(scene, shots.o, shots.d)
    hit = hits.shape_id >= 0
    surface = hits.surface
    length, shading = (np.sqrt((n * n).sum(axis=1)) for n in (surface.n, surface.sh_n))
    unit = np.abs(length - 1.0) <= UNIT_ATOL
    shaded = (np.abs(shading - 1.0) <= UNIT_ATOL) | (shading == 0.0)  # vertex normals may cancel
    with np.errstate(over="ignore", invalid="ignore"):
        beyond = np.isinf(hits.t * np.abs(shots.d).max(axis=1))  # a place that float64 has no numbers for
    fine = (np.isfinite(surface.p).all(axis=1) | beyond) & unit & shaded
    for i in np.flatnonzero(hit & ~fine):
        what = f"p {surface.p[i].tolist()}, n {surface.n[i].tolist()}, sh_n {surface.sh_n[i].tolist()}"
        ray = shots.taken(slice(i, i + 1))._replace(t_min=np.zeros(1), t_max=np.full(1, np.inf))
        yield Finding("surface", f"shape {hits.shape_id[i]} is hit with {what}", ray)

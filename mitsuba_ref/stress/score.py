"""Witnesses of a sweep, and their scores in one setting: wrong hits and misses, wrong primitives, errors of t."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from caster.geometry.packing import Packed
from caster.rendering.hits import cast
from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.error_model.bounds import intersections_at
from mitsuba_ref.error_model.bracket import Bracket
from mitsuba_ref.error_model.intersections import Intersections
from mitsuba_ref.hard.family import Family, scene_of
from mitsuba_ref.hard.swept_families import NO_VIEW
from mitsuba_ref.judge.adjudication import ExactHits, PreparedScene, claims_of, prepare_scene, ratios_of_any_tie
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, send_request
from mitsuba_ref.reference.shared_input import SharedRays, export, packed_float32, shape_ids
from mitsuba_ref.reference.variants import LLVM, SCALAR, usable_variants
from mitsuba_ref.report.results import largest
from mitsuba_ref.subjects.subject import Answer, CastRequest, NoAnswer, Subject, Unsupported


@dataclasses.dataclass(frozen=True)
class Witness:
    """A line of the plots. variant: of Mitsuba, "" for our caster."""

    key: str
    title: str
    variant: str = ""
    robust: bool = True


OURS = Witness("ours", "ours")
REFERENCES = (
    Witness("scalar", "Mitsuba scalar, robust", SCALAR),
    Witness("llvm", "Mitsuba LLVM, default", LLVM, robust=False),
    Witness("llvm-robust", "Mitsuba LLVM, robust", LLVM),
)
WITNESSES = (OURS, *REFERENCES)
CANDIDATE = Witness("candidate", "the candidate")
BESIDE_CANDIDATE = (CANDIDATE, OURS, REFERENCES[0])  # the witnesses of a candidate's sweep

# Rays of a setting by default; in a closed mesh, exact arithmetic need not decide all of them.
DEFAULT_RAYS, DEFAULT_CLOSED_RAYS = 400, 10_000


class Observation(NamedTuple):
    """Hits that one witness reports for the rays of a setting."""

    t: np.ndarray  # (n,) float64, lengths of d, inf on a miss
    prim: np.ndarray  # (n,) number of the primitive in the scene, -1 on a miss

    @property
    def hit(self) -> np.ndarray:
        """(n,) bool. A NaN counts as a hit, so that it is noticed."""
        return ~np.isposinf(self.t)


@dataclass(frozen=True)
class Absent:
    """A witness without an observation, and the reason."""

    status: Literal["missing", "crash", "not applicable"]
    why: str


@dataclasses.dataclass(frozen=True)
class PreparedSetting(PreparedScene):
    """One point of a sweep: a scene and float32 rays through it, the same for all, with its geometry packed."""

    family: Family
    x: float


def prepare_setting(family: Family, seed: int, x: float, rays: int | None = None) -> PreparedSetting:
    """A setting of a family, for any rays: its camera is one without a Mitsuba sensor, so that none is exported."""
    made, rng = family.at(seed, x)
    scene = scene_of({**NO_VIEW, "shape": made.data["shape"]})
    count = rays or (DEFAULT_CLOSED_RAYS if family.closed else DEFAULT_RAYS)
    aimed = made.aim(rng, packed_float32(scene), count)
    ready = prepare_scene(scene, aimed.o.astype(np.float32), aimed.d.astype(np.float32))
    return PreparedSetting(**vars(ready), family=family, x=x)


def cast_by_bvh(ready: PreparedSetting) -> Observation:
    """The public cast, on the packed float32 geometry."""
    ready.scene.derived["packed"] = ready.packed
    hits = cast(ready.scene, ready.o, ready.d)
    return Observation(hits.t, scene_prim_ids(ready.packed, hits.shape_id, hits.prim_id))


def scene_prim_ids(packed: Packed, shape: np.ndarray, prim: np.ndarray) -> np.ndarray:
    """Numbers within the scene of primitives of shapes; -1 for shape -1."""
    return np.where(shape < 0, -1, packed.first[np.maximum(shape, 0)] + np.maximum(prim, 0))


def trace_by_reference(
    witness: Witness, settings: Sequence[PreparedSetting], folder: Path
) -> list[Observation | Absent]:
    """One of Mitsuba's configurations for several settings."""
    found = usable_variants()
    if witness.variant not in found.names:
        return [Absent("missing", found.why)] * len(settings)
    jobs = [_job(witness, ready, folder / f"{witness.key}-{i}") for i, ready in enumerate(settings)]
    # A ray takes some ten microseconds, more on a busy machine.
    answers = [send_request(job, DEFAULT_TIMEOUT + 1e-3 * len(job.o)) for job in jobs]
    return [_observation(ready, answer) for ready, answer in zip(settings, answers, strict=True)]


def _job(witness: Witness, ready: PreparedSetting, folder: Path) -> TraceRequest:
    xml = export(ready.scene, ready.model, robust=witness.robust).write(folder)
    o, d = ready.o, ready.d
    endless = np.full(len(o), np.inf, np.float32)
    # Mitsuba warns of far milder things than these scenes, and takes a very large or small sphere for a stretched one.
    return TraceRequest(xml, witness.variant, o, d, endless, lights=False, strict=False)


def _observation(ready: PreparedSetting, answer: TraceResponse | Crash) -> Observation | Absent:
    if isinstance(answer, Crash):
        return Absent("crash", f"{answer.kind} ({answer.exit}) {answer.headline}".strip())
    place = {name: index for index, name in enumerate(shape_ids(ready.scene))}
    shapes = np.array([*(place.get(name, -1) for name in answer.names), -1])
    return Observation(answer.t.astype(np.float64), scene_prim_ids(ready.packed, shapes[answer.shape], answer.prim))


# Scores of witnesses in one setting: wrong hits and misses, wrong primitives, errors of t.


# In a closed mesh every ray from inside hits, so exact arithmetic need not decide all of them: it decides this many,
# spread evenly, and the first of those that some witness reports as misses.
ADJUDICATED_IF_CLOSED, CONFIRMED_MISSES = 1000, 200  # rays

WRONG_RAYS_LISTED = 5


@dataclass(frozen=True)
class Score:
    """Counts of rays; errors of t in the family's unit, over rays that both the witness and exact arithmetic hit."""

    false_hits: int
    false_misses: int
    wrong_primitives: int  # hits of another primitive than those that are hit first, exactly
    beyond: int  # errors beyond the bound of their ray
    compared: int  # rays whose t was compared
    worst: float | None  # largest error over its bound
    error: float | None  # largest
    median: float | None
    first_wrong: tuple[int, ...] = ()  # the first rays that are wrong in any of these ways
    excused: int = 0  # of a candidate: other hits and misses than the exact ones, which its rounding allows
    example: str = ""  # of a candidate: its first wrong ray
    status: Literal["ok"] = "ok"

    @property
    def wrong_masks(self) -> int:
        return self.false_hits + self.false_misses

    @property
    def fails(self) -> bool:
        """Whether this is beyond what our caster may do."""
        return bool(self.wrong_masks or self.wrong_primitives or self.beyond)

    @property
    def breaks(self) -> bool:
        """Whether this is a breakdown: a wrong mask, or an error beyond what rounding explains."""
        return bool(self.wrong_masks or self.beyond)


@dataclass(frozen=True)
class Bound:
    """Predictions of the error model: the largest bound of the setting's rays, in the family's unit."""

    float32: float | None  # None: float32 resolves none of the rays
    float64: float | None
    unresolved: int  # rays without a float32 bound


class ExactAnswers(NamedTuple):
    """Exact answers of a setting: hit or miss for each ray, everything for the adjudicated ones."""

    hit: np.ndarray  # (n,) bool, of all rays
    rows: np.ndarray  # (m,) the adjudicated rays
    hits: ExactHits  # of these


def exact_answers(ready: PreparedSetting, reported_misses: np.ndarray) -> ExactAnswers:
    """Exact answers; all rays are adjudicated but for a closed mesh.

    reported_misses: (n,) rays that some witness reports as misses. Raises AssertionError if a ray leaves a closed mesh.
    """
    count = len(ready.o)
    if ready.family.closed:
        sample = np.linspace(0, count - 1, min(count, ADJUDICATED_IF_CLOSED)).astype(int)
        rows = np.union1d(sample, np.flatnonzero(reported_misses)[:CONFIRMED_MISSES])
    else:
        rows = np.arange(count)
    hits = ExactHits(ready, ready.o[rows], ready.d[rows])
    hit = np.ones(count, bool)
    hit[rows] = hits.hit
    if ready.family.closed and not hit.all():
        raise AssertionError(f"ray {int(np.argmin(hit))} leaves a closed mesh from inside by exact arithmetic")
    return ExactAnswers(hit, rows, hits)


def ask_candidate(subject: Subject, ready: PreparedSetting) -> Answer | Absent:
    """A candidate's answer to the rays of a setting."""
    rays = SharedRays(ready.o, ready.d, np.full(len(ready.o), np.inf, np.float32), np.zeros(len(ready.o)))
    with ScratchFolder() as folder:
        try:
            return subject.answer(CastRequest(ready.scene, ready.model, rays, Path(folder)))
        except Unsupported as declined:
            return Absent("not applicable", str(declined))
        except NoAnswer as error:
            return Absent("crash", str(error))


def t_text(t: float) -> str:
    """A hit or a miss, in words."""
    return "a miss" if np.isposinf(t) else f"a hit at t {t!r}"


class Scorer:
    """Compares witnesses with the exact answers of one setting."""

    def __init__(self, ready: PreparedSetting, exact: ExactAnswers) -> None:
        self.ready, self.primitives, self.exact = ready, ready.primitives, exact
        length = np.linalg.norm(exact.hits.d, axis=1)
        unit = ready.family.unit
        self.unit = np.abs(exact.hits.t) if unit is None else unit / length  # (m,) lengths of d
        self.hit_rows = np.flatnonzero(exact.hits.hit)

    @property
    def bound(self) -> Bound:
        hits, rows = self.exact.hits, self.hit_rows
        float32, float64 = (bound[rows] / self.unit[rows] for bound in (hits.float32, hits.float64))
        return Bound(largest(float32), largest(float64), int(np.sum(~np.isfinite(hits.float32[rows]))))

    def score_candidate(self, answer: Answer) -> Score:
        """Wrong is what neither is exactly right nor allowed by the rounding of the candidate's precision."""
        hit, rows, hits = self.exact
        some, model = answer.rows(rows), self.ready.model

        def near(of: np.ndarray, prim: np.ndarray, t: np.ndarray) -> Intersections:
            return intersections_at(model, prim, (hits.o[of], hits.d[of]), t, answer.ku, ours=True)

        ratio = ratios_of_any_tie(hits.answers, some, near, self.ready.packed).best
        inexact = np.flatnonzero(~(ratio <= 1.0) & ~some.is_broken)
        claims = claims_of(some.rows(inexact), self.ready.packed)
        endless = np.full(len(inexact), np.inf)
        found = Bracket(model, answer.ku, ours=True).judge(hits.o[inexact], hits.d[inexact], endless, claims)
        allowed = (found.allowed & ~(claims.t <= 0.0)) | found.open
        wrong = (answer.hit != hit) | answer.is_broken
        wrong[rows] = some.is_broken
        wrong[rows[inexact[~allowed]]] = True
        both = self.hit_rows[np.isfinite(some.t[self.hit_rows])]
        relative = hits.errors(both, some.t[both]) / self.unit[both]
        wrong_rays = np.flatnonzero(wrong)
        return Score(
            false_hits=int(np.sum(wrong & answer.hit & ~hit)),
            false_misses=int(np.sum(wrong & ~answer.hit & hit)),
            wrong_primitives=0,
            beyond=int(np.sum(wrong & answer.hit & hit)),
            compared=len(both),
            worst=largest(ratio[both][np.isfinite(ratio[both])]),
            error=largest(relative),
            median=float(np.median(relative)) if len(both) else None,
            first_wrong=tuple(wrong_rays[:WRONG_RAYS_LISTED].tolist()),
            excused=int(allowed.sum()),
            example=self._ray_text(int(wrong_rays[0]), answer) if len(wrong_rays) else "",
        )

    def _ray_text(self, ray: int, answer: Answer) -> str:
        """A ray in hex floats, the candidate's answer to it and the exact one."""
        o, d = (" ".join(float(x).hex() for x in a[ray]) for a in (self.ready.o, self.ready.d))
        place = int(np.searchsorted(self.exact.rows, ray))
        known = place < len(self.exact.rows) and self.exact.rows[place] == ray
        exact_t = float(self.exact.hits.t[place]) if known else None
        exact = "a hit, of a closed mesh" if exact_t is None else t_text(exact_t)
        return f"ray {ray}: o {o}, d {d}: the candidate has {t_text(float(answer.t[ray]))}, exactly it is {exact}"

    def score(self, found: Observation | Absent, *, ours: bool) -> Score | Absent:
        if isinstance(found, Absent):
            return found
        hit, rows, hits = self.exact
        both = self.hit_rows[found.hit[rows[self.hit_rows]]]
        errors = hits.errors(both, found.t[rows[both]])
        prim = found.prim[rows[both]]
        other = np.array([int(k) not in hits.ties[i] for i, k in zip(both, prim, strict=True)], bool)
        allowed = (hits.float64 if ours else hits.float32)[both]
        named = np.flatnonzero(other & (prim >= 0) & (prim < self.primitives))
        of_named = hits.bounds(both[named], prim[named])[0 if ours else 1]
        allowed[named] = np.maximum(allowed[named], of_named)
        beyond = ~(errors <= allowed)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(errors > 0.0, errors / allowed, 0.0)
        relative = errors / self.unit[both]
        wrong = found.hit != hit
        wrong[rows[both[beyond | other]]] = True
        return Score(
            false_hits=int(np.sum(found.hit & ~hit)),
            false_misses=int(np.sum(~found.hit & hit)),
            wrong_primitives=int(other.sum()),
            beyond=int(beyond.sum()),
            compared=len(both),
            worst=largest(ratio),
            error=largest(relative),
            median=float(np.median(relative)) if len(both) else None,
            first_wrong=tuple(np.flatnonzero(wrong)[:WRONG_RAYS_LISTED].tolist()),
        )

"""Stress sweeps: hard scenes traced by several ray casters, their wrong hits, misses, primitives and errors of t."""

import dataclasses
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, computed_field
from pydantic.dataclasses import dataclass

from caster.rendering.hits import cast
from caster.system.atomic_files import ScratchFolder, check_folder, write_text
from mitsuba_ref.error_model.bracket import Bracket
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.scene_model import OUR_SIDE, REFERENCE_SIDE, Side
from mitsuba_ref.hard.family import Family
from mitsuba_ref.hard.rays import endless
from mitsuba_ref.judge.adjudication import ExactHits, PreparedScene, claims_of, prepare_scene
from mitsuba_ref.judge.checks.knife_edges import nearest_hits, scene_of_ray, t_text
from mitsuba_ref.judge.explanations import format_numbers
from mitsuba_ref.reference.messages import Crash, TraceRequest
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, send_request
from mitsuba_ref.reference.shared_input import endless_rays, export, packed_float32
from mitsuba_ref.reference.variants import LLVM, SCALAR, usable_variants
from mitsuba_ref.report.output import NOTHING, aligned, largest
from mitsuba_ref.stress.origins import DEFAULT_RAYS, Absent, OriginSweep, Sweep
from mitsuba_ref.subjects.subject import FLOAT32, FLOAT64, Answer, CastRequest, NoAnswer, Subject, Unsupported

# ---- casters and settings


@dataclasses.dataclass(frozen=True)
class Caster:
    """A caster in a sweep. variant: that of Mitsuba; "" for others."""

    key: str
    title: str
    variant: str = ""
    robust: bool = True


OURS = Caster("ours", "ours")
REFERENCES = (
    Caster("scalar", "Mitsuba scalar, robust", SCALAR),
    Caster("llvm", "Mitsuba LLVM, default", LLVM, robust=False),
    Caster("llvm-robust", "Mitsuba LLVM, robust", LLVM),
)
CASTERS = (OURS, *REFERENCES)
CANDIDATE = Caster("candidate", "the candidate")
BESIDE_CANDIDATE = (CANDIDATE, OURS, REFERENCES[0])  # the casters of a candidate's sweep

DEFAULT_CLOSED_RAYS = 10_000  # of a setting; in a closed mesh, exact arithmetic need not decide all of them


@dataclasses.dataclass(frozen=True)
class PreparedSetting(PreparedScene):
    """One point of a sweep: a scene and float32 rays through it, the same for all, with its geometry packed."""

    family: Family
    x: float


def prepare_setting(family: Family, seed: int, x: float, rays: int | None) -> PreparedSetting:
    """A setting of a family."""
    made, rng = family.at(seed, x)
    scene, count = made.scene(), rays or (DEFAULT_CLOSED_RAYS if family.closed else DEFAULT_RAYS)
    aimed = made.aim(rng, packed_float32(scene), count)
    ready = prepare_scene(scene, aimed.o.astype(np.float32), aimed.d.astype(np.float32))
    return PreparedSetting(**vars(ready), family=family, x=x)


# ---- answers


def cast_by_bvh(ready: PreparedSetting) -> Answer:
    """Cast by our public function, on the packed float32 geometry."""
    ready.scene.derived["packed"] = ready.model.packed
    hits = cast(ready.scene, ready.o, ready.d)
    found = nearest_hits(ready.model.packed, hits.t, hits.shape_id, hits.prim_id)
    return Answer(found.t, None, FLOAT64, {}, prim=found.prim, exact_visibility=True)


def trace_by_reference(caster: Caster, ready: PreparedSetting) -> Answer | Absent:
    """Trace the rays of a setting by one of Mitsuba's configurations."""
    found = usable_variants()
    if caster.variant not in found.names:
        return Absent("missing", found.why)
    t_max = np.full(len(ready.o), np.inf, np.float32)
    with ScratchFolder() as folder:
        xml = export(ready.scene, ready.model, robust=caster.robust).write(Path(folder))
        # Mitsuba warns of far milder things than these scenes, and takes a very large or small sphere for a stretched
        # one.
        request = TraceRequest(xml, caster.variant, ready.o, ready.d, t_max, lights=False, strict=False)
        # A ray takes some ten microseconds, more on a busy machine.
        answer = send_request(request, DEFAULT_TIMEOUT + 1e-3 * len(ready.o))
    if isinstance(answer, Crash):
        return Absent("crash", answer.brief)
    return Answer(answer.t.astype(np.float64), None, FLOAT32, {})


def ask_candidate(subject: Subject, ready: PreparedSetting) -> Answer | Absent:
    """A candidate's answer to the rays of a setting."""
    rays = endless_rays(ready.o, ready.d)
    with ScratchFolder() as folder:
        try:
            return subject.answer(CastRequest(ready.scene, ready.model, rays, Path(folder)))
        except Unsupported as declined:
            return Absent("not applicable", str(declined))
        except NoAnswer as error:
            return Absent("crash", str(error))


# ---- scores

# In a closed mesh every ray from inside hits, so exact arithmetic need not decide all of them: it decides this many,
# spread evenly, and the first of those that some caster reports as misses.
ADJUDICATED_IF_CLOSED, CONFIRMED_MISSES = 1000, 200  # rays

WRONG_RAYS_LISTED = 5


@dataclass(frozen=True)
class Score:
    """Counts of rays; errors of t in the family's unit, over rays that both the caster and exact arithmetic hit."""

    false_hits: int
    false_misses: int
    beyond: int  # hits of another surface, or with t or the normal beyond the bound of their ray
    compared: int  # rays whose t was compared
    worst: float | None  # largest error over its bound
    error: float | None  # largest
    first_wrong: tuple[int, ...] = ()  # the first rays that are wrong in any of these ways
    excused: int = 0  # other answers than the exact ones, which rounding allows
    example: str = ""  # the first wrong ray
    scene: Annotated[str, Field(exclude=True)] = ""  # that ray as a scene file
    status: Literal["ok"] = "ok"

    @property
    def wrong_masks(self) -> int:
        return self.false_hits + self.false_misses

    @property
    def breaks(self) -> bool:
        """Whether this is a breakdown: a wrong mask, or an error beyond what rounding explains."""
        return bool(self.wrong_masks or self.beyond)


class Scorer:
    """Compares casters with the exact answers of one setting: to all rays, or in a closed mesh to some of them."""

    def __init__(self, ready: PreparedSetting, reported_misses: Array) -> None:
        """reported_misses: (n,) rays that some caster reports as misses.

        Raises AssertionError if a ray leaves a closed mesh.
        """
        self.ready, count = ready, len(ready.o)
        self.rows = np.arange(count)  # (m,) the adjudicated rays
        if ready.family.closed:
            sample = np.linspace(0, count - 1, min(count, ADJUDICATED_IF_CLOSED)).astype(int)
            self.rows = np.union1d(sample, np.flatnonzero(reported_misses)[:CONFIRMED_MISSES])
        self.exact = ExactHits(ready.model, ready.o[self.rows], ready.d[self.rows])
        self.hit = np.ones(count, bool)
        self.hit[self.rows] = self.exact.hit
        if ready.family.closed and not self.hit.all():
            raise AssertionError(f"ray {int(np.argmin(self.hit))} leaves a closed mesh from inside by exact arithmetic")
        unit = ready.family.unit
        self.unit = np.abs(self.exact.t) if unit is None else unit / np.linalg.norm(self.exact.d, axis=1)

    def bound(self, side: Side) -> float | None:
        """The prediction of the error model: the largest bound of the rays, in the family's unit."""
        return largest(self.exact.bounds(side) / self.unit)

    def score(self, answer: Answer, *, reference: bool = False) -> Score:
        """Score a caster: an answer is wrong if it is neither exact nor allowed by rounding in its precision.

        Ours has to be exact. reference: by the bounds of its own arithmetic; no wrong hit or miss of it is excused.
        """
        exact, some = self.exact, answer.rows(self.rows)
        side = REFERENCE_SIDE if reference else answer.side
        ratio = exact.ratios(some, side)
        wrong = ~(ratio <= 1.0)
        open_to_excuse = exact.hit & some.hit if reference else np.full(len(wrong), not answer.exact_visibility)
        inexact = np.flatnonzero(wrong & open_to_excuse & ~some.is_broken)
        claims = claims_of(some.rows(inexact), exact.model.packed)
        bracketed = Bracket(exact.model, side).judge(endless(exact.o[inexact], exact.d[inexact]), claims)
        excused = inexact[(bracketed.allowed & ~(claims.t <= 0.0)) | bracketed.open]
        wrong[excused] = False
        all_wrong = answer.hit != self.hit
        all_wrong[self.rows] = wrong
        errors, rays = exact.errors(some.t), np.flatnonzero(all_wrong)[:WRONG_RAYS_LISTED].tolist()
        return Score(
            false_hits=int(np.sum(all_wrong & answer.hit & ~self.hit)),
            false_misses=int(np.sum(all_wrong & ~answer.hit & self.hit)),
            beyond=int(np.sum(all_wrong & answer.hit & self.hit)),
            compared=int(np.isfinite(errors).sum()),
            worst=largest(ratio[np.isfinite(errors)]),
            error=largest(errors / self.unit),
            first_wrong=tuple(rays),
            excused=len(excused),
            example=self._ray_text(rays[0], answer) if rays else "",
            scene=scene_of_ray(self.ready.scene, self.ready.o[rays[0]], self.ready.d[rays[0]]).to_toml()
            if rays
            else "",
        )

    def _ray_text(self, ray: int, answer: Answer) -> str:
        """The answer along a ray and the exact one: their normals where only these differ, else t."""
        given = f"ray {ray}: t of the answer: {t_text(float(answer.t[ray]))}\n      exact t: "
        place = np.flatnonzero(self.rows == ray)
        if not len(place):
            return f"{given}finite, within a closed mesh"
        t, here = self.exact.t[place], answer.rows(self.rows)
        if here.n is not None and self.exact.ratios(replace(here, n=None), answer.side)[place[0]] <= 1.0:
            prim = np.array([self.exact.answers[place[0]].prim])
            right = self.exact.near(place, prim, t, answer.side).n[0]
            given, expected = (format_numbers(n) for n in (here.n[place[0]], right))
            return f"ray {ray}: its t is right; normal of the answer: ({given}); expected: ({expected})"
        return f"{given}{t_text(float(t[0]))}"


# ---- sweeps

JSON_FORMAT = 4  # goes up when a key changes its meaning or goes away


@dataclass(frozen=True)
class SettingResult:
    """Exact answers to the rays of one setting, and the scores of all casters."""

    x: float
    rays: int
    adjudicated: int  # rays decided by exact arithmetic; a closed mesh needs only a sample
    hits: int
    ties: int  # rays that hit several primitives at exactly the same t
    bound32: float | None  # None: float32 resolves none of the rays
    bound64: float | None
    witnesses: Mapping[str, Score | Absent]  # by caster
    replay: str = ""  # the command that shows the first wrong ray of the subject


@dataclass(frozen=True, kw_only=True)
class SweepResult(Sweep):
    """The results of one family by caster."""

    settings: tuple[SettingResult, ...]
    error: str
    easiest: float
    misses: bool  # whether exact misses are expected; not from inside a closed mesh

    @classmethod
    def of(cls, family: Family, settings: Sequence[SettingResult] = (), **more: Any) -> "SweepResult":
        return cls(
            family.name,
            family.title,
            family.quantity,
            settings=tuple(settings),
            error=family.error,
            easiest=family.easiest,
            misses=not family.closed,
            **more,
        )

    @property
    def casters(self) -> tuple[Caster, ...]:
        with_candidate = any(CANDIDATE.key in setting.witnesses for setting in self.settings)
        return BESIDE_CANDIDATE if with_candidate else CASTERS

    def problems_in(self, setting: SettingResult) -> Iterator[str]:
        """A setting without hits or misses, and errors of the subject: the candidate, or ours without one."""
        needed = {"hits": setting.hits} | ({"misses": setting.rays - setting.hits} if self.misses else {})
        for name in (name for name, count in needed.items() if not count):
            yield (
                f"exact arithmetic has no {name} of {setting.rays} rays, so the setting tests nothing; "
                "more --rays may help"
            )
        key = self.casters[0].key
        score = setting.witnesses[key]
        if isinstance(score, Absent):
            if score.status == "crash":
                yield f"{key}: no answer: {score.why}"
        elif score.breaks:
            yield (
                f"{key}:\n      {score.false_hits} false hits, {score.false_misses} false misses, "
                f"{score.beyond} hits beyond their bounds\n"
                f"      rays {list(score.first_wrong)}\n      {score.example}\n"
                f"      replay: {setting.replay}"
            )

    @computed_field  # type: ignore[prop-decorator]
    @property
    def breakdowns(self) -> dict[str, list[float]]:
        """By caster, the first x at which it breaks down, on either side of where the family is easiest."""
        found = {}
        for caster in self.casters:
            broken = [setting.x for setting in self.settings if setting.witnesses[caster.key].breaks]
            below, above = ([x for x in broken if (x < self.easiest) == side] for side in (True, False))
            found[caster.key] = [*below[-1:], *above[:1]]
        return found

    def absence(self, key: str) -> Absent | None:
        """Why a caster has no score in any setting; None if it has one."""
        scores = [setting.witnesses[key] for setting in self.settings]
        absent = [score for score in scores if isinstance(score, Absent)]
        return absent[0] if absent and len(absent) == len(scores) else None

    def rows(self) -> list[list[str]]:
        names = [name for caster in self.casters for name in (caster.key, "wrong")]
        found = [[self.quantity, "rays", "hits", "ties", "bound 64", "bound 32", *names]]
        for setting in self.settings:
            counts = map(str, (setting.rays, setting.hits, setting.ties))
            bounds = map(_number, (setting.bound64, setting.bound32))
            found.append(row := [f"{setting.x:.4g}", *counts, *bounds])
            for score in (setting.witnesses[caster.key] for caster in self.casters):
                if isinstance(score, Absent):
                    row += score.status, NOTHING
                else:  # a ! where an error is beyond its bound
                    row += _number(score.error) + "!" * bool(score.beyond), str(score.wrong_masks)
        return found

    def legend(self) -> str:
        return f"of each caster: {self.error}, !: beyond its bound; wrong hits and misses"

    def footnotes(self) -> Iterator[str]:
        """Where each caster first breaks down; why one is absent."""
        yield f"breaks down at: {', '.join(f'{each.key} {self.breakdown(each.key)}' for each in self.casters)}"
        if not self.misses:
            yield self.leaks()
        for caster in self.casters:
            if (absent := self.absence(caster.key)) and absent.status != "missing":
                yield f"{caster.title}: {absent.status}: {absent.why}"

    def breakdown(self, key: str) -> str:
        """Where a caster first breaks down, in words."""
        if absent := self.absence(key):
            return absent.status
        return " and ".join(f"{x:.4g}" for x in self.breakdowns[key]) or "never"

    def leaks(self) -> str:
        """Rays that leave a closed mesh, all settings together."""
        found = []
        for caster in self.casters:
            scores = [setting.witnesses[caster.key] for setting in self.settings]
            out = sum(score.false_misses for score in scores if isinstance(score, Score))
            absent = self.absence(caster.key)
            found.append(f"{caster.key} {absent.status if absent else out}")
        return f"leaks of {sum(setting.rays for setting in self.settings)} rays: {', '.join(found)}"


def _number(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1e}" if value else "0"


@dataclass(frozen=True)
class StressRun:
    """A run of `mitsuba-ref stress`. requested: the selected families; an interrupted run has results of some only."""

    seed: int
    versions: Mapping[str, str]
    requested: tuple[str, ...]
    families: tuple[SweepResult | OriginSweep, ...]
    skip_unsupported: bool = False  # families that the candidate declined do not fail the run, others being judged
    format: int = JSON_FORMAT

    @property
    def judged(self) -> list[SweepResult | OriginSweep]:
        return [sweep for sweep in self.families if not (self.skip_unsupported and sweep.declined)]

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        finished = len(self.families) == len(self.requested)
        return bool(self.judged) and finished and all(sweep.ok for sweep in self.judged)


def sweep(
    family: Family,
    seed: int,
    rays: int | None,
    candidate: Subject | None = None,
    folder: Path | None = None,
    words: Sequence[str] = (),
) -> SweepResult:
    """Sweep a family. The same seed and number of rays give the same result, except for the time.

    candidate: one that takes rays, judged in place of our caster. folder: for the first wrong ray of each setting;
    words: options that name the candidate, for replays.
    """
    start, casters = perf_counter(), BESIDE_CANDIDATE if candidate else CASTERS
    settings = [prepare_setting(family, seed, x, rays) for x in family.values]
    given = [ask_candidate(candidate, ready) if candidate else None for ready in settings]
    declined = [each.why for each in given if isinstance(each, Absent) and each.status == "not applicable"]
    if candidate and len(declined) == len(settings):
        return SweepResult.of(family, seconds=perf_counter() - start, declined=declined[0])
    results = []
    for ready, answer in zip(settings, given, strict=True):
        found = score_setting(ready, casters, answer)
        subject = found.witnesses[casters[0].key]
        if folder and isinstance(subject, Score) and subject.breaks:
            file = check_folder(folder) / f"{family.name}-{ready.x:g}.toml"
            head = f"mitsuba-ref stress: ray {subject.first_wrong[0]} of {family.name}, {family.quantity} {ready.x:g}"
            write_text(file, f"# {head}\n\n{subject.scene}")
            found = replace(found, replay=shlex.join(["mitsuba-ref", "probe", str(file), "0", "0", *words]))
        results.append(found)
    return SweepResult.of(family, results, seconds=perf_counter() - start)


def score_setting(
    ready: PreparedSetting, casters: Sequence[Caster], given: Answer | Absent | None = None
) -> SettingResult:
    """Trace a setting by these casters and score their answers. given: the candidate's."""
    answers: dict[Caster, Answer | Absent] = {CANDIDATE: given} if given else {}
    for each in casters:
        if each is not CANDIDATE:
            answers[each] = trace_by_reference(each, ready) if each.variant else cast_by_bvh(ready)
    missed = [~found.hit for found in answers.values() if not isinstance(found, Absent)]
    scorer = Scorer(ready, np.any(missed, axis=0))
    scores = {
        each.key: found if isinstance(found, Absent) else scorer.score(found, reference=bool(each.variant))
        for each, found in answers.items()
    }
    return SettingResult(
        ready.x,
        len(ready.o),
        adjudicated=len(scorer.rows),
        hits=int(scorer.hit.sum()),
        ties=sum(len(answer.prims) > 1 for answer in scorer.exact.answers),
        bound32=scorer.bound(REFERENCE_SIDE),
        bound64=scorer.bound(OUR_SIDE),
        witnesses=scores,
    )


def as_text(sweep: SweepResult | OriginSweep, skip_unsupported: bool = False) -> str:
    """The table of a sweep with its failures; one line if everything was declined."""
    if sweep.declined:
        mark, why = "SKIP" if skip_unsupported else "FAIL", sweep.declined.partition("\n")[0]
        return f"{mark}  {sweep.name}: {sweep.title}; the candidate declined every setting: {why}"
    mark = "PASS" if sweep.ok else "FAIL"
    head = f"{mark}  {sweep.name}: {sweep.title}   {sweep.seconds:.1f} s\nx: {sweep.quantity}"
    (_, *names), *settings = sweep.rows()
    problems = (f"FAIL  {line}" for line in sweep.problems)
    table = aligned([["x", *names], *settings], step=2)
    return "\n".join([head, sweep.legend(), *table, *sweep.footnotes(), *problems])

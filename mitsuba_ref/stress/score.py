"""The casters of a sweep, and their scores in one setting: wrong hits and misses, wrong primitives, errors of t."""

import dataclasses
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass

from caster.rendering.hits import cast
from caster.scene.export import format_toml
from caster.system.atomic_files import ScratchFolder, check_folder, write_text
from mitsuba_ref.error_model.bracket import Bracket
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.hard.family import Family, Fields
from mitsuba_ref.judge.adjudication import ExactHits, PreparedScene, claims_of, prepare_scene
from mitsuba_ref.judge.checks.knife_edges import nearest_hits, t_text
from mitsuba_ref.judge.explanations import format_numbers
from mitsuba_ref.reference.messages import Crash, TraceRequest
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, send_request
from mitsuba_ref.reference.shared_input import endless_rays, export, packed_float32
from mitsuba_ref.reference.variants import LLVM, SCALAR, usable_variants
from mitsuba_ref.report.results import largest
from mitsuba_ref.subjects.subject import FLOAT32, FLOAT64, Answer, CastRequest, NoAnswer, Subject, Unsupported


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

# Rays of a setting by default; in a closed mesh, exact arithmetic need not decide all of them.
DEFAULT_RAYS, DEFAULT_CLOSED_RAYS = 400, 10_000


@dataclass(frozen=True)
class Absent:
    """The reason why a caster has no answer."""

    status: Literal["missing", "crash", "not applicable"]
    why: str

    @property
    def breaks(self) -> bool:
        return self.status == "crash"


@dataclasses.dataclass(frozen=True)
class PreparedSetting(PreparedScene):
    """One point of a sweep: a scene and float32 rays through it, the same for all, with its geometry packed."""

    family: Family
    x: float
    data: Fields  # of the scene, as a scene file gives them

    def write_ray(self, folder: Path, ray: int) -> Path:
        """Write the scene with one ray as its camera; returns the file. Raises OutputError."""
        check_folder(folder)
        o, d = (a[ray].tolist() for a in (self.o, self.d))
        camera = {"type": "ray", "origin": o, "direction": d}
        path = folder / f"{self.family.name}-{self.x:g}.toml"
        head = f"# mitsuba-ref stress: ray {ray} of {self.family.name}, {self.family.quantity} {self.x:g}\n\n"
        write_text(path, head + format_toml(self.data | {"camera": camera}))
        return path


def prepare_setting(family: Family, seed: int, x: float, rays: int | None = None) -> PreparedSetting:
    """A setting of a family."""
    made, rng = family.at(seed, x)
    scene, count = made.scene(), rays or (DEFAULT_CLOSED_RAYS if family.closed else DEFAULT_RAYS)
    aimed = made.aim(rng, packed_float32(scene), count)
    ready = prepare_scene(scene, aimed.o.astype(np.float32), aimed.d.astype(np.float32))
    return PreparedSetting(**vars(ready), family=family, x=x, data=made.data)


# ---- answers


def cast_by_bvh(ready: PreparedSetting) -> Answer:
    """Cast by our public function, on the packed float32 geometry."""
    ready.scene.derived["packed"] = ready.packed
    hits = cast(ready.scene, ready.o, ready.d)
    found = nearest_hits(ready.packed, hits.t, hits.shape_id, hits.prim_id)
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
    status: Literal["ok"] = "ok"

    @property
    def wrong_masks(self) -> int:
        return self.false_hits + self.false_misses

    @property
    def breaks(self) -> bool:
        """Whether this is a breakdown: a wrong mask, or an error beyond what rounding explains."""
        return bool(self.wrong_masks or self.beyond)


@dataclass(frozen=True)
class Bound:
    """Predictions of the error model: the largest bound of the setting's rays, in the family's unit."""

    float32: float | None  # None: float32 resolves none of the rays
    float64: float | None


class Scorer:
    """Compares casters with the exact answers of one setting: to all rays, or in a closed mesh to some of them."""

    def __init__(self, ready: PreparedSetting, reported_misses: np.ndarray) -> None:
        """reported_misses: (n,) rays that some caster reports as misses.

        Raises AssertionError if a ray leaves a closed mesh.
        """
        self.ready, count = ready, len(ready.o)
        self.rows = np.arange(count)  # (m,) the adjudicated rays
        if ready.family.closed:
            sample = np.linspace(0, count - 1, min(count, ADJUDICATED_IF_CLOSED)).astype(int)
            self.rows = np.union1d(sample, np.flatnonzero(reported_misses)[:CONFIRMED_MISSES])
        self.exact = ExactHits(ready, ready.o[self.rows], ready.d[self.rows])
        self.hit = np.ones(count, bool)
        self.hit[self.rows] = self.exact.hit
        if ready.family.closed and not self.hit.all():
            ray = int(np.argmin(self.hit))
            raise AssertionError(f"ray {ray} leaves a closed mesh from inside by exact arithmetic")
        unit = ready.family.unit
        self.unit = np.abs(self.exact.t) if unit is None else unit / np.linalg.norm(self.exact.d, axis=1)

    @property
    def bound(self) -> Bound:
        sides = self.exact.bounds(KU, ours=False), self.exact.bounds(KU_OURS, ours=True)
        return Bound(*(largest(bounds / self.unit) for bounds in sides))

    def score(self, answer: Answer, *, reference: bool = False) -> Score:
        """Score a caster: an answer is wrong if it is neither exact nor allowed by rounding in its precision.

        Ours has to be exact. reference: by the bounds of its own arithmetic; no wrong hit or miss of it is excused.
        """
        exact, some, packed = self.exact, answer.rows(self.rows), self.ready.packed
        ratio = exact.ratios(some, ours=not reference)
        wrong = ~(ratio <= 1.0)
        open_to_excuse = exact.hit & some.hit if reference else np.full(len(wrong), not answer.exact_visibility)
        inexact = np.flatnonzero(wrong & open_to_excuse & ~some.is_broken)
        claims, t_max = claims_of(some.rows(inexact), packed), np.full(len(inexact), np.inf)
        bracket = Bracket(self.ready.model, answer.ku, ours=not reference)
        bracketed = bracket.judge(exact.o[inexact], exact.d[inexact], t_max, claims)
        excused = inexact[(bracketed.allowed & ~(claims.t <= 0.0)) | bracketed.open]
        wrong[excused] = False
        all_wrong = answer.hit != self.hit
        all_wrong[self.rows] = wrong
        errors = exact.errors(some.t)
        return Score(
            false_hits=int(np.sum(all_wrong & answer.hit & ~self.hit)),
            false_misses=int(np.sum(all_wrong & ~answer.hit & self.hit)),
            beyond=int(np.sum(all_wrong & answer.hit & self.hit)),
            compared=int(np.isfinite(errors).sum()),
            worst=largest(ratio[np.isfinite(errors)]),
            error=largest(errors / self.unit),
            first_wrong=tuple(np.flatnonzero(all_wrong)[:WRONG_RAYS_LISTED].tolist()),
            excused=len(excused),
            example=self._ray_text(int(np.argmax(all_wrong)), answer) if all_wrong.any() else "",
        )

    def _ray_text(self, ray: int, answer: Answer) -> str:
        """The answer along a ray and the exact one: their normals where only these differ, else t."""
        given = f"ray {ray}: t of the answer: {t_text(float(answer.t[ray]))}\n      exact t: "
        place = np.flatnonzero(self.rows == ray)
        if not len(place):
            return f"{given}finite, within a closed mesh"
        t, here = self.exact.t[place], answer.rows(self.rows)
        if here.n is not None and self.exact.ratios(replace(here, n=None), ours=True)[place[0]] <= 1.0:
            prim = np.array([self.exact.answers[place[0]].prim])
            right = self.exact.near(place, prim, t, answer.ku, ours=True).n[0]
            given, expected = (format_numbers(n) for n in (here.n[place[0]], right))
            return f"ray {ray}: its t is right; normal of the answer: ({given}); expected: ({expected})"
        return f"{given}{t_text(float(t[0]))}"

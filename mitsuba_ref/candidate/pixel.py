"""A candidate at one pixel: asked about the whole picture, as `validate` does, and judged at this pixel alone."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from caster.scene import Scene
from mitsuba_ref.candidate.answer import Answer, NoAnswer
from mitsuba_ref.candidate.asking import Candidate
from mitsuba_ref.candidate.diagnosis import diagnose, marked_miss
from mitsuba_ref.candidate.hearing import Heard, hear, one_of
from mitsuba_ref.candidate.how_far import as_witness, factors, off_from_exact
from mitsuba_ref.candidate.judge import CandidateJudge
from mitsuba_ref.candidate.pictures import candidate_aovs
from mitsuba_ref.candidate.reasons import reason
from mitsuba_ref.candidate.telling import answer_words, hints
from mitsuba_ref.exact import ExactAnswer
from mitsuba_ref.jobs import Crash
from mitsuba_ref.judge import EXACT
from mitsuba_ref.pair import Pair
from mitsuba_ref.pixels import flat
from mitsuba_ref.quantities import at_no_common_hit
from mitsuba_ref.rays import SharedRays
from mitsuba_ref.reference import Witness, consult
from mitsuba_ref.verdict import CANDIDATE_WRONG, CLASSES, FAILING, OURS_WRONG, UNDECIDED, UNLISTED
from mitsuba_ref.witnesses import CANDIDATE, Saying

GIVES = ("t", "depth", "normal")  # all that a candidate may say of a hit


@dataclass(frozen=True)
class CandidatePixel:
    """What became of one pixel of a candidate, and why."""

    name: str  # who it is, as named
    verdict: str
    precision: str = ""  # whose bounds it is held to
    why: str = ""
    says: Mapping[str, Any] = field(default_factory=dict)  # hit, and of GIVES what there is
    off: Mapping[str, Any] = field(default_factory=dict)  # from the exact answer, where both hit
    ratios: Mapping[str, float] = field(default_factory=dict)  # error over bound, of what was judged
    not_judged: Mapping[str, str] = field(default_factory=dict)  # the rest, and why
    case: str = ""  # where the reference is wrong: the number of the known case, or "unlisted"
    alone: str = ""  # what it says when asked about this ray alone
    notes: tuple[str, ...] = ()
    problem: str = ""  # why there is nothing to judge
    saying: Saying | None = None  # the same, as a witness among the others

    @property
    def ok(self) -> bool:
        wrong = self.verdict == CANDIDATE_WRONG or self.verdict in FAILING
        return not self.problem and not wrong and self.case != UNLISTED

    def to_dict(self) -> dict[str, Any]:
        """For JSON, but for infinite numbers."""
        found = {name: value for name, value in vars(self).items() if name != "saying"}
        return found | {"ok": self.ok}


def candidate_at(candidate: Candidate, scene: Scene, pixel: tuple[int, int], pair: Pair) -> CandidatePixel:
    """Ask and judge. pair: ours and Mitsuba's answers along this pixel's ray. Raises SceneError."""
    x, y = pixel
    x0, y0, x1, y1 = scene.film.window
    if not (x0 <= x < x1 and y0 <= y < y1):
        x0, y0, x1, y1 = 0, 0, scene.film.width, scene.film.height
        scene = scene.with_film(crop=(x0, y0, x1, y1))
    row = (y - y0) * (x1 - x0) + x - x0
    try:
        heard = hear(candidate, scene, alone=row)
    except NoAnswer as error:
        saying = Saying(CANDIDATE, "", -1, np.nan, problem="no answer")
        return CandidatePixel(candidate.name, UNDECIDED, problem=str(error), saying=saying)
    here = heard.scene.with_film(crop=(x, y, x + 1, y + 1))
    rays = one_of(heard.rays, row)
    witness = _witness(here, heard, rays, pair)
    if isinstance(witness, Crash):
        problem = f"Mitsuba ended without an answer ({witness.exit}): {witness.words}"
        return CandidatePixel(candidate.name, UNDECIDED, problem=problem)
    judge = CandidateJudge(here, heard.model, rays, witness, heard.answer.at(row))
    return _judged(candidate.name, judge, heard)


def _witness(scene: Scene, heard: Heard, rays: SharedRays, pair: Pair) -> Witness | Crash:
    """What Mitsuba says; it is asked again only where the XML has a far plane that the scene has not."""
    if all(np.array_equal(mine, known) for mine, known in zip(rays, pair.rays, strict=True)):
        return pair.witness
    return consult(scene, heard.model, rays, lights=False)


def _judged(name: str, judge: CandidateJudge, heard: Heard) -> CandidatePixel:
    judgement, answer = judge.judge(), judge.answer
    verdict = CLASSES[int(judgement.classes[0])]
    said = {int(row): what for what, rows in diagnose(judge, judgement).said.items() for row in rows}
    if said and _marks_a_miss(judge, heard.answer.t):
        said[0] = marked_miss(float(answer.t[0]))
    exact = judgement.exact.of(0)
    off = off_from_exact(judge, exact)
    ratios = {check: float(ratio[0]) for check, ratio in judgement.ratios.items()}
    left = _not_judged(judge, exact)
    judged = {check: share for check, share in ratios.items() if check not in left or share > 0.0}
    told = (reason(judge, judgement, said, 0), factors(judge, off, judged))
    case = judgement.cases.get(0)
    return CandidatePixel(
        name,
        CANDIDATE_WRONG if verdict == OURS_WRONG else verdict,
        answer.precision,
        "; ".join(filter(None, told)),
        _says(judge),
        off,
        judged,
        {check: why for check, why in left.items() if check not in judged},
        "" if 0 not in judgement.cases else UNLISTED if case is None else str(case),
        _alone(heard.alone, answer),
        (*answer.notes, *heard.limits, *hints(answer, judgement)),
        saying=as_witness(judge, judgement, off),
    )


def _marks_a_miss(judge: CandidateJudge, everywhere: np.ndarray) -> bool:
    """Whether t is a number in the place of inf: Mitsuba misses, and other rays have the very same one."""
    t = judge.answer.t[0]
    return bool(np.isfinite(t) and not judge.witness.hit[0] and (everywhere == t).sum() > 1)


def _says(judge: CandidateJudge) -> dict[str, Any]:
    """Numbers as they are; a normal of length 1, NaN where it was not finite."""
    aovs = candidate_aovs(judge)
    given = {"t": judge.answer.t} | {name: flat(aovs, name) for name in ("depth", "normal") if name in aovs}
    hit, t = bool(judge.answer.hit[0]), float(judge.answer.t[0])
    return {"hit": hit, "t_hex": t.hex()} | {
        name: values[0].tolist() for name, values in given.items() if hit or name != "normal"
    }


def _not_judged(judge: CandidateJudge, exact: ExactAnswer | None) -> dict[str, str]:
    hits = bool(judge.answer.hit[0]), bool(judge.witness.hit[0])
    found = at_no_common_hit(*hits, "the candidate", ("depth", "normal"))
    if judge.answer.n is None:
        found["normal"] = "the candidate gives none"
    if exact is None:
        found[EXACT] = "there is no ray" if judge.t_max[0] < 0.0 else "exact arithmetic gave no answer"
    return found


def _alone(alone: Answer | NoAnswer | None, together: Answer) -> str:
    if alone is None:
        return ""
    if isinstance(alone, NoAnswer):
        return f"no answer: {alone}"
    bits = [(each.t.tobytes(), None if each.n is None else each.n.tobytes()) for each in (alone, together)]
    same = bits[0] == bits[1] and [*alone.broken] == [*together.broken]
    return "the same, to the bit" if same else f"something else: {answer_words(alone, 0)}"

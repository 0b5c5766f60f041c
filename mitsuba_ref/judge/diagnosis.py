"""What is wrong with a candidate: sentences, each with the pixels it is true of, by trying what people get wrong.

Nothing here decides whether a pixel passes; it only says of those that do not what their numbers look like.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from mitsuba_ref.cameras.camera_reference import camera_axes
from mitsuba_ref.error_model.bounds import row_distance
from mitsuba_ref.error_model.intersections import dot, norm, unit
from mitsuba_ref.judge.candidate_judge import CandidateJudge, CandidateJudgement
from mitsuba_ref.judge.classification import CLASS_CODE
from mitsuba_ref.judge.pixel_shift import MAX_DIAGNOSED_PIXELS, WrongPixels, find_pixel_shift, wrong_pixels
from mitsuba_ref.judge.verdict import FAILING, REFERENCE_WRONG, UNDECIDED, WRONG

# A supposition is told where it predicts the number to this share of itself: far beyond rounding in float32, far below
# any of the faults that are told apart here.
MATCH_RTOL = 1e-4
DISTINCT_RTOL = 10 * MATCH_RTOL  # two numbers that are so far apart are not alike
MAJORITY = 0.5  # what is said of all wrong t at once has to be true of more of them than this


class Diagnosis(NamedTuple):
    """Each sentence and the rows of the picture, ascending, that it is true of; each failing row has one."""

    said: Mapping[str, np.ndarray]

    def of(self, row: int) -> str:
        """The sentence of one row."""
        return next(what for what, rows in self.said.items() if row in rows)


def diagnose(judge: CandidateJudge, judgement: CandidateJudgement) -> Diagnosis:
    """The first sentence that is true of each pixel that fails, in the order of `suppositions`."""
    said: dict[str, np.ndarray] = {}
    left = judgement.is_class(*FAILING)
    unlisted = [row for row, case in judgement.cases.items() if case is None]
    left[unlisted] = True

    def say(what: str, rows: np.ndarray) -> None:
        mine = rows[left[rows]]
        if len(mine):
            said[what] = np.union1d(said.get(what, np.zeros(0, np.int64)), mine)
            left[mine] = False

    for what, rows in _marked_misses(judge):
        say(what, rows)
    for why, broken in judge.answer.broken.items():
        say(f"no answer: {why}", np.flatnonzero(broken))
    say("a hit where the camera has no ray", np.flatnonzero((judge.t_max < 0.0) & judge.answer.hit))
    of_mitsuba = judgement.classes == CLASS_CODE[REFERENCE_WRONG]
    say("the candidate is right, and Mitsuba wrong in no known way", np.flatnonzero(of_mitsuba))
    say("exact arithmetic gave no answer", np.flatnonzero(judgement.classes == CLASS_CODE[UNDECIDED]))
    wrong = np.flatnonzero(left & (judgement.classes == CLASS_CODE[WRONG]))
    if len(wrong):
        failing = wrong_pixels(judge, judgement, wrong)
        for what, rows in hypotheses(judge, failing):
            say(what, rows)
    say("not what is there, in no way that is recognised", np.flatnonzero(left))
    return Diagnosis(said)


def _marked_misses(judge: CandidateJudge) -> Iterator[tuple[str, np.ndarray]]:
    """A number in the place of inf: the same one wherever Mitsuba misses."""
    rows = np.flatnonzero(~judge.witness.hit & (judge.t_max >= 0.0))
    t = judge.answer.t[rows]
    if len(rows) > 1 and np.isfinite(t[0]) and (t == t[0]).all():
        yield marked_miss(float(t[0])), rows


def marked_miss(t: float) -> str:
    """The sentence about a number in the place of inf."""
    return f"t is {t:.7g} where nothing is hit; a miss has t inf"


def hypotheses(judge: CandidateJudge, failing: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    """(sentence, rows it is true of), what says most first."""
    if (shift := find_pixel_shift(judge, failing)) is not None:
        where = f"({shift.x:+.2f}, {shift.y:+.2f}) of a pixel to the right and down"
        yield f"seen from beside the pixels' centres, by {where}", failing.rows
    yield from _wrong_hits(judge, failing)
    hit = judge.answer.hit[failing.rows] & failing.hit
    there = failing.take(hit)
    if len(there.rows):
        yield from _wrong_t(judge, there)
        yield from _wrong_normal(judge, there)


def _wrong_hits(judge: CandidateJudge, failing: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    rows, says = failing.rows, judge.answer.hit[failing.rows]
    missed = rows[~says & failing.hit]
    everything = len(judge.answer.t) > 1 and not judge.answer.hit.any()  # of one pixel, that says nothing
    if len(missed) and not everything:
        at = np.flatnonzero(~says & failing.hit)
        lines = judge.o[missed], judge.d[missed]
        met = judge.model.intersect(failing.prim[at], *lines, judge.answer.ku, ours=True)
        begins_inside = np.unique(met.pair[(met.at.t < 0.0) & met.at.possible])
        what = "missed: the surface's first root is behind the ray's origin, and the second one was not tried"
        yield what, missed[begins_inside]
    if len(missed):
        yield ("the candidate misses everything" if everything else "missed; exact arithmetic hits"), missed
    yield "a hit; exact arithmetic misses", rows[says & ~failing.hit]


def _wrong_t(judge: CandidateJudge, f: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    """Rows where t is not what it should be."""
    t, d = judge.answer.t[f.rows], judge.d[f.rows]
    t_rounding = np.broadcast_to(judge.answer.t_rounding, judge.answer.t.shape)[f.rows]
    off = ~(np.abs(t - f.t) <= f.at.t_error + t_rounding)
    root = off & _other_root(judge, f, t)
    yield "another root of the surface that is hit first, such as the far one", f.rows[root]
    if judge.scene.camera.type != "ray":
        cosine = unit(d) @ camera_axes(judge.scene.camera)[2]
        what = "depth along z, the view axis, in place of t along the ray"
        yield what, f.rows[_matches_factor(t, f.t, cosine, off)]
    what = "distance in place of t, which counts in lengths of d"
    yield what, f.rows[_matches_factor(t, f.t, norm(d), off)]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.where(off, t / f.t - 1.0, 0.0)
    if not off.any():
        return
    middle = float(np.median(share[off]))
    same = off & (np.abs(share - middle) <= 0.01 * abs(middle))
    if same.sum() > MAJORITY * off.sum() and same.sum() > 1:
        yield f"t is {1.0 + middle:.7g} times what it should be", f.rows[same]
    behind = off & (share > DISTINCT_RTOL) & _hits_other_surface(judge, f, t)
    yield "a surface that lies behind the first one", f.rows[behind]
    for some, word in ((off & (share < 0.0), "before"), (off & (share > 0.0), "behind")):
        if some.any():
            yield (
                f"t is off: {word} what is hit, by {_range_text(np.abs(share[some]))} of itself",
                f.rows[some],
            )


def _matches_factor(t: np.ndarray, right: np.ndarray, factor: np.ndarray, off: np.ndarray) -> np.ndarray:
    """(m,) bool: t looks like `factor` times what is right; where the factor is nearly 1, only if others show it."""
    fits = off & _close(t, right * factor)
    telling = fits & (np.abs(factor - 1.0) > DISTINCT_RTOL)
    return fits if telling.sum() > MAJORITY * off.sum() else telling


def _wrong_normal(judge: CandidateJudge, f: WrongPixels) -> Iterator[tuple[str, np.ndarray]]:
    """Rows where t is right."""
    n = judge.answer.n
    if n is None:
        return
    n = n[f.rows]
    towards = dot(f.at.n, judge.d[f.rows]) > 0.0
    opposite = row_distance(n, -f.at.n) <= MATCH_RTOL
    yield (
        "the normal is turned towards the ray; geometric normals point outside, whoever looks",
        f.rows[opposite & towards],
    )
    yield "the normal is turned round", f.rows[opposite]
    shading = (row_distance(n, f.at.sh_n) <= MATCH_RTOL) & (row_distance(f.at.sh_n, f.at.n) > DISTINCT_RTOL)
    yield "the interpolated normal in place of the geometric one", f.rows[shading]
    off = row_distance(n, f.at.n)
    off = off[np.isfinite(off)]
    if len(off):
        yield f"the normal is off by {_range_text(off)} of its length", f.rows


def _range_text(sizes: np.ndarray) -> str:
    """From the smallest to the largest."""
    low, high = f"{sizes.min():.2g}", f"{sizes.max():.2g}"
    return low if low == high else f"{low} to {high}"


def _close(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        near: np.ndarray = np.abs(a - b) <= MATCH_RTOL * np.abs(b)
    return near


def _other_root(judge: CandidateJudge, f: WrongPixels, t: np.ndarray) -> np.ndarray:
    """(m,) bool: t is a root of the same primitive, though not the first."""
    met = judge.model.intersect(f.prim, judge.o[f.rows], judge.d[f.rows], judge.answer.ku, ours=True)
    found = np.zeros(len(t), bool)
    with np.errstate(invalid="ignore"):
        fits = _close(t[met.pair], met.at.t) & ~_close(met.at.t, f.t[met.pair]) & met.at.possible
    found[met.pair[fits]] = True
    return found


def _hits_other_surface(judge: CandidateJudge, f: WrongPixels, t: np.ndarray) -> np.ndarray:
    """(m,) bool: some other surface on the ray is at t."""
    rows = f.rows[:MAX_DIAGNOSED_PIXELS]
    possible = judge.bracket.possible_hits(judge.o[rows], judge.d[rows], judge.t_max[rows])
    found = np.zeros(len(t), bool)
    found[possible.ray[_close(t[possible.ray], possible.at.t)]] = True
    return found

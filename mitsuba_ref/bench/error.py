"""Who is how wrong: t against exact arithmetic, on rays of the picture and on rays aimed at edges."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mitsuba_ref.bench.aiming import at_edges
from mitsuba_ref.bench.preparing import Prepared
from mitsuba_ref.bench.work import ANY, SHADOW_END
from mitsuba_ref.bounds import bounds_of
from mitsuba_ref.exact import ExactAnswer, Oracle

SAMPLE = 2000  # rays of each sort


@dataclass(frozen=True)
class Score:
    """Over the sample of rays of the picture, and over those aimed at edges."""

    rays: int
    ulps: (
        float | None
    )  # largest |t - exact t| in float32 units in the last place of the exact t; None: nothing to compare
    bounds: float | None  # largest in units of the bound of its ray
    masks: int  # rays that hit where there is exactly nothing, or miss where there is something
    beyond: int  # hits whose t is beyond its bound, or not a number: another surface, or none
    edge_rays: int
    edge_masks: int
    edge_beyond: int


class Truth:
    """Rays and the exact answers about them."""

    def __init__(self, ready: Prepared, asks: str, seed: int, sample: int = SAMPLE) -> None:
        rng = np.random.default_rng([seed, 7])
        some = np.sort(rng.choice(len(ready.o), min(sample, len(ready.o)), replace=False))
        edges = at_edges(rng, ready, some)
        self.pictured = len(some)
        self.o, self.d = (
            np.concatenate(pair) for pair in zip((ready.o[some], ready.d[some]), edges, strict=True)
        )
        self.any = asks == ANY
        o, d = (a.astype(np.float64) for a in (self.o, self.d))
        end = SHADOW_END if self.any else np.inf
        self.answers = tuple(Oracle(ready.packed).ask_all(o, d, t_max=end))
        self.hit = np.array([answer.hit for answer in self.answers], bool)
        self.t = np.array([np.inf if answer.t is None else float(answer.t) for answer in self.answers])
        self.own, self.float32 = bounds(ready, self.answers, self.t, o, d)

    def score(self, t: np.ndarray, *, ours: bool) -> Score:
        """t: (n,) what somebody says about all rays, inf on a miss, NaN counts as a hit."""
        said = ~np.isposinf(t)
        wrong = said != self.hit
        both = np.flatnonzero(said & self.hit) if not self.any else np.zeros(0, int)
        off = np.array([_off(self.answers[i], float(t[i])) for i in both.tolist()])
        allowed = (self.own if ours else self.float32)[both]
        beyond = np.zeros(len(t), bool)
        beyond[both] = ~(off <= allowed)
        pictured = both < self.pictured
        with np.errstate(divide="ignore", invalid="ignore"):
            of_bound = np.where(off > 0.0, off / allowed, 0.0)[pictured]
        ulps = (off / np.spacing(np.abs(self.t[both]).astype(np.float32)).astype(np.float64))[pictured]
        here, there = slice(0, self.pictured), slice(self.pictured, None)
        return Score(
            rays=self.pictured,
            ulps=largest(ulps),
            bounds=largest(of_bound),
            masks=int(wrong[here].sum()),
            beyond=int(beyond[here].sum()),
            edge_rays=len(t) - self.pictured,
            edge_masks=int(wrong[there].sum()),
            edge_beyond=int(beyond[there].sum()),
        )


class Allowed(NamedTuple):
    own: np.ndarray  # (n,) of a float64 caster
    float32: np.ndarray  # (n,)


def bounds(
    ready: Prepared, answers: tuple[ExactAnswer, ...], t: np.ndarray, o: np.ndarray, d: np.ndarray
) -> Allowed:
    """How far t may be off at each ray, at the most generous of those that are exactly nearest; inf: no bound."""
    ray = np.repeat(np.arange(len(answers)), [len(answer.ties) for answer in answers])
    prim = np.array([tie.prim for answer in answers for tie in answer.ties], int)
    found = bounds_of(ready.model, prim, o[ray], d[ray], t[ray])
    out = Allowed(np.zeros(len(answers)), np.zeros(len(answers)))
    for widest, meeting in zip(out, (found.own, found.at), strict=True):
        np.maximum.at(widest, ray, np.where(np.isnan(meeting.t_error), np.inf, meeting.t_error))
    return out


def _off(answer: ExactAnswer, t: float) -> float:
    """|t - exact|, rounded once; NaN for a NaN."""
    return float("nan") if answer.t is None or np.isnan(t) else answer.t.off(t)


def largest(values: np.ndarray) -> float | None:
    """The largest that is a number; None where there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else None

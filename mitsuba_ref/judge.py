"""The class of every pixel: bounds, then exact arithmetic on who is right, then the bracket of what float32 may say."""

from dataclasses import dataclass
from functools import cached_property
from time import perf_counter

import numpy as np

from caster.rendering import Aovs
from caster.scene import Scene
from mitsuba_ref.adjudication import Adjudication, adjudicate, ties_taken, worth_asking
from mitsuba_ref.bounds import bounds_of
from mitsuba_ref.bracket import Bracket, Claims
from mitsuba_ref.cases import case_of
from mitsuba_ref.coherence import contradictions
from mitsuba_ref.compare import Comparison, check_allowances, compare
from mitsuba_ref.exact import Oracle
from mitsuba_ref.measuring import Measure
from mitsuba_ref.meeting import KU, KU_OURS
from mitsuba_ref.model import Model
from mitsuba_ref.own import Held, beyond_float64, held
from mitsuba_ref.pair import Pair
from mitsuba_ref.pixels import Pixels, flat
from mitsuba_ref.shading import Shading, hit_at, judge_diffuse, right_in_float64
from mitsuba_ref.verdict import (
    AGREE,
    CLASSES,
    EXPLAINED,
    OUR_WORD,
    OURS_WRONG,
    OUT_OF_DOMAIN,
    REFERENCE_WRONG,
    TIE,
    UNDECIDED,
)

CODE = {name: code for code, name in enumerate(CLASSES)}

SAMPLE = 4096  # agreeing pixels of a scene whose shadows are held to float64's bracket: a tenth of a second

# Where normals are not bounded any closer than this, float32 says nothing useful of the pixel: an angle of 3.6 degrees.
VAGUE = 2.0**-4


@dataclass(frozen=True)
class Judgement:
    """One row a pixel."""

    classes: np.ndarray  # (n,) index into CLASSES
    comparison: Comparison
    shading: Shading
    exact: Adjudication
    exact_ratio: (
        np.ndarray
    )  # (n,) share of the bound between our t and the exact one; inf where ours is wrong
    cases: dict[
        int, int | None
    ]  # pixel where the reference is wrong -> number in mitsuba_ref/cases.py, if listed
    exact_seconds: float  # what the adjudication took

    def ratio(self, name: str) -> np.ndarray:
        """(n,) error over bound of a check, `diffuse` and `exact` included."""
        apart = {"diffuse": self.shading.ratio, EXACT: self.exact_ratio}
        return apart[name] if name in apart else self.comparison.ratios[name]

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.comparison.ratios, "diffuse", EXACT)

    def excess(self, name: str) -> np.ndarray:
        """(n,) error over what the scene allows of the bound."""
        return self.ratio(name) / self.comparison.allowed.get(name, 1.0)

    def is_class(self, *names: str) -> np.ndarray:
        """(n,) bool: pixels of one of these classes."""
        return np.isin(self.classes, [CODE[name] for name in names])


EXACT = "exact"  # ours against exact arithmetic, beside the checks of mitsuba_ref.checks


class Judge:
    """One scene's pair of pictures, about to be judged."""

    def __init__(self, scene: Scene, model: Model, pair: Pair):
        self.scene, self.model, self.pair = scene, model, pair
        self.o, self.d = pair.rays.o.astype(np.float64), pair.rays.d.astype(np.float64)
        self.t_max = pair.rays.t_max.astype(np.float64)
        self.bounds = bounds_of(model, pair.prim, self.o, self.d, pair.t)
        with np.errstate(invalid="ignore"):
            self.point = self.o + pair.t[:, None] * self.d
        # No rounding excuses a picture that contradicts itself.
        self.contradictions = contradictions(scene, model.packed, pair)
        self.coherent = ~np.any(list(self.contradictions.values()), axis=0)

    @cached_property
    def ours(self) -> Bracket:
        return Bracket(self.model, KU_OURS, ours=True)

    @cached_property
    def theirs(self) -> Bracket:
        return Bracket(self.model, KU, ours=False)

    @cached_property
    def oracle(self) -> Oracle:
        return Oracle(self.model.packed)

    @cached_property
    def held(self) -> tuple[Held, ...]:
        """Our own quantities, and what float64 allows of them."""
        return tuple(held(self.pair, self.bounds, self.point))

    def judge(self) -> Judgement:
        """Geometry first, then the diffuse AOV. Raises SceneError for a [check] that nothing would heed."""
        check_allowances(self.scene.checks)
        pair, bounds = self.pair, self.bounds
        pixels = Pixels(pair.ours, pair.reference, bounds, pair.t, pair.length, self.point)
        comparison = compare(pixels, self.scene.checks)
        vague = pixels.both_hit & ~(np.maximum(bounds.at.n_error, bounds.at.sh_error) <= VAGUE)
        plain = comparison.agrees & self.coherent & ~vague
        start = perf_counter()
        exact = self._adjudicate(plain)
        seconds = perf_counter() - start
        classes = np.where(plain, CODE[AGREE], CODE[UNDECIDED])
        # What the derived bounds let pass, but the scene's own stricter ones do not, has no excuse.
        disputed = ~plain & self.coherent & (vague | ~comparison.derived)
        rows = np.flatnonzero(disputed)
        rows = rows[exact.are_right(rows)]
        if len(rows):
            classes[rows] = self._settle(rows, vague[rows], exact)
        classes[beyond_float64(self.held) & self.coherent] = CODE[OURS_WRONG]
        classes[exact.rows[~exact.answered]] = CODE[UNDECIDED]
        classes[exact.rows[exact.wrong]] = CODE[OURS_WRONG]
        shading = self._shade(classes, comparison.allowed["diffuse"])
        ratio = np.zeros(len(classes))
        ratio[exact.rows] = np.where(exact.answered, exact.share, 0.0)
        cases = self._cases(np.flatnonzero(classes == CODE[REFERENCE_WRONG]), plain, exact)
        judgement = Judgement(classes, comparison, shading, exact, ratio, cases, seconds)
        for name, where in self.contradictions.items():
            judgement.ratio(name)[where] = np.inf
        return judgement

    def _adjudicate(self, plain: np.ndarray) -> Adjudication:
        """Ours against exact arithmetic wherever it may matter, and at some pixels where it should not."""
        pair = self.pair
        rows = worth_asking(plain, pair.prim >= 0, self.bounds.at.certain, pair.ours.hit.shape)
        rays = (self.o, self.d, self.t_max)
        return adjudicate(self.oracle, rays, (pair.t, pair.prim), self.bounds, rows)

    def _settle(self, rows: np.ndarray, vague: np.ndarray, exact: Adjudication) -> np.ndarray:
        """The class of disputed pixels where ours is exactly right."""
        o, d = self.o[rows], self.d[rows]
        claims = self._claims(self.pair.reference, self.pair.witness.t, rows)
        theirs = self.theirs.judge(o, d, self.t_max[rows], claims)
        # No numbers within the bounds give a hit at the origin itself: a ray begins beyond it.
        allowed = theirs.allowed & ((claims.shape < 0) | (claims.t > 0.0))
        beyond = self.pair.ours.hit.ravel()[rows] & ~self.bounds.resolved[rows]
        classes = np.full(len(rows), CODE[REFERENCE_WRONG])
        classes[(theirs.open & ~allowed) | (allowed & (vague | beyond))] = CODE[OUT_OF_DOMAIN]
        classes[allowed & ~(vague | beyond)] = CODE[EXPLAINED]
        answers = [exact.of(row) for row in rows]
        classes[ties_taken(self.model, o, d, claims, answers, VAGUE)] = CODE[TIE]
        return classes

    def _claims(self, aovs: Aovs, t: np.ndarray, rows: np.ndarray) -> Claims:
        names = ("shape_id", "normal", "shading_normal", "position")
        return Claims(t[rows], *(flat(aovs, name)[rows] for name in names))

    def _shade(self, classes: np.ndarray, allowed: float) -> Shading:
        """Judge diffuse where geometry agrees by Mitsuba's lights, elsewhere by float64 alone; classes change."""
        hit = self.pair.ours.hit.ravel()
        agreeing = np.flatnonzero((classes == CODE[AGREE]) & hit)
        shading = judge_diffuse(self.scene, self.pair, self.bounds, agreeing, (self.ours, self.theirs))
        beyond = shading.ratio > allowed
        disputed = beyond & (shading.ratio > 1.0) & ~shading.unresolvable & ~shading.explained
        classes[beyond] = CODE[UNDECIDED]
        classes[beyond & (shading.ratio > 1.0) & shading.unresolvable] = CODE[OUT_OF_DOMAIN]
        classes[beyond & shading.explained] = CODE[EXPLAINED]
        testable = hit & np.isfinite(self.bounds.own.t_error)
        alone = np.flatnonzero((self._by_ourselves(classes) | disputed) & testable)
        if len(alone):
            values = flat(self.pair.ours, "diffuse")[alone]
            own = hit_at(self.pair, self.bounds.own, alone)
            right = right_in_float64(self.scene, own, self.pair.prim[alone], values, self.ours)
            classes[alone[right & disputed[alone]]] = CODE[REFERENCE_WRONG]
            classes[alone[~right]] = CODE[OURS_WRONG]
            shading.ratio[alone[~right]] = np.inf
        return shading

    def _by_ourselves(self, classes: np.ndarray) -> np.ndarray:
        """(n,) bool: pixels whose diffuse value is held to float64: all but those that agree, and some of them.

        Mitsuba's coarse shadows could be copied, and would agree with it.
        """
        agreeing = np.flatnonzero(classes == CODE[AGREE])
        chosen = np.isin(classes, [CODE[name] for name in OUR_WORD])
        chosen[np.random.default_rng(1).choice(agreeing, min(SAMPLE, len(agreeing)), replace=False)] = True
        return chosen

    def _cases(self, rows: np.ndarray, plain: np.ndarray, exact: Adjudication) -> dict[int, int | None]:
        """Which known case each pixel is where the reference is wrong. Wrong light on a right surface is none."""
        cases: dict[int, int | None] = {int(row): None for row in rows}
        rows = rows[~plain[rows]]
        if len(rows):
            answers = [answer for answer in map(exact.of, rows) if answer is not None]
            claims = self._claims(self.pair.reference, self.pair.witness.t, rows)
            lines = self.o[rows], self.d[rows], self.t_max[rows]
            prims = [self.named_by_reference(int(row)) for row in rows]
            measured = Measure(self.model, self.oracle).all_of(lines, claims, answers, prims)
            cases |= {int(row): case_of(each) for row, each in zip(rows, measured, strict=True)}
        return cases

    def named_by_reference(self, row: int) -> int:
        """The number in the scene of what Mitsuba says is hit, -1 on a miss.

        Of a shape with a stand-in, whose triangles Mitsuba counts by itself, the first primitive.
        """
        shape = int(flat(self.pair.reference, "shape_id")[row])
        if shape < 0:
            return -1
        first, last = (int(n) for n in self.model.packed.first[shape : shape + 2])
        prim = first + int(self.pair.witness.answer.prim[row])
        return prim if first <= prim < last else first

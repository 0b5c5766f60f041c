"""The class of every pixel: where the comparison is not enough, brackets decide whether rounding allows both sides."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from caster.rendering import Aovs
from caster.scene import Scene
from mitsuba_ref.bounds import bounds_of
from mitsuba_ref.bracket import Bracket, Claims
from mitsuba_ref.coherence import contradictions
from mitsuba_ref.compare import Comparison, check_allowances, compare
from mitsuba_ref.meeting import KU, KU_OURS
from mitsuba_ref.model import Model
from mitsuba_ref.pair import Pair
from mitsuba_ref.pixels import Pixels, flat
from mitsuba_ref.shading import Shading, hit_at, judge_diffuse, right_in_float64
from mitsuba_ref.verdict import AGREE, CLASSES, EXPLAINED, OUT_OF_DOMAIN, UNDECIDED

CODE = {name: code for code, name in enumerate(CLASSES)}
EXCUSED = [CODE[EXPLAINED], CODE[OUT_OF_DOMAIN]]

SAMPLE = 4096  # agreeing pixels of a scene whose shadows are held to float64's bracket: a tenth of a second

# Where normals are not bounded any closer than this, float32 says nothing useful of the pixel: an angle of 3.6 degrees.
VAGUE = 2.0**-4


@dataclass(frozen=True)
class Judgement:
    """One row a pixel."""

    classes: np.ndarray  # (n,) index into CLASSES
    comparison: Comparison
    shading: Shading
    ours_fails: np.ndarray  # (n,) bool: ours is beyond float64's bracket, so ours it is

    def ratio(self, name: str) -> np.ndarray:
        """(n,) error over bound of a check, `diffuse` included."""
        return self.shading.ratio if name == "diffuse" else self.comparison.ratios[name]

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.comparison.ratios, "diffuse")

    def excess(self, name: str) -> np.ndarray:
        """(n,) error over what the scene allows of the bound."""
        return self.ratio(name) / self.comparison.allowed.get(name, 1.0)


class Judge:
    """One scene's pair of pictures, about to be judged."""

    def __init__(self, scene: Scene, model: Model, pair: Pair):
        self.scene, self.model, self.pair = scene, model, pair
        self.o, self.d = pair.rays.o.astype(np.float64), pair.rays.d.astype(np.float64)
        self.bounds = bounds_of(model, pair.prim, self.o, self.d, pair.t)
        # No rounding excuses a picture that contradicts itself.
        self.contradictions = contradictions(scene, model.packed, pair)
        self.coherent = ~np.any(list(self.contradictions.values()), axis=0)

    @cached_property
    def ours(self) -> Bracket:
        return Bracket(self.model, KU_OURS, ours=True)

    @cached_property
    def theirs(self) -> Bracket:
        return Bracket(self.model, KU, ours=False)

    def judge(self) -> Judgement:
        """Geometry first, then the diffuse AOV. Raises SceneError for a [check] that nothing would heed."""
        check_allowances(self.scene.checks)
        pair, bounds = self.pair, self.bounds
        with np.errstate(invalid="ignore"):
            point = self.o + pair.t[:, None] * self.d
        pixels = Pixels(pair.ours, pair.reference, bounds, pair.t, pair.length, point)
        comparison = compare(pixels, self.scene.checks)
        vague = pixels.both_hit & ~(np.maximum(bounds.at.n_error, bounds.at.sh_error) <= VAGUE)
        classes = np.where(comparison.agrees & self.coherent & ~vague, CODE[AGREE], CODE[UNDECIDED])
        ours_fails = ~self.coherent
        # What the derived bounds let pass, but the scene's own stricter ones do not, has no excuse.
        disputed = np.flatnonzero(
            (classes == CODE[UNDECIDED]) & self.coherent & (vague | ~comparison.derived)
        )
        if len(disputed):
            classes[disputed], ours_fails[disputed] = self._settle(disputed, vague[disputed])
        judgement = Judgement(
            classes, comparison, self._shade(classes, comparison.allowed["diffuse"]), ours_fails
        )
        for name, where in self.contradictions.items():
            judgement.ratio(name)[where] = np.inf
        return judgement

    def _settle(self, rows: np.ndarray, vague: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(class, whether ours is wrong by float64) of disputed pixels."""
        o, d, t_max = self.o[rows], self.d[rows], self.pair.rays.t_max[rows].astype(np.float64)
        ours = self.ours.judge(o, d, t_max, self._claims(self.pair.ours, self.pair.t, rows))
        theirs = self.theirs.judge(o, d, t_max, self._claims(self.pair.reference, self.pair.witness.t, rows))
        fine = ours.allowed | ours.open
        beyond = self.pair.ours.hit.ravel()[rows] & ~self.bounds.resolved[rows]
        classes = np.full(len(rows), CODE[UNDECIDED])
        classes[fine & theirs.allowed] = CODE[EXPLAINED]
        unknowable = (theirs.open & ~theirs.allowed) | (theirs.allowed & (vague | beyond))
        classes[fine & unknowable] = CODE[OUT_OF_DOMAIN]
        return classes, ~fine

    def _claims(self, aovs: Aovs, t: np.ndarray, rows: np.ndarray) -> Claims:
        names = ("shape_id", "normal", "shading_normal", "position")
        return Claims(t[rows], *(flat(aovs, name)[rows] for name in names))

    def _shade(self, classes: np.ndarray, allowed: float) -> Shading:
        """Judge diffuse where geometry agrees by Mitsuba's lights, elsewhere by float64 alone; classes change."""
        hit = self.pair.ours.hit.ravel()
        agreeing = np.flatnonzero((classes == CODE[AGREE]) & hit)
        shading = judge_diffuse(self.scene, self.pair, self.bounds, agreeing, (self.ours, self.theirs))
        beyond = shading.ratio > allowed
        classes[beyond] = CODE[UNDECIDED]
        classes[beyond & (shading.ratio > 1.0) & shading.unresolvable] = CODE[OUT_OF_DOMAIN]
        classes[beyond & shading.explained] = CODE[EXPLAINED]
        alone = np.flatnonzero(self._by_ourselves(classes) & hit & np.isfinite(self.bounds.own.t_error))
        if len(alone):
            values = flat(self.pair.ours, "diffuse")[alone]
            own = hit_at(self.pair, self.bounds.own, alone)
            right = right_in_float64(self.scene, own, self.pair.prim[alone], values, self.ours)
            classes[alone[~right]] = CODE[UNDECIDED]
            shading.ratio[alone[~right]] = np.inf
        return shading

    def _by_ourselves(self, classes: np.ndarray) -> np.ndarray:
        """(n,) bool: pixels whose diffuse value is held to float64: all that are excused, and some that agree.

        Mitsuba's coarse shadows could be copied, and would agree with it.
        """
        agreeing = np.flatnonzero(classes == CODE[AGREE])
        chosen = np.isin(classes, EXCUSED)
        chosen[np.random.default_rng(1).choice(agreeing, min(SAMPLE, len(agreeing)), replace=False)] = True
        return chosen

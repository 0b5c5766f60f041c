"""The class of every pixel: where the comparison is not enough, brackets decide whether rounding allows both sides."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from caster.rendering import Aovs
from caster.scene import Scene
from mitsuba_ref.bounds import Bounds, bounds_of
from mitsuba_ref.bracket import Bracket, Claims
from mitsuba_ref.coherence import coherent
from mitsuba_ref.compare import Comparison, compare
from mitsuba_ref.meeting import KU, KU_OURS
from mitsuba_ref.model import Model
from mitsuba_ref.pair import Pair
from mitsuba_ref.pixels import Pixels, flat
from mitsuba_ref.shading import Shading, judge_diffuse
from mitsuba_ref.verdict import AGREE, CLASSES, EXPLAINED, OUT_OF_DOMAIN, UNDECIDED

CODE = {name: code for code, name in enumerate(CLASSES)}


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


@dataclass(frozen=True)
class Judge:
    """One scene's pair of pictures, about to be judged."""

    scene: Scene
    model: Model
    pair: Pair

    @cached_property
    def ours(self) -> Bracket:
        return Bracket(self.model, KU_OURS, ours=True)

    @cached_property
    def theirs(self) -> Bracket:
        return Bracket(self.model, KU, ours=False)

    @cached_property
    def coherent(self) -> np.ndarray:
        """(n,) bool: our picture holds no value that contradicts our own hit; no rounding excuses one."""
        return coherent(self.pair)

    def judge(self) -> Judgement:
        """Geometry first; the diffuse AOV where geometry agrees."""
        pair, rays = self.pair, self.pair.rays
        o, d = rays.o.astype(np.float64), rays.d.astype(np.float64)
        bounds = bounds_of(self.model, pair.prim, o, d, pair.t)
        pixels = Pixels(pair.ours, pair.reference, bounds, pair.t, pair.length, rays.start)
        comparison = compare(pixels, self.scene.checks)
        classes = np.where((comparison.worst <= 1.0) & self.coherent, CODE[AGREE], CODE[UNDECIDED])
        disputed = np.flatnonzero(classes == CODE[UNDECIDED])
        ours_fails = np.zeros(len(classes), bool)
        if len(disputed):
            classes[disputed], ours_fails[disputed] = self._settle(disputed, o[disputed], d[disputed])
        shading = self._shade(bounds, np.flatnonzero((classes == CODE[AGREE]) & pixels.both_hit), classes)
        return Judgement(classes, comparison, shading, ours_fails)

    def _settle(self, rows: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(class, whether ours is wrong by float64) of disputed pixels."""
        t_max = self.pair.rays.t_max[rows].astype(np.float64)
        ours = self.ours.judge(o, d, t_max, self._our_claims(rows))
        theirs = self.theirs.judge(o, d, t_max, self._their_claims(rows))
        fine = (ours.allowed | ours.unresolvable) & self.coherent[rows]
        classes = np.full(len(rows), CODE[UNDECIDED])
        classes[fine & theirs.unresolvable] = CODE[OUT_OF_DOMAIN]
        classes[fine & theirs.allowed] = CODE[EXPLAINED]
        return classes, ~fine

    def _our_claims(self, rows: np.ndarray) -> Claims:
        return self._claims(self.pair.ours, self.pair.t, rows)

    def _their_claims(self, rows: np.ndarray) -> Claims:
        return self._claims(self.pair.reference, self.pair.witness.t, rows)

    def _claims(self, aovs: Aovs, t: np.ndarray, rows: np.ndarray) -> Claims:
        names = ("shape_id", "normal", "shading_normal", "position")
        return Claims(t[rows], *(flat(aovs, name)[rows] for name in names))

    def _shade(self, bounds: Bounds, rows: np.ndarray, classes: np.ndarray) -> Shading:
        shading = judge_diffuse(self.scene, self.pair, bounds, rows, self.ours, self.theirs)
        beyond = shading.ratio > 1.0
        classes[beyond] = CODE[UNDECIDED]
        classes[beyond & shading.unresolvable] = CODE[OUT_OF_DOMAIN]
        classes[beyond & shading.explained] = CODE[EXPLAINED]
        return shading

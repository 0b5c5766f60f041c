"""The class of every pixel: bounds, then exact arithmetic on who is right, then the bracket of what float32 may say."""

from dataclasses import dataclass
from functools import cached_property
from time import perf_counter

import numpy as np

from caster.rendering.images import Aovs
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import PixelPairs, aov_rows, reference_bounds
from mitsuba_ref.error_model.bracket import Bracket, Claims
from mitsuba_ref.error_model.intersections import KU, KU_OURS
from mitsuba_ref.error_model.scene_model import SceneModel, model_of
from mitsuba_ref.judge.adjudication import Adjudication, adjudicate, claims_other_tie, needs_adjudication
from mitsuba_ref.judge.comparison import Comparison, check_allowances, compare
from mitsuba_ref.judge.defect_features import FeatureMeasurement
from mitsuba_ref.judge.diffuse import DiffuseComparison, diffuse_within_float64, judge_diffuse, shading_points
from mitsuba_ref.judge.known_defects import defect_of
from mitsuba_ref.judge.self_checks import SelfCheck, fails_self_check, inconsistent_aovs, self_checks
from mitsuba_ref.judge.verdict import (
    AGREE,
    CLASSES,
    EXPLAINED,
    JUDGED_WITHOUT_REFERENCE,
    OUT_OF_DOMAIN,
    REFERENCE_WRONG,
    TIE,
    UNDECIDED,
    WRONG,
)
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.rays import SharedRays, shared_rays
from mitsuba_ref.reference.rendering import trace_reference
from mitsuba_ref.reference.session import DEFAULT_TIMEOUT, SendRequest, send_request
from mitsuba_ref.subjects.ours import ImagePair, cast_ours, pair_images

CLASS_CODE = {name: code for code, name in enumerate(CLASSES)}

AGREEING_PIXELS_SHADED = (
    4096  # agreeing pixels of a scene whose shadows are held to float64's bracket: a tenth of a second
)

# Where normals are not bounded any closer than this, float32 says nothing useful of the pixel: an angle of 3.6 degrees.
LARGEST_USEFUL_NORMAL_ERROR = 2.0**-4


@dataclass(frozen=True)
class Judgement:
    """One row a pixel."""

    classes: np.ndarray  # (n,) index into CLASSES
    comparison: Comparison
    shading: DiffuseComparison
    exact: Adjudication
    exact_ratio: (
        np.ndarray
    )  # (n,) share of the bound between our t and the exact one; inf where ours is wrong
    cases: dict[
        int, int | None
    ]  # pixel where the reference is wrong -> number in mitsuba_ref/judge/known_defects.py, if listed
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
        return np.isin(self.classes, [CLASS_CODE[name] for name in names])


EXACT = "exact"  # ours against exact arithmetic, beside the checks of mitsuba_ref.judge.checks


class Judge:
    """One scene's pair of pictures, about to be judged."""

    def __init__(self, scene: Scene, model: SceneModel, pair: ImagePair):
        self.scene, self.model, self.pair = scene, model, pair
        self.o, self.d = pair.rays.o.astype(np.float64), pair.rays.d.astype(np.float64)
        self.t_max = pair.rays.t_max.astype(np.float64)
        self.bounds = reference_bounds(model, pair.prim, self.o, self.d, pair.t)
        with np.errstate(invalid="ignore"):
            self.point = self.o + pair.t[:, None] * self.d
        # No rounding excuses a picture that contradicts itself.
        self.contradictions = inconsistent_aovs(scene, model.packed, pair)
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
    def held(self) -> tuple[SelfCheck, ...]:
        """Our own quantities, and what float64 allows of them."""
        return tuple(self_checks(self.pair, self.bounds, self.point))

    def judge(self) -> Judgement:
        """Geometry first, then the diffuse AOV. Raises SceneError for a [check] that nothing would heed."""
        check_allowances(self.scene.checks)
        pair, bounds = self.pair, self.bounds
        pixels = PixelPairs(pair.ours, pair.reference, bounds, pair.t, pair.length, self.point)
        comparison = compare(pixels, self.scene.checks)
        vague = pixels.both_hit & ~(
            np.maximum(bounds.at.n_error, bounds.at.sh_error) <= LARGEST_USEFUL_NORMAL_ERROR
        )
        plain = comparison.agrees & self.coherent & ~vague
        start = perf_counter()
        exact = self._adjudicate(plain)
        seconds = perf_counter() - start
        classes = np.where(plain, CLASS_CODE[AGREE], CLASS_CODE[UNDECIDED])
        # What the derived bounds let pass, but the scene's own stricter ones do not, has no excuse.
        disputed = ~plain & self.coherent & (vague | ~comparison.derived)
        rows = np.flatnonzero(disputed)
        rows = rows[exact.are_right(rows)]
        if len(rows):
            classes[rows] = self._settle(rows, vague[rows], exact)
        classes[fails_self_check(self.held) & self.coherent] = CLASS_CODE[WRONG]
        classes[exact.rows[~exact.answered]] = CLASS_CODE[UNDECIDED]
        classes[exact.rows[exact.wrong]] = CLASS_CODE[WRONG]
        shading = self._shade(classes, comparison.allowed["diffuse"])
        ratio = np.zeros(len(classes))
        ratio[exact.rows] = np.where(exact.answered, exact.share, 0.0)
        cases = self._cases(np.flatnonzero(classes == CLASS_CODE[REFERENCE_WRONG]), plain, exact)
        judgement = Judgement(classes, comparison, shading, exact, ratio, cases, seconds)
        for name, where in self.contradictions.items():
            judgement.ratio(name)[where] = np.inf
        return judgement

    def _adjudicate(self, plain: np.ndarray) -> Adjudication:
        """Ours against exact arithmetic wherever it may matter, and at some pixels where it should not."""
        pair = self.pair
        rows = needs_adjudication(plain, pair.prim >= 0, self.bounds.at.certain, pair.ours.hit.shape)
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
        classes = np.full(len(rows), CLASS_CODE[REFERENCE_WRONG])
        classes[(theirs.open & ~allowed) | (allowed & (vague | beyond))] = CLASS_CODE[OUT_OF_DOMAIN]
        classes[allowed & ~(vague | beyond)] = CLASS_CODE[EXPLAINED]
        answers = [exact.of(row) for row in rows]
        classes[claims_other_tie(self.model, o, d, claims, answers, LARGEST_USEFUL_NORMAL_ERROR)] = (
            CLASS_CODE[TIE]
        )
        return classes

    def _claims(self, aovs: Aovs, t: np.ndarray, rows: np.ndarray) -> Claims:
        names = ("shape_id", "normal", "shading_normal", "position")
        return Claims(t[rows], *(aov_rows(aovs, name)[rows] for name in names))

    def _shade(self, classes: np.ndarray, allowed: float) -> DiffuseComparison:
        """Judge diffuse where geometry agrees by Mitsuba's lights, elsewhere by float64 alone; classes change."""
        hit = self.pair.ours.hit.ravel()
        agreeing = np.flatnonzero((classes == CLASS_CODE[AGREE]) & hit)
        shading = judge_diffuse(self.scene, self.pair, self.bounds, agreeing, (self.ours, self.theirs))
        beyond = shading.ratio > allowed
        disputed = beyond & (shading.ratio > 1.0) & ~shading.unresolvable & ~shading.explained
        classes[beyond] = CLASS_CODE[UNDECIDED]
        classes[beyond & (shading.ratio > 1.0) & shading.unresolvable] = CLASS_CODE[OUT_OF_DOMAIN]
        classes[beyond & shading.explained] = CLASS_CODE[EXPLAINED]
        testable = hit & np.isfinite(self.bounds.own.t_error)
        alone = np.flatnonzero((self._by_ourselves(classes) | disputed) & testable)
        if len(alone):
            values = aov_rows(self.pair.ours, "diffuse")[alone]
            own = shading_points(self.pair, self.bounds.own, alone)
            right = diffuse_within_float64(self.scene, own, self.pair.prim[alone], values, self.ours)
            classes[alone[right & disputed[alone]]] = CLASS_CODE[REFERENCE_WRONG]
            classes[alone[~right]] = CLASS_CODE[WRONG]
            shading.ratio[alone[~right]] = np.inf
        return shading

    def _by_ourselves(self, classes: np.ndarray) -> np.ndarray:
        """(n,) bool: pixels whose diffuse value is held to float64: all but those that agree, and some of them.

        Mitsuba's coarse shadows could be copied, and would agree with it.
        """
        agreeing = np.flatnonzero(classes == CLASS_CODE[AGREE])
        chosen = np.isin(classes, [CLASS_CODE[name] for name in JUDGED_WITHOUT_REFERENCE])
        chosen[
            np.random.default_rng(1).choice(
                agreeing, min(AGREEING_PIXELS_SHADED, len(agreeing)), replace=False
            )
        ] = True
        return chosen

    def _cases(self, rows: np.ndarray, plain: np.ndarray, exact: Adjudication) -> dict[int, int | None]:
        """Which known case each pixel is where the reference is wrong. Wrong light on a right surface is none."""
        cases: dict[int, int | None] = {int(row): None for row in rows}
        rows = rows[~plain[rows]]
        if len(rows):
            answers = [answer for answer in map(exact.of, rows) if answer is not None]
            claims = self._claims(self.pair.reference, self.pair.witness.t, rows)
            lines = self.o[rows], self.d[rows], self.t_max[rows]
            prims = [self.reference_prim(int(row)) for row in rows]
            measured = FeatureMeasurement(self.model, self.oracle).all_of(lines, claims, answers, prims)
            cases |= {int(row): defect_of(each) for row, each in zip(rows, measured, strict=True)}
        return cases

    def reference_prim(self, row: int) -> int:
        """The number in the scene of what Mitsuba says is hit, -1 on a miss.

        Of a shape with a stand-in, whose triangles Mitsuba counts by itself, the first primitive.
        """
        shape = int(aov_rows(self.pair.reference, "shape_id")[row])
        if shape < 0:
            return -1
        first, last = (int(n) for n in self.model.packed.first[shape : shape + 2])
        prim = first + int(self.pair.witness.answer.prim[row])
        return prim if first <= prim < last else first


# A scene brought before the judge: both sides' answers along the same rays.


def judge_of(
    scene: Scene,
    *,
    whole: SharedRays | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    send: SendRequest = send_request,
) -> Judge | Crash:
    """The judge of the film's window, or how Mitsuba ended without an answer.

    whole: the rays that stand-ins are cut to, if they are others than the window's own. ask: the way to Mitsuba.
    Raises SceneError for a scene that cannot be judged.
    """
    rays = shared_rays(scene)
    view = cast_ours(scene, rays)
    model = model_of(scene, view.packed, rays if whole is None else whole)
    witness = trace_reference(scene, model, rays, timeout=timeout, send=send)
    if isinstance(witness, Crash):
        return witness
    return Judge(scene, model, pair_images(scene, rays, view, witness))

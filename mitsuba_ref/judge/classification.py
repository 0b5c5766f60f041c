"""Classifies every pixel: by comparison within bounds, by exact arithmetic, and by the answers that rounding allows.

One judge for every subject (docs/method.md, "Classes"). A pixel where everything agrees within its bound is `agree`.
At other pixels, at edges, and at a sample of the agreeing ones, exact arithmetic decides first whether the subject is
right, and then whether float32 rounding allows Mitsuba's answer. A subject whose own visibility is rounded is excused
where its rounding allows its answer; our caster claims exact visibility, and is never excused.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from caster.description.errors import SceneError
from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.error_model.bounds import aov_rows, row_distance
from mitsuba_ref.error_model.bracket import CLAIMED_MISS, Bracket, Claims
from mitsuba_ref.error_model.intersections import Array, row_groups, without_float_warnings
from mitsuba_ref.error_model.scene_model import REFERENCE_SIDE, UncertainRaysModel
from mitsuba_ref.error_model.tolerances import LARGEST_USEFUL_NORMAL_ERROR, NEARLY_ALL
from mitsuba_ref.judge.adjudication import Adjudication, claims_of, exact_ratios, oracle_answers, sample_rows
from mitsuba_ref.judge.checks.mesh_files import files_of, for_mitsuba
from mitsuba_ref.judge.comparison import BOUNDED_AOVS, Pixels, check_ratios, pair_images
from mitsuba_ref.judge.defect_lookup import defect_features, defect_of
from mitsuba_ref.judge.diffuse import diffuse_within_float64, hits_of, judge_diffuse
from mitsuba_ref.judge.verdict import CLASSES, JUDGED_WITHOUT_REFERENCE
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, SendRequest, send_request
from mitsuba_ref.reference.rendering import trace_reference
from mitsuba_ref.subjects.requests import SubjectResponse

CLASS_CODE = {name: code for code, name in enumerate(CLASSES)}
CODE = SimpleNamespace(**CLASS_CODE)  # CODE.wrong is the code of the class `wrong`
EXACT = "exact"  # the subject against exact arithmetic, beside the checks of judge/comparison.py

# Agreeing pixels away from edges that are compared with exact arithmetic as well: they cost 0.1 s per scene.
AGREEING_PIXELS_ADJUDICATED = 1024

# Agreeing pixels of a scene whose diffuse values are compared with float64's bracket as well: they cost 0.1 s.
AGREEING_PIXELS_SHADED = 4096

# Size of the sample that is adjudicated first among pixels that disagree in the same way. If nearly all of it is wrong,
# the other pixels are not adjudicated: they stay undecided, which fails as well, so that no pixel passes by this rule.
WRONG_PIXELS_ADJUDICATED = 512
MAX_KINDS_OF_SHAPES = 64  # pixels of each shape are sampled separately in scenes of at most so many shapes


@dataclass(frozen=True)
class Judgement:
    """One row a pixel."""

    classes: Array  # (n,) index into CLASSES
    ratios: Mapping[str, Array]  # (n,) error over bound of each check, `exact` included
    allowed: Mapping[str, float]  # the scene's own shares of bounds; 1 for other checks
    exact: Adjudication
    cases: dict[int, int | None]  # pixel where the reference is wrong -> number of the known defect, if listed
    not_adjudicated: Array  # rows

    def excess(self, name: str) -> Array:
        """(n,) error over what the scene allows of the bound."""
        return self.ratios[name] / self.allowed.get(name, 1.0)

    def is_class(self, *names: str) -> Array:
        """(n,) bool: pixels of one of these classes."""
        return np.isin(self.classes, [CLASS_CODE[name] for name in names])


class Judge(Pixels):
    """Gives each pixel its class."""

    @cached_property
    def bracket(self) -> Bracket:
        """The answers that rounding allows the subject."""
        view = replace(self.view, refined=True) if isinstance(self.view, UncertainRaysModel) else self.view
        return Bracket(view, self.answer.side)

    @cached_property
    def reference_bracket(self) -> Bracket:
        """The answers that rounding allows Mitsuba."""
        return Bracket(self.model, REFERENCE_SIDE)

    @cached_property
    def oracle(self) -> Oracle:
        return Oracle(self.model.packed)

    def judge(self) -> Judgement:
        """Judge the geometry, then the diffuse AOV. Raises SceneError for a [check] that has no effect."""
        checks = self.scene.checks if self.names_prims else {}
        for name in checks:
            if name not in BOUNDED_AOVS:
                raise SceneError(f"check.{name}: {name} has no bound to scale; only {', '.join(BOUNDED_AOVS)} have one")
        allowed = {name: check.ratio for name, check in checks.items()}
        ratios = check_ratios(self)

        # Step 1: plain agreement. Images that contradict themselves, and invalid answers, agree with nothing.
        loose, fits, broken = self._has_loose_normals(), self._reference_fits(), self.answer.is_broken
        agrees = np.all([ratio <= allowed.get(name, 1.0) for name, ratio in ratios.items()], axis=0)
        agreeing = agrees & self.consistent & ~broken & fits & ~loose

        # Step 2: exact arithmetic, where it may matter and at some pixels where it should not.
        exact = self._adjudicate(agreeing)

        # Step 3: classes of disputed pixels, first where the subject is exactly right, then where it is not.
        classes = np.where(agreeing, CODE.agree, CODE.undecided)
        # A pixel that fails only the scene's own stricter bounds is not disputed: nothing excuses it.
        beyond = np.any([~(ratio <= 1.0) for ratio in ratios.values()], axis=0)
        disputed = ~agreeing & self.consistent & (loose | beyond | ~fits)
        self._classify_reference(classes, disputed, loose, exact)
        other_tie = exact.right & disputed[exact.rows] & (~exact.of_first | self.hits_at_t_min[exact.rows])
        classes[exact.rows[other_tie]] = CODE.tie
        for check in self.self_checks.values():
            classes[check.fails & self.consistent] = CODE.wrong
        classes[exact.rows[~exact.answered]] = CODE.undecided
        rows, (excused, lost) = exact.rows[exact.wrong], self._within_rounding(exact)
        classes[rows] = CODE.wrong  # unless its own rounding allows the answer
        classes[rows[lost]] = CODE.out_of_domain
        classes[rows[excused]] = CODE.explained
        classes[broken | ((self.t_max < 0.0) & self.hit)] = CODE.wrong

        # Step 4: light, where the subject gives it.
        if "diffuse" in self.subject:
            ratios["diffuse"] = self._classify_diffuse(classes, allowed.get("diffuse", 1.0))
        ratios[EXACT] = np.zeros(len(classes))
        ratios[EXACT][exact.rows] = np.where(exact.answered, exact.ratio, 0.0)
        for name, where in self.inconsistent.items():
            ratios[name][where] = np.inf
        for ratio in ratios.values():
            ratio[broken] = np.inf
        cases = self._known_cases(np.flatnonzero(classes == CODE.reference_wrong), agreeing, exact)
        left_out = ~agreeing & (classes == CODE.undecided) & (self.t_max >= 0.0)
        left_out[exact.rows] = False
        rows = np.flatnonzero(left_out & self.consistent)
        return Judgement(classes, ratios, allowed, exact, cases, rows)

    def _has_loose_normals(self) -> Array:
        """(n,) bool: where normals are bounded so loosely that their agreement means nothing."""
        at, own = self.at, self.own
        error = np.maximum(at.n_error, at.sh_error) if self.names_prims else own.n_error
        loose = self.both_hit & ~(error <= LARGEST_USEFUL_NORMAL_ERROR)
        return loose & (not self.answer.hits_only)

    @without_float_warnings
    def _reference_fits(self) -> Array:
        """(n,) bool: Mitsuba's answer lies on the primitive it names, so that a subject may be held to that one."""
        if self.names_prims:
            return np.ones(len(self.t_max), bool)
        at, result = self.at, self.result
        t = self.reference_t
        fits = at.possible & (np.abs(t - at.t) <= at.t_error) & (t > 0.0)
        fits &= row_distance(aov_rows(self.reference, "normal"), at.n) <= at.n_error
        return fits | ~result.hit

    @without_float_warnings
    def _adjudicate(self, agreeing: Array) -> Adjudication:
        """Compare the subject with exact arithmetic where it disagrees, near edges, and at some other pixels."""
        own, certain = self.own, self.at.certain
        if not self.answer.exact_visibility:
            certain = certain & own.certain
        hits = np.pad(self.hit.reshape(self.shape), 1)
        near_hit = sliding_window_view(hits, (3, 3)).any(axis=(2, 3)).ravel()
        if self.rays.is_list:
            # Rounding may move a hit beyond t_min or t_max, and a miss has no neighbours.
            certain = certain & (own.t - own.t_error > self.t_min) & (own.t + own.t_error <= self.t_max)
            rows = np.flatnonzero(~self.hit & (self.t_max >= 0.0))
            near_hit[rows] |= self.bracket.blocked(self.lines.take(rows))[0]
        chosen = ~agreeing | np.where(self.hit, ~certain, near_hit)
        chosen[sample_rows(np.flatnonzero(~chosen), AGREEING_PIXELS_ADJUDICATED)] = True
        rows = np.flatnonzero(chosen & (self.t_max >= 0.0))
        return self.adjudicated(np.setdiff1d(rows, self._surely_wrong(rows[~agreeing[rows]])))

    def _surely_wrong(self, rows: Array) -> Array:
        """Those of some disputed rows that need no adjudication, since nearly all of a sample of their kind are wrong.

        These pixels stay undecided, which fails as well.
        """
        found, kind = rows[:0], self.kinds_of_pixels(rows)
        for group in np.flatnonzero(np.bincount(kind) > WRONG_PIXELS_ADJUDICATED):
            members = rows[kind == group]
            sample = sample_rows(members, WRONG_PIXELS_ADJUDICATED)
            exact = self.adjudicated(sample)
            excused = np.any(self._within_rounding(exact), axis=0)
            if (~excused).sum() >= NEARLY_ALL * len(sample):
                found = np.union1d(found, np.setdiff1d(members, sample))
        return found

    def kinds_of_pixels(self, rows: Array) -> Array:
        """(m,) groups of rows: by the shape that Mitsuba hits, and by whether each side hits."""
        shape = self.result.shape_id[rows] * (len(self.model.packed.parts) <= MAX_KINDS_OF_SHAPES)
        return row_groups(np.column_stack([shape, self.result.hit[rows], self.hit[rows]]))

    def adjudicated(self, rows: Array) -> Adjudication:
        """Compare these rows of the image, ascending, with exact arithmetic."""
        given, t_min, starts = self.answer.rows(rows), self.t_min[rows], self.hits_at_t_min[rows]
        limits = np.where(starts, np.nextafter(t_min, -np.inf), t_min)
        answers = oracle_answers(self.oracle, self.lines.take(rows)._replace(t_min=limits))
        starts &= [each is not None and each.distance == limit for each, limit in zip(answers, t_min, strict=True)]
        given = replace(given, t=np.where(starts, t_min, given.t))
        found = exact_ratios(answers, given, lambda of, *at: self.near(rows[of], *at), self.model.packed)
        return Adjudication(rows, answers, *found)

    @cached_property
    def hits_at_t_min(self) -> Array:
        """(n,) bool: a candidate's hits at t_min, such as t = 0, up to rounding of o; it may count them to the ray."""
        off = np.abs(self.answer.t - self.t_min) * np.abs(self.d).max(axis=1)
        found: Array = off <= self.answer.ku * np.abs(self.o).max(axis=1)
        return found & (not (self.answer.exact_visibility or self.answer.hits_only))

    def _classify_reference(self, classes: Array, disputed: Array, loose: Array, exact: Adjudication) -> None:
        """Classify disputed pixels where the subject is exactly right, by Mitsuba's answer."""
        rows = np.flatnonzero(disputed)
        rows = rows[np.isin(rows, exact.rows[exact.right])]
        if not len(rows):
            return
        lines, claims = self.reference_lines.take(rows), self._reference_claims(rows)
        found = self.reference_bracket.judge(lines, claims)
        # No numbers within the bounds give a hit at the origin itself: a ray begins beyond it.
        allowed = found.allowed & ((claims.shape < 0) | (claims.t > 0.0))
        at = self.at if self.names_prims else self.own
        useless = loose[rows] | (self.hit & (self.prim >= 0) & ~np.isfinite(at.t_error))[rows]
        classes[rows] = CODE.reference_wrong
        classes[rows[(found.open & ~allowed) | (allowed & useless)]] = CODE.out_of_domain
        classes[rows[allowed & ~useless]] = CODE.explained
        exponent = self.rays.rows(rows).reference_exponent
        same = (lines.o == self.o[rows]).all(axis=1)
        same &= (np.ldexp(lines.d, exponent[:, None]) == self.d[rows]).all(axis=1)
        for i in np.flatnonzero(allowed & ~useless & same):
            answer = exact.of(rows[i])
            if answer is not None and claims.shape[i] in self.model.packed.shape_of(answer.prims[1:]):
                classes[rows[i]] = CODE.tie

    def _within_rounding(self, exact: Adjudication) -> tuple[Array, Array]:
        """(m,) bool each, at the adjudicated rows where the subject is not exactly right.

        Its rounding allows the answer; its precision or camera cannot resolve it.
        """
        rows = exact.rows[exact.wrong]
        lost = np.zeros(len(rows), bool)
        if self.answer.exact_visibility or not len(rows):
            return lost, lost
        claims = claims_of(self.answer.rows(rows), self.model.packed)
        found = self.bracket.judge(self.lines.take(rows), claims)
        allowed = found.allowed & ((claims.shape == CLAIMED_MISS) | ~(claims.t <= 0.0) | self.hits_at_t_min[rows])
        if isinstance(self.view, UncertainRaysModel):
            prim, t = exact.first_hits(rows)
            lost = self.view.is_unresolved(prim, self.d[rows], t)
        return allowed, found.open | lost

    def _reference_claims(self, rows: Array) -> Claims:
        names = ("shape_id", "normal", "shading_normal", "position")
        shape, *vectors = (aov_rows(self.reference, name)[rows] for name in names)
        claims = Claims(self.reference_t[rows], shape, *vectors)
        return claims if self.uv is None else claims._replace(uv=self.result.answer.uv[rows])

    def _classify_diffuse(self, classes: Array, allowed: float) -> Array:
        """(n,) error over bound by Mitsuba's lights where geometry agrees, elsewhere by float64; changes classes."""
        agreeing = np.flatnonzero((classes == CODE.agree) & self.hit)
        ratio, explained, unresolvable = judge_diffuse(self, agreeing, (self.bracket, self.reference_bracket))
        beyond = ratio > allowed
        disputed = beyond & (ratio > 1.0) & ~unresolvable & ~explained
        classes[beyond] = CODE.undecided
        classes[beyond & (ratio > 1.0) & unresolvable] = CODE.out_of_domain
        classes[beyond & explained] = CODE.explained
        testable = self.hit & np.isfinite(self.own.t_error)
        # Compared with float64: all that pass without the reference, and some that agree, which would show a subject
        # that copies Mitsuba's coarse shadows.
        held = disputed | np.isin(classes, [CLASS_CODE[name] for name in JUDGED_WITHOUT_REFERENCE])
        held[sample_rows(np.flatnonzero(classes == CODE.agree), AGREEING_PIXELS_SHADED)] = True
        alone = np.flatnonzero(held & testable)
        if len(alone):
            values = aov_rows(self.subject, "diffuse")[alone]
            own = hits_of(self, self.own, alone)
            right = diffuse_within_float64(self.scene, own, self.prim[alone], values, self.bracket)
            classes[alone[right & disputed[alone]]] = CODE.reference_wrong
            classes[alone[~right]] = CODE.wrong
            ratio[alone[~right]] = np.inf
        return ratio

    def _known_cases(self, rows: Array, agreeing: Array, exact: Adjudication) -> dict[int, int | None]:
        """The known defect at each row, where the reference is wrong. Wrong light on a right surface is none."""
        cases: dict[int, int | None] = {int(row): None for row in rows}
        rows = rows[~agreeing[rows]]
        if len(rows):
            lines = self.reference_lines.take(rows)
            answers = [answer for answer in map(exact.of, rows) if answer is not None]
            if self.rays.is_list:  # along other numbers than the subject's
                answers = self.oracle.first_hits(*lines)
            prims = self.reference_prim[rows].astype(np.int64)
            claims, robust = self._reference_claims(rows), self.result.robust
            features = defect_features(self.model, self.oracle, lines, claims, answers, prims, robust)
            cases |= {int(row): defect_of(each) for row, each in zip(rows, features, strict=True)}
        return cases


def judge_of(
    response: SubjectResponse,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    send: SendRequest = send_request,
    with_files: bool = True,
) -> Judge | Crash:
    """The judge of a subject's response, or how Mitsuba ended without an answer.

    send: the way to Mitsuba. with_files: it also reads the mesh files. Raises SceneError.
    """
    scene, model, rays, answer = response.scene, response.model, response.rays, response.answer
    with ScratchFolder() as folder:
        files = files_of(scene) if with_files else ()
        meshes = [for_mitsuba(file, Path(folder), i) for i, file in enumerate(files)]
        result = trace_reference(
            scene,
            model,
            rays.for_reference(),
            lights=answer.images is not None,
            mesh_files=meshes,
            timeout=timeout,
            send=send,
        )
    if isinstance(result, Crash):
        return result
    result = replace(result, t=rays.t_of_reference(result.t))
    return Judge(scene, model, pair_images(scene, rays, answer, result), response.view)

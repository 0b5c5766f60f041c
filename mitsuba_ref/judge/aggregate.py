"""The verdict of a scene from its judgement: counts by class, largest ratios, listed failures, and bias."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import SceneError
from caster.geometry.packing import Packed, packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import Bounds, aov_rows, row_distance
from mitsuba_ref.error_model.intersections import dot, row_groups, stacked_columns
from mitsuba_ref.error_model.tolerances import KU, KU_OURS, LARGEST_Z, U32, K
from mitsuba_ref.judge.classification import CLASS_CODE, EXACT, Judge, Judgement
from mitsuba_ref.judge.comparison import ImagePair
from mitsuba_ref.judge.diagnosis import NOT_ADJUDICATED, Diagnosis, failing_rows
from mitsuba_ref.judge.explanations import full_reason, pixel_answers, reason
from mitsuba_ref.judge.verdict import (
    AGREE,
    BIAS_OF_POSITION,
    BIAS_OF_T,
    CLASSES,
    FAILING,
    MAX_LISTED_FAILURES,
    UNLISTED,
    WRONG,
    ErrorStatistics,
    Extremes,
    Failure,
    Finding,
    KindBias,
    SceneCheck,
    SceneStatistics,
    SceneVerdict,
)
from mitsuba_ref.reference.shared_input import pixel_of
from mitsuba_ref.shapes import kind_of
from mitsuba_ref.shapes.shape_reference import PositionTerms
from mitsuba_ref.subjects.subject import FLOAT32, Answer

# What the judge compares of our caster, and a candidate does not give; ids of shapes and primitives only some do.
NEVER_GIVEN = ("position", "shading_normal", "uv", "shape_id", "diffuse")


def quantities_not_given(answer: Answer) -> tuple[str, ...]:
    """What the judge compares, and this answer lacks."""
    if answer.images is not None:
        return ()
    if answer.hits_only:
        return ("depth", "normal", *NEVER_GIVEN)
    never = tuple(name for name in NEVER_GIVEN if name != "shape_id" or answer.shape_id is None)
    return never if answer.n is not None else ("normal", *never)


def class_counts(judgement: Judgement, hit: np.ndarray) -> dict[str, int]:
    """Hit pixels of each class; one that fails counts, whether anything is hit there or not."""
    counted = hit | judgement.is_class(*FAILING)
    numbers = np.bincount(judgement.classes[counted], minlength=len(CLASSES))
    return dict(zip(CLASSES, map(int, numbers), strict=True))


def largest_ratios(judgement: Judgement) -> dict[str, float]:
    """The largest ratio of each check among the pixels that agree."""
    agreeing = judgement.classes == CLASS_CODE[AGREE]
    return {name: float(judgement.ratio(name)[agreeing].max(initial=0.0)) for name in judgement.names}


def defect_counts(judgement: Judgement) -> dict[str, int]:
    """Number of pixels where the reference is wrong, by known case."""
    numbers = sorted(judgement.cases.values(), key=lambda case: (case is None, case))
    return dict(Counter(UNLISTED if case is None else str(case) for case in numbers))


def scene_statistics(scene: Scene) -> SceneStatistics:
    """Camera, shapes and number of primitives; the latter of a scene that can be packed."""
    count = 0
    with suppress(SceneError):
        count = int(packed(scene).first[-1])
    shapes = dict(Counter(str(shape.type) for shape in scene.shapes))
    return SceneStatistics(str(scene.camera.type), shapes, count)


def findings(judge: Judge, diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Each cause once, with its pixels, most first; second causes of the same pixels, and what has none, at the end."""
    ordered = sorted(diagnosis.causes, key=lambda each: (each.what == NOT_ADJUDICATED, each.second, -len(each.rows)))
    return tuple(
        Finding(
            len(cause.rows), cause.what, *pixel_of(judge.scene, int(cause.rows[0])), cause.of, cause.remedy, cause.where
        )
        for cause in ordered
    )


def listed_failures(judge: Judge, judgement: Judgement, diagnosis: Diagnosis) -> tuple[Failure, ...]:
    """Some of the pixels that fail: one of each diagnosis, then the worst of the others.

    Of a diagnosis the worst pixel, or where a subject names no primitives, so that most have no factor, the first.
    """
    by_row, rows = diagnosis.by_row(), worst_first(judgement, failing_rows(judgement))
    order = rows if judge.names_prims else sorted(rows)
    cause_of = {int(row): what for what, rows in diagnosis.rows_of.items() for row in rows}
    leading = {cause_of[row]: row for row in reversed(order)}
    most_first = sorted(
        leading.values(), key=lambda row: (cause_of[row] == NOT_ADJUDICATED, -len(diagnosis.rows_of[cause_of[row]]))
    )
    chosen = list(dict.fromkeys([*most_first, *rows]))[:MAX_LISTED_FAILURES]
    return tuple(failure_at(judge, judgement, by_row, row) for row in chosen)


def worst_first(judgement: Judgement, rows: np.ndarray) -> list[int]:
    """These rows of the image by the largest excess of any check."""
    excess = np.array([judgement.excess(name)[rows] for name in judgement.names])
    return [int(row) for row in rows[np.argsort(-excess.max(axis=0), kind="stable")]]


def failing_by_check(judgement: Judgement) -> dict[str, np.ndarray]:
    """Rows that fail, worst first, under every check that they fail; under `exact` where they fail none."""
    rows = failing_rows(judgement)
    excess = {name: judgement.excess(name)[rows] for name in judgement.names}
    beyond = {name: ~(ratio <= 1.0) for name, ratio in excess.items()}
    beyond[EXACT] = beyond[EXACT] | ~np.any(list(beyond.values()), axis=0)
    order = {name: np.argsort(-ratio, kind="stable") for name, ratio in excess.items()}
    found = {name: rows[order[name]][beyond[name][order[name]]] for name in judgement.names}
    return {name: failing for name, failing in found.items() if len(failing)}


def failure_at(judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int, check: str = "") -> Failure:
    """One pixel that fails. check: the one to report; "": the one that finds most."""
    check = check or decisive_check(judgement, row)
    text = pixel_answers(judge, judgement, row, check)
    explain = full_reason if judge.names_prims else reason
    why = explain(judge, judgement, diagnosed, row)
    verdict, ratio = CLASSES[int(judgement.classes[row])], float(judgement.ratio(check)[row])
    x, y = pixel_of(judge.scene, row)
    return Failure(x, y, verdict, check, ratio, text.subject, text.reference, text.exact, why)


def decisive_check(judgement: Judgement, row: int) -> str:
    """The check that finds most; `exact`, the least specific one, only where it is the only one."""
    excess = {name: float(judgement.excess(name)[row]) for name in judgement.names}
    beyond = {name: ratio for name, ratio in excess.items() if name != EXACT and not ratio <= 1.0}
    return max(beyond or excess, key=lambda name: excess[name])


def failure_hints(answer: Answer, judgement: Judgement) -> tuple[str, ...]:
    """What may help where pixels fail: bounds are as wide as the round-off that they are made of."""
    if not judgement.is_class(*FAILING).any():
        return ()
    ratios = judgement.exact.ratio[judgement.is_class(WRONG)[judgement.exact.rows]]
    if answer.hints or answer.precision == FLOAT32 or not len(ratios) or ratios.max() > KU / KU_OURS:
        return answer.hints
    return (
        "every pixel that is beyond the bounds of float64 is within those of float32; if that will do: "
        "--candidate-precision float32",
    )


# ---- bias: whether the errors of the reference have a mean, by kind of primitive (docs/method.md) ----

# How much of their bounds the errors of the reference use, and whether they are biased.
#
# A defect of ours far below what float32 resolves moves no pixel beyond its bound, but it moves all of them
# the same way.
# Rounding does so, too, within a primitive: its numbers are rounded once, for all rays. So only the means of
# *groups* of pixels count, of which nothing that is rounded belongs to two. See docs/method.md, "Bias".


class GroupSums(NamedTuple):
    """Errors in groups of pixels of which nothing that is rounded belongs to two."""

    keys: np.ndarray  # (g, c), distinct
    errors: np.ndarray  # (g,) sums of signed shares of bounds
    counts: np.ndarray  # (g,) pixels


class KindErrors(NamedTuple):
    """Errors at the primitives of one kind."""

    quantity: str  # BIAS_OF_T or BIAS_OF_POSITION
    groups: tuple[GroupSums, ...]  # one for each way to group
    t_sums: np.ndarray  # (2,) of errors of t in roundings, and of their weights


class PixelErrors(NamedTuple):
    """Errors of one window of a film, of which those of several windows can be made one statistic."""

    k_t: np.ndarray  # (m,) K times the error over its bound
    k_normal: np.ndarray  # (m,)
    kinds: Mapping[str, KindErrors]


def pixel_errors(packed: Packed, pair: ImagePair, bounds: Bounds) -> PixelErrors:
    """From both sides' answers and the reference's bounds alone: no float64's bounds, no exact answer."""
    with np.errstate(invalid="ignore", divide="ignore"):
        error = pair.result.t - pair.t
        share = np.where(error == 0.0, 0.0, error / bounds.at.t_error)
        turned = row_distance(aov_rows(pair.subject, "normal"), aov_rows(pair.reference, "normal")) / bounds.at.n_error
        same = aov_rows(pair.subject, "shape_id") == aov_rows(pair.reference, "shape_id")
        near = (np.abs(share) <= 1.0) & np.isfinite(bounds.at.t_error)
    hit = (pair.prim >= 0) & pair.result.hit & near
    rows = np.flatnonzero(hit & same & (turned <= 1.0))
    tied = np.flatnonzero(hit & ~same)
    kinds = _errors_of_kinds(packed, pair, bounds, share, rows, tied)
    return PixelErrors(K * np.abs(share[rows]), K * turned[rows], kinds)


def error_statistics(windows: Sequence[PixelErrors]) -> ErrorStatistics:
    """Of all windows of one scene's film."""
    t = np.concatenate([window.k_t for window in windows])
    normal = np.concatenate([window.k_normal for window in windows])
    biases = []
    for kind in dict.fromkeys(kind for window in windows for kind in window.kinds):
        found = [window.kinds[kind] for window in windows if kind in window.kinds]
        ways = zip(*(errors.groups for errors in found), strict=True)
        weakest = weakest_bias([z_of_groups(merged_groups(way)) for way in ways])
        total, weight = np.sum([errors.t_sums for errors in found], axis=0)
        t_bias = float(total / weight) if weight > 0.0 else 0.0
        biases.append(KindBias(kind, *weakest, found[0].quantity, t_bias))
    return ErrorStatistics(len(t), extremes(t), extremes(normal), looseness(t), tuple(biases))


def extremes(k: np.ndarray) -> Extremes:
    """The largest, and what 99 % are below; 0 of none."""
    return Extremes(float(k.max()), float(np.quantile(k, 0.99))) if len(k) else Extremes()


def looseness(k: np.ndarray) -> float:
    """Bound over error in the middle."""
    middle = float(np.median(k)) if len(k) else 0.0
    return K / middle if middle > 0.0 else float("inf")


def untied(prim: np.ndarray, kind: np.ndarray, tied: np.ndarray, tied_kind: np.ndarray) -> np.ndarray:
    """(m,) bool: pixels that are evidence of a bias. prim, kind: (m,) of each; tied, tied_kind: (j,) of tied pixels.

    Where another shape has the same t, the reference names either of the two by the sign of a rounding, so that the
    pixels that are left are biased, however right ours is. j pixels that drop out by sign move a sum of m roundings by
    j of them at most, chance by sqrt(m): beyond j^2 = m no primitive of that kind that has tied pixels is evidence.
    """
    many = [each for each in np.unique(tied_kind) if np.sum(tied_kind == each) ** 2 > np.sum(kind == each)]
    found: np.ndarray = ~(np.isin(kind, many) & np.isin(prim, tied))
    return found


def _errors_of_kinds(
    packed: Packed, pair: ImagePair, bounds: Bounds, share: np.ndarray, rows: np.ndarray, tied: np.ndarray
) -> dict[str, KindErrors]:
    """For each kind that is hit at these rows. tied: rows where the reference names another shape at the same t."""
    prim = pair.prim[rows]
    shape = packed.shape_of(prim)
    kind, k = packed.kind_of[shape], prim - packed.first[shape] + packed.start[shape]
    evidence = untied(prim, kind, pair.prim[tied], packed.kind_of[packed.shape_of(pair.prim[tied])])
    scalar = pair.result.answer.versions["variant"].startswith("scalar")
    found = {}
    for place in np.unique(kind):
        prims, here = packed.kinds[place].prims, (kind == place) & evidence
        at, reference = rows[here], kind_of(prims)
        o, d = (a[at].astype(np.float64) for a in (pair.rays.o, pair.rays.d))
        ways = reference.rounding_groups
        if not scalar and reference.rounding_groups_llvm is not None:
            ways = reference.rounding_groups_llvm
        keys = [way(prims, k[here], bounds.own.n[at], o, d) for way in ways]
        quantity, errors = BIAS_OF_T, share[at]
        if reference.position_terms is not None:
            quantity = BIAS_OF_POSITION
            errors = position_shares(reference.position_terms, prims, k[here], at, pair, bounds)
            keys.append(pair.result.answer.prim_uv[at])  # a corner's products with the same number are rounded alike
        groups = tuple(group_sums(key, errors) for key in keys)
        found[reference.name] = KindErrors(quantity, groups, t_roundings(share[at], pair.t[at], bounds.at.t_error[at]))
    return found


def position_shares(
    terms: PositionTerms, prims: Any, k: np.ndarray, at: np.ndarray, pair: ImagePair, bounds: Bounds
) -> np.ndarray:
    """(m,) how far the reference's positions at these rows are beyond ours along the ray, over their roundings.

    A position is the sum of the corners by barycentrics 1 - b1 - b2, b1 and b2. They are biased as t is, by a
    reciprocal that is not the nearest number to it; but whatever they are, the position over the sum of the three lies
    in the face's plane, up to K roundings of what is added. To these comes our own rounding, which alone counts where
    Mitsuba has none: in a plane through the origin, across an axis.
    """
    o, d, t = pair.rays.o[at].astype(np.float64), pair.rays.d[at].astype(np.float64), pair.t[at]
    b1, b2 = pair.result.answer.prim_uv[at].T
    weights = stacked_columns(np.float32(1.0) - b1 - b2, b1, b2).astype(np.float64)  # the first as Mitsuba rounds it
    p, n = pair.result.answer.p[at].astype(np.float64), bounds.own.n[at]
    slope = dot(n, d)
    with np.errstate(divide="ignore", invalid="ignore"):
        beyond = np.sign(slope) * dot(n, p / weights.sum(axis=1)[:, None] - o - t[:, None] * d)
        rounding = KU * dot(np.abs(n), terms(prims, k, weights, p)) + np.abs(slope) * bounds.own.t_error[at]
        share = np.clip(beyond / rounding, -1.0, 1.0)  # so that no pixel outweighs those that are within their bounds
    return np.where(np.isnan(share), 0.0, share)  # a position that is no number fails its own check


def t_roundings(share: np.ndarray, t: np.ndarray, t_error: np.ndarray) -> np.ndarray:
    """(2,) sums of the errors of t in roundings U t, weighted by how well each t is resolved, and of the weights.

    share: (m,) error over bound; t, t_error: (m,).
    """
    resolution = U32 * t / t_error
    return np.array([share @ resolution, resolution @ resolution])


def weakest_bias(found: Sequence[tuple[int, float]]) -> tuple[int, float]:
    """(groups, z) of several ways to group: the fewest groups, and the z nearest to 0."""
    return min(groups for groups, _ in found), min((z for _, z in found), key=abs)


def group_sums(key: np.ndarray, error: np.ndarray, count: np.ndarray | None = None) -> GroupSums:
    """Sums over groups. key: (m, c), equal in a group; error: (m,) signed; count: (m,) pixels, one each if None."""
    group = row_groups(key)
    keys = np.empty((int(group.max(initial=-1)) + 1, key.shape[1]), key.dtype)
    keys[group] = key
    return GroupSums(keys, np.bincount(group, error), np.bincount(group, count))


def merged_groups(sums: Sequence[GroupSums]) -> GroupSums:
    """Sums over the groups of several windows, where a group may have pixels in each."""
    if len(sums) == 1:
        return sums[0]
    return group_sums(*(np.concatenate(arrays) for arrays in zip(*sums, strict=True)))


def z_of_groups(sums: GroupSums) -> tuple[int, float]:
    """(number of groups, z).

    z is the sum of the groups' means over the root of the sum of their squares: mean / (std / sqrt(n)), with the
    spread about 0, which is where the mean has to be, and not about the mean that was found.
    """
    means = sums.errors / sums.counts
    spread = float(np.sqrt(np.sum(means**2)))
    return len(means), float(means.sum()) / spread if spread > 0.0 else 0.0


def check_bias(found: ErrorStatistics) -> SceneCheck:
    """Fails where the errors of a kind with enough groups have a mean that chance does not explain."""
    biased = [bias for bias in found.biases if bias.enough_groups and not abs(bias.z) <= LARGEST_Z]
    words = [
        f"{bias.quantity} of {bias.kind} is biased: z {bias.z:.1f} of {bias.groups} groups, "
        f"{LARGEST_Z:g} at most by chance"
        for bias in biased
    ] or [
        f"{bias.kind} z {bias.z:.1f} of {bias.groups} groups{'' if bias.enough_groups else ', too few to tell'}"
        for bias in found.biases
    ]
    return SceneCheck("bias", abs(found.z) / LARGEST_Z, "; ".join(words) or "nothing to look at")


# ---- the windows of a large film, judged one after the other ----


def merge_windows(windows: Sequence[SceneVerdict]) -> SceneVerdict:
    """The verdict of a film from those of windows that it consists of, without statistics and bias.

    Numbers are added up, ratios are the largest; failures of the first are listed first; one window without a
    comparison is the problem of all.
    """
    first, listed = windows[0], [failure for window in windows for failure in window.failures]
    problems = [window.problem for window in windows if window.problem]
    return replace(
        first,
        pixels=sum(window.pixels for window in windows),
        hit_pixels=sum(window.hit_pixels for window in windows),
        counts={name: sum(window.counts[name] for window in windows) for name in CLASSES},
        ratios=_largest([window.ratios for window in windows]),
        checks=_worst_checks(windows),
        failures=_leading(listed),
        seconds=sum(window.seconds for window in windows),
        reference_seconds=sum(window.reference_seconds for window in windows),
        reference_stored=all(window.reference_stored for window in windows),
        problem=problems[0] if problems else "",
        adjudicated=sum(window.adjudicated for window in windows),
        not_adjudicated=sum(window.not_adjudicated for window in windows),
        exact_seconds=sum(window.exact_seconds for window in windows),
        cases=_added([window.cases for window in windows]),
        reproducers=tuple(file for window in windows for file in window.reproducers),
        not_stored=sum(window.not_stored for window in windows),
        failing_by=_added([window.failing_by for window in windows]),
        worst_by=_worst_failures(windows),
        findings=_merged_findings(windows),
        notes=tuple(dict.fromkeys(note for window in windows for note in window.notes)),
    )


def _added(counts: Sequence[Mapping[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for each in counts:
        total.update(each)
    return dict(total)


def _largest(ratios: Sequence[Mapping[str, float]]) -> dict[str, float]:
    names = dict.fromkeys(name for each in ratios for name in each)
    return {name: max(each[name] for each in ratios if name in each) for name in names}


def _worst_checks(windows: Sequence[SceneVerdict]) -> tuple[SceneCheck, ...]:
    """Of each name the one that comes nearest to its bound, or is beyond; in the order of the window with the most."""
    longest = max(windows, key=lambda window: len(window.checks)).checks
    names = dict.fromkeys(check.name for check in (*longest, *(c for w in windows for c in w.checks)))
    every = [check for window in windows for check in window.checks]
    return tuple(
        max((check for check in every if check.name == name), key=lambda check: _badness(check.ratio)) for name in names
    )


def _badness(ratio: float) -> tuple[bool, float]:
    """A key by which NaN is beyond everything."""
    return (not ratio <= np.inf, ratio)


def _leading(failures: Sequence[Failure]) -> tuple[Failure, ...]:
    """One of each reason, then the worst of the others."""
    leading = list({failure.reason: failure for failure in reversed(failures)}.values())[::-1]
    others = [failure for failure in failures if failure not in leading]
    others.sort(key=lambda failure: _badness(failure.ratio), reverse=True)
    return tuple([*leading, *others][:MAX_LISTED_FAILURES])


def _worst_failures(windows: Sequence[SceneVerdict]) -> dict[str, Failure]:
    """Of each check the failure with the largest ratio."""
    names = dict.fromkeys(name for window in windows for name in window.worst_by)
    found = {name: [w.worst_by[name] for w in windows if name in w.worst_by] for name in names}
    return {name: max(each, key=lambda failure: _badness(failure.ratio)) for name, each in found.items()}


def _merged_findings(windows: Sequence[SceneVerdict]) -> tuple[Finding, ...]:
    """Each diagnosis once, most pixels first."""
    every = [finding for window in windows for finding in window.findings]
    pixels, of = (_added([{each.what: getattr(each, name)} for each in every]) for name in ("pixels", "of"))
    first = {finding.what: finding for finding in reversed(every)}
    merged = [replace(first[what], pixels=n, of=of.get(what, 0)) for what, n in pixels.items()]
    return tuple(sorted(merged, key=lambda each: (each.what == NOT_ADJUDICATED, -each.pixels)))

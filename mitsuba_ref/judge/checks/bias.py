"""Bias: a systematic offset of the reference's errors, by kind of primitive (docs/method.md, "Bias")."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import Packed
from mitsuba_ref.error_model.bounds import Bounds, aov_rows, row_distance
from mitsuba_ref.error_model.intersections import dot, row_groups, stacked_columns
from mitsuba_ref.error_model.scene_model import kinds_of
from mitsuba_ref.error_model.tolerances import KU, LARGEST_Z, U32, K
from mitsuba_ref.judge.checks import OURS, check
from mitsuba_ref.judge.comparison import ImagePair
from mitsuba_ref.judge.verdict import BIAS_OF_POSITION, BIAS_OF_T, ErrorStatistics, Extremes, KindBias, SceneCheck
from mitsuba_ref.shapes import kind_of
from mitsuba_ref.shapes.shape_reference import PositionTerms

# A defect of ours far below what float32 resolves moves no pixel beyond its bound, but it moves all of them the same
# way. Rounding does so, too, within a primitive: its numbers are rounded once, for all rays. So only the means of
# *groups* of pixels count, and no two groups share a rounded number. See docs/method.md, "Bias".


class GroupSums(NamedTuple):
    """Errors in groups of pixels that share no rounded number."""

    keys: np.ndarray  # (g, c), distinct
    errors: np.ndarray  # (g,) sums of signed shares of bounds
    counts: np.ndarray  # (g,) pixels


class KindErrors(NamedTuple):
    """Errors at the primitives of one kind."""

    quantity: str  # BIAS_OF_T or BIAS_OF_POSITION
    groups: tuple[GroupSums, ...]  # one for each way to group
    t_sums: np.ndarray  # (2,) of errors of t in roundings, and of their weights


class PixelErrors(NamedTuple):
    """Errors of one window of a film; those of several windows are joined into one statistic."""

    k_t: np.ndarray  # (m,) K times the error over its bound
    k_normal: np.ndarray  # (m,)
    kinds: Mapping[str, KindErrors]


def pixel_errors(packed: Packed, pair: ImagePair, bounds: Bounds) -> PixelErrors:
    """Errors from both sides' answers and the reference's bounds alone, without float64 bounds or exact answers."""
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
    """Statistics of all windows of one scene's film."""
    t = np.concatenate([window.k_t for window in windows])
    normal = np.concatenate([window.k_normal for window in windows])
    biases = []
    for kind in dict.fromkeys(kind for window in windows for kind in window.kinds):
        found = [window.kinds[kind] for window in windows if kind in window.kinds]
        ways = zip(*(errors.groups for errors in found), strict=True)
        groups, z = zip(*(z_of_groups(merged_groups(way)) for way in ways), strict=True)
        total, weight = np.sum([errors.t_sums for errors in found], axis=0)
        t_bias = float(total / weight) if weight > 0.0 else 0.0
        biases.append(KindBias(kind, min(groups), min(z, key=abs), found[0].quantity, t_bias))
    return ErrorStatistics(len(t), extremes(t), extremes(normal), looseness(t), tuple(biases))


def extremes(k: np.ndarray) -> Extremes:
    """The largest value and the 99th percentile; 0 if there is none."""
    return Extremes(*map(float, np.quantile(k, (1.0, 0.99)))) if len(k) else Extremes()


def looseness(k: np.ndarray) -> float:
    """Bound over error at the median."""
    middle = float(np.median(k)) if len(k) else 0.0
    return K / middle if middle > 0.0 else float("inf")


def untied(prim: np.ndarray, kind: np.ndarray, tied: np.ndarray, tied_kind: np.ndarray) -> np.ndarray:
    """(m,) bool: pixels that are evidence of a bias. prim, kind: (m,) of each; tied, tied_kind: (j,) of tied pixels.

    If two shapes have the same t, the reference names either by the sign of a rounding, so that the remaining pixels of
    each are biased, however right ours is. j pixels that drop out by sign move a sum of m roundings by at most j,
    chance by sqrt(m): if j^2 > m, no primitive of that kind with tied pixels is evidence.
    """
    many = [each for each in np.unique(tied_kind) if np.sum(tied_kind == each) ** 2 > np.sum(kind == each)]
    found: np.ndarray = ~(np.isin(kind, many) & np.isin(prim, tied))
    return found


def _errors_of_kinds(
    packed: Packed, pair: ImagePair, bounds: Bounds, share: np.ndarray, rows: np.ndarray, tied: np.ndarray
) -> dict[str, KindErrors]:
    """Errors of each kind hit at these rows. tied: rows where the reference names another shape at the same t."""
    prim = pair.prim[rows]
    kind, k = kinds_of(packed, prim)
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


def group_sums(key: np.ndarray, error: np.ndarray, count: np.ndarray | None = None) -> GroupSums:
    """Sums over groups. key: (m, c), equal in a group; error: (m,) signed; count: (m,) pixels, one each if None."""
    group = row_groups(key)
    keys = np.empty((int(group.max(initial=-1)) + 1, key.shape[1]), key.dtype)
    keys[group] = key
    return GroupSums(keys, np.bincount(group, error), np.bincount(group, count))


def merged_groups(sums: Sequence[GroupSums]) -> GroupSums:
    """Sums over the groups of several windows; a group may have pixels in each."""
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


@check(of=(OURS,), scope="film")
def check_bias(statistics: ErrorStatistics) -> SceneCheck:
    """Fail if the errors of a kind with enough groups have a mean that chance does not explain."""
    biased = [bias for bias in statistics.biases if bias.enough_groups and not abs(bias.z) <= LARGEST_Z]
    words = [
        f"{bias.quantity} of {bias.kind} is biased: z {bias.z:.1f} of {bias.groups} groups, "
        f"{LARGEST_Z:g} at most by chance"
        for bias in biased
    ] or [
        f"{bias.kind} z {bias.z:.1f} of {bias.groups} groups{'' if bias.enough_groups else ', too few to tell'}"
        for bias in statistics.biases
    ]
    return SceneCheck("bias", abs(statistics.z) / LARGEST_Z, "; ".join(words) or "nothing to look at")

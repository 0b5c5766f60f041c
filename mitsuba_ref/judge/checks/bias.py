"""Bias (docs/method.md, "Bias"): systematic errors of the reference by kind, and a factor on all t of a candidate."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import Packed
from mitsuba_ref.error_model.bounds import Bounds, aov_rows, row_distance
from mitsuba_ref.error_model.intersections import (
    dot,
    row_groups,
    stacked_columns,
    without_float_warnings,
    without_overflow_warnings,
)
from mitsuba_ref.error_model.tolerances import BIASED_PIXELS, KU, LARGEST_T_BIAS, LARGEST_Z, MIN_GROUPS, U32, K
from mitsuba_ref.judge.checks import CANDIDATE, OURS, Found, check
from mitsuba_ref.judge.comparison import ImagePair
from mitsuba_ref.judge.verdict import BIAS_OF_POSITION, BIAS_OF_T, ErrorStatistics, Extremes, KindBias
from mitsuba_ref.shapes import kind_of
from mitsuba_ref.shapes.shape_reference import PositionTerms
from mitsuba_ref.subjects.subject import FLOAT32, FLOAT64

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


@without_float_warnings
def pixel_errors(packed: Packed, pair: ImagePair, bounds: Bounds, shared: np.ndarray | None = None) -> PixelErrors:
    """Errors from both sides' answers and the reference's bounds alone, without float64 bounds or exact answers.

    shared: (shapes,) bool, of instances in a Mitsuba file: the rounding of a matrix is shared by all their hits.
    """
    error = pair.result.t - pair.t
    share = np.where(error == 0.0, 0.0, error / bounds.at.t_error)
    turned = row_distance(aov_rows(pair.subject, "normal"), aov_rows(pair.reference, "normal")) / bounds.at.n_error
    same = aov_rows(pair.subject, "shape_id") == aov_rows(pair.reference, "shape_id")
    near = (np.abs(share) <= 1.0) & np.isfinite(bounds.at.t_error)
    hit = (pair.prim >= 0) & pair.result.hit & near
    if shared is not None:
        hit[hit] = ~shared[packed.shape_of(pair.prim[hit])]
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
        ways = zip(*(errors.groups for errors in found), strict=True)  # a group may have pixels in several windows
        merged = (group_sums(*(np.concatenate(arrays) for arrays in zip(*way, strict=True))) for way in ways)
        groups, z = zip(*map(z_of_groups, merged), strict=True)
        total, weight = np.sum([errors.t_sums for errors in found], axis=0)
        t_bias = float(total / weight) if weight > 0.0 else 0.0
        biases.append(KindBias(kind, min(groups), min(z, key=abs), found[0].quantity, t_bias))
    middle = float(np.median(t)) if len(t) else 0.0
    looseness = K / middle if middle > 0.0 else float("inf")  # bound over error
    return ErrorStatistics(len(t), extremes(t), extremes(normal), looseness, tuple(biases))


def extremes(k: np.ndarray) -> Extremes:
    """The largest value and the 99th percentile; 0 if there is none."""
    return Extremes(*map(float, np.quantile(k, (1.0, 0.99)))) if len(k) else Extremes()


def untied(prim: np.ndarray, kind: np.ndarray, tied: np.ndarray, tied_kind: np.ndarray) -> np.ndarray:
    """(m,) bool: pixels that are evidence of a bias. prim, kind: (m,) of each; tied, tied_kind: (j,) of tied pixels.

    If two shapes have the same t, the reference names either by the sign of a rounding, so that the remaining pixels of
    each are biased, however right ours is. j pixels that drop out by sign move a sum of m roundings by at most j,
    chance by sqrt(m): if j^2 > m, no primitive of that kind with tied pixels is evidence.
    """
    many = [each for each in np.unique(tied_kind) if np.sum(tied_kind == each) ** 2 > np.sum(kind == each)]
    return ~(np.isin(kind, many) & np.isin(prim, tied))


def _errors_of_kinds(
    packed: Packed, pair: ImagePair, bounds: Bounds, share: np.ndarray, rows: np.ndarray, tied: np.ndarray
) -> dict[str, KindErrors]:
    """Errors of each kind hit at these rows. tied: rows where the reference names another shape at the same t."""
    prim = pair.prim[rows]
    kind, k = packed.kinds_of(prim)
    evidence = untied(prim, kind, pair.prim[tied], packed.kinds_of(pair.prim[tied])[0])
    scalar = pair.result.answer.versions["variant"].startswith("scalar")
    found = {}
    for place in np.unique(kind):
        prims, here = packed.kinds[place].prims, (kind == place) & evidence
        at, reference = rows[here], kind_of(prims)
        o, d = (a[at].astype(np.float64) for a in (pair.rays.o, pair.rays.d))
        ways = (None if scalar else reference.rounding_groups_llvm) or reference.rounding_groups
        keys = [way(prims, k[here], bounds.own.n[at], o, d) for way in ways]
        quantity, errors = BIAS_OF_T, share[at]
        if reference.position_terms is not None:
            quantity = BIAS_OF_POSITION
            errors = position_shares(reference.position_terms, prims, k[here], at, pair, bounds)
            keys.append(pair.result.answer.prim_uv[at])  # a corner's products with the same number are rounded alike
        groups = tuple(group_sums(key, errors) for key in keys)
        resolution = U32 * pair.t[at] / bounds.at.t_error[at]  # how well each t is resolved, its weight
        t_sums = np.array([share[at] @ resolution, resolution @ resolution])
        found[reference.name] = KindErrors(quantity, groups, t_sums)
    return found


@without_overflow_warnings
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
    beyond = np.sign(slope) * dot(n, p / weights.sum(axis=1)[:, None] - o - t[:, None] * d)
    rounding = KU * dot(np.abs(n), terms(prims, k, weights, p)) + np.abs(slope) * bounds.own.t_error[at]
    share = np.clip(beyond / rounding, -1.0, 1.0)  # so that no pixel outweighs those that are within their bounds
    return np.where(np.isnan(share), 0.0, share)  # a position that is no number fails its own check


def group_sums(key: np.ndarray, error: np.ndarray, count: np.ndarray | None = None) -> GroupSums:
    """Sums over groups. key: (m, c), equal in a group; error: (m,) signed; count: (m,) pixels, one each if None."""
    group = row_groups(key)
    keys = np.empty((int(group.max(initial=-1)) + 1, key.shape[1]), key.dtype)
    keys[group] = key
    return GroupSums(keys, np.bincount(group, error), np.bincount(group, count))


def z_of_groups(sums: GroupSums) -> tuple[int, float]:
    """(number of groups, z).

    z is the sum of the groups' means over the root of the sum of their squares: mean / (std / sqrt(n)), with the
    spread about 0, which is where the mean has to be, and not about the mean that was found.
    """
    means = sums.errors / sums.counts
    spread = float(np.sqrt(np.sum(means**2)))
    return len(means), float(means.sum()) / spread if spread > 0.0 else 0.0


@check(of=(OURS,), scope="film")
def check_bias(statistics: ErrorStatistics) -> Found:
    """Fail if the errors of a kind with enough groups have a mean that chance does not explain."""
    words = [
        f"{bias.quantity} of {bias.kind} is biased: z {bias.z:.1f} of {bias.groups} groups, "
        f"{LARGEST_Z:g} at most by chance"
        for bias in statistics.biases
        if bias.enough_groups and not abs(bias.z) <= LARGEST_Z
    ] or [
        f"{bias.kind} z {bias.z:.1f} of {bias.groups} groups{'' if bias.enough_groups else ', too few to tell'}"
        for bias in statistics.biases
    ]
    return abs(statistics.z) / LARGEST_Z, "; ".join(words) or "nothing to look at"


# ---- a common factor on all t of a candidate, even within their bounds

ROUNDOFF = {FLOAT32: U32, FLOAT64: 2.0**-53}  # u of a candidate's precision
FIT_ROUNDING = 2.0**-20  # far above the residual of a column that a float64 least-squares fit explains fully


class FactorFit(NamedTuple):
    """The factor 1 + u `roundings` that fits all t best, beside a shift of each shape."""

    roundings: float
    z: float  # of the sums over primitives, whose signs are random without such a factor
    groups: int  # primitives at which a factor differs from a shift


@check(of=(CANDIDATE,), scope="window")
def check_t_bias(packed: Packed, pair: ImagePair, bounds: Bounds, prims: np.ndarray) -> Found | None:
    """Fail if one factor explains the errors of t, and is larger than estimated reciprocals make it.

    None if t is not given, or if the candidate rounds rays or geometry itself.
    """
    answer = pair.answer
    if answer.hits_only or answer.own_camera or answer.own_geometry:
        return None
    fit = fitted_factor(packed, pair, bounds, prims)
    words = f"t is off by {fit.roundings:+.1f} of its roundings on average, z {fit.z:.1f} of {fit.groups} primitives"
    if fit.groups < MIN_GROUPS:
        return 0.0, f"{fit.groups} primitives, too few to tell"
    ratio = min(abs(fit.roundings) / LARGEST_T_BIAS, abs(fit.z) / LARGEST_Z)
    if ratio > 1.0:
        words += (
            f"; estimated reciprocals explain at most {LARGEST_T_BIAS:g}: is every t scaled or moved by a constant?"
        )
    return ratio, words


@without_float_warnings
def fitted_factor(packed: Packed, pair: ImagePair, bounds: Bounds, prims: np.ndarray) -> FactorFit:
    """Fit one factor on t by least squares over pixels, weighted by their bounds.

    A candidate may round the origin of its rays, or the place of a shape, once for all rays; a shift by the vector s
    changes t by s.n / d.n. So a shift of each shape is fitted first, and its part is removed from errors and factor.
    """
    answer, own = pair.answer, bounds.own
    bound = own.t_error + answer.t_rounding
    error = (answer.t - own.t) / bound
    shift = own.n / (dot(own.n, pair.rays.d.astype(np.float64)) * bound)[:, None]
    near = (prims >= 0) & answer.hit & (np.abs(error) <= 1.0) & np.isfinite(bound)
    rows = np.flatnonzero(near & np.isfinite(shift).all(axis=1))
    rows = rows[:: max(1, -(-len(rows) // BIASED_PIXELS))]
    error, shift, prim = error[rows], shift[rows], prims[rows]
    factor = ROUNDOFF[answer.precision] * own.t[rows] / bound[rows]
    of_shape = packed.shape_of(prim)
    for shape in np.unique(of_shape):
        here = np.flatnonzero(of_shape == shape)
        both = np.column_stack([error[here], factor[here]])
        left = both - shift[here] @ np.linalg.lstsq(shift[here], both, rcond=None)[0]
        tells = np.linalg.norm(left[:, 1]) > FIT_ROUNDING * np.linalg.norm(both[:, 1])
        error[here], factor[here] = left.T if tells else np.zeros((2, 1))  # at a plane, a shift explains any factor
    tells = factor != 0.0
    sums = group_sums(prim[tells, None], error[tells] * factor[tells]).errors
    weight, spread = float(factor @ factor), float(np.sqrt(sums @ sums))
    if weight == 0.0 or spread == 0.0:
        return FactorFit(0.0, 0.0, len(sums))
    return FactorFit(float(error @ factor) / weight, float(sums.sum()) / spread, len(sums))

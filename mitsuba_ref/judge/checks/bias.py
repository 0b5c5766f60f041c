"""Bias (docs/method.md, "Bias"): systematic errors of the reference by kind, and a factor on all t of a candidate."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mitsuba_ref.error_model.intersections import (
    Array,
    dot,
    row_groups,
    stacked_columns,
    without_float_warnings,
    without_overflow_warnings,
)
from mitsuba_ref.error_model.tolerances import BIASED_PIXELS, KU, LARGEST_T_BIAS, LARGEST_Z, MIN_GROUPS, U32
from mitsuba_ref.judge.checks import CANDIDATE, OURS, Found, check
from mitsuba_ref.judge.classification import Judge
from mitsuba_ref.judge.verdict import KindBias
from mitsuba_ref.reference.originals import original_of
from mitsuba_ref.shapes import kind_of
from mitsuba_ref.shapes.shape_reference import PositionTerms

# A defect of ours far below what float32 resolves moves no pixel beyond its bound, but it moves all of them the same
# way. Rounding does so, too, within a primitive: its numbers are rounded once, for all rays. So only the means of
# *groups* of pixels count, and no two groups share a rounded number. See docs/method.md, "Bias".


@without_float_warnings
def kind_biases(judge: Judge, excused: Array) -> list[KindBias]:
    """Bias of each kind, from both sides' answers and the reference's bounds, without float64 bounds or exact answers.

    excused: (n,) bool, pixels that pass without the reference; they are no evidence. Nor are instances in a Mitsuba
    file: the rounding of a matrix is shared by all their hits.
    """
    packed, answer = judge.model.packed, judge.result.answer
    error = judge.result.t - judge.answer.t
    share = np.where(error == 0.0, 0.0, error / judge.at.t_error)
    turned = judge.distance("normal") / judge.at.n_error
    same = np.equal(*judge.sides("shape_id"))
    near = (np.abs(share) <= 1.0) & np.isfinite(judge.at.t_error)
    hit = (judge.prim >= 0) & judge.result.hit & near
    if original := original_of(judge.scene):
        hit[hit] = ~(original.condition > 0.0)[packed.shape_of(judge.prim[hit])]
    rows, tied = np.flatnonzero(hit & same & (turned <= 1.0) & ~excused), judge.prim[hit & ~same]
    prim = judge.prim[rows]
    kind, k = packed.kinds_of(prim)
    evidence = untied(prim, kind, tied, packed.kinds_of(tied)[0])
    scalar = answer.versions["variant"].startswith("scalar")
    found = []
    for place in np.unique(kind):
        prims, here = packed.kinds[place].prims, (kind == place) & evidence
        at, reference = rows[here], kind_of(prims)
        ways = (None if scalar else reference.rounding_groups_llvm) or reference.rounding_groups
        keys = [way(prims=prims, k=k[here], n=judge.own.n[at], o=judge.o[at], d=judge.d[at]) for way in ways]
        quantity, errors = "t", share[at]
        if reference.position_terms is not None:
            quantity = "position"
            errors = position_shares(reference.position_terms, prims, k[here], at, judge)
            keys.append(answer.prim_uv[at])  # a corner's products with the same number are rounded alike
        groups, z = zip(*(z_of_groups(key, errors) for key in keys), strict=True)
        resolution = U32 * judge.answer.t[at] / judge.at.t_error[at]  # how well each t is resolved, its weight
        weight = float(resolution @ resolution)
        t_bias = float(share[at] @ resolution) / weight if weight > 0.0 else 0.0
        found.append(KindBias(reference.name, min(groups), min(z, key=abs), quantity, t_bias))
    return found


def untied(prim: Array, kind: Array, tied: Array, tied_kind: Array) -> Array:
    """(m,) bool: pixels that are evidence of a bias. prim, kind: (m,) of each; tied, tied_kind: (j,) of tied pixels.

    If two shapes have the same t, the reference names either by the sign of a rounding, so that the remaining pixels of
    each are biased, however right ours is. j pixels that drop out by sign move a sum of m roundings by at most j,
    chance by sqrt(m): if j^2 > m, no primitive of that kind with tied pixels is evidence.
    """
    many = [each for each in np.unique(tied_kind) if np.sum(tied_kind == each) ** 2 > np.sum(kind == each)]
    return ~(np.isin(kind, many) & np.isin(prim, tied))


@without_overflow_warnings
def position_shares(terms: PositionTerms, prims: Any, k: Array, at: Array, judge: Judge) -> Array:
    """(m,) how far the reference's positions at these rows are beyond ours along the ray, over their roundings.

    A position is the sum of the corners by barycentrics 1 - b1 - b2, b1 and b2. They are biased as t is, by a
    reciprocal that is not the nearest number to it; but whatever they are, the position over the sum of the three lies
    in the face's plane, up to K roundings of what is added. To these comes our own rounding, which alone counts where
    Mitsuba has none: in a plane through the origin, across an axis.
    """
    o, d, t, own = judge.o[at], judge.d[at], judge.answer.t[at], judge.own
    b1, b2 = judge.result.answer.prim_uv[at].T
    weights = stacked_columns(np.float32(1.0) - b1 - b2, b1, b2).astype(np.float64)  # the first as Mitsuba rounds it
    p, n = judge.result.answer.p[at].astype(np.float64), own.n[at]
    slope = dot(n, d)
    beyond = np.sign(slope) * dot(n, p / weights.sum(axis=1)[:, None] - o - t[:, None] * d)
    rounding = KU * dot(np.abs(n), terms(prims, k, weights, p)) + np.abs(slope) * own.t_error[at]
    share = np.clip(beyond / rounding, -1.0, 1.0)  # so that no pixel outweighs those that are within their bounds
    return np.where(np.isnan(share), 0.0, share)  # a position that is no number fails its own check


def z_of_groups(key: Array, error: Array) -> tuple[int, float]:
    """(number of groups, z of their means). key: (m, c), equal in a group; error: (m,) signed."""
    group = row_groups(key)
    means = np.bincount(group, error) / np.bincount(group)
    return len(means), z_of(means)


def z_of(values: Array) -> float:
    """Their sum over the root of the sum of their squares.

    That is mean / (std / sqrt(n)) with the spread about 0, where the mean has to be, and not about the mean found.
    """
    spread = float(np.sqrt(np.sum(values**2)))
    return float(values.sum()) / spread if spread > 0.0 else 0.0


@check(of=(OURS,), scope="window")
def check_bias(biases: Sequence[KindBias]) -> Found:
    """Fail if the errors of a kind with enough groups have a mean that chance does not explain."""
    shares = [abs(bias.z) / LARGEST_Z if bias.enough_groups else 0.0 for bias in biases]
    words = [
        f"{bias.quantity} of {bias.kind} is biased: z {bias.z:.1f} of {bias.groups} groups, "
        f"{LARGEST_Z:g} at most by chance"
        for bias, share in zip(biases, shares, strict=True)
        if not share <= 1.0
    ] or [
        f"{bias.kind} z {bias.z:.1f} of {bias.groups} groups{'' if bias.enough_groups else ', too few to tell'}"
        for bias in biases
    ]
    return float(np.max(shares, initial=0.0)), "; ".join(words) or "nothing to look at"


# ---- a common factor on all t of a candidate, even within their bounds

FIT_ROUNDING = 2.0**-20  # far above the residual of a column that a float64 least-squares fit explains fully


@check(of=(CANDIDATE,), scope="window")
def check_t_bias(judge: Judge) -> Found | None:
    """Fail if one factor explains the errors of t, and is larger than estimated reciprocals make it.

    None if t is not given, or if the candidate rounds rays or geometry itself.
    """
    answer = judge.answer
    if answer.hits_only or answer.own_camera or answer.own_geometry:
        return None
    roundings, z, groups = fitted_factor(judge)
    words = f"t is off by {roundings:+.1f} of its roundings on average, z {z:.1f} of {groups} primitives"
    if groups < MIN_GROUPS:
        return 0.0, f"{groups} primitives, too few to tell"
    ratio = min(abs(roundings) / LARGEST_T_BIAS, abs(z) / LARGEST_Z)
    if ratio > 1.0:
        words += (
            f"; estimated reciprocals explain at most {LARGEST_T_BIAS:g}: is every t scaled or moved by a constant?"
        )
    return ratio, words


@without_float_warnings
def fitted_factor(judge: Judge) -> tuple[float, float, int]:
    """Fit one factor 1 + u r on t by least squares over pixels, weighted by their bounds.

    Returns r, the z of its sums over primitives, whose signs are random without such a factor, and the number of
    primitives at which a factor differs from a shift.

    A candidate may round the origin of its rays, or the place of a shape, once for all rays; a shift by the vector s
    changes t by s.n / d.n. So a shift of each shape is fitted first, and its part is removed from errors and factor.
    """
    answer, own, prims = judge.answer, judge.own, judge.prim
    bound = own.t_error + answer.t_rounding
    error = (answer.t - own.t) / bound
    shift = own.n / (dot(own.n, judge.d) * bound)[:, None]
    near = (prims >= 0) & answer.hit & (np.abs(error) <= 1.0) & np.isfinite(bound)
    rows = np.flatnonzero(near & np.isfinite(shift).all(axis=1))
    rows = rows[:: max(1, -(-len(rows) // BIASED_PIXELS))]
    error, shift, prim = error[rows], shift[rows], prims[rows]
    factor = np.finfo(answer.precision).eps / 2.0 * own.t[rows] / bound[rows]
    of_shape = judge.model.packed.shape_of(prim)
    for shape in np.unique(of_shape):
        here = np.flatnonzero(of_shape == shape)
        both = np.column_stack([error[here], factor[here]])
        left = both - shift[here] @ np.linalg.lstsq(shift[here], both, rcond=None)[0]
        tells = np.linalg.norm(left[:, 1]) > FIT_ROUNDING * np.linalg.norm(both[:, 1])
        error[here], factor[here] = left.T if tells else np.zeros((2, 1))  # at a plane, a shift explains any factor
    tells = factor != 0.0
    sums = np.bincount(row_groups(prim[tells, None]), error[tells] * factor[tells])
    weight = float(factor @ factor)
    return float(error @ factor) / weight if weight > 0.0 else 0.0, z_of(sums), len(sums)

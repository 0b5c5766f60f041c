"""A common factor on all t of a candidate, even within their bounds (docs/method.md, "Bias")."""

from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Packed
from mitsuba_ref.error_model.bounds import Bounds
from mitsuba_ref.error_model.intersections import dot
from mitsuba_ref.error_model.tolerances import BIASED_PIXELS, LARGEST_T_BIAS, LARGEST_Z, MIN_GROUPS, U32
from mitsuba_ref.judge.checks import CANDIDATE, check
from mitsuba_ref.judge.checks.bias import group_sums
from mitsuba_ref.judge.comparison import ImagePair
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.subjects.subject import FLOAT32, FLOAT64

ROUNDOFF = {FLOAT32: U32, FLOAT64: 2.0**-53}  # u of a candidate's precision
FIT_ROUNDING = 2.0**-20  # far above the residual of a column that a float64 least-squares fit explains fully


class FactorFit(NamedTuple):
    """The factor 1 + u `roundings` that fits all t best, beside a shift of each shape."""

    roundings: float
    z: float  # of the sums over primitives, whose signs are random without such a factor
    groups: int  # primitives at which a factor differs from a shift


@check(of=(CANDIDATE,), scope="window")
def check_t_bias(packed: Packed, pair: ImagePair, bounds: Bounds, prims: np.ndarray) -> SceneCheck | None:
    """Fail if one factor explains the errors of t, and is larger than estimated reciprocals make it.

    None if t is not given, or if the candidate rounds rays or geometry itself.
    """
    answer = pair.answer
    if answer.hits_only or answer.own_camera or answer.own_geometry:
        return None
    fit = fitted_factor(packed, pair, bounds, prims)
    words = f"t is off by {fit.roundings:+.1f} of its roundings on average, z {fit.z:.1f} of {fit.groups} primitives"
    if fit.groups < MIN_GROUPS:
        return SceneCheck("t_bias", 0.0, f"{fit.groups} primitives, too few to tell")
    ratio = min(abs(fit.roundings) / LARGEST_T_BIAS, abs(fit.z) / LARGEST_Z)
    if ratio > 1.0:
        words += f"; estimated reciprocals explain at most {LARGEST_T_BIAS:g}: is every t scaled by a constant?"
    return SceneCheck("t_bias", ratio, words)


def fitted_factor(packed: Packed, pair: ImagePair, bounds: Bounds, prims: np.ndarray) -> FactorFit:
    """Fit one factor on t by least squares over pixels, weighted by their bounds.

    A candidate may round the origin of its rays, or the place of a shape, once for all rays; a shift by the vector s
    changes t by s.n / d.n. So a shift of each shape is fitted first, and its part is removed from errors and factor.
    """
    answer, own = pair.answer, bounds.own
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
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

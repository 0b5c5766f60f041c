"""Bias of the errors of t: whether they lean to one side, by kind of primitive (docs/method.md, "Bias")."""

from collections.abc import Sequence

import numpy as np

from caster.geometry.packing import Packed
from mitsuba_ref.error_model.bounds import Bounds, aov_rows, row_distance
from mitsuba_ref.error_model.intersections import K
from mitsuba_ref.error_model.tolerances import LARGEST_Z
from mitsuba_ref.judge.comparison import ImagePair
from mitsuba_ref.judge.verdict import ErrorStatistics, Extremes, KindBias, SceneCheck
from mitsuba_ref.shapes import kind_of

# How much of their bounds the errors of the reference use, and whether they lean to one side.
#
# A defect of ours far below what float32 resolves moves no pixel beyond its bound, but it moves all of them
# the same way.
# Rounding does so, too, within a primitive: its numbers are rounded once, for all rays. So only the means of
# *groups* of pixels count, of which nothing that is rounded belongs to two. See docs/method.md, "Bias".


def error_statistics(packed: Packed, pair: ImagePair, bounds: Bounds) -> ErrorStatistics:
    """Of one scene, from both sides' answers and the reference's bounds alone: no float64's bounds, no exact answer."""
    with np.errstate(invalid="ignore", divide="ignore"):
        error = pair.result.t - pair.t
        share = np.where(error == 0.0, 0.0, error / bounds.at.t_error)
        turned = (
            row_distance(aov_rows(pair.subject, "normal"), aov_rows(pair.reference, "normal"))
            / bounds.at.n_error
        )
        same = aov_rows(pair.subject, "shape_id") == aov_rows(pair.reference, "shape_id")
        held = (np.abs(share) <= 1.0) & (turned <= 1.0) & np.isfinite(bounds.at.t_error)
    rows = np.flatnonzero((pair.prim >= 0) & pair.result.hit & same & held)
    t, normal = K * np.abs(share[rows]), K * turned[rows]
    return ErrorStatistics(
        len(rows),
        extremes(t),
        extremes(normal),
        looseness(t),
        _kind_biases(packed, pair, bounds, share, rows),
    )


def extremes(k: np.ndarray) -> Extremes:
    """The largest, and what 99 % are below; 0 of none."""
    return Extremes(float(k.max()), float(np.quantile(k, 0.99))) if len(k) else Extremes()


def looseness(k: np.ndarray) -> float:
    """Bound over error in the middle."""
    middle = float(np.median(k)) if len(k) else 0.0
    return K / middle if middle > 0.0 else float("inf")


def _kind_biases(
    packed: Packed, pair: ImagePair, bounds: Bounds, share: np.ndarray, rows: np.ndarray
) -> tuple[KindBias, ...]:
    """One for each kind that is hit at these rows."""
    prim = pair.prim[rows]
    shape = packed.shape_of(prim)
    kind, k = packed.kind_of[shape], prim - packed.first[shape] + packed.start[shape]
    scalar = pair.result.answer.versions["variant"].startswith("scalar")
    biases = []
    for place in np.unique(kind):
        prims, here = packed.kinds[place].prims, kind == place
        at, reference = rows[here], kind_of(prims)
        o, d = (a[at].astype(np.float64) for a in (pair.rays.o, pair.rays.d))
        ways = reference.rounding_groups
        if not scalar and reference.rounding_groups_llvm is not None:
            ways = reference.rounding_groups_llvm
        keys = [way(prims, k[here], bounds.own.n[at], o, d) for way in ways]
        biases.append(KindBias(reference.name, *weakest_bias([z_of_groups(key, share[at]) for key in keys])))
    return tuple(biases)


def weakest_bias(found: Sequence[tuple[int, float]]) -> tuple[int, float]:
    """(groups, z) of several ways to group: the fewest groups, and the z nearest to 0."""
    return min(groups for groups, _ in found), min((z for _, z in found), key=abs)


def z_of_groups(key: np.ndarray, error: np.ndarray) -> tuple[int, float]:
    """(number of groups, z). key: (m, c), equal in a group; error: (m,) signed.

    z is the sum of the groups' means over the root of the sum of their squares: mean / (std / sqrt(n)), with the
    spread about 0, which is where the mean has to be, and not about the mean that was found.
    """
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.ravel()
    count = np.bincount(group)
    means = np.bincount(group, error) / count
    spread = float(np.sqrt(np.sum(means**2)))
    return len(count), float(means.sum()) / spread if spread > 0.0 else 0.0


def check_bias(found: ErrorStatistics) -> SceneCheck:
    """Fails where the errors of a kind with enough groups lean to one side by more than chance explains."""
    words = [
        f"{bias.kind} z {bias.z:.1f} of {bias.groups} groups{'' if bias.enough_groups else ', too few to tell'}"
        for bias in found.biases
    ]
    return SceneCheck("bias", abs(found.z) / LARGEST_Z, "; ".join(words) or "nothing to look at")

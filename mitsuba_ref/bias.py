"""How much of their bounds the errors of the reference use, and whether they lean to one side.

A defect of ours far below what float32 resolves moves no pixel beyond its bound, but it moves all of them the same way.
Rounding does so, too, within a primitive: its numbers are rounded once, for all rays. So only the means of *groups* of
pixels count, of which nothing that is rounded belongs to two. See docs/method.md, "Bias".
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from caster.packing import Packed
from mitsuba_ref.bounds import Bounds
from mitsuba_ref.meeting import K
from mitsuba_ref.pair import Pair
from mitsuba_ref.pixels import apart, flat
from mitsuba_ref.scene_check import SceneCheck
from mitsuba_ref.shared_roundings import GROUPS, GROUPS_OF_LLVM, all_one

# Means of groups whose signs are tosses of a coin give |z| >= x with a probability of at most 2 exp(-x^2 / 2),
# however many and however large they are (Hoeffding): 7.5e-6 for 5. No |z| exceeds the root of the number of groups.
LARGEST_Z = 5.0
FEWEST_GROUPS = int(LARGEST_Z**2) + 1  # with fewer, no bias whatever could fail


class Bias(NamedTuple):
    """What the errors of t of one kind of primitive lean to."""

    kind: str  # name of its packed arrays
    groups: int  # of the way to group pixels that makes the fewest
    z: float  # of the way that makes it smallest; positive: the reference sees things farther away than ours

    @property
    def tells(self) -> bool:
        """Whether there are enough groups to fail by."""
        return self.groups >= FEWEST_GROUPS


class Statistics(NamedTuple):
    """The errors of a scene where both name the same surface within its bounds: K times the error over its bound."""

    pixels: int
    t_largest: float
    t_p99: float  # 99 % of the pixels are below
    normal_largest: float
    normal_p99: float
    looseness: float  # median of the bound of t over its error; inf where most are exact
    biases: tuple[Bias, ...]

    @property
    def z(self) -> float:
        """Of the kind that leans most among those that can tell; 0 where none can."""
        return max((bias.z for bias in self.biases if bias.tells), key=abs, default=0.0)


def statistics(packed: Packed, pair: Pair, bounds: Bounds) -> Statistics:
    """Of one scene, from both sides' answers and the reference's bounds alone: no float64's bounds, no exact answer."""
    with np.errstate(invalid="ignore", divide="ignore"):
        error = pair.witness.t - pair.t
        share = np.where(error == 0.0, 0.0, error / bounds.at.t_error)
        turned = apart(flat(pair.ours, "normal"), flat(pair.reference, "normal")) / bounds.at.n_error
        same = flat(pair.ours, "shape_id") == flat(pair.reference, "shape_id")
        held = (np.abs(share) <= 1.0) & (turned <= 1.0) & np.isfinite(bounds.at.t_error)
    rows = np.flatnonzero((pair.prim >= 0) & pair.witness.hit & same & held)
    t, normal = K * np.abs(share[rows]), K * turned[rows]
    return Statistics(
        len(rows), *extremes(t), *extremes(normal), looseness(t), _biases(packed, pair, bounds, share, rows)
    )


def extremes(k: np.ndarray) -> tuple[float, float]:
    """The largest, and what 99 % are below; 0 of none."""
    return (float(k.max()), float(np.quantile(k, 0.99))) if len(k) else (0.0, 0.0)


def looseness(k: np.ndarray) -> float:
    """Bound over error in the middle."""
    middle = float(np.median(k)) if len(k) else 0.0
    return K / middle if middle > 0.0 else float("inf")


def _biases(
    packed: Packed, pair: Pair, bounds: Bounds, share: np.ndarray, rows: np.ndarray
) -> tuple[Bias, ...]:
    """One for each kind that is hit at these rows."""
    prim = pair.prim[rows]
    shape = packed.shape_of(prim)
    kind, k = packed.kind_of[shape], prim - packed.first[shape] + packed.start[shape]
    scalar = pair.witness.answer.versions["variant"].startswith("scalar")
    ways_of = GROUPS if scalar else GROUPS_OF_LLVM
    biases = []
    for place in np.unique(kind):
        prims, here = packed.kinds[place].prims, kind == place
        at, name = rows[here], type(prims).__name__
        o, d = (a[at].astype(np.float64) for a in (pair.rays.o, pair.rays.d))
        ways = ways_of.get(name, (all_one,))
        keys = [way(prims, k[here], bounds.own.n[at], o, d) for way in ways]
        biases.append(Bias(name, *least([z_of_groups(key, share[at]) for key in keys])))
    return tuple(biases)


def least(found: Sequence[tuple[int, float]]) -> tuple[int, float]:
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


def check_bias(found: Statistics) -> SceneCheck:
    """Fails where the errors of a kind with enough groups lean to one side by more than chance explains."""
    words = [
        f"{bias.kind} z {bias.z:.1f} of {bias.groups} groups{'' if bias.tells else ', too few to tell'}"
        for bias in found.biases
    ]
    return SceneCheck("bias", abs(found.z) / LARGEST_Z, "; ".join(words) or "nothing to look at")

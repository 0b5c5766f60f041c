"""By how much rounding the numbers of a ray and a primitive may move t: what the bounds of the caster are held to.

One formula for each kind, written for arrays from what the kind is, not from the kernels. All are in units of t, count
each operand's magnitude once, and are at least |t|.
"""

from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import Packed

ULP = 2.0**-52

# What we give may be off by so many ulps of the condition: the judge's currency for float64, 2 K 2^-53 with K = 4
# (docs/method.md, "The currency of errors"). A condition counts each operand's rounding, half an ulp, once; the
# roundings in between have the rest. The worst of 40,000 hits needs 1.
T_ULPS = 4.0

# The bound that we give beside t may be so many: where a ray is taken to object space, d is off by 6 u there
# (TO_OBJECT_SPACE_ERROR), so d.d by 3 times that, which comes in twice, and everything is doubled for the
# division: 72 u. Other
# terms are at most 12 u (`moved` in roots.py; 9 u in triangles.py), doubled or doubled twice: 48 u. u is half an ulp.
OFF_ULPS = 64.0

# Of a chord that is plainly there, the kernel asks no more than that its discriminant is known to 2^-26 of itself,
# which spares a square root (roots.py, SHARE), and takes that for the share its root is off by; doubled for the
# division, and a little for terms of second order. What we give is as good as T_ULPS says all the same.
OFF_SHARE = 1.01 * 2.0**-25

# Products of a triangle's edges that underflow: the bounds of n.a and n.d have 2^-1020 each for them (vec.py, TINY),
# doubled for the division, and once more for the slope that is only known to half of itself.
UNDERFLOW = 4.0 * 2.0**-1020

Found = tuple[np.ndarray, np.ndarray, np.ndarray]  # the fields of Conditions


class Conditions(NamedTuple):
    """In units of t."""

    size: np.ndarray  # (n,) what rounding scales with; inf where t is not resolved at all
    slack: np.ndarray  # (n,) what the kernel's bound has on top: OFF_SHARE of half a chord, or what may underflow
    stretch: np.ndarray  # (n,) |d| + 1 / |d| of what is round: the kernel's bounds take 1 + |d|^2 for 2 |d|

    def off_limit(self) -> np.ndarray:
        """(n,) what the bound beside t may be; inf where t is not resolved."""
        return OFF_ULPS * ULP * self.size * self.stretch + self.slack


def conditions(packed: Packed, prim: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> Conditions:
    """Of rays (n, 3), (n, 3) that meet prim[i] at t[i]."""
    shape = packed.shape_of(prim)
    kind, k = packed.kind_of[shape], prim - packed.first[shape] + packed.start[shape]
    out, slack, stretch = np.full(len(prim), np.nan), np.zeros(len(prim)), np.ones(len(prim))
    for place, each in enumerate(packed.kinds):
        rows = np.flatnonzero(kind == place)
        if len(rows):
            with np.errstate(all="ignore"):
                formula = FORMULAS[type(each.prims).__name__]
                found = formula(each.prims, k[rows], o[rows], d[rows], np.abs(t[rows]))
                numbers = found if isinstance(found, tuple) else (found, 0.0, 1.0)
                out[rows], slack[rows], stretch[rows] = numbers
    return Conditions(np.where(np.isnan(out), np.inf, out) + np.abs(t), slack, stretch)


def size(v: np.ndarray) -> np.ndarray:
    return np.abs(v).sum(axis=1)


def inner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=1)


def scaled_exactly(v: np.ndarray) -> np.ndarray:
    """Rows brought to about 1 by powers of two, so that no product leaves the range of float64."""
    return np.ldexp(v, -np.frexp(np.abs(v).max(axis=1))[1][:, None])


def triangles(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> Found:
    """t = a.N / d.N: the first corner and the direction, each against the permanent Q of the edges."""
    a, b, c = (prims.vertices[prims.faces[k, j]] for j in range(3))
    e1, e2 = scaled_exactly(b - a), scaled_exactly(c - a)
    spread = np.abs(e1[:, [1, 2, 0]] * e2[:, [2, 0, 1]]) + np.abs(e1[:, [2, 0, 1]] * e2[:, [1, 2, 0]])
    slope = np.abs(inner(np.cross(e1, e2), d))
    exponents = np.frexp(np.abs(b - a).max(axis=1))[1] + np.frexp(np.abs(c - a).max(axis=1))[1]
    underflow = UNDERFLOW * (1.0 + t) / np.ldexp(slope, exponents)
    condition = (inner(np.abs(a - o), spread) + t * inner(np.abs(d), spread)) / slope
    return condition, underflow, np.ones(len(k))


def planes(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> np.ndarray:
    n = prims.normal[k]
    return np.abs(n).max(axis=1) * (size(prims.point[k] - o) + t * size(d)) / np.abs(inner(n, d))


def seen(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, ...]:
    """The ray in object space, and the magnitudes that it is added up from: (f, e, sizes of f, sizes of e)."""
    m, away = prims.to_object[k], o - prims.center[k]
    f, e = (np.einsum("ijk,ik->ij", m, v) for v in (away, d))
    of_f = np.einsum("ijk,ik->ij", np.abs(m), np.abs(away))
    return f, e, of_f, np.abs(m).max(axis=2) * size(d)[:, None]


def disks(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> np.ndarray:
    _, e, of_f, of_e = seen(prims, k, o, d)
    return (of_f[:, 2] + t * of_e[:, 2]) / np.abs(e[:, 2])


def chord(f: np.ndarray, d: np.ndarray, r: np.ndarray, of_f: np.ndarray, of_d: np.ndarray, t: np.ndarray) -> Found:
    """Half a chord h is sqrt(r^2 - g^2), and g is off as f and t d are: by r / h times that."""
    length = np.sqrt(inner(d, d))
    g = np.cross(f, d / length[:, None])
    h = np.sqrt(np.maximum(r * r - inner(g, g), 0.0))
    return (of_f + r + t * of_d) / length * (r / h), OFF_SHARE * h / length, length + 1.0 / length


def spheres(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> Found:
    f, r = o - prims.center[k], prims.radius[k]
    scale = -np.frexp(r)[1]
    f, r = np.ldexp(f, scale[:, None]), np.ldexp(r, scale)
    found = chord(f, d, r, size(f), np.zeros(len(k)), t)
    return np.ldexp(found[0], -scale), np.ldexp(found[1], -scale), found[2]


def ellipsoids(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> Found:
    f, e, of_f, of_e = seen(prims, k, o, d)
    return chord(f, e, np.ones(len(k)), of_f.sum(axis=1), of_e.sum(axis=1), t)


def cylinders(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> Found:
    f, e, of_f, of_e = seen(prims, k, o, d)
    flat = np.array([1.0, 1.0, 0.0])
    return chord(f * flat, e * flat, np.ones(len(k)), of_f[:, :2].sum(axis=1), of_e[:, :2].sum(axis=1), t)


FORMULAS = {
    "Triangles": triangles,
    "Planes": planes,
    "Disks": disks,
    "Spheres": spheres,
    "Ellipsoids": ellipsoids,
    "Cylinders": cylinders,
}

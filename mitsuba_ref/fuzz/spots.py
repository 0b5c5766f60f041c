"""Places on primitives where rays are likely to be judged wrongly: corners, edges, rims, and any others."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from caster.packing import Packed, count
from caster.wording import SceneError
from mitsuba_ref.fuzz.setting import Rng

SORTS = ("corner", "edge", "beside", "inside")  # beside: just outside of an edge or a rim
BESIDE = (-16.0, -2.0)  # decades of how far outside, in sizes of the primitive


class Spots(NamedTuple):
    """One row a place. Computed in float64, so on the primitive up to rounding; exactly so on the lattice."""

    p: np.ndarray  # (m, 3)
    along: np.ndarray  # (m, 3) a direction within the surface there: of the edge, the rim or a tangent
    n: np.ndarray  # (m, 3) across the surface, of any length


Unit = tuple[np.ndarray, np.ndarray, np.ndarray]  # p, along, n of a shape at the origin
Place = Callable[[Any, np.ndarray, Rng, str], Spots]


class Picks(NamedTuple):
    """Primitives, one a row: k counts within the shape."""

    shape: np.ndarray  # (m,)
    k: np.ndarray  # (m,)


class Targets:
    """The primitives of a packed scene, as something to aim at."""

    def __init__(self, packed: Packed) -> None:
        self.parts = packed.parts
        self.counts = np.array([count(part) for part in packed.parts])

    def pick(self, rng: Rng, count: int) -> Picks:
        """Any shape, then any of its primitives."""
        shape = rng.choice(np.flatnonzero(self.counts), count)
        return Picks(shape, rng.integers(self.counts[shape]))

    def spots(self, rng: Rng, picks: Picks, sort: str | None = None) -> Spots:
        """A place on each of them, of this sort or of any."""
        sorts = (
            np.full(len(picks.k), sort) if sort else rng.choice(SORTS, len(picks.k), p=(0.3, 0.3, 0.2, 0.2))
        )
        out = Spots(*np.zeros((3, len(picks.k), 3)))
        for shape in np.unique(picks.shape):
            for each in np.unique(sorts):
                rows = np.flatnonzero((picks.shape == shape) & (sorts == each))
                if len(rows):
                    part = self.parts[shape]
                    found = place_of(part)(part, picks.k[rows], rng, str(each))
                    for all_rows, some in zip(out, found, strict=True):
                        all_rows[rows] = some
        return out


def place_of(part: Any) -> Place:
    name = type(part).__name__
    if name not in PLACES:
        raise SceneError(
            f"fuzz: no places to aim at on {name}: add a line {name!r}: (a function of the packed arrays, "
            "primitive numbers (m,), a random generator and a sort that gives Spots) to PLACES in "
            "mitsuba_ref/fuzz/spots.py"
        )
    return PLACES[name]


def on_triangles(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> Spots:
    corners = prims.vertices[prims.faces[k]]
    corners = np.take_along_axis(
        corners, rng.permuted(np.tile(np.arange(3), (len(k), 1)), axis=1)[..., None], 1
    )
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    share = shares(rng, len(k))
    along = np.where(rng.random((len(k), 1)) < 0.7, b - a, (b - a) + share * (c - a))
    n = np.cross(b - a, c - a)
    if sort == "corner":
        return Spots(a, along, n)
    if sort == "edge":
        return Spots(a + share * (b - a), b - a, n)
    if sort == "beside":
        out = 10.0 ** rng.uniform(*BESIDE, (len(k), 1))
        return Spots(a + share * (b - a) - out * (c - a), b - a, n)
    return Spots(a + 0.5 * share * (b - a) + 0.5 * shares(rng, len(k)) * (c - a), along, n)


def on_planes(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> Spots:
    n = prims.normal[k]
    side = np.eye(3)[np.argmin(np.abs(n), axis=1)]
    u, v = np.cross(n, side), np.cross(n, np.cross(n, side))
    if sort == "corner":
        return Spots(prims.point[k], u, n)
    at = shares(rng, len(k)) * u + shares(rng, len(k)) * v
    return Spots(prims.point[k] + at, np.where(rng.random((len(k), 1)) < 0.5, u, v), n)


def on_spheres(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> Spots:
    p, along, n = unit_ball(rng, len(k), sort)
    r = prims.radius[k][:, None]
    return Spots(prims.center[k] + r * p, r * along, n)


def on_ellipsoids(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> Spots:
    return carried(prims, k, unit_ball(rng, len(k), sort))


def on_cylinders(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> Spots:
    return carried(prims, k, unit_tube(rng, len(k), sort))


def on_disks(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> Spots:
    return carried(prims, k, unit_disk(rng, len(k), sort))


def carried(prims: Any, k: np.ndarray, unit: Unit) -> Spots:
    """A unit shape's places under p -> center + to_world p."""
    p, along, n = unit
    to_world, to_object = prims.to_world[k], prims.to_object[k]
    moved = prims.center[k] + np.einsum("ijk,ik->ij", to_world, p)
    across = np.einsum("ikj,ik->ij", to_object, n)
    return Spots(moved, np.einsum("ijk,ik->ij", to_world, along), across / np.abs(across).max(initial=1e-300))


def unit_ball(rng: Rng, count: int, sort: str) -> Unit:
    c, s = circle(rng, count)
    turned = rng.permuted(np.column_stack([c, s, np.zeros(count)]), axis=1)
    any_way = rng.normal(size=(count, 3))
    any_way /= np.linalg.norm(any_way, axis=1, keepdims=True)
    u = np.where((sort == "corner") | (rng.random((count, 1)) < 0.3), turned, any_way)
    across = np.cross(u, np.eye(3)[np.argmin(np.abs(u), axis=1)])
    return outside(rng, u, sort), across, u


def unit_tube(rng: Rng, count: int, sort: str) -> Unit:
    c, s = circle(rng, count)
    zero, one = np.zeros(count), np.ones(count)
    z = rng.integers(0, 2, count).astype(float) if sort in ("corner", "beside") else shares(rng, count)[:, 0]
    if sort == "beside":
        z += 10.0 ** rng.uniform(*BESIDE, count) * np.where(z > 0.0, 1.0, -1.0)
    around, upright = np.column_stack([-s, c, zero]), np.column_stack([zero, zero, one])
    along = np.where(rng.random((count, 1)) < 0.5, around, upright)
    return np.column_stack([c, s, z]), along, np.column_stack([c, s, zero])


def unit_disk(rng: Rng, count: int, sort: str) -> Unit:
    c, s = circle(rng, count)
    zero = np.zeros(count)
    rim, around = np.column_stack([c, s, zero]), np.column_stack([-s, c, zero])
    share = shares(rng, count) if sort == "inside" else np.ones((count, 1))
    along = np.where(rng.random((count, 1)) < 0.5, around, rim)
    return share * outside(rng, rim, sort), along, np.tile([0.0, 0.0, 1.0], (count, 1))


def outside(rng: Rng, p: np.ndarray, sort: str) -> np.ndarray:
    return p * (1.0 + 10.0 ** rng.uniform(*BESIDE, (len(p), 1))) if sort == "beside" else p


def circle(rng: Rng, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of the unit circle: on an axis, (3, 4) / 5 up to one rounding, or any."""
    angle = 2.0 * np.pi * rng.random(count)
    c = np.choose(rng.integers(3, size=count), [np.ones(count), np.full(count, 0.6), np.cos(angle)])
    s = np.choose((c == 1.0) + 2 * (c == 0.6), [np.sin(angle), np.zeros(count), np.full(count, 0.8)])
    swap = rng.random(count) < 0.5
    c, s = np.where(swap, s, c), np.where(swap, c, s)
    return c * rng.choice([-1.0, 1.0], count), s * rng.choice([-1.0, 1.0], count)


def shares(rng: Rng, count: int) -> np.ndarray:
    """(count, 1) of 0 to 1; half of them eighths, which leave lattice points on the lattice."""
    eighths = rng.integers(0, 9, (count, 1)) / 8.0
    return np.where(rng.random((count, 1)) < 0.5, eighths, rng.random((count, 1)))


PLACES: dict[str, Place] = {
    "Triangles": on_triangles,
    "Planes": on_planes,
    "Spheres": on_spheres,
    "Ellipsoids": on_ellipsoids,
    "Cylinders": on_cylinders,
    "Disks": on_disks,
}

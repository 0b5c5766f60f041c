"""Adversarial rays, aimed at features of the packed scene."""

from collections.abc import Callable

import numpy as np

from caster.geometry.packing import Kind, Packed
from caster.kernels.protocol import hull_point, hull_size

Rng = np.random.Generator
OD = tuple[np.ndarray, np.ndarray]


def hull_points(kind: Kind) -> np.ndarray:
    """(n, points, 3): what each primitive of a kind stretches between; a triangle's are its corners."""
    count = range(hull_size(kind.prims))
    return np.array([[hull_point(kind.prims, k, j) for j in count] for k in range(len(kind.ids))])


def scene_points(packed: Packed) -> np.ndarray:
    """(n, 3, 3): three points of every primitive; of one without an end, points around its place."""
    rows = []
    for kind in packed.kinds:
        if kind.bounded:
            rows.append(hull_points(kind)[:, :3])
        else:
            rows.append(kind.prims.point[:, None, :] + np.eye(3))
    return np.concatenate(rows)


def size_of(points: np.ndarray) -> float:
    return float(np.ptp(points.reshape(-1, 3), axis=0).max())


def picked(points: np.ndarray, rng: Rng, count: int) -> np.ndarray:
    """(count, 3, 3): points of randomly chosen primitives."""
    return points[rng.integers(len(points), size=count)]


def around(points: np.ndarray, rng: Rng, count: int, sizes: float = 2.0) -> np.ndarray:
    """(count, 3): places up to `sizes` scene sizes away from a primitive."""
    return picked(points, rng, count)[:, 0] + sizes * size_of(points) * rng.uniform(-1.0, 1.0, (count, 3))


def at_random(points: np.ndarray, rng: Rng, count: int) -> OD:
    return around(points, rng, count, 0.5), rng.normal(size=(count, 3))


def unnormalised(points: np.ndarray, rng: Rng, count: int) -> OD:
    """Directions of any length from 1e-30 to 1e30, at points between a primitive's corners."""
    o = around(points, rng, count)
    aim = np.einsum("nj,njc->nc", rng.dirichlet(np.ones(3), count), picked(points, rng, count))
    return o, (aim - o) * 10.0 ** rng.uniform(-30.0, 30.0, (count, 1))


def at_corners(points: np.ndarray, rng: Rng, count: int) -> OD:
    o = around(points, rng, count)
    return o, picked(points, rng, count)[:, 0] - o


def at_edge_midpoints(points: np.ndarray, rng: Rng, count: int) -> OD:
    o, ends = around(points, rng, count), picked(points, rng, count)
    return o, 0.5 * (ends[:, 0] + ends[:, 1]) - o


def from_far_away(points: np.ndarray, rng: Rng, count: int) -> OD:
    o, ends = around(points, rng, count, 1e6), picked(points, rng, count)
    return o, ends.mean(axis=1) - o


def from_inside(points: np.ndarray, rng: Rng, count: int) -> OD:
    """From between a primitive's own points, in any direction."""
    return picked(points, rng, count).mean(axis=1), rng.normal(size=(count, 3))


def along_axes(points: np.ndarray, rng: Rng, count: int) -> OD:
    """One component of d is not zero; the zeros have either sign; o shares coordinates with corners."""
    d = rng.choice([0.0, -0.0], (count, 3))
    d[np.arange(count), rng.integers(3, size=count)] = rng.choice([-1.0, 1.0], count)
    return on_box_planes(points, rng, count), d


def in_a_box_plane(points: np.ndarray, rng: Rng, count: int) -> OD:
    """A component of d is 0.0 or -0.0, and o has that coordinate of a corner: 0 times inf in a slab."""
    o = on_box_planes(points, rng, count)
    d = picked(points, rng, count)[:, 1] - o
    d[np.arange(count), rng.integers(3, size=count)] = rng.choice([0.0, -0.0], count)
    d[~d.any(axis=1), 0] = 1.0
    return o, d


def on_box_planes(points: np.ndarray, rng: Rng, count: int) -> np.ndarray:
    """Places each coordinate of which is that of some corner or, a third of the time, any."""
    corner, anywhere = picked(points, rng, count)[:, 0], around(points, rng, count, 0.5)
    return np.where(rng.random((count, 3)) < 2.0 / 3.0, corner, anywhere)


def in_the_plane_of_three_points(points: np.ndarray, rng: Rng, count: int) -> OD:
    """Edge-on up to rounding: from a place in a triangle's plane, at a place in it or at its corner."""
    ends = picked(points, rng, count)
    o = in_plane(ends, rng.uniform(-5.0, 5.0, (count, 2)))
    aim = in_plane(ends, np.where(rng.random((count, 1)) < 0.5, 0.0, rng.random((count, 2))))
    return o, aim - o


def in_plane(ends: np.ndarray, sides: np.ndarray) -> np.ndarray:
    a, b, c = ends[:, 0], ends[:, 1], ends[:, 2]
    return a + sides[:, :1] * (b - a) + sides[:, 1:] * (c - a)


def grazing(points: np.ndarray, rng: Rng, count: int) -> OD:
    """As in_the_plane_of_three_points, lifted out of it by 1e-16 to 1e-2 of the scene's size."""
    o, d = in_the_plane_of_three_points(points, rng, count)
    return o + 10.0 ** rng.uniform(-16.0, -2.0, (count, 1)) * size_of(points) * rng.normal(size=(count, 3)), d


FAMILIES: tuple[Callable[[np.ndarray, Rng, int], OD], ...] = (
    at_random,
    unnormalised,
    at_corners,
    at_edge_midpoints,
    from_far_away,
    from_inside,
    along_axes,
    in_a_box_plane,
    in_the_plane_of_three_points,
    grazing,
)


def hard_rays(packed: Packed, rng: Rng, count: int) -> dict[str, OD]:
    """`count` rays of every family; none is zero or not finite."""
    points = scene_points(packed)
    families = {family.__name__: family(points, rng, count) for family in FAMILIES}
    for _, d in families.values():
        d[~d.any(axis=1)] = (0.0, -0.0, 1.0)
    return families

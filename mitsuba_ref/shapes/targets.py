"""Random surface points, fields of shapes and mesh files: targets of hard rays, and shapes of the fuzzer."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.error_model.intersections import Array

Rng = np.random.Generator

LATTICE_STEPS = 8  # lattice coordinates are whole multiples of size / 8: their sums and differences are exact
POINT_KINDS = ("corner", "edge", "beside", "inside")  # beside: just outside of an edge or a rim


BESIDE_DECADES = (-16.0, -2.0)  # decades of how far outside, in sizes of the primitive


class SurfacePoints(NamedTuple):
    """Points on surfaces, one a row, in float64: on the primitive up to rounding, exactly so on the lattice."""

    p: Array  # (m, 3)
    along: Array  # (m, 3) a direction within the surface there: of the edge, the rim or a tangent
    n: Array  # (m, 3) across the surface, of any length


# (arrays, k (m,), random generator, one of POINT_KINDS) -> points where hits are hard to decide
PointsFunction = Callable[[Any, Array, Rng, str], SurfacePoints]


def on_unit_shape(points: Callable[[Rng, int, str], SurfacePoints]) -> PointsFunction:
    """Points of a unit shape under p -> center + to_world p. points: of the unit shape."""

    def on_shapes(prims: Any, k: Array, rng: Rng, sort: str) -> SurfacePoints:
        p, along, n = points(rng, len(k), sort)
        moved = prims.center[k] + np.einsum("ijk,ik->ij", prims.to_world[k], p)
        across = np.einsum("ikj,ik->ij", prims.to_object[k], n)
        along = np.einsum("ijk,ik->ij", prims.to_world[k], along)
        return SurfacePoints(moved, along, across / np.abs(across).max(initial=1e-300))

    return on_shapes


def pushed_outside(rng: Rng, p: Array, sort: str) -> Array:
    return p * (1.0 + 10.0 ** rng.uniform(*BESIDE_DECADES, (len(p), 1))) if sort == "beside" else p


def unit_circle_points(rng: Rng, count: int) -> tuple[Array, Array]:
    """Points of the unit circle: on an axis, at (3, 4) / 5 up to one rounding, or anywhere."""
    angle = 2.0 * np.pi * rng.random(count)
    c = np.choose(rng.integers(3, size=count), [np.ones(count), np.full(count, 0.6), np.cos(angle)])
    s = np.choose((c == 1.0) + 2 * (c == 0.6), [np.sin(angle), np.zeros(count), np.full(count, 0.8)])
    swap = rng.random(count) < 0.5
    c, s = np.where(swap, s, c), np.where(swap, c, s)
    return c * rng.choice([-1.0, 1.0], count), s * rng.choice([-1.0, 1.0], count)


def random_fractions(rng: Rng, count: int) -> Array:
    """(count, 1) numbers from 0 to 1; half of them are eighths, which keep lattice points on the lattice."""
    eighths = rng.integers(0, 9, (count, 1)) / 8.0
    return np.where(rng.random((count, 1)) < 0.5, eighths, rng.random((count, 1)))


def random_point(rng: Rng, lattice: bool) -> list[float]:
    """A point in the cube [-1, 1]^3, in units of the shape."""
    steps = rng.integers(-LATTICE_STEPS, LATTICE_STEPS + 1, 3) / LATTICE_STEPS if lattice else rng.uniform(-1.0, 1.0, 3)
    return list(steps.tolist())


def random_length(rng: Rng, lattice: bool) -> float:
    if lattice:
        return float(rng.integers(1, LATTICE_STEPS + 1)) / LATTICE_STEPS
    return float(10.0 ** rng.uniform(-1.5, 0.0))


def coin_flip(rng: Rng) -> bool:
    return bool(rng.random() < 0.5)


def random_unit_vectors(rng: Rng, count: int) -> Array:
    """(count, 3) in any direction alike."""
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def random_directions(rng: Rng, count: int) -> Array:
    """(count, 3) of about unit length; some along axes, some with small whole components."""
    any_way = random_unit_vectors(rng, count)
    whole = rng.integers(-3, 4, (count, 3)).astype(float)
    whole[~whole.any(axis=1), 0] = 1.0
    axes = np.eye(3)[rng.integers(3, size=count)] * rng.choice([-1.0, 1.0], (count, 1))
    which = rng.choice(3, (count, 1), p=(0.6, 0.25, 0.15))
    return np.where(which == 0, any_way, np.where(which == 1, whole, axes))


# ---- mesh files: shared edges and corners, slivers, faces without an area ----

MESH_FILES = tuple(
    str(Path(__file__).with_name("meshes") / f"{name}.obj")
    for name in ("octahedron", "dented_icosphere", "fan_of_slivers", "pinched_sheet", "doubled_square")
)

"""Targets of hard rays and random shapes: points on surfaces, small meshes, random fields.

A generator that no longer gives some of its kinds would only make the fuzzer and `knife_edges` weaker: nothing fails.
"""

import math
from typing import Any

import numpy as np
import pytest
from places import scene_of
from triangle_soup import triangle_soup

import caster
from caster.geometry.packing import Triangles, pack
from caster.shapes.cylinder import Cylinders
from caster.shapes.disk import Disks
from caster.shapes.linear_curve import RoundSegments
from caster.shapes.plane import Planes
from caster.shapes.sphere import Ellipsoids, OuterEllipsoids, Spheres
from mitsuba_ref.shapes import KINDS, REFERENCES, targets
from mitsuba_ref.shapes.triangle_meshes import view_triangle

COUNT = 600
PLACE = [{"matrix": [[2, 0.5, 0, 1], [0, 0.75, 0.25, 2], [0.125, 0, -1.5, 3], [0, 0, 0, 1]]}]
SHAPES: dict[type, tuple[Any, ...]] = {
    Spheres: (caster.SphereCloud(centers=((1, 2, 3), (-4, 0, 1)), radii=(0.5, 3.0)),),
    Ellipsoids: (caster.Sphere(to_world=PLACE), caster.Sphere(center=(3, 0, 1), radius=0.5, to_world=PLACE)),
    OuterEllipsoids: (
        caster.EllipsoidCloud(centers=((0, 1, 2), (3, 0, 1)), scales=((1, 2, 3),) * 2, quaternions=((1, 2, 3, 4),) * 2),
    ),
    RoundSegments: (caster.LinearCurve(points=((0, 1, 2), (4, 0, 1), (5, 5, 5)), radii=(1.0, 2.0, 0.5)),),
    Disks: (caster.Disk(to_world=PLACE), caster.Disk(to_world=[{"translate": [1, 2, 3]}])),
    Cylinders: (caster.Cylinder(to_world=PLACE), caster.Cylinder(p0=(1, 0, 0), p1=(4, 1, 1), radius=0.25)),
    Planes: (caster.Plane(point=(1, 2, 3), normal=(1, 2, 4)), caster.Plane(point=(0, 5, 0), normal=(0, -1, 0))),
    Triangles: tuple(
        caster.Triangle(vertices=each)
        for each in (((0, 0, 1), (4, 0, 2), (1, 3, 3)), ((1, 1, 1), (-2, 1, 0), (0, 2, 5)))
    ),
}


def on_hull(prims: Any, k: np.ndarray, p: np.ndarray) -> np.ndarray:
    """How far points are outside of the sphere of the hull that is nearest to them, in its radii."""
    axis, grow, h = prims.end[k] - prims.start[k], np.diff(prims.radius[k], axis=1)[:, 0], p - prims.start[k]
    height = (h * axis).sum(axis=1) + prims.radius[k, 0] * grow
    share = np.clip(height / ((axis * axis).sum(axis=1) - grow * grow), 0.0, 1.0)
    return np.linalg.norm(h - share[:, None] * axis, axis=1) / (prims.radius[k, 0] + share * grow) - 1.0


def in_object_space(prims: Any, k: np.ndarray, p: np.ndarray) -> np.ndarray:
    if hasattr(prims, "radius"):
        return (p - prims.center[k]) / prims.radius[k][:, None]
    return np.linalg.solve(prims.to_world[k], (p - prims.center[k])[..., None])[..., 0]


def outside(prims: Any, k: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(how far points are beyond the outline, how far off the surface that goes on there), in sizes of the shape."""
    if isinstance(prims, Triangles):
        corners = prims.vertices[prims.faces[k]]
        weights = np.linalg.solve(np.swapaxes(corners - 9.0, 1, 2), (p - 9.0)[..., None])[..., 0]  # from another point
        return -weights.min(axis=1), np.abs(weights.sum(axis=1) - 1.0)
    if isinstance(prims, RoundSegments):
        return on_hull(prims, k, p), np.zeros(len(p))
    if isinstance(prims, Planes):
        return np.full(len(p), -1.0), np.abs(((p - prims.point[k]) * prims.normal[k]).sum(axis=1))
    q = in_object_space(prims, k, p)
    if isinstance(prims, Disks):
        return np.hypot(q[:, 0], q[:, 1]) - 1.0, np.abs(q[:, 2])
    if isinstance(prims, Cylinders):
        return np.maximum(-q[:, 2], q[:, 2] - 1.0), np.abs(np.hypot(q[:, 0], q[:, 1]) - 1.0)
    beyond = np.linalg.norm(q, axis=1) - 1.0
    return beyond, np.zeros(len(p))


def decades_are_spread(x: np.ndarray) -> bool:
    """From 1e-16 to 1e-2, all of them alike; float64 shows them from 1e-14 or so on."""
    seen = np.log10(x[x > 1e-13])
    return x.min() > -1e-13 and x.max() < 1.001e-2 and np.histogram(seen, 5, (-13.0, -2.0))[0].min() > 0.08 * len(x)


def test_every_kind_has_a_shape_here():
    assert set(SHAPES) == set(KINDS)


@pytest.mark.parametrize("sort", targets.POINT_KINDS)
@pytest.mark.parametrize("kind", SHAPES, ids=lambda kind: kind.__name__)
def test_points_lie_on_a_surface_on_its_outline_or_just_outside(kind, sort):
    (found,) = pack(scene_of(*SHAPES[kind])).kinds
    prims, k = found.prims, np.arange(COUNT) % 2
    points = KINDS[kind].surface_points(prims, k, np.random.default_rng([3, len(sort)]), sort)
    beyond, off = outside(prims, k, points.p)
    assert off.max() < 1e-12
    assert (np.abs((points.along * points.n).sum(axis=1)) < 1e-11 * np.abs(points.along).max()).all()
    assert (np.linalg.norm(points.along, axis=1) > 0.0).all() and (np.linalg.norm(points.n, axis=1) > 0.0).all()
    if kind is Spheres:
        assert np.abs(np.cross(points.p - prims.center[k], points.n)).max() < 1e-9 * np.abs(points.n).max()
    if kind is Planes:
        assert sort != "corner" or np.array_equal(points.p, prims.point[k])
    elif sort == "beside":
        assert decades_are_spread(beyond)
    elif sort == "inside" and kind not in (Spheres, Ellipsoids, OuterEllipsoids, RoundSegments):
        assert beyond.max() < 1e-12 and np.median(beyond) < -0.02
    elif kind is not Cylinders or sort == "corner":
        assert np.abs(beyond).max() < 1e-12
    assert len(np.unique(np.round(points.p[k == 0], 6), axis=0)) > (2 if sort == "corner" else 20) or kind is Planes


@pytest.mark.parametrize("lattice", [False, True])
@pytest.mark.parametrize("reference", REFERENCES.values(), ids=lambda each: each.type_name)
def test_random_fields_describe_a_shape_and_are_of_the_lattice_where_it_says_so(reference, lattice):
    rng = np.random.default_rng([8, lattice])
    found = [reference.random_fields(rng, lattice) for _ in range(200)]
    for fields in found[:20]:
        reference.describes.model_validate(fields)
    for name in ("center", "centers", "point", "vertices", "p0"):
        numbers = [np.ravel(each[name]) for each in found if name in each]
        assert not numbers or bool((np.concatenate(numbers) * 8.0 % 1.0 == 0.0).all()) is lattice
    assert len({repr(fields) for fields in found}) > 1 or not found[0] or reference.type_name == "teapot"


# ---- what is measured at a triangle for the known defects


@pytest.mark.parametrize(
    ("t", "beyond"),
    [
        (1.0, True),
        (2.0 - 1e-5, True),
        (2.0, False),
        (2.5, False),
        (4.0, False),
        (4.0 + 1e-5, True),
        (9.0, True),
        (-3.0, True),
    ],
)
def test_a_t_is_beyond_the_corners_of_a_triangle_before_the_nearest_or_behind_the_farthest(t, beyond):
    """Corners at t = 2, 3 and 4 of a ray of length 2; 1e-6 beyond them is rounding."""
    prims = triangle_soup(np.array([[5.0, 0, 2], [-1, 7, 4], [2, -3, 6]]))
    o, d = np.array([7.0, 0.0, -2.0]), np.array([0.0, 0.0, 2.0])
    for off in (0.0, 1e-6, -1e-6):
        assert view_triangle(prims, 0, o, d, t + off).beyond_corners is beyond


def test_a_triangle_is_as_slender_as_its_height_over_its_longest_edge():
    corners = np.array([[0.0, 0, 0], [4, 0, 0], [1, 0.5, 0], [2, 0, 0], [0, 0, 0]])
    prims = triangle_soup(corners[[0, 1, 2, 2, 0, 1, 0, 1, 3, 0, 4, 4]])
    d = np.array([3.0, 0.0, 4.0])
    views = [view_triangle(prims, k, np.ones(3), d, 1.0) for k in range(4)]
    assert [view.slenderness for view in views] == [0.125, 0.125, 0.0, 0.0]
    assert [view.without_area for view in views] == [False, False, True, True]
    assert [view.cosine for view in views] == pytest.approx([0.8, 0.8, 1.0, 1.0]) and math.isfinite(views[3].cosine)

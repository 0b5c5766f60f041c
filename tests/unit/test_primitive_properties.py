"""Hulls and projections of each kind and camera, against independent formulas."""

import math

import numpy as np
import pytest
from places import scene_of
from triangle_soup import triangle_soup

from caster import cast
from caster.cameras import CAMERAS
from caster.geometry.packing import pack
from caster.jit.decorators import implements
from caster.kernels.protocol import camera_ray, hull_point, hull_size, intersect, load, prepare, project, t_lower_bound
from caster.kernels.raster.screen_bounds import edge_line, is_beyond
from caster.shapes import Cylinder, Disk, Sphere, Triangle

ALONG_AXES = [{"scale": [1.0, 2.0, 0.5]}, {"translate": [0.3, -0.7, 5.0]}]  # so that boxes touch what they hold
TURNED = [{"scale": [0.5, 1.5, 1.0]}, {"rotate": {"axis": [1.0, 2.0, 3.0], "degrees": 50.0}}, {"translate": [1, 2, 3]}]
CONVEX = {
    "sphere": Sphere(center=(0.1, 0.2, 0.3), radius=0.7),
    "ellipsoid": Sphere(center=(0.1, 0.2, 0.3), radius=0.7, to_world=ALONG_AXES),
    "cylinder": Cylinder(p0=(0.5, 0.0, -0.5), p1=(0.5, 0.0, 1.5), radius=0.3),
    "stretched cylinder": Cylinder(p0=(0.5, 0.0, -0.5), p1=(0.5, 0.0, 1.5), radius=0.3, to_world=ALONG_AXES),
    "disk": Disk(to_world=[{"scale": 2.0}, {"translate": [1.0, 2.0, 3.0]}]),
    "triangle": Triangle(vertices=((0.0, 0.0, 0.0), (1.0, 0.0, 0.5), (0.0, 1.0, 2.0))),
}
HITS = 1500


@pytest.mark.parametrize("name", CONVEX)
def test_the_hull_of_a_primitive_holds_its_surface_and_touches_it(name):
    scene = scene_of(CONVEX[name])
    (kind,) = pack(scene).kinds
    hull = np.array([hull_point(kind.prims, 0, j) for j in range(hull_size(kind.prims))])
    low, high = hull.min(axis=0), hull.max(axis=0)
    rng = np.random.default_rng([150, list(CONVEX).index(name)])
    aim = rng.uniform(low, high, (4 * HITS, 3))
    o = aim + 10.0 * rng.normal(size=aim.shape)
    p = cast(scene, o, aim - o).position
    p = p[np.isfinite(p).all(axis=1) & (cast(scene, o, aim - o).shape_id >= 0)]
    assert len(p) >= HITS // 2
    size = np.linalg.norm(high - low)
    assert (p >= low - 1e-12 * size).all() and (p <= high + 1e-12 * size).all()
    u = rng.normal(size=(3, 200))  # a convex hull holds what it reaches as far as in every direction
    u /= np.linalg.norm(u, axis=0)
    assert ((p @ u).max(axis=0) <= (hull @ u).max(axis=0) + 1e-12 * (size + np.abs(hull).max())).all()
    assert (p.min(axis=0) - low).max() < 0.05 * size and (high - p.max(axis=0)).max() < 0.05 * size


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda cls: cls.__name__)
def test_a_ray_projects_to_its_pixel_and_a_step_moves_it_no_further_than_stated(camera):
    if "look_at" not in camera.model_fields:
        return
    shift = {"principal_point": (0.1, -0.2)} if "principal_point" in camera.model_fields else {}
    packed = camera(eye=(0.1, 0.2, 0.3), look_at=(1.0, -0.5, 2.0), **shift).pack(80, 60)
    if not implements(project, type(packed)):
        return
    rng, moves = np.random.default_rng(153), []
    for _ in range(200):
        x, y = rng.uniform(0.0, 80.0), rng.uniform(0.0, 60.0)
        o, d, _, t_max = camera_ray(packed, x, y)
        t = 10.0 ** rng.uniform(-2.0, 2.0)
        p = np.array(o) + t * np.array(d)
        found = project(packed, tuple(p))
        if t_max < 0.0 or not found[4]:
            continue
        assert found[:2] == pytest.approx((x, y), abs=1e-9) and found[2] > 0.0
        step = 1e-4 * t * rng.normal(size=3)
        moved = project(packed, tuple(p + step))
        length = np.hypot(moved[0] - found[0], moved[1] - found[1])
        moves.append(length / (found[2] * np.linalg.norm(step)))
    assert len(moves) >= 50 and max(moves) <= 1.0 + 1e-2


def test_the_lower_bound_of_a_packet_keeps_a_ray_at_an_edge():
    """A bundle of one ray, at an edge up to rounding: what `intersect` leaves open is not culled."""
    rng, undecided = np.random.default_rng(154), 0
    for _ in range(200):
        prims = triangle_soup(rng.normal(size=(3, 3)))
        o, share = rng.normal(size=3), rng.random()
        d = share * prims.vertices[0] + (1.0 - share) * prims.vertices[1] - o
        pre = prepare(prims, load(prims, 0), tuple(o))
        t, _ = intersect(prims, pre, tuple(d), 0.0, math.inf)
        least = t_lower_bound(prims, pre, tuple(d), tuple(d))
        assert least <= (t if t > 0.0 else 1.0 + 1e-9)
        undecided += t == 0.0
    assert undecided >= 50


def doubled_area(a: np.ndarray, b: np.ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def test_a_point_beyond_an_edge_is_in_no_triangle_with_corners_within_the_bound():
    rng, found = np.random.default_rng(155), 0
    for _ in range(1500):
        wide = 10.0 ** rng.uniform(-3.0, 0.5)
        corners, point = rng.uniform(-10.0, 10.0, (3, 2)), rng.uniform(-11.0, 11.0, 2)
        a, b, c = ((*corner, wide, 1.0) for corner in corners)
        assert not is_beyond(edge_line(a, b, c, math.inf), *point)
        if is_beyond(edge_line(a, b, c, wide), *point):
            found += 1
            for _ in range(8):
                moved = corners + wide * rng.choice([-1.0, 1.0], (3, 2)) - point
                areas = [doubled_area(moved[i], moved[i - 2]) for i in range(3)]
                assert min(areas) < 0.0 < max(areas)
    assert found >= 300  # it says something

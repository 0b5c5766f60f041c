"""Screen bounds contain the pixels of all rays that hit a primitive, and few others."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from triangle_soup import triangle_soup

from caster.cameras import Fisheye, Orthographic, Panorama, Pinhole, pinhole
from caster.jit.simd import LANES
from caster.kernels.protocol import (
    camera_ray,
    distortion_bound,
    intersect,
    load,
    prepare,
    project,
    project_bounding_sphere,
    t_lower_bound,
)
from caster.kernels.raster.screen_bounds import PROJECTION_MARGIN, ScreenBounds, Window, bound_hulls, project_vertices
from caster.kernels.raster.tile import DX, DY, DZ, PRIM, T_ERROR, UNCERTAIN, T, generate_camera_rays, new_tile
from caster.kernels.raster.tile import HEIGHT as TILE_HEIGHT
from caster.kernels.raster.tile import WIDTH as TILE_WIDTH
from caster.kernels.raster.tile_casting import cast_in_bounds, direction_bounds

WIDTH, HEIGHT = 300, 200
POSE: dict[str, Any] = {"eye": (0.3, -0.2, 0.7), "direction": (0.2, -0.5, 0.8), "up": (0.1, 1.0, 0.0)}
CAMERAS = {
    "pinhole": Pinhole(fov=80.0, principal_point=(0.1, -0.2), **POSE),
    "orthographic": Orthographic(width=3.0, **POSE),
    "fisheye": Fisheye(fov=180.0, **POSE),
    "wider fisheye": Fisheye(fov=250.0, **POSE),
    "wide fisheye": Fisheye(fov=360.0, **POSE),
    "narrow fisheye": Fisheye(fov=30.0, **POSE),
    "panorama": Panorama(**POSE),
}
BOUND_MARGIN_PIXELS = 2.0**-10  # pixels, as in screen_bounds.py: what roundings may take
COUNT = 400


def film_rays(camera: Any, rng: np.random.Generator, scale: int = 1) -> Any:
    """(film position, origin, direction, distance) of rays, on a film that is so many times as large."""
    for _ in range(COUNT):
        x, y = rng.uniform(0.0, scale * WIDTH), rng.uniform(0.0, scale * HEIGHT)
        o, d, _, t_max = camera_ray(camera, x, y)
        if t_max >= 0.0:
            yield (x, y), np.array(o), np.array(d), 10.0 ** rng.uniform(-2, 2)


def met_balls(camera: Any, rng: np.random.Generator, reach: float) -> Any:
    """(film position, centre, radius) of spheres that the ray there hits, most of them near their rim.

    reach: radii are up to so many times the distance.
    """
    for at, o, d, t in film_rays(camera, rng):
        r = t * reach * rng.uniform(0.01, 1.0)
        side = np.cross(d, rng.normal(size=3))
        aside = side / np.linalg.norm(side) * r * (1.0 - 1e-9)
        yield at, tuple(o + t * d + aside), r


def overlap(camera: Any, rng: np.random.Generator, reach: float) -> np.ndarray:
    """(n, 4) how far from each side of the box each film position lies, over the box's size; negative: outside."""
    found = []
    for (x, y), center, r in met_balls(camera, rng, reach):
        left, top, right, bottom, depth, valid = project_bounding_sphere(camera, center, r)
        if valid and left > -math.inf:
            inside = np.array([x - left, right - x, y - top, bottom - y]) + BOUND_MARGIN_PIXELS
            found.append(inside / (max(right - left, bottom - top) + BOUND_MARGIN_PIXELS))
            assert depth <= np.linalg.norm(np.array(center) - camera.eye) - r + 1e-12 * (1.0 + r)
    return np.array(found)


@pytest.mark.parametrize("reach", [0.001, 0.03, 0.3])
@pytest.mark.parametrize("name", CAMERAS)
def test_the_box_of_a_sphere_holds_every_ray_that_hits_it_and_touches_some(name, reach):
    rng = np.random.default_rng([140, list(CAMERAS).index(name)])
    found = overlap(CAMERAS[name].pack(WIDTH, HEIGHT), rng, reach)
    assert len(found) > COUNT // 4 and found.min() >= 0.0
    # a rim's nearest point is in the middle of a side for some: each side is as near as it may be
    assert np.quantile(found.min(axis=1), 0.1) < 0.05 and np.quantile(found, 0.05, axis=0).max() < 0.12


def hits_exactly(o: Any, d: Any, center: Any, r: float) -> bool:
    """Whether a line comes within r of a centre."""
    f, d = [Fraction(c) - Fraction(x) for c, x in zip(center, o, strict=True)], [Fraction(x) for x in d]
    across = sum((f[i - 1] * d[i] - f[i] * d[i - 1]) ** 2 for i in range(3))
    return bool(across <= Fraction(r) ** 2 * sum(x * x for x in d))


def test_the_box_of_a_sphere_allows_for_the_rounding_of_angles():
    """Of a fisheye so narrow that the rounding of a direction is a share of a pixel."""
    camera, hits = Fisheye(fov=1e-10, **(POSE | {"eye": (0.0, 0.0, 0.0)})).pack(WIDTH, HEIGHT), 0
    for (x, y), center, r in met_balls(camera, np.random.default_rng(141), 1e-11):
        o, d, *_ = camera_ray(camera, x, y)
        if hits_exactly(o, d, center, r):
            left, top, right, bottom, _, valid = project_bounding_sphere(camera, center, r)
            inside = min(x - left, right - x, y - top, bottom - y)
            assert valid and inside >= -BOUND_MARGIN_PIXELS
            hits += 1
    assert hits > COUNT // 8


@pytest.mark.parametrize("name", ["fisheye", "narrow fisheye"])
def test_spheres_that_no_ray_hits_are_nowhere(name):
    camera = CAMERAS[name].pack(WIDTH, HEIGHT)
    behind = np.array(camera.eye) - 5.0 * np.array(camera.forward)
    left, top, right, bottom, _, valid = project_bounding_sphere(camera, tuple(behind), 0.5)
    assert valid and left > right and top > bottom


@pytest.mark.parametrize("name", ["fisheye", "panorama"])
@pytest.mark.parametrize("size", [1e-200, 1e-130, 1e130, 1e200, math.inf])
def test_where_nothing_is_known_nothing_is_stated(name, size):
    """Sizes without squares, an eye in the ball, a ball without an end."""
    camera = CAMERAS[name].model_copy(update={"eye": (0.0, 0.0, 0.0)}).pack(WIDTH, HEIGHT)
    for r in (0.1 * size, 10.0 * size, math.inf):
        *_, depth, valid = project_bounding_sphere(camera, (min(size, 1e300), 0.0, 0.0), r)
        assert not valid and depth <= min(size, 1e300) - r


def fields(tile: np.ndarray, box: Any, field: Any) -> np.ndarray:
    """A field of the pixels of a box."""
    rows = tile[int(field) : int(field) + TILE_WIDTH * TILE_HEIGHT].reshape(TILE_HEIGHT, TILE_WIDTH)
    return rows[: box[3] - box[1], : box[2] - box[0]]


def off_the_line(camera: Any, rng: np.random.Generator) -> list[float]:
    """How far rays through edges of small triangles pass from the line through their ends, over what `bent` allows."""
    found = []
    for at, o, d, t in film_rays(camera, rng, FINE):
        along = t * 10.0 ** rng.uniform(-2, -1.4) * rng.normal(size=3)
        across = along + 1e-6 * t * rng.normal(size=3)  # a needle: of what is allowed, others need less
        corners = o + t * d + [along, -rng.uniform(0.8, 1.2) * along, across]
        seen = np.array([project(camera, tuple(p)) for p in corners])
        more, share, valid = distortion_bound(camera, math.hypot(*np.ptp(seen[:, :2], axis=0)))
        if valid and seen[:, 4].all():
            start, end = seen[0, :2], seen[1, :2]
            edge, aside = end - start, at - start
            off = abs(edge[0] * aside[1] - edge[1] * aside[0]) / math.hypot(*edge)
            found.append(off / (more + BOUND_MARGIN_PIXELS))
            assert seen[:, 3].min() * share <= t * (1.0 + 1e-12)
    return found


FINE = 10  # pixels are so much smaller, so that BOUND_MARGIN_PIXELS is little beside what is measured
BENDING = ("fisheye", "wider fisheye", "narrow fisheye", "panorama")


@pytest.mark.parametrize("name", BENDING)
def test_the_distortion_bound_holds_for_edges(name):
    found = off_the_line(CAMERAS[name].pack(FINE * WIDTH, FINE * HEIGHT), np.random.default_rng(143))
    assert len(found) > COUNT // 4 and max(found) <= 1.0
    assert max(found) > 0.06  # 5 / 8 for a line, less since angles are taken from pictures that stretch them


@pytest.mark.parametrize("name", BENDING)
def test_the_pixels_of_a_triangle_hold_its_curved_edges_on_every_side(name):
    """Edges bend out of the box of their corners by more than a pixel, to each side, and none leaves its pixels."""
    size = 50 * WIDTH, 50 * HEIGHT
    camera, rng, count = CAMERAS[name].pack(*size), np.random.default_rng(148), 400
    corners, inside = [], []
    while len(corners) < count:
        at = rng.uniform(0.2, 0.8, 2) * size
        half = rng.choice([(0, 1), (1, 0)]) * rng.uniform(0.02, 0.1) * size[1]  # the edge is upright or level
        rays = [camera_ray(camera, *each) for each in (at, at - half, at + half)]
        if min(t_max for *_, t_max in rays) >= 0.0:
            middle, start, end = (np.array(o) + 3.0 * np.array(d) for o, d, *_ in rays)
            corners.append([start, end, middle + 1e-3 * rng.normal(size=3)])
    points = np.array(corners).reshape(-1, 3)
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    window, reach = Window(0, 0, *size), (0.0, PROJECTION_MARGIN)
    bounds = ScreenBounds(np.zeros((count, 4), np.int32), np.zeros(count), faces, np.zeros((3 * count, 4)))
    project_vertices(points, camera, window, bounds.projected, reach, 0, 3 * count)
    bound_hulls(points, faces, camera, window, bounds, reach, 0, count)
    beyond = np.zeros(4, int)  # left, top, right, bottom
    for k in range(count):
        a, b = points[3 * k : 3 * k + 2]
        seen = np.array([project(camera, tuple(a + s * (b - a))) for s in np.linspace(0.0, 1.0, 17)])
        if not seen[:, 4].all() or np.abs(np.diff(seen[:, :2], axis=0)).max() > min(size) / 4:  # around the seam
            continue
        low, high = np.clip(seen[:, :2].min(axis=0), 0, size), np.clip(seen[:, :2].max(axis=0), 0, size)
        pixels = bounds.pixels[k]
        # pixels whose centres the edge passes
        assert (np.ceil(low - 0.5) >= pixels[:2]).all() and (np.floor(high + 0.5) <= pixels[2:]).all()
        box = bounds.projected[3 * k : 3 * k + 3, :2]
        beyond += [*(box.min(axis=0) - low > 1.0), *(high - box.max(axis=0) > 1.0)]
        inside.append(np.prod(pixels[2:] - pixels[:2]) < np.prod(size) / 16)
    curved = beyond[1::2] if name == "panorama" else beyond  # which draws upright lines straight
    assert curved.min() >= 10 and np.mean(inside) > 0.5, (beyond, np.mean(inside))


def test_no_ray_of_a_packet_hits_a_triangle_before_its_lower_bound_of_t():
    rng, hits, never, near = np.random.default_rng(142), 0, 0, []
    for _ in range(600):
        prims = triangle_soup(rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-1, 1) + rng.normal(size=3))
        o = tuple(rng.normal(size=3))
        wide = 10.0 ** rng.uniform(-3, -0.3)
        middle = rng.dirichlet((1.0, 1.0, 1.0)) @ prims.vertices - o if rng.random() < 0.7 else rng.normal(size=3)
        many = middle / np.linalg.norm(middle) + wide * rng.uniform(-0.5, 0.5, (12, 3))
        low, high = tuple(many.min(axis=0)), tuple(many.max(axis=0))
        pre = prepare(prims, load(prims, 0), o)
        least = t_lower_bound(prims, pre, low, high)
        met = [t for t, off in (intersect(prims, pre, tuple(d), 0.0, math.inf) for d in many) if 0.0 < t < math.inf]
        assert all(t >= least for t in met), (met, least)
        hits, never = hits + len(met), never + (least == math.inf)
        near.extend(t / least for t in met if wide < 0.01)
    assert hits > 2000 and never > 100
    assert np.median(near) < 1.05  # it says something


def test_what_a_tile_has_covered_hides_what_lies_behind_and_changes_no_hit():
    """A wall at depth 1 is hit everywhere, and another at depth 2 is as many tries as make the tile look at it.

    Then come triangles of a few pixels: before the first wall, just behind it, on both sides of it, and far behind.
    """
    camera = Pinhole(fov=40.0, eye=(0.0, 0.0, 0.0), direction=(0.0, 0.0, 1.0)).pack(TILE_WIDTH, TILE_HEIGHT)
    window, box = Window(0, 0, TILE_WIDTH, TILE_HEIGHT), (0, 0, TILE_WIDTH, TILE_HEIGHT)
    small = [(8, 8, 24, 16), (40, 40, 56, 48), (64, 16, 80, 24), (104, 48, 120, 56), (0, 56, 16, 64)]
    depths = [(0.99,) * 3, (1.001,) * 3, (0.9, 1.1, 0.9), (1.02,) * 3, (1.9, 1.1, 1.3)]
    points = [(-9.0, -9.0, 2.0), (9.0, -9.0, 2.0), (0.0, 18.0, 2.0)]
    for (x0, y0, x1, y1), at in zip(small, depths, strict=True):
        for x, y, depth in zip((x0, x1, x0), (y0, y0, y1), at, strict=True):
            d = np.array(camera_ray(camera, float(x), float(y))[1])
            points.append(tuple(depth * d / d[2]))
    count = len(points) // 3
    prims, pixels = triangle_soup(np.array(points)), np.array([box, *small], np.int32)
    near, unused = (np.array([2.0, *(min(at) for at in depths)]), (np.zeros((0, 3), np.int32), np.zeros((0, 4))))
    bounds = ScreenBounds(pixels, near, *unused)
    found = []
    for first in (0, 1):  # with the second wall and without it
        tile = new_tile()
        generate_camera_rays(camera, window, box, tile)
        at_wall = slice(int(T), int(T) + TILE_WIDTH * TILE_HEIGHT)
        tile[at_wall] = 1.0 / tile[int(DZ) : int(DZ) + TILE_WIDTH * TILE_HEIGHT]
        order = np.arange(count, dtype=np.int32)
        cast_in_bounds(prims, order, (first, count - first), bounds, 10, box, tile, True)
        found.append([fields(tile, box, field) for field in (T, T_ERROR, PRIM, UNCERTAIN)])
    assert np.array_equal(*found)
    assert np.unique(found[0][2]).tolist() == [-1.0, 11.0, 13.0]  # nothing but the wall, and what is before it


@pytest.mark.parametrize("name", CAMERAS)
def test_the_bounds_of_a_tiles_directions_are_the_least_and_the_largest(name):
    rng, camera = np.random.default_rng(146), CAMERAS[name].pack(WIDTH, HEIGHT)
    for _ in range(6):
        x, y = (int(n) for n in rng.integers((0, 0), (170, 150)))
        box = x, y, x + LANES * int(rng.integers(1, 128 // LANES)), y + int(rng.integers(1, 40))
        tile = new_tile()
        generate_camera_rays(camera, Window(0, 0, WIDTH, HEIGHT), box, tile)
        low, high = direction_bounds(tile, box)
        for d, least, most in zip([fields(tile, box, f) for f in (DX, DY, DZ)], low, high, strict=True):
            assert (least, most) == (d.min(), d.max())


def test_tangents_of_a_circle_are_rounded_outwards():
    """x = m z touches |p - c| = r where (c_x - m c_z)^2 = r^2 (1 + m^2); beyond it the left side is larger."""
    rng, tight = np.random.default_rng(171), 0
    for _ in range(3000):
        z = 10.0 ** rng.uniform(-3.0, 3.0)
        r = z * rng.choice([10.0 ** rng.uniform(-12.0, -0.1), 1.0 - 10.0 ** rng.uniform(-12.0, -0.5)])
        x = float(rng.choice([0.0, r, -r, z, rng.normal() * z, rng.normal() * r]))
        for m, side in zip(pinhole.tangents(x, z, r), (-1, 1), strict=True):
            aside = side * (Fraction(m) * Fraction(z) - Fraction(x))
            assert aside > 0 and aside**2 >= Fraction(r) ** 2 * (1 + Fraction(m) ** 2), (x, z, r, side)
            nearer = m - side * 2.0**-40 * abs(m)
            tight += (
                Fraction(r) ** 2 * (1 + Fraction(nearer) ** 2) > (Fraction(nearer) * Fraction(z) - Fraction(x)) ** 2
            )
    assert tight > 3000  # of 6000, that are not much larger than they have to be

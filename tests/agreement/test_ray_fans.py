"""Arrays of rays that share a point, cast as fans, have the hits of brute force."""

import numpy as np
import pytest
from random_scenes import KINDS, name, random_scene
from same_bits import assert_same_bits
from test_shadow_fans import hull_points

from caster.cameras import Pinhole
from caster.geometry.packing import packed
from caster.kernels.bvh.build import LEAF_SIZE
from caster.kernels.nearest import Rays
from caster.kernels.raster.tile import WIDTH
from caster.rendering import ray_fans
from caster.rendering.casting import find_nearest
from caster.rendering.hits import validated_rays
from caster.rendering.images import camera_rays
from caster.scene.model import Scene
from caster.shapes import SHAPES, Sphere

COUNT = 640
PRIMITIVES = 10 * LEAF_SIZE  # at least, in a scene: a tree of some levels
CUBE = next(shape for shape in SHAPES if name(shape) == "cube")
WITH_TREES = [shape for shape in KINDS if name(shape) != "plane"]
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


def scene_of(shapes, size, seed, count=None):
    """Primitives for a tree of some leaves: many shapes of one primitive, or a few meshes."""
    rng = np.random.default_rng(seed)
    offset = float(rng.choice([0.0, 30.0])) * size
    if count is None:
        one = packed(random_scene(np.random.default_rng(seed), shapes[:1], Pinhole, count=1))
        count = max(3, -(-PRIMITIVES // int(one.first[-1])))
    arrays = packed(random_scene(rng, shapes, Pinhole, count=count, size=size, offset=offset))
    return arrays, rng


def points(arrays, rng, size):
    """Where rays start or end: around the shapes, among them, on one of them, and far away."""
    middle = hull_points(arrays, rng, 1)[0]
    yield middle + size * rng.normal(size=3)
    yield middle + 4.0 * size * rng.normal(size=3)
    yield hull_points(arrays, rng, 1)[0]
    yield middle + 1e7 * size * rng.normal(size=3)


def aims(arrays, rng, size):
    """Points to aim at: of hulls, and close beside them."""
    through = hull_points(arrays, rng, COUNT)
    return through + size * rng.choice([0.0, 1e-15, 1e-9, 1e-3, 0.2], (COUNT, 1)) * rng.normal(size=(COUNT, 3))


def from_point(o, arrays, rng, size):
    """Rays of any length that start at one point; some have limits of their own, some are none."""
    d = aims(arrays, rng, size) - o
    d[~np.abs(d).max(axis=1).astype(bool)] = 1.0
    lengths = rng.choice([1.0, 1.0, 1e-3, 1e3], (COUNT, 1))
    t_max = np.where(rng.random(COUNT) < 0.7, np.inf, rng.uniform(0.5, 1.5, COUNT) / lengths[:, 0])
    t_max[rng.random(COUNT) < 0.02] = -1.0
    t_min = np.where(rng.random(COUNT) < 0.8, 0.0, rng.uniform(0.0, 1.0, COUNT) / lengths[:, 0])
    return Rays(np.tile(o, (COUNT, 1)), d * lengths, np.minimum(t_min, np.abs(t_max)), t_max)


def assert_fans_change_nothing(arrays, rays, what):
    """How many rays hit."""
    slow = find_nearest(arrays, rays, "brute-force", 1)
    fast = find_nearest(arrays, rays, threads=2)
    assert_same_bits({"t": slow.t, "prim": slow.prim}, {"t": fast.t, "prim": fast.prim}, what)
    return int((slow.prim >= 0).sum())


def calls_in_rows(monkeypatch, least):
    """Arguments of the tiles of rays in rows, which few rays are enough for, wherever they lead to."""
    calls = []
    real = ray_fans._tiles_in_rows
    monkeypatch.setattr(ray_fans, "MIN_RAYS_IN_ROWS", least)
    monkeypatch.setattr(ray_fans, "MIN_SHARE_IN_VIEW", 0.0)
    monkeypatch.setattr(ray_fans, "_tiles_in_rows", lambda *about: calls.append(about) or real(*about))
    return calls


@pytest.fixture
def as_rows(monkeypatch):
    """Rays from one point are cast as if they were rows of a tile; returns the calls."""
    rows = ray_fans.RayRows(0, WIDTH, COUNT // WIDTH)
    monkeypatch.setattr(ray_fans, "PRIMITIVES_PER_RAY_IN_ROWS", 1e9)
    monkeypatch.setattr(ray_fans, "find_rows", lambda rays: rows)
    return calls_in_rows(monkeypatch, 64)


@pytest.mark.parametrize(
    ("shape", "size"),
    [*((shape, 1.0) for shape in WITH_TREES), (CUBE, 1e-6), (CUBE, 1e5), (Sphere, 1e-6), (Sphere, 1e5)],
    ids=lambda value: value if isinstance(value, float) else name(value),
)
def test_rays_from_one_point_hit_what_they_hit_alone(shape, size, as_rows):
    """In any order: wrong rows change no hit."""
    arrays, rng = scene_of([shape], size, [94, list(SHAPES).index(shape), int(np.log10(size)) + 9])
    hits = [
        assert_fans_change_nothing(arrays, from_point(o, arrays, rng, size), f"from {o}")
        for o in points(arrays, rng, size)
    ]
    assert [count for _, count, _ in as_rows] == 4 * [COUNT] and sum(hits) > COUNT / 2


def test_a_ray_from_elsewhere_hits_what_it_hits_alone(as_rows):
    """Of all kinds of primitives, one with a tree of its own or not; signs of zero make no other origin."""
    arrays, rng = scene_of(list(SHAPES), 1.0, 98, count=LEAF_SIZE + 1)
    rays = from_point(np.zeros(3), arrays, rng, 1.0)
    rays.o[:] = rng.choice([0.0, -0.0], (COUNT, 3))
    assert_fans_change_nothing(arrays, rays, "zeros")
    strays = np.setdiff1d(np.arange(COUNT), np.linspace(0, COUNT - 1, ray_fans.SAMPLED_RAYS).astype(int))[::7]
    rays.o[strays] -= 2.0 * rays.d[strays]
    assert_fans_change_nothing(arrays, rays, "elsewhere")
    assert [count for _, count, _ in as_rows] == 2 * [COUNT]


def test_few_rays_rays_past_everything_and_rays_of_two_origins_are_no_fans(monkeypatch):
    arrays, rng = scene_of([CUBE], 1.0, 100, count=14)
    monkeypatch.setattr(ray_fans, "MIN_RAYS_IN_ROWS", 4096)
    eye = hull_points(arrays, rng, 1)[0] + np.array([0.0, 0.0, 6.0])
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 128), np.linspace(-0.5, 0.5, 128))
    rays = validated_rays(eye, np.stack([x, y, -np.ones_like(x)], -1).reshape(-1, 3), 0.0, np.inf)

    def is_fan(rays):
        return ray_fans.fan_tiles(arrays, rays, 1) is not None

    assert is_fan(rays)
    assert not is_fan(Rays(*(a[:4000] for a in rays)))
    assert not is_fan(Rays(*(a[rng.permutation(x.size)] for a in rays)))
    assert not is_fan(rays._replace(d=rays.d * [1.0, 1.0, -1.0]))  # the other way
    rays.o[::2] += [3.0, 0.0, 0.0]
    assert not is_fan(rays)


# ---- rays in rows


WIDE, HIGH = 131, 9  # a film of two tiles, the second narrow


@pytest.fixture
def in_rows(monkeypatch):
    """Rows are looked for among few rays, too; returns the calls."""
    return calls_in_rows(monkeypatch, 4 * WIDE)


def film_rays(arrays, rng, size, width=WIDE, height=HIGH):
    """Rays of a film from one point at the shapes, of any lengths; some have limits of their own, some are none."""
    middle = hull_points(arrays, rng, 1)[0]
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    eye = middle - 4.0 * size * frame[2]
    x, y = np.meshgrid(np.linspace(-0.3, 0.3, width), np.linspace(-0.2, 0.2, height))
    d = frame[2] + x.reshape(-1, 1) * frame[0] + y.reshape(-1, 1) * frame[1]
    count = len(d)
    t_max = np.where(rng.random(count) < 0.7, np.inf, size * rng.uniform(3.5, 4.5, count))
    t_max[rng.random(count) < 0.02] = -1.0
    t_min = np.where(rng.random(count) < 0.8, 0.0, size * rng.uniform(3.0, 4.0, count))
    return Rays(np.tile(eye, (count, 1)), d, np.minimum(t_min, np.abs(t_max)), t_max)


@pytest.mark.parametrize("shape", WITH_TREES, ids=name)
def test_rays_in_rows_hit_what_they_hit_alone(shape, in_rows):
    """Whole films, arrays that begin and end within a row, and with a ray from elsewhere."""
    arrays, rng = scene_of([shape], 1.0, [104, list(SHAPES).index(shape)])
    rays = film_rays(arrays, rng, 1.0)
    assert ray_fans.find_rows(rays) == (0, WIDE, HIGH)
    assert assert_fans_change_nothing(arrays, rays, "whole") > WIDE
    part = Rays(*(a[57:-20] for a in rays))
    assert ray_fans.find_rows(part) == (WIDE - 57, WIDE, HIGH - 2)
    assert_fans_change_nothing(arrays, part, "part")
    assert [rows for *_, rows in in_rows] == [(0, WIDE, HIGH), (WIDE - 57, WIDE, HIGH - 2)]
    rays.o[-6] = np.nextafter(rays.o[-6], np.inf)
    assert_fans_change_nothing(arrays, rays, "elsewhere")


def test_rows_of_all_kinds_and_of_many_tiles(in_rows):
    """Of kinds without a tree, too, and of more primitives than are projected for so few rays."""
    arrays, rng = scene_of(list(SHAPES), 1.0, 105, count=LEAF_SIZE + 1)
    rays = film_rays(arrays, rng, 1.0, 2 * WIDTH + 1, 65)
    assert_fans_change_nothing(arrays, rays, "all kinds")
    assert len(in_rows) == 1


def film_of(camera, width=200, height=120):
    return camera_rays(Scene(camera=camera, film={"width": width, "height": height}))


@pytest.mark.parametrize("fov", [1.0, 45.0, 150.0])
def test_rows_of_a_film_are_found_also_in_a_part_of_it(fov):
    rays = film_of(Pinhole(eye=(1.0, 2.0, 3.0), look_at=(0.0, 0.0, 0.0), fov=fov))
    assert ray_fans.find_rows(rays) == (0, 200, 120)
    assert ray_fans.find_rows(Rays(*(a[90:-70] for a in rays))) == (110, 200, 118)

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
from caster.rendering.casting import find_any, find_nearest
from caster.rendering.hits import validated_rays
from caster.rendering.images import camera_rays
from caster.scene.model import Scene
from caster.shapes import SHAPES, Sphere

COUNT = 640
PRIMITIVES = 10 * LEAF_SIZE  # at least, in a scene: a tree of some levels
CUBE = next(shape for shape in SHAPES if name(shape) == "cube")
WITH_TREES = [shape for shape in KINDS if name(shape) != "plane"]
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


@pytest.fixture(autouse=True)
def taken(monkeypatch):
    """Cast as fans wherever possible; returns how many rays were."""
    numbers = []
    limits = {"MIN_RAYS_IN_ROWS": 64, "MIN_RAYS_SORTED": 64, "MAX_PATH_IN_ORDER": -1.0, "MIN_SHARE_IN_VIEW": 0.0}
    limits["MIN_RAYS_PER_COUNT"] = 8
    for constant, value in limits.items():
        monkeypatch.setattr(ray_fans, constant, value)
    real = ray_fans.sort_rays

    def sort(*about):
        order = real(*about)
        assert np.array_equal(np.sort(order), np.arange(*about[3]))
        numbers.append(len(order))
        return order

    monkeypatch.setattr(ray_fans, "sort_rays", sort)
    return numbers


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


def to_point(p, arrays, rng, size, rounding):
    """Rays that end at a point: in float64, from float32 differences, or of unit length with the distance as t_max."""
    near = aims(arrays, rng, size)
    o = near + rng.choice([0.0, 1e-9, 0.3, 1.0], (COUNT, 1)) * (near - p)
    if rounding == "float32":
        o = o.astype(np.float32).astype(np.float64)
    d = p - o
    if rounding == "float32":
        d = d.astype(np.float32).astype(np.float64)
    t_max = np.ones(COUNT)
    if rounding == "unit":
        t_max = np.linalg.norm(d, axis=1)
        d, t_max = d / np.where(t_max > 0.0, t_max, 1.0)[:, None], t_max * (1.0 - 1e-12)
    d[~np.abs(d).max(axis=1).astype(bool)] = 1.0
    t_max[rng.random(COUNT) < 0.02] = -1.0
    return Rays(o, d, np.where(rng.random(COUNT) < 0.5, 0.0, 1e-12), t_max)


def assert_fans_change_nothing(arrays, rays, what):
    """How many rays hit."""
    slow = find_nearest(arrays, rays, "brute-force", 1)
    fast = find_nearest(arrays, rays, threads=2)
    assert_same_bits({"t": slow.t, "prim": slow.prim}, {"t": fast.t, "prim": fast.prim}, what)
    return assert_any_hit_is_the_same(arrays, rays, what, slow.prim >= 0)


def assert_any_hit_is_the_same(arrays, rays, what, expected=None):
    if expected is None:
        expected = find_nearest(arrays, rays, "brute-force", 1).prim >= 0
    found = find_any(arrays, rays, 2)
    wrong = np.flatnonzero(expected != found)
    assert not len(wrong), f"{what}: {len(wrong)} of {COUNT}, first {wrong[:3]}"
    return int(expected.sum())


@pytest.mark.parametrize(
    ("shape", "size"),
    [*((shape, 1.0) for shape in WITH_TREES), (CUBE, 1e-6), (CUBE, 1e5), (Sphere, 1e-6), (Sphere, 1e5)],
    ids=lambda value: value if isinstance(value, float) else name(value),
)
def test_rays_from_one_point_hit_what_they_hit_alone(shape, size, taken):
    arrays, rng = scene_of([shape], size, [94, list(SHAPES).index(shape), int(np.log10(size)) + 9])
    hits = [
        assert_fans_change_nothing(arrays, from_point(o, arrays, rng, size), f"from {o}")
        for o in points(arrays, rng, size)
    ]
    assert taken == 8 * [COUNT] and sum(hits) > COUNT / 2


@pytest.mark.parametrize("rounding", ["float64", "float32", "unit"])
@pytest.mark.parametrize("shape", WITH_TREES, ids=name)
@pytest.mark.slow("three roundings of each kind", every=2)
def test_rays_to_one_point_are_blocked_where_they_are_alone(shape, rounding, taken):
    arrays, rng = scene_of([shape], 1.0, [95, list(SHAPES).index(shape)])
    blocked = [
        assert_any_hit_is_the_same(arrays, to_point(p, arrays, rng, 1.0, rounding), f"to {p}")
        for p in points(arrays, rng, 1.0)
    ]
    assert len(taken) >= 1 and sum(blocked) > COUNT / 2


@pytest.mark.parametrize("shape", WITH_TREES, ids=name)
def test_parallel_rays_are_blocked_where_they_are_alone(shape, taken):
    arrays, rng = scene_of([shape], 1.0, [96, list(SHAPES).index(shape)])
    for back in (rng.normal(size=3), np.array([0.0, -2.0, 0.0]), rng.normal(size=3) * [1.0, 1e-9, 1.0]):
        o = aims(arrays, rng, 1.0) - rng.choice([0.0, 1e-9, 1.0], (COUNT, 1)) * back
        limits = rng.choice([np.inf, 1.0], COUNT)
        rays = Rays(o, np.tile(back, (COUNT, 1)), np.zeros(COUNT), limits)
        assert assert_any_hit_is_the_same(arrays, rays, f"along {back}") > COUNT / 40
    assert len(taken) == 3


@pytest.mark.parametrize("kind", ["from", "to", "along"])
def test_an_array_with_one_ray_that_does_not_belong_is_no_fan(kind, taken):
    """Of all kinds of primitives, one with a tree of its own or not."""
    arrays, rng = scene_of(list(SHAPES), 1.0, 97, count=LEAF_SIZE + 1)
    p = next(points(arrays, rng, 1.0))
    rays = from_point(p, arrays, rng, 1.0) if kind == "from" else to_point(p, arrays, rng, 1.0, "float64")
    if kind == "along":
        rays.d[:], rays.t_max[:] = [0.3, 0.2, 1.0], np.inf
    rays.t_max[:] = np.abs(rays.t_max)
    stray = np.setdiff1d(np.arange(COUNT), np.linspace(0, COUNT - 1, ray_fans.SAMPLED_RAYS).astype(int))[7]
    rays.o[stray] += rng.normal(size=3)
    rays.d[stray] = rng.normal(size=3)
    assert assert_any_hit_is_the_same(arrays, rays, kind) > COUNT / 4 and not taken
    rays.t_max[stray] = -1.0  # there is no ray
    assert assert_any_hit_is_the_same(arrays, rays, kind) > COUNT / 4 and taken == [COUNT]


def test_signs_of_zero_in_an_origin_change_no_bit(taken):
    arrays, rng = scene_of(list(SHAPES), 1.0, 98, count=LEAF_SIZE + 1)
    rays = from_point(np.zeros(3), arrays, rng, 1.0)
    rays.o[:] = rng.choice([0.0, -0.0], (COUNT, 3))
    assert_fans_change_nothing(arrays, rays, "zeros")
    assert len(taken) == 2


def test_more_rays_than_are_sorted_at_a_time(monkeypatch, taken):
    monkeypatch.setattr(ray_fans, "MAX_RAYS_SORTED", 400)
    arrays, rng = scene_of([CUBE], 1.0, 99)
    assert_fans_change_nothing(arrays, from_point(next(points(arrays, rng, 1.0)), arrays, rng, 1.0), "chunks")
    assert len(taken) == 4


def test_rays_in_order_past_everything_or_few_are_no_fans(monkeypatch):
    """So are rays that go on beyond the point in common, those to several points, and nearest hits of rays to one."""
    monkeypatch.undo()
    arrays, rng = scene_of([CUBE], 1.0, 100, count=14)
    monkeypatch.setattr(ray_fans, "MIN_RAYS_SORTED", 4096)
    monkeypatch.setattr(ray_fans, "MIN_RAYS_IN_ROWS", 4096)
    middle = hull_points(arrays, rng, 1)[0]
    eye = middle + np.array([0.0, 0.0, 6.0])
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 128), np.linspace(-0.5, 0.5, 128))
    rows = validated_rays(np.tile(eye, (x.size, 1)), np.stack([x, y, -np.ones_like(x)], -1).reshape(-1, 3), 0.0, np.inf)
    mixed = Rays(*(a[rng.permutation(x.size)] for a in rows))
    mixed = mixed._replace(d=rows.d[rng.permutation(x.size)])

    def is_fan(rays, any_hit=False):
        return ray_fans.fan_tiles(arrays, rays, any_hit, 1) is not None

    assert is_fan(mixed) and is_fan(mixed, True)
    assert not is_fan(Rays(*(a[:4000] for a in mixed)))
    monkeypatch.setattr(ray_fans, "find_rows", lambda rays: None)
    assert not is_fan(rows)
    assert not is_fan(mixed._replace(d=mixed.d * [1.0, 1.0, -1.0]))  # the other way
    back = Rays(eye + mixed.d, -mixed.d, mixed.t_min, np.ones(x.size))
    assert is_fan(back, True) and not is_fan(back)
    assert not is_fan(back._replace(t_max=np.full(x.size, 2.0)), True)
    assert not is_fan(back._replace(t_max=np.full(x.size, np.inf)), True)
    back.o[::2] += [3.0, 0.0, 0.0]
    assert not is_fan(back, True)


# ---- rays in rows


WIDE, HIGH = 131, 9  # a film of two tiles, the second narrow


@pytest.fixture
def in_rows(monkeypatch):
    """Rows are looked for among few rays, too; the rows that were cast."""
    monkeypatch.setattr(ray_fans, "MIN_RAYS_IN_ROWS", 4 * WIDE)
    found = []
    real = ray_fans._tiles_in_rows
    monkeypatch.setattr(ray_fans, "_tiles_in_rows", lambda *about: found.append(about[2]) or real(*about))
    return found


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
    assert in_rows == 2 * [(0, WIDE, HIGH)] + 2 * [(WIDE - 57, WIDE, HIGH - 2)]
    rays.o[-6] = np.nextafter(rays.o[-6], np.inf)
    assert_fans_change_nothing(arrays, rays, "elsewhere")


def test_rows_of_all_kinds_and_of_many_tiles(in_rows):
    """Of kinds without a tree, too, and of more primitives than are projected for so few rays."""
    arrays, rng = scene_of(list(SHAPES), 1.0, 105, count=LEAF_SIZE + 1)
    rays = film_rays(arrays, rng, 1.0, 2 * WIDTH + 1, 65)
    assert_fans_change_nothing(arrays, rays, "all kinds")
    assert len(in_rows) == 2


def film_of(camera, width=200, height=120):
    return camera_rays(Scene(camera=camera, film={"width": width, "height": height}))


@pytest.mark.parametrize("fov", [1.0, 45.0, 150.0])
def test_rows_of_a_film_are_found_also_in_a_part_of_it(fov):
    rays = film_of(Pinhole(eye=(1.0, 2.0, 3.0), look_at=(0.0, 0.0, 0.0), fov=fov))
    assert ray_fans.find_rows(rays) == (0, 200, 120)
    assert ray_fans.find_rows(Rays(*(a[90:-70] for a in rays))) == (110, 200, 118)

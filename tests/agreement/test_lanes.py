"""What is handled as vectors gives what its plain text says, bit for bit."""

import numpy as np
import pytest

from caster.aovs import kernel_of
from caster.jit import simd
from caster.jit.decorators import jit
from caster.jit.kernel_cache import COMPILED
from caster.jit.simd import CHILDREN, LANES
from caster.kernels.bvh.traversal import PacketBoxSetup, RayBoxSetup
from caster.kernels.raster import tile as tiles
from caster.kernels.raster.tile import new_lanes
from caster.kernels.surface.per_hit import (
    STRIDE,
    aovs_in_tile,
    aovs_in_tile_by_lanes,
    new_surface_buffer,
    surfaces_in_tile,
    surfaces_in_tile_by_lanes,
)
from caster.kernels.triangles import Triangles
from caster.shapes.plane import Planes
from caster.shapes.sphere import Spheres

# NumPy's scalars warn of an overflow, machine code does not
pytestmark = [] if COMPILED else pytest.mark.filterwarnings("ignore::RuntimeWarning")
compiled_only = pytest.mark.skipif(not COMPILED, reason="without Numba there is only the plain text")
ROWS = tiles.HEIGHT if COMPILED else 6  # of a tile that are looked at


@jit
def intersect_boxes(boxes, node, view, t_min, t_max, near):
    return simd.intersect_boxes(boxes, node, view, t_min, t_max, near)


@jit
def intersect_boxes_packet(boxes, node, view, t_min, t_max, near):
    return simd.intersect_boxes_packet(boxes, node, view, t_min, t_max, near)


@jit
def small_ones(numbers, i, j, limit, mask, answers):
    a, b = np.uint64(i), np.uint64(j)
    answers[0], answers[1] = simd.lane_min(numbers, a), simd.lane_max(numbers, a)
    answers[2] = simd.lane_max_of_sums(numbers, a, b)
    answers[3] = 1.0 if simd.any_sum_reaches(numbers, a, b, limit) else 0.0
    answers[4] = simd.lowest_bit(mask)


@jit
def lanes_in_range(a, i, least, end):
    return simd.lanes_in_range(a, i, least, end)


@jit
def numbers_in_range(a, i, least, end, lanes, into):
    simd.numbers_in_range(a, i, least, end, lanes, into)


@jit
def gather_corners(rows, faces, lanes, numbers, into, step):
    simd.gather_corners(rows, faces, lanes, numbers, into, step)


def wide(rng, *shape):
    """Numbers of all sizes, some 0, some infinite, as t of a miss is."""
    numbers = rng.normal(size=shape) * 10.0 ** rng.integers(-9, 9, shape)
    return np.where(rng.random(shape) < 0.05, rng.choice([0.0, -0.0, np.inf], shape), numbers)


def some_boxes(rng):
    low, high = np.sort(rng.uniform(-1.0, 1.0, (2, 5, 3, CHILDREN)), axis=0)
    none = rng.random((5, 1, CHILDREN)) < 0.2
    return np.concatenate([np.where(none, 2.0, low), np.where(none, -2.0, high)], axis=1).astype(np.float32)


def one_view(rng):
    near = tuple(int(c + 3 * rng.integers(2)) for c in range(3))
    inverse, enter, leave = (tuple(rng.normal(size=3).tolist()) for _ in range(3))
    return RayBoxSetup(near, tuple((3, 5, 7)[c] - near[c] for c in range(3)), inverse, enter, leave)


def several_views(rng):
    one, most = one_view(rng), tuple(rng.normal(size=3).tolist())
    enter = tuple(-np.inf if rng.random() < 0.1 else x for x in one.enter)
    return PacketBoxSetup(one.near, one.far, one.inverse, most, enter, one.leave, 2.0 ** int(rng.integers(-3, 4)))


@compiled_only
@pytest.mark.parametrize(
    ("compiled", "plain", "a_view"),
    [
        (intersect_boxes, simd.intersect_boxes, one_view),
        (intersect_boxes_packet, simd.intersect_boxes_packet, several_views),
    ],
    ids=["one ray", "several rays"],
)
def test_boxes_are_entered_alike(compiled, plain, a_view):
    rng = np.random.default_rng(31)
    masks = []
    for _ in range(300):
        boxes, view, node = some_boxes(rng), a_view(rng), int(rng.integers(5))
        near = np.zeros((2, CHILDREN))
        limits = 0.0, float(rng.choice([1.0, 10.0, np.inf]))
        masks.append(compiled(boxes, node, view, *limits, near[0]))
        assert masks[-1] == plain(boxes, node, view, *limits, near[1])
        assert (near[0] == near[1]).all()
    assert len(set(masks)) > 20  # some of everything


@compiled_only
def test_numbers_of_lanes_are_chosen_alike():
    rng = np.random.default_rng(32)
    for _ in range(300):
        numbers, mask = wide(rng, 4 * LANES), int(rng.integers(1, 1 << CHILDREN))
        i, j = rng.integers(0, 3 * LANES, 2).tolist()
        limit, answers = float(rng.normal()), np.zeros(5)
        small_ones(numbers, i, j, limit, mask, answers)
        assert answers.tolist() == [
            simd.lane_min(numbers, i),
            simd.lane_max(numbers, i),
            simd.lane_max_of_sums(numbers, i, j),
            float(simd.any_sum_reaches(numbers, i, j, limit)),
            simd.lowest_bit(mask),
        ]


def a_range(rng):
    """Numbers of primitives in a tile, some of misses, a place among them, and a range that may begin and end there."""
    least = int(rng.integers(-1, 3))
    numbers = rng.integers(-1, 6, 4 * LANES).astype(float)
    return numbers, np.uint64(rng.integers(3 * LANES)), float(least), float(least + rng.integers(1, 4))


def a_range_and_lanes(rng):
    return *a_range(rng), wide(rng, 4 * LANES), np.uint64(rng.integers(3 * LANES))


def some_faces(rng):
    """Rows, of which some face has the last, faces, and lanes: nine fields to be written, beside numbers of faces."""
    rows, faces = wide(rng, 5, 3), rng.integers(0, 5, (6, 3)).astype(np.int32)
    faces[rng.integers(6), rng.integers(3)] = 4
    lanes, before = wide(rng, 10 * LANES), bool(rng.random() < 0.5)
    numbers, into = (0, LANES) if before else (9 * LANES, 0)
    lanes[numbers : numbers + LANES] = rng.integers(0, 6, LANES)
    return rows, faces, lanes, np.uint64(numbers), np.uint64(into), np.uint64(LANES)


def written_differently(compiled, plain, given):
    """Whether two functions return or leave another bit."""
    one, other = ([x.copy() if isinstance(x, np.ndarray) else x for x in given] for _ in range(2))
    if compiled(*one) != plain(*(int(x) if isinstance(x, np.uint64) else x for x in other)):
        return True
    pairs = zip(one, other, strict=True)
    return any(a.tobytes() != b.tobytes() for a, b in pairs if isinstance(a, np.ndarray))


@compiled_only
@pytest.mark.parametrize(
    ("compiled", "given_by"),
    [(lanes_in_range, a_range), (numbers_in_range, a_range_and_lanes), (gather_corners, some_faces)],
    ids=["in range", "numbers", "corners"],
)
def test_lanes_are_chosen_and_gathered_alike(compiled, given_by):
    rng, plain = np.random.default_rng(34), getattr(simd, compiled.__name__)
    assert not any(written_differently(compiled, plain, given_by(rng)) for _ in range(300))


SIZES = 10.0 ** np.array([0.0, 0.0, 0.0, 3.0, -9.0, 120.0, 152.0, -152.0, -200.0])


def hard_triangles(rng, count):
    """Of all sizes; some thin, some points, some with normals that cancel or vanish."""
    corners = rng.normal(size=(count, 3, 3)) + rng.normal(size=(count, 1, 3))
    thin, point = rng.random(count) < 0.2, rng.random(count) < 0.05
    between = corners[:, 0] + rng.random((count, 1)) * (corners[:, 1] - corners[:, 0])
    corners[thin, 2] = between[thin] + rng.choice([0.0, 1e-13, 1e-9], (count, 1))[thin] * corners[thin, 2]
    corners[point, 1:] = corners[point, :1]
    vertices = (corners * rng.choice(SIZES, (count, 1, 1))).reshape(-1, 3)
    normals = rng.normal(size=(3 * count, 3)) * rng.choice(SIZES, (3 * count, 1))
    normals[rng.random(3 * count) < 0.1] = 0.0
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    smooth, textured = rng.random((2, count)) < 0.6
    return Triangles(vertices, faces, normals, rng.random((3 * count, 2)), smooth, textured)


def hit_tile(rng, prims, count, longest_run=40):
    """Rays of a tile with what they meet, in runs: towards a point of that triangle, some along its plane."""
    tile, pixels = tiles.new_tile(), tiles.PIXELS
    hit = np.repeat(rng.integers(-1, count, pixels), rng.integers(1, longest_run, pixels))[:pixels]
    corners = prims.vertices.reshape(-1, 3, 3)[np.maximum(hit, 0)]
    size = np.abs(corners).max(axis=(1, 2))[:, None] + 1e-300
    p = (corners * rng.dirichlet((1, 1, 1), pixels)[:, :, None]).sum(axis=1)
    along = rng.random((pixels, 1)) < 0.1
    d = np.where(along, (corners[:, 1] - corners[:, 0]) / size, rng.normal(size=(pixels, 3)))
    t = size[:, 0] * rng.random(pixels)
    o = p - t[:, None] * d
    fields = [(tiles.T, t), (tiles.PRIM, hit)]
    fields += [(at, o[:, c]) for c, at in enumerate((tiles.OX, tiles.OY, tiles.OZ))]
    fields += [(at, d[:, c]) for c, at in enumerate((tiles.DX, tiles.DY, tiles.DZ))]
    for at, values in fields:
        tile[int(at) : int(at) + pixels] = values
    return tile


def is_inside(box):
    """Which pixels of a tile a box at its corner has."""
    y, x = np.divmod(np.arange(tiles.PIXELS), tiles.WIDTH)
    return (x < box[2]) & (y < box[3])


@pytest.mark.parametrize("wants_uv", [False, True], ids=["without uv", "with uv"])
@pytest.mark.parametrize("seed", range(6))
def test_surfaces_of_several_pixels_are_those_of_one_at_a_time(seed, wants_uv):
    rng = np.random.default_rng(seed)
    prims, box = hard_triangles(rng, 300), (0, 0, 101, ROWS)
    tile = hit_tile(rng, prims, 300, longest_run=4 if seed % 2 else 40)  # each way of gathering
    for numbers in ((0, 300), (20, 320)):  # the second: others are of another kind
        one, several = new_surface_buffer(), new_surface_buffer()
        surfaces_in_tile(prims, numbers, tile, box, one, wants_uv)
        surfaces_in_tile_by_lanes(prims, numbers, tile, box, several, new_lanes(), wants_uv)
        inside = is_inside(box)
        for field in range(11 if wants_uv else 9):
            rows = slice(field * STRIDE, field * STRIDE + tiles.PIXELS)
            np.testing.assert_array_equal(one[rows][inside], several[rows][inside], str(field))
            assert np.array_equal(np.signbit(one[rows][inside]), np.signbit(several[rows][inside]))


@pytest.mark.parametrize("fields", [(0, 1, 2), (2,), (0, 1)])
@pytest.mark.parametrize("longest_run", [4, 40, 300])
def test_aovs_of_single_fields_are_those_of_the_surfaces(fields, longest_run):
    """By lanes and pixel by pixel, in an image that reaches beyond the tile; other kinds stay as they were."""
    rng = np.random.default_rng([7, longest_run])
    prims, box = hard_triangles(rng, 300), (9, 3, 110, ROWS - 2)
    tile = hit_tile(rng, prims, 300, longest_run)
    names = [name if n in fields else "" for n, name in enumerate(("position", "normal", "shading_normal"))]
    for numbers, misses in (((0, 300), True), ((20, 320), True), ((20, 320), False)):
        buffer, found = new_surface_buffer(), []
        surfaces_in_tile(prims, numbers, tile, box, buffer, False)
        for by_lanes in (False, True):
            images = [np.full((64, 128, 3) if name else (0, 0, 3), 7.0) for name in names]
            out = tuple((kernel_of(name or "normal"), image) for name, image in zip(names, images, strict=True))
            if by_lanes:
                aovs_in_tile_by_lanes(prims, numbers, tile, box, new_lanes(), misses, out)
            else:
                aovs_in_tile(prims, numbers, tile, box, misses, out)
            found.append(images)
        prim = tile[int(tiles.PRIM) : int(tiles.PRIM) + tiles.PIXELS].reshape(tiles.HEIGHT, tiles.WIDTH)
        mine = ((prim >= numbers[0]) & (prim < numbers[1]))[: box[3] - box[1], : box[2] - box[0]]
        for n in fields:
            expected = np.full((64, 128, 3), 7.0)
            inside = expected[box[1] : box[3], box[0] : box[2]]
            inside[~mine] = 0.0 if misses else 7.0
            for c in range(3):
                rows = buffer[(3 * n + c) * STRIDE :][: tiles.PIXELS].reshape(tiles.HEIGHT, tiles.WIDTH)
                inside[mine, c] = rows[: mine.shape[0], : mine.shape[1]][mine]
            for images in found:
                np.testing.assert_array_equal(images[n], expected)


def hard_spheres(rng, count):
    radius = 10.0 ** rng.uniform(-3.0, 3.0, count) * rng.choice([1.0, 1.0, 1e-40, 1e40], count)
    center = rng.normal(size=(count, 3)) * np.abs(radius)[:, None] * 10.0 ** rng.integers(-2, 3, (count, 1))
    return Spheres(center, radius, np.tile(np.eye(3), (count, 1, 1)))


def some_planes(rng, count):
    return Planes(unit(rng.normal(size=(count, 3))), rng.normal(size=(count, 3)))


def unit(v):
    return v / np.linalg.norm(v, axis=1, keepdims=True)


@pytest.mark.parametrize(("kind", "wants_uv"), [("spheres", False), ("planes", False), ("planes", True)])
@pytest.mark.parametrize("seed", range(3))
def test_surfaces_of_several_pixels_of_other_kinds(seed, kind, wants_uv):
    """On average 20 pixels a run; d of length 1 but for a tenth, and t of misses infinite."""
    rng = np.random.default_rng(seed)
    count, pixels, box = 50, tiles.PIXELS, (0, 0, 101, ROWS)
    prims = hard_spheres(rng, count) if kind == "spheres" else some_planes(rng, count)
    hit = np.repeat(rng.integers(-1, count, pixels), rng.integers(1, 40, pixels))[:pixels]
    d, size = unit(rng.normal(size=(pixels, 3))), np.ones((pixels, 1))
    d[rng.random(pixels) < 0.1] *= 3.0
    on = rng.normal(size=(pixels, 3))
    if kind == "spheres":
        size = prims.radius[np.maximum(hit, 0)][:, None]
        on = prims.center[np.maximum(hit, 0)] + size * unit(rng.normal(size=(pixels, 3)))
    t = size[:, 0] * 10.0 ** rng.uniform(-1.0, 1.0, pixels)
    o = on - t[:, None] * d
    t[hit < 0] = np.inf
    tile = tiles.new_tile()
    fields = [(tiles.T, t), (tiles.PRIM, hit)]
    fields += [(at, o[:, c]) for c, at in enumerate((tiles.OX, tiles.OY, tiles.OZ))]
    fields += [(at, d[:, c]) for c, at in enumerate((tiles.DX, tiles.DY, tiles.DZ))]
    for at, values in fields:
        tile[int(at) : int(at) + pixels] = values
    for numbers in ((0, count), (20, 20 + count)):
        one, several = new_surface_buffer(), new_surface_buffer()
        surfaces_in_tile(prims, numbers, tile, box, one, wants_uv)
        surfaces_in_tile_by_lanes(prims, numbers, tile, box, several, new_lanes(), wants_uv)
        inside = is_inside(box)
        for field in range(11 if wants_uv else 9):
            rows = slice(field * STRIDE, field * STRIDE + pixels)
            assert np.isfinite(one[rows][inside & (hit >= numbers[0])]).all()
            np.testing.assert_array_equal(one[rows][inside], several[rows][inside], str(field))
            assert np.array_equal(np.signbit(one[rows][inside]), np.signbit(several[rows][inside]))

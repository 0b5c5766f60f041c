"""Vector operations agree with NumPy, and surfaces of several hits at once with those of single hits, to the bit."""

from typing import Any

import numpy as np
import pytest
from same_bits import bits

import caster
from caster.geometry.packing import pack
from caster.jit import simd
from caster.jit.decorators import jit
from caster.jit.kernel_cache import COMPILED
from caster.jit.simd import CHILDREN, LANES
from caster.kernels.bvh.traversal import PacketAxis, RayAxis
from caster.kernels.math import lanes
from caster.kernels.math.vec import TINY
from caster.kernels.protocol import surface
from caster.kernels.raster import tile as tiles
from caster.kernels.raster.tile import NORMALS, SURFACES, SURFACES_WITH_UV, new_lanes
from caster.kernels.surface.per_hit import STRIDE, new_surface_buffer, surfaces_in_tile
from caster.kernels.triangles import Triangles
from caster.shapes.sphere import Spheres

# NumPy's scalars warn of an overflow, machine code does not
pytestmark = [] if COMPILED else pytest.mark.filterwarnings("ignore::RuntimeWarning")
compiled_only = pytest.mark.skipif(not COMPILED, reason="without Numba there is only the plain text")
ROWS = tiles.HEIGHT if COMPILED else 6  # of a tile that are looked at


def wide(rng, *shape):
    """Numbers of all sizes, some 0, some infinite, as t of a miss is."""
    numbers = rng.normal(size=shape) * 10.0 ** rng.integers(-9, 9, shape)
    return np.where(rng.random(shape) < 0.05, rng.choice([0.0, -0.0, np.inf], shape), numbers)


# ---- operations of vectors: compiled, and as NumPy has them ----

PAIRS = (np.add, np.subtract, np.multiply, np.fmax, np.fmin)


@jit
def every_operation(a: Any, singles: Any, bits: int, out: Any, answers: Any) -> None:
    v, w = simd.load_lanes(a, 3), simd.load_lanes(a, 17)
    simd.store(v + w, out, 0)
    simd.store(v - w, out, 8)
    simd.store(v * w, out, 16)
    simd.store(simd.larger(v, w), out, 24)
    simd.store(simd.lesser(v, w), out, 32)
    simd.store(simd.select(bits, v, w), out, 40)
    simd.store(simd.splat(a[2]), out, 48)
    simd.store(simd.load_children(singles, 2), out, 56)
    answers[0], answers[1] = simd.bits_below(v, w), simd.bits_up_to(v, w)
    answers[2], answers[3] = simd.bits_below(v, v), simd.bits_up_to(v, v)
    answers[4] = simd.lowest_bit(bits)
    out[64], out[65] = simd.least(v), simd.largest(v)


@compiled_only
def test_operations_of_vectors_are_those_of_numpy():
    rng = np.random.default_rng(32)
    for _ in range(300):
        a, singles, chosen = wide(rng, 25), wide(rng, 10).astype(np.float32), int(rng.integers(1, 256))
        a[17:20] = a[3:6]  # some are equal
        v, w, out, answers = a[3:11], a[17:25], np.zeros(66), np.zeros(5, np.int64)
        with np.errstate(all="ignore"):
            pairs = [function(v, w) for function in PAIRS]
        picked = np.where(chosen >> np.arange(8) & 1, v, w)
        expected = np.concatenate([*pairs, picked, np.full(8, a[2]), singles[2:], [v.min(), v.max()]])
        every_operation(a, singles, chosen, out, answers)
        assert np.array_equal(out, expected, equal_nan=True)
        below, up_to = (int(np.packbits(flags, bitorder="little")[0]) for flags in (v < w, v <= w))
        assert answers.tolist() == [below, up_to, 0, 255, (chosen & -chosen).bit_length() - 1]


# ---- tests of several numbers, boxes and points ----


def packed_bits(flags):
    return sum(int(flag) << n for n, flag in enumerate(flags))


def some_boxes(rng):
    low, high = np.sort(rng.uniform(-1.0, 1.0, (2, 5, 3, CHILDREN)), axis=0)
    none = rng.random((5, 1, CHILDREN)) < 0.2
    return np.concatenate([np.where(none, 2.0, low), np.where(none, -2.0, high)], axis=1).astype(np.float32)


def one_view(rng):
    near = [int(c + 3 * rng.integers(2)) for c in range(3)]
    numbers = rng.normal(size=(3, 3))
    if rng.random() < 0.25:  # left half an ulp before it is entered: the padding decides
        numbers[:] = 0.0, 1.0, 1.0 - 2.0**-53
    return tuple(RayAxis(*each) for each in zip(near, *numbers.T.tolist(), strict=True))


def several_views(rng):
    view, unit, most = one_view(rng), 2.0 ** int(rng.integers(-3, 4)), rng.normal(size=3).tolist()
    enters = [-np.inf if rng.random() < 0.1 else axis.enter for axis in view]
    return tuple(
        PacketAxis(axis.near, axis.inverse, *more, axis.leave, unit)
        for axis, *more in zip(view, most, enters, strict=True)
    )


def sides(boxes, node, view):
    """Near and far sides (3, 8) of boxes, and the numbers of each axis but its rows (n, 3, 1)."""
    near = [axis.near for axis in view]
    far = [c + 3 if row < 3 else c for c, row in enumerate(near)]
    return *(boxes[node, rows].astype(float) for rows in (near, far)), np.array(view).T[1:, :, None]


PADDING = 1.0 + 6.0 * 2.0**-53 / (1.0 - 3.0 * 2.0**-53)  # 1 + 2 gamma_3, of Ize (2013)
LATEST = np.finfo(np.float64).max


def entered(enter, leave, t_min, t_max):
    """(bits of boxes, where each is entered) of slabs (3, 8)."""
    enter, leave = np.maximum(enter.max(axis=0), t_min), np.minimum(leave.min(axis=0) * PADDING, t_max)
    return packed_bits(enter <= leave), np.minimum(enter, LATEST)


def entered_by_one(boxes, node, view, *limits):
    near, far, (inverse, enter, leave) = sides(boxes, node, view)
    return entered(near * inverse + enter, far * inverse + leave, *limits)


def entered_by_several(boxes, node, view, *limits):
    near, far, (least, most, enter, leave, unit) = sides(boxes, node, view)
    begin, end = near * unit + enter, far * unit + leave
    with np.errstate(invalid="ignore"):
        return entered(np.fmin(begin * least, begin * most), np.fmax(end * least, end * most), *limits)


@pytest.mark.parametrize(
    ("name", "expected", "a_view"),
    [("intersect_boxes", entered_by_one, one_view), ("intersect_boxes_packet", entered_by_several, several_views)],
)
def test_boxes_are_entered_as_the_formula_says(name, expected, a_view):
    rng, masks = np.random.default_rng(31), []
    for _ in range(300):
        boxes, view, node, near = some_boxes(rng), a_view(rng), int(rng.integers(5)), np.zeros(CHILDREN)
        limits = 0.0, float(rng.choice([1.0, 10.0, np.inf]))
        masks.append(getattr(lanes, name)(boxes, node, view, *limits, near))
        mask, where = expected(boxes, node, view, *limits)
        assert masks[-1] == mask and np.array_equal(near, where)
    assert len(set(masks)) > 20  # some of everything


def a_range(rng):
    """Numbers of primitives in a tile, some of misses, a place, and a range that may begin and end with them."""
    low = float(rng.integers(-1, 3))
    return rng.integers(-1, 6, 4 * LANES).astype(float), int(rng.integers(3 * LANES)), low, low + rng.integers(1, 4)


def some_lines(rng):
    return tuple(tuple(map(float, rng.integers(-3, 4, 3))) for _ in range(3))


def a_plane(rng):
    return tuple(tuple(rng.normal(size=3).tolist()) for _ in range(2)), tuple((0.3 * rng.random(3)).tolist())


def reach(lines, x0, x1, y0, y1):
    """Whether boxes -x1..x0 have a point beyond no line."""
    found = [max(a * x0, -a * x1) + np.maximum(b * y0, -b * y1) + c >= 0.0 for a, b, c in lines]
    return np.all(found, axis=0)


@jit
def sum_reaches(numbers: Any, first: int, second: int, limit: float) -> int:
    return int(lanes.any_sum_reaches(numbers, first, second, limit))


def checks(rng):
    """(name, result, expected result) for each function of lanes.py."""
    numbers, i, low, end = a_range(rng)
    sizes, (j, k) = wide(rng, 4 * LANES), rng.integers(0, 3 * LANES, 2).tolist()
    first, second = sizes[j : j + LANES], sizes[k : k + LANES]
    most = float((first + second).max())
    yield "lane_min", lanes.lane_min(sizes, j), first.min()
    yield "lane_max", lanes.lane_max(sizes, j), first.max()
    yield "lane_max_of_sums", lanes.lane_max_of_sums(sizes, j, k), most
    yield "any_sum_reaches", sum_reaches(sizes, j, k, most), True
    if most < np.inf:
        yield "any_sum_reaches", sum_reaches(sizes, j, k, float(np.nextafter(most, np.inf))), False
    taken = numbers[i : i + LANES]
    within = (low <= taken) & (taken < end)
    yield "lanes_in_range", lanes.lanes_in_range(numbers, i, low, end), packed_bits(within)
    out, expected = wide(rng, 4 * LANES), None
    expected = out.copy()
    expected[j : j + LANES] = np.where(within, taken - low, 0.0)
    lanes.numbers_in_range(numbers, i, low, end, out, j)
    yield "numbers_in_range", out.tolist(), expected.tolist()
    boxes, limits, lines = rng.integers(-4, 5, 3 * 5 * CHILDREN).astype(float), rng.integers(-2, 4, 5), some_lines(rng)
    node = int(rng.integers(3))
    fields = boxes.reshape(3, 5, CHILDREN)[node]
    below = packed_bits((fields <= limits[:, None]).all(axis=0))
    yield "boxes_below", lanes.boxes_below(boxes, node, tuple(map(float, limits))), below
    reached = [
        np.maximum(a * fields[0], -a * fields[1]) + np.maximum(b * fields[2], -b * fields[3]) + c for a, b, c in lines
    ]
    holds = np.all(np.array(reached) >= 0.0, axis=0)
    # of a box of integers that is there; of others, least and largest are the wrong way round
    there = packed_bits((fields[0] <= -fields[1]) & (fields[2] <= -fields[3]))
    yield "boxes_reach_lines", lanes.boxes_reach_lines(boxes, node, lines) & there, packed_bits(holds) & there
    points = rng.integers(-3, 4, 3 * LANES).astype(float)
    x, y = points.reshape(3, LANES)[:2]
    inside = np.all([a * x + b * y + c >= 0.0 for a, b, c in lines], axis=0)
    yield "lanes_within_lines", lanes.lanes_within_lines(points, 0, LANES, lines), packed_bits(inside)
    (p, normal), error = a_plane(rng)
    away = np.array(p)[:, None] - points.reshape(3, LANES)
    height = normal[0] * away[0] + normal[1] * away[1] + normal[2] * away[2]
    off = error[0] * abs(away[0]) + error[1] * abs(away[1]) + error[2] * abs(away[2]) + TINY
    above = lanes.lanes_above(points, 0, LANES, 2 * LANES, (p, normal, error))
    yield "lanes_above", above, packed_bits(height > off)


def test_numbers_boxes_and_points_are_chosen_as_numpy_chooses_them():
    rng = np.random.default_rng(34)
    for _ in range(300 if COMPILED else 30):
        for name, found, expected in checks(rng):
            assert found == expected, name


@jit
def corners_of(rows: Any, faces: Any, out: Any, numbers: int, into: int, step: int) -> None:
    simd.gather_corners(rows, faces, out, numbers, into, step)


def test_corners_of_faces_are_gathered_coordinate_by_coordinate():
    rng = np.random.default_rng(35)
    for _ in range(100):
        rows, faces = wide(rng, 5, 3), rng.integers(0, 5, (6, 3)).astype(np.int32)
        faces[rng.integers(6), rng.integers(3)] = 4  # some face has the last row
        out = wide(rng, 10 * LANES)
        numbers, into = (0, LANES) if rng.random() < 0.5 else (9 * LANES, 0)
        chosen = rng.integers(0, 6, LANES)
        out[numbers : numbers + LANES] = chosen
        expected = out.copy()
        expected[into : into + 9 * LANES] = rows[faces[chosen]].transpose(1, 2, 0).ravel()
        corners_of(rows, faces, out, numbers, into, LANES)
        assert np.array_equal(bits(out), bits(expected))


# ---- surfaces ----

SIZES = 10.0 ** np.array([0.0, 0.0, 0.0, 3.0, -9.0, 120.0, 152.0, -152.0, -200.0])


def hard_triangles(rng, count):
    """Triangles of all sizes; some thin, some points, some with vertex normals that cancel or are 0."""
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


def hard_spheres(rng, count):
    radius = 10.0 ** rng.uniform(-3.0, 3.0, count) * rng.choice([1.0, 1.0, 1e-40, 1e40], count)
    center = rng.normal(size=(count, 3)) * np.abs(radius)[:, None] * 10.0 ** rng.integers(-2, 3, (count, 1))
    return Spheres(center, radius, np.linalg.qr(rng.normal(size=(count, 3, 3)))[0])


def placed(shape):
    """Some of a shape that packs to images of a unit shape, stretched by little and by 10^90."""

    def some(rng, count):
        camera = caster.Pinhole(eye=(0, 0, 9), look_at=(0, 0, 0))
        shapes = []
        for n in range(count):
            size = rng.uniform(0.2, 2.0, 3) * (1e90 if n % 9 == 8 else 1.0)
            turn = {"axis": rng.normal(size=3).tolist(), "degrees": float(rng.uniform(0.0, 360.0))}
            place = {"translate": rng.normal(size=3).tolist()}
            shapes.append(shape(to_world=[{"scale": size.tolist()}, {"rotate": turn}, place]))
        return pack(caster.Scene(camera=camera, shapes=shapes)).kinds[0].prims

    return some


SOME = {"triangles": hard_triangles, "spheres": hard_spheres}
SOME |= {"ellipsoids": placed(caster.Sphere), "cylinders": placed(caster.Cylinder)}


def aims(rng, prims, hit):
    """(points (n, 3) that rays lead to, about how large what they hit is (n, 1))."""
    k, count = np.maximum(hit, 0), len(hit)
    if isinstance(prims, Triangles):
        corners = prims.vertices.reshape(-1, 3, 3)[k]
        weights = rng.dirichlet((1, 1, 1), count)[:, :, None]
        return (corners * weights).sum(axis=1), np.abs(corners).max(axis=(1, 2))[:, None] + 1e-300
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    if isinstance(prims, Spheres):
        return prims.center[k] + prims.radius[k][:, None] * out, prims.radius[k][:, None]
    m = prims.to_world[k]
    return prims.center[k] + np.einsum("nij,nj->ni", m, out), np.abs(m).max(axis=(1, 2))[:, None]


def hit_tile(rng, prims, count, longest_run):
    """A tile of rays with hits in runs; nine in ten d have length 1, and t of misses is infinite."""
    tile, pixels = tiles.new_tile(), tiles.PIXELS
    hit = np.repeat(rng.integers(-1, count, pixels), rng.integers(1, longest_run, pixels))[:pixels]
    p, size = aims(rng, prims, hit)
    d = rng.normal(size=(pixels, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    d[rng.random(pixels) < 0.1] *= 3.0
    if isinstance(prims, Triangles):
        corners = prims.vertices.reshape(-1, 3, 3)[np.maximum(hit, 0)]
        d = np.where(rng.random((pixels, 1)) < 0.1, (corners[:, 1] - corners[:, 0]) / size, d)  # along the plane
    t = size[:, 0] * 10.0 ** rng.uniform(-1.0, 0.5, pixels)
    fields = [(tiles.T, np.where(hit < 0, np.inf, t)), (tiles.PRIM, hit)]
    fields += [(at, (p - t[:, None] * d)[:, c]) for c, at in enumerate((tiles.OX, tiles.OY, tiles.OZ))]
    fields += [(at, d[:, c]) for c, at in enumerate((tiles.DX, tiles.DY, tiles.DZ))]
    for at, values in fields:
        tile[int(at) : int(at) + pixels] = values
    return tile


@jit
def one_at_a_time(prims: Any, numbers: Any, tile: Any, out: Any) -> None:
    """out (pixels, 11): p, n, sh_n, u, v of the hits on a kind."""
    for i in range(len(out)):
        at = tiles.lane(i)
        prim = int(tile[tiles.PRIM + at])
        if numbers[0] <= prim < numbers[1]:
            o = tile[tiles.OX + at], tile[tiles.OY + at], tile[tiles.OZ + at]
            d = tile[tiles.DX + at], tile[tiles.DY + at], tile[tiles.DZ + at]
            p, n, sh_n, u, v = surface(prims, prim - numbers[0], o, d, tile[tiles.T + at], True)
            for c in range(3):
                out[i, c], out[i, 3 + c], out[i, 6 + c] = p[c], n[c], sh_n[c]
            out[i, 9], out[i, 10] = u, v


FIELDS = {NORMALS: range(3, 6), SURFACES: range(9), SURFACES_WITH_UV: range(11)}


@pytest.mark.parametrize("longest_run", [4, 40], ids=["short runs", "long runs"])
@pytest.mark.parametrize("kind", SOME)
def test_surfaces_of_several_hits_are_those_of_one_at_a_time(kind, longest_run):
    rng, count, box = np.random.default_rng([7, longest_run]), 60, (0, 0, 101, ROWS)
    prims = SOME[kind](rng, count)
    tile = hit_tile(rng, prims, count, longest_run)
    prim = tile[int(tiles.PRIM) : int(tiles.PRIM) + tiles.PIXELS]
    y, x = np.divmod(np.arange(tiles.PIXELS), tiles.WIDTH)
    for numbers in ((0, count), (20, 20 + count)):  # the second: others are of another kind, and keep what they have
        expected, mine = np.full((tiles.PIXELS, 11), 7.0), (x < box[2]) & (y < box[3])
        one_at_a_time(prims, numbers, tile, expected[: ROWS * tiles.WIDTH])
        mine &= (prim >= numbers[0]) & (prim < numbers[1])
        for wants, fields in FIELDS.items():
            buffer = new_surface_buffer()
            buffer[:] = 7.0
            surfaces_in_tile(prims, numbers, tile, box, buffer, new_lanes(), wants)
            for field in fields:
                found = buffer[field * STRIDE : field * STRIDE + tiles.PIXELS]
                assert np.array_equal(bits(found[mine]), bits(expected[mine, field])), (wants, field)
                assert (found[~mine & (y < ROWS) & (x < 96)] == 7.0).all()

"""Parts of the oracle by themselves, against matrices of Fractions and lists: each number, not only who is hit."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from oracle_aims import triangles

from caster.geometry.packing import Kind
from caster.shapes.sphere import Spheres
from mitsuba_ref.oracle import exact_planar, exact_quadrics
from mitsuba_ref.oracle.exact_numbers import integer_ray, scaled
from mitsuba_ref.oracle.interface import OutsideDomain, TieSet, check_rays
from mitsuba_ref.oracle.oracle import (
    BRANCHING_FACTOR,
    Oracle,
    RayColumns,
    box_levels,
    identical_groups,
    morton_order,
    slab_test,
    whole_groups,
)


def exact(rows) -> list[Fraction]:
    return [Fraction(float(x)) for x in rows]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_ray_in_object_space_is_the_one_that_its_matrix_brings_back(seed, mirrored):
    """M (o + s d) / size + center is the ray again, with t = s 2^e: exactly, of either handedness and any scale."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(3, 3)) * 2.0 ** rng.integers(-30, 30)
    if (np.linalg.det(matrix) < 0.0) is not mirrored:
        matrix[0] *= -1.0
    prims = SimpleNamespace(center=rng.normal(size=(2, 3)), to_world=np.stack([np.eye(3), matrix]))
    o, d = (rng.normal(size=3) * 2.0 ** rng.integers(-20, 20), rng.normal(size=3) * 2.0 ** rng.integers(-20, 20))
    affine = exact_quadrics.prepare_affine(prims, 1)
    ray = exact_quadrics.to_object_space(affine, integer_ray(o.tolist(), d.tolist()))
    assert affine.determinant > 0 and ray.size > 0
    columns = [exact(row) for row in matrix]
    center, given_o, given_d = exact(prims.center[1]), exact(o), exact(d)
    for i in range(3):
        at = sum(columns[i][j] * Fraction(ray.o[j], ray.size) for j in range(3)) + center[i]
        along = sum(columns[i][j] * Fraction(ray.d[j], ray.size) for j in range(3)) / Fraction(2) ** ray.e
        assert (at, along) == (given_o[i], given_d[i])


def test_numbers_are_scaled_to_the_coarsest_power_of_two_that_holds_them():
    for numbers in ([1.0, 3.0, -8.0], [0.75, -0.0, 2.5], [5e-324, 1.0, 1e300], [0.0, 0.0, 0.0]):
        integers, k = scaled(numbers)
        assert [Fraction(n, 2**k) for n in integers] == exact(numbers) and k >= 0
        assert k == 0 or any(n % 2 for n in integers)


GROUPS = [("edge", np.array([4, 9])), ("inside", np.array([2])), ("vertex", np.array([3, 5, 7]))]
SORTED = [(2, "inside"), (3, "vertex"), (4, "edge"), (5, "vertex"), (7, "vertex"), (9, "edge")]


def test_ties_are_in_the_order_of_their_primitives_whatever_their_groups():
    for order in ((0, 1, 2), (2, 1, 0), (1, 0, 2)):
        ties = TieSet("t", [GROUPS[i] for i in order])
        assert [(hit.prim, hit.where) for hit in ties] == SORTED and len(ties) == 6
        assert [(ties[i].prim, ties[i].where) for i in range(-6, 6)] == SORTED * 2
        assert [hit.prim for hit in ties[1:4]] == [3, 4, 5] and ties.prims.tolist() == [2, 3, 4, 5, 7, 9]
        assert {hit.t for hit in ties} == {"t"} and ties[0].t == ties[1].t == "t"
    with pytest.raises(IndexError):
        TieSet("t", GROUPS)[6]


@pytest.mark.parametrize("boxes", ["affine_boxes", "disk_boxes", "cylinder_boxes"])
def test_boxes_hold_every_corner_and_little_more(boxes):
    """Corners in Fractions: none lies outside, and each side touches one up to a few units in the last place."""
    rng = np.random.default_rng(5)
    prims = SimpleNamespace(center=rng.normal(size=(20, 3)), to_world=rng.normal(size=(20, 3, 3)))
    heights = {"affine_boxes": (-1, 1), "disk_boxes": (0,), "cylinder_boxes": (0, 1)}[boxes]
    low, high = getattr(exact_quadrics, boxes)(prims)
    for k in range(20):
        columns, center = [exact(row) for row in prims.to_world[k]], exact(prims.center[k])
        for i in range(3):
            ends = [
                center[i] + x * columns[i][0] + y * columns[i][1] + z * columns[i][2]
                for x in (-1, 1) for y in (-1, 1) for z in heights
            ]  # fmt: skip
            slack = Fraction(2) ** -44
            assert min(ends) - slack < Fraction(low[k, i]) <= min(ends)
            assert max(ends) <= Fraction(high[k, i]) < max(ends) + slack


def test_affine_primitives_with_a_number_that_is_none_are_left_out():
    prims = SimpleNamespace(center=np.zeros((4, 3)), to_world=np.tile(np.eye(3), (4, 1, 1)))
    prims.center[1, 2], prims.to_world[2, 0, 1] = np.nan, np.inf
    assert exact_quadrics.usable_affine(prims).tolist() == [True, False, False, True]


RAYS = [
    ({}, None),
    ({"o": (np.inf, 0.0, 0.0)}, "o = [inf, 0.0, 0.0], d = [0.0, 0.0, 1.0], t_min = 0.0, t_max = inf"),
    ({"d": (0.0, np.nan, 1.0)}, "o = [0.0, 0.0, 0.0], d = [0.0, nan, 1.0], t_min = 0.0, t_max = inf"),
    ({"d": (0.0, -0.0, 0.0)}, "o = [0.0, 0.0, 0.0], d = [0.0, -0.0, 0.0], t_min = 0.0, t_max = inf"),
    ({"t_min": np.nan}, "o = [0.0, 0.0, 0.0], d = [0.0, 0.0, 1.0], t_min = nan, t_max = inf"),
    ({"t_max": np.nan}, "o = [0.0, 0.0, 0.0], d = [0.0, 0.0, 1.0], t_min = 0.0, t_max = nan"),
    ({"t_min": -np.inf, "t_max": -1.0, "d": (0.0, 5e-324, 0.0)}, None),
]


@pytest.mark.parametrize(("change", "said"), RAYS)
def test_a_ray_outside_of_the_domain_is_named_with_its_numbers(change, said):
    """The second and the third of four are the same."""
    plain = {"o": (0.0, 0.0, 0.0), "d": (0.0, 0.0, 1.0), "t_min": 0.0, "t_max": np.inf}
    rows = {name: np.array([plain[name], *[(plain | change)[name]] * 2, plain[name]], float) for name in plain}
    if said is None:
        check_rays(**rows)
        return
    with pytest.raises(OutsideDomain) as error:
        check_rays(**rows)
    must = "ray 1: o and d must be finite, d not 0, and t_min and t_max numbers or infinite, got "
    assert str(error.value) == must + said


def test_the_roots_of_each_primitive_are_its_own_wherever_others_are_nowhere():
    """Faces at the heights of their numbers, and two spheres, in two arrays whose numbers alternate."""
    square = np.array([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]])
    faces = triangles(np.stack([square + np.array([0, 0, k]) for k in (1, 3, 5, 6)]))
    faces.vertices[3 * 1 + 2, 0] = faces.vertices[3 * 3, 1] = np.nan  # the faces 3 and 6
    balls = Spheres(np.array([[0.0, 0, 0], [0, 0, 2], [0, 0, 4]]), np.full(3, 0.25), np.zeros((3, 3, 3)))
    kinds = (Kind(faces, np.array([1, 3, 5, 6])), Kind(balls, np.array([0, 2, 4])))
    for order in (kinds, kinds[::-1]):
        oracle = Oracle(SimpleNamespace(kinds=order, first=np.array([0, 7])))
        for prim in range(7):
            found = oracle.roots(prim, (0.5**9, 0.0, -1.0), (0.0, 0.0, 2.0))
            heights = [] if prim in (3, 6) else [prim] if prim % 2 else [prim - 0.25, prim + 0.25]
            assert [float(hit.t) for hit in found] == pytest.approx([(z + 1.0) / 2.0 for z in heights], abs=1e-4)
            assert all(hit.prim == prim for hit in found)
        for wrong in (-1, 7):
            with pytest.raises(IndexError):
                oracle.roots(wrong, (0.0, 0.0, -1.0), (0.0, 0.0, 2.0))


def test_identical_rows_are_gathered_by_the_numbers_of_their_primitives():
    lowest, ids = np.array([0, 1, 0, 3, 1, 5, 0, 3]), np.array([4, 8, 9, 2, 1, 7, 0, 5])
    groups, repeated = identical_groups(lowest, ids)
    assert {row: numbers.tolist() for row, numbers in groups.items()} == {0: [0, 4, 9], 1: [1, 8], 3: [2, 5]}
    assert repeated.tolist() == [False, False, True, False, True, False, True, True]
    assert identical_groups(None, ids) == ({}, None)


def crossing(line, box) -> tuple[Fraction, Fraction] | None:
    """From which t to which a line is within a box, in Fractions; None: nowhere."""
    near = far = None
    for o, d, low, high in zip(*line, *box, strict=True):
        if not d:
            if not low <= o <= high:
                return None
            continue
        ends = sorted([(low - o) / d, (high - o) / d])
        near, far = ((ends[0] if near is None else max(near, ends[0])), (ends[1] if far is None else min(far, ends[1])))
    return None if near > far else (near, far)


def test_a_ray_passes_a_box_as_it_does_in_fractions():
    """On a lattice, where many rays pass along faces and through corners, or begin or end at a box: all that pass, no
    other that misses by more than rounding, and a `near` that is no later and hardly earlier than the box."""
    rng = np.random.default_rng(14)
    n = 4000
    o, d = rng.integers(-4, 5, (n, 3)).astype(float), rng.integers(-2, 3, (n, 3)).astype(float)
    d[~d.any(axis=1), 1] = 1.0
    low = rng.integers(-4, 2, (n, 3)).astype(float)
    high = low + rng.integers(0, 6, (n, 3))
    t_min, t_max = rng.choice([-np.inf, 0.0, 1.0], n), rng.choice([np.inf, np.inf, 2.0, 1.0, -1.0], n)
    rays = RayColumns(o.T, d.T, t_min, t_max)
    crossed, near = slab_test(rays, np.arange(n), low.T, high.T)
    touched = []
    for i in range(n):
        span = crossing((exact(o[i]), exact(d[i])), (exact(low[i]), exact(high[i])))
        inside = span is not None and span[1] > t_min[i] and span[0] <= t_max[i] and t_min[i] <= t_max[i]
        assert not inside or crossed[i], i
        if crossed[i] and not inside:
            touched.append(i)
            assert span is not None and (span[1] == t_min[i] or t_min[i] > t_max[i]), i
        if inside:
            assert near[i] <= span[0] and float(span[0]) - near[i] <= 1e-14 * max(1.0, abs(float(span[0])))
    assert 0.05 < crossed.mean() < 0.5 and touched


@pytest.mark.parametrize("count", [1, 31, 32, 33, 1024, 1025])
def test_boxes_of_boxes_hold_those_of_their_group_and_no_more(count):
    rng = np.random.default_rng(15)
    low = rng.normal(size=(3, count))
    high = low + rng.random((3, count))
    whole = whole_groups(np.arange(count))
    assert len(whole) % BRANCHING_FACTOR == 0 and len(whole) - count < BRANCHING_FACTOR
    assert whole.tolist() == [*range(count), *[count - 1] * (len(whole) - count)]
    levels = box_levels(low[:, whole], high[:, whole], count)
    boxes, rows = count, [np.array([i]) for i in range(count)]
    for level in levels:
        assert level.boxes == boxes == len(rows)
        for i, members in enumerate(rows):
            group, place = divmod(i, BRANCHING_FACTOR)
            assert level.low[:, group, place].tolist() == low[:, members].min(axis=1).tolist()
            assert level.high[:, group, place].tolist() == high[:, members].max(axis=1).tolist()
        rows = [np.concatenate(rows[i : i + BRANCHING_FACTOR]) for i in range(0, boxes, BRANCHING_FACTOR)]
        boxes = len(rows)
    assert boxes == 1 and levels[-1].low.shape == (3, 1, BRANCHING_FACTOR)
    assert box_levels(low[:, :0], high[:, :0], 0) == []


@pytest.mark.parametrize("size", [1.0, 2.0**1000, 2.0**-1000])
def test_boxes_are_in_the_order_of_their_centres_along_the_curve(size):
    """Cells of a grid of 1024^3 between the first and the last centre; bits of z, y and x in turn."""
    rng = np.random.default_rng(16)
    low = np.vstack([rng.integers(0, 1024, (60, 3)), np.zeros((1, 3)), np.full((1, 3), 1023)]) + 0.25
    cells = np.floor(low).astype(int).tolist()
    codes = [
        sum(((cell[axis] >> bit) & 1) << (3 * bit + axis) for bit in range(10) for axis in range(3)) for cell in cells
    ]
    middle = low - 0.25  # of boxes that are 1 wide and centred there
    order = morton_order((middle - 0.5) * size, (middle + 0.5) * size)
    assert [codes[i] for i in order] == sorted(codes) and morton_order(low[:0], low[:0]).tolist() == []
    assert morton_order(low[:1], low[:1]).tolist() == [0]
    flat = np.zeros((5, 3)) * size
    assert morton_order(flat, flat).tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("scale", [1.0, 2.0**-40, 2.0**60])
@pytest.mark.parametrize("length", [1.0, 2.0**-7, 2.0**9])
def test_a_ray_in_the_plane_of_a_primitive_runs_along_it_between_its_ends(scale, length):
    """t counts in lengths of d: at x from 1 to 5/2 of a triangle, from 2 to 4 of a disk, from 1 to 3 of a wall."""
    o, d = np.array([-0.5, 0.25, 0.75]) * scale, np.array([0.5, 0.0, 0.0]) * scale * length
    ray = integer_ray(o.tolist(), d.tolist())
    faces = triangles(np.array([[[0.5, -0.75, 0.75], [2.5, 0.25, 0.75], [1.5, 1.25, 0.75]]]) * scale)
    turned = np.array([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]]) * scale
    disk = SimpleNamespace(center=np.array([[3.0, 0.25, 0.75]]) * scale, to_world=turned)
    along = np.array([[[0.0, 0, 2], [1, 0, 0], [0, 1, 0]]]) * scale
    wall = SimpleNamespace(center=np.array([[1.0, -0.75, 0.75]]) * scale, to_world=along)
    back = SimpleNamespace(center=np.array([[3.0, -0.75, 0.75]]) * scale, to_world=along * np.array([1, 1, -1]))
    found = [
        (exact_planar.intersect_triangle(exact_planar.prepare_triangle(faces, 0), ray), (1, 2.5)),
        (exact_planar.intersect_disk(exact_quadrics.prepare_affine(disk, 0), ray), (2, 4)),
        (exact_quadrics.intersect_cylinder(exact_quadrics.prepare_affine(wall, 0), ray), (1, 3)),
        (exact_quadrics.intersect_cylinder(exact_quadrics.prepare_affine(back, 0), ray), (1, 3)),
    ]
    for crossed, ends in found:
        (contact,) = crossed.contacts
        first, last = (Fraction(x + 0.5) / Fraction(0.5 * length) for x in ends)
        assert crossed.roots == () and (contact.why, contact.first, contact.last) == ("edge_on", first, last)
    beside = integer_ray((o + np.array([0, 0, scale / 64])).tolist(), d.tolist())
    for prepare, intersect, prims in (
        (exact_planar.prepare_triangle, exact_planar.intersect_triangle, faces),
        (exact_quadrics.prepare_affine, exact_planar.intersect_disk, disk),
    ):
        assert intersect(prepare(prims, 0), beside) == exact_planar.NO_INTERSECTION


@pytest.mark.parametrize(
    ("o", "where"),
    [
        ((1.0, -2.0, 0.5), ["tangent"]),
        ((1.0, -2.0, 0.0), ["tangent"]),
        ((-1.0, -2.0, 1.0), ["tangent"]),
        ((0.5, -2.0, 0.5), ["inside", "inside"]),
        ((0.5, -2.0, 0.0), ["rim", "rim"]),
        ((0.0, -2.0, 1.0), ["rim", "rim"]),
        ((0.0, -2.0, 1.0 + 2.0**-52), []),
        ((1.0 + 2.0**-52, -2.0, 0.0), []),
    ],
)
def test_a_line_hits_a_wall_at_its_rims_or_along_a_tangent_also_at_a_rim(o, where):
    wall = SimpleNamespace(center=np.zeros((1, 3)), to_world=np.eye(3)[None])
    cylinder, ray = exact_quadrics.prepare_affine(wall, 0), integer_ray(list(o), [0.0, 1.0, 0.0])
    assert [at for _, at in exact_quadrics.intersect_cylinder(cylinder, ray).roots] == where

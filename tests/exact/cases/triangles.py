"""Cases 15 to 28: triangles, closed meshes, slivers, and rays nearly edge-on."""

import numpy as np
from aimed_rays import direction

from cases import integer_shapes
from cases.case import Case, Maker, Questions
from cases.shapes import Aim, mesh_of, rays_at, shape_of, turn
from caster import Heightfield, Triangle


def lattice(make: Maker) -> Questions:
    """Corners, edges and diagonals of a flat grid of eighths, from whole places: exact for everybody."""
    scene = make.scene([Heightfield(size=4.0, resolution=32, amplitude=0.0)])
    count = make.count(150)
    o = np.column_stack([make.rng.integers(-8, 9, (count, 2)) / 4.0, make.rng.integers(1, 5, count)])
    p = np.column_stack([make.rng.integers(-15, 16, (count, 2)) / 8.0, np.zeros(count)])
    half = make.rng.integers(0, 2, (count, 2)) / 16.0
    yield make.ask("corners", scene, o, p - o, vertex=140, never=("miss",))
    yield make.ask(
        "edges and diagonals", scene, o, p + np.column_stack([half, np.zeros(count)]) - o, edge=60, never=("miss",)
    )


THIN = ("triangle", "rectangle", "cube", "disk", "sphere", "cylinder", "mesh")


def slivers(make: Maker) -> Questions:
    """Of height 10^-1 to 10^-12 (10^-14 in float64), turned, from 5 away."""
    for height in (1e-1, 1e-3, 1e-6, 1e-9, 1e-12 if make.single else 1e-14):
        for kind in THIN:
            if make.single and height < 1e-6 and kind not in ("triangle", "mesh"):
                continue  # in float32 numbers, such a matrix has no inverse
            shape = shape_of(kind, make.rng, 1.0, stretch=[1.0, height, 1.0])
            scene = make.scene([shape])
            o, d = rays_at(make, scene, make.count(16), aim=Aim((4.0, 6.0)))
            yield make.ask(f"{kind} of height {height:g}", scene, o, d, hit=6)


def without_area(make: Maker) -> Questions:
    """Corners in a line, in one point, or the same corner twice, exactly; between faces that are there."""
    for _ in range(4):
        a, v = integer_shapes.whole(make.rng, 2, 3)
        count = make.count(20)
        aim = a + v * make.rng.integers(0, 9, (count, 1)) / 4.0
        o = integer_shapes.whole(make.rng, count, 3)
        for name, vertices, faces in (
            ("in a line", [a, a + v, a + 2 * v], [[0, 1, 2]]),
            ("one corner twice", [a, a + 2 * v], [[0, 1, 1]]),
            ("one point", [a], [[0, 0, 0]]),
        ):
            near = a if name == "one point" else aim
            corners = np.array(vertices) * integer_shapes.UNIT
            yield make.ask(
                name,
                [mesh_of(corners, faces)],
                o * integer_shapes.UNIT,
                (near - o) * integer_shapes.UNIT,
                never=("hit",),
            )
        w = integer_shapes.whole(make.rng, 2, 3)
        corners = np.array([a, a + v, a + 2 * v, a + w[0], a + w[1]]) * integer_shapes.UNIT
        mesh = mesh_of(corners, [[0, 1, 2], [0, 2, 3], [0, 4, 2]])
        yield make.ask(
            "between two faces", [mesh], o * integer_shapes.UNIT, (aim - o) * integer_shapes.UNIT, hit=8, edge=5
        )


def nearly_in_a_line(make: Maker) -> Questions:
    """0, 1/3 and 1 along a turned line: what is left of an area is rounding."""
    for _ in range(6):
        a, v = make.rng.normal(size=(2, 3))
        corners = make.rounded([a, a + v / 3.0, a + v])
        count = make.count(30)
        aim = make.rounded(a + make.rng.random((count, 1)) * v)
        o = make.rounded(2.0 * direction(make.rng, count))
        yield make.ask("a line", [mesh_of(corners, [[0, 1, 2]])], o, aim - o, miss=10, exact=0 if make.single else 3)


def in_an_axis_line(make: Maker) -> Questions:
    """Three corners that share two decimals: exactly in a line, though no number is round."""
    x, z = make.rounded([-1113.45459, -56.2431908])
    for _ in range(4):
        y = make.rounded(make.rng.uniform(-100.0, -70.0, 3))
        corners = np.column_stack([np.full(3, x), y, np.full(3, z)])
        o = make.rounded(np.array([-1081.0, 100.0, 88.0]) + make.rng.normal(size=(make.count(20), 3)))
        aim = make.rounded(corners[0] + make.rng.random((len(o), 1)) * (corners[2] - corners[0]))
        yield make.ask("a line", [mesh_of(corners, [[0, 1, 2]])], o, aim - o, never=("hit",))
        along = np.column_stack([np.full(20, x), y[0] + make.rng.uniform(1, 9, 20), np.full(20, z)])
        yield make.ask("along it", [mesh_of(corners, [[0, 1, 2]])], along, (0.0, -1.0, 0.0), never=("hit",))


def in_the_plane(make: Maker) -> Questions:
    """Along the surface, from a point of its plane or parallel above it: no hit, as edge-on is a miss by convention."""
    flat = (integer_shapes.triangle, integer_shapes.rectangle, integer_shapes.disk, integer_shapes.plane)
    for each in integer_shapes.each(make.rng, flat, 2):
        rows = make.rng.integers(0, len(each.p), make.count(25))
        d = each.tangent[rows] * integer_shapes.UNIT
        o = each.p[rows] - d * make.rng.integers(0, 3, (len(rows), 1))
        exact = 0 if each.kind in ("disk", "plane") else 12  # a product with 0 is seen to be 0 without integers
        yield make.ask(f"{each.kind}, turned", [each.shape], o, d, exact=exact, never=("hit",))
        above = each.n[rows] * integer_shapes.UNIT * 2.0**-6 * make.rng.choice([-1.0, 1.0], (len(rows), 1))
        yield make.ask(f"above a {each.kind}", [each.shape], each.p[rows] - d + above, d, never=("hit",))
    cube = integer_shapes.cube(make.rng)
    d = cube.tangent * integer_shapes.UNIT
    yield make.ask("along a cube's sides", [cube.shape], cube.p - 3.0 * d, d, exact=20)


def upright_grazing(make: Maker) -> Questions:
    """Across an axis: slopes of 10^-2 down to the smallest number."""
    corners = [[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [0.0, 3.0, 0.0]]
    least = 2.0**-149 if make.single else 2.0**-1074
    for shape in (Triangle(vertices=corners), shape_of("rectangle", make.rng).model_copy(update={"to_world": ()})):
        slopes = np.array(
            [*10.0 ** -np.arange(2.0, 38.0), 1e-40, least, *(() if make.single else (1e-200, 1e-300, 1e-310))]
        )
        slopes = make.rounded(slopes)
        d = np.column_stack([np.full(len(slopes), 0.5), np.full(len(slopes), 0.25), -slopes])
        o = np.column_stack([np.full((len(slopes), 2), -0.125), slopes])
        yield make.ask(type(shape).__name__.lower(), [shape], o, d, hit=30)


def skinny(make: Maker) -> Questions:
    """Edges of 11, 10 and 2, 50 to 600 away, at 0.1 degrees and less."""
    h = float.fromhex
    kept = Triangle(
        vertices=[
            [h("0x1.4d8dbep+6"), h("0x1.d3404p+5"), h("0x1.fea0fap+5")],
            [h("0x1.451a8ap+6"), h("0x1.83cd9cp+5"), h("0x1.1239dcp+6")],
            [h("0x1.4e11e2p+6"), h("0x1.c6e7cp+5"), h("0x1.00ec7p+6")],
        ]
    )
    o = [h("0x1.014626p+9"), h("0x1.ae3188p+7"), h("-0x1.2bf194p+8")]
    d = [h("-0x1.76f022p-1"), h("-0x1.1ca874p-2"), h("0x1.3e4a02p-1")]
    yield make.ask("one that Embree's robust mode hits", [kept], o, d, miss=1)
    for _ in range(8):
        base = [[0.0, 0.0, 0.0], [11.2, 0.0, 0.0], [9.6, 0.9, 0.0]]
        shape = Triangle(vertices=base, to_world=[turn(make.rng), {"translate": 60.0 * make.rng.normal(size=3)}])
        scene = make.scene([shape])
        aim = Aim((50.0, 600.0), (1e-6, 2e-3), 0.6)
        o, d = rays_at(make, scene, make.count(60), aim=aim)
        yield make.ask("skinny", scene, o, d, hit=15, miss=5)


CASES = (
    Case(17, "a lattice of eighths, on which float arithmetic is exact", lattice),
    Case(19, "slivers, turned", slivers),
    Case(21, "triangles without an area, exactly", without_area),
    Case(22, "three corners in a line but for rounding", nearly_in_a_line),
    Case(23, "three corners on a line along an axis", in_an_axis_line),
    Case(24, "in the plane of something flat, exactly, or parallel above it", in_the_plane),
    Case(27, "grazing across an axis, down to the smallest slope", upright_grazing),
    Case(28, "skinny triangles nearly edge-on", skinny),
)

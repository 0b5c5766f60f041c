"""Cases 44 to 52: rectangles, disks and planes."""

from collections.abc import Iterator

import numpy as np

from cases import integer_shapes
from cases.case import Case, Maker, Question
from cases.shapes import KINDS, Aim, rays_at, shape_of, turn
from caster import Disk, Plane, Rectangle


def borders(make: Maker) -> Iterator[Question]:
    """At the border, one unit in the last place beside it, at corners and on the diagonal; upright and turned."""
    one = [float(make.beside(1.0, step)) for step in (-1, 0, 1)]
    for x in one:
        for y in (0.3, -1.0, x, -x):
            wants = {"hit" if max(abs(x), abs(y)) <= 1.0 else "miss": 2}
            o = [[x, y, 3.0], [y, x, 3.0]]
            yield make.ask(f"upright, ({x!r}, {y!r})", [Rectangle()], o, (0.0, 0.0, -1.0), **wants)
    along = make.rng.integers(-15, 16, make.count(20)) / 16.0
    yield make.ask(
        "upright diagonal", [Rectangle()], np.column_stack([-along, along, along * 0 + 2]), (0.0, 0.0, -1.0), tie=20
    )
    for each in integer_shapes.each(
        make.rng, (integer_shapes.rectangle, integer_shapes.triangle, integer_shapes.cube), 2
    ):
        rows = np.flatnonzero(~each.inside)
        d = make.rounded(np.rint(each.n[rows]) + each.tangent[rows]) * integer_shapes.UNIT
        o = each.p[rows] - d
        least = max(len(rows) // 3, 1)
        yield make.ask(f"{each.kind}, turned", [each.shape], o, d, hit=least, exact=least)
        if each.kind != "cube":
            yield make.ask(
                f"{each.kind}, beside", [each.shape], make.beside(o, int(make.rng.choice([-1, 1]))), d, exact=0
            )


def rims(make: Maker) -> Iterator[Question]:
    """Of a disk at (1, 0), (0.6, 0.8) and the like, exactly and beside; turned, and elliptic."""
    for x, y in ((1.0, 0.0), (0.6, 0.8), (-0.8, 0.6), (0.28, -0.96)):
        for step in (-1, 0, 1):
            o = [[float(make.beside(make.rounded(x), step)), float(make.rounded(y)), 2.0]]
            yield make.ask(f"upright, ({x}, {y}), step {step}", [Disk()], o, (0.0, 0.0, -1.0))
    for each in integer_shapes.each(make.rng, (integer_shapes.disk,), 4):
        rows = np.flatnonzero(~each.inside)
        d = (each.n[rows] + each.tangent[rows]) * integer_shapes.UNIT
        yield make.ask("turned", [each.shape], each.p[rows] - d, d, rim=12, exact=12, never=("miss",))
        for step in (-1, 1):
            yield make.ask(f"turned, step {step}", [each.shape], make.beside(each.p[rows] - d, step), d, hit=1, miss=1)


def mixed_scales(make: Maker) -> Iterator[Question]:
    for factors in ((1e3, 1, 1), (1e3, 1e-3, 1), (1, 1, 1e6), (1, 1, 1e-6)):
        for kind in ("rectangle", "disk", "cube", "sphere", "cylinder"):
            scene = make.scene([shape_of(kind, make.rng, 1.0, stretch=factors)])
            o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(25))
            yield make.ask(f"{kind} scaled by {factors}", scene, o, d, hit=5)


def horizon(make: Maker) -> Iterator[Question]:
    """From 1 above, dipping by 10^-2 to 10^-8, and 10^-15 in float64."""
    dips = make.rounded(10.0 ** -np.arange(2.0, 9.0 if make.single else 16.0))
    for turned in (False, True):
        steps = [turn(make.rng)] if turned else []
        matrix = Rectangle(to_world=steps).matrix[:3, :3]
        d = np.column_stack([np.cos(dips), 0.3 + 0.0 * dips, -dips]) @ matrix.T
        o = make.rounded(matrix[:, 2])
        normal = matrix[:, 2]
        shapes = {"plane": Plane(normal=normal, offset=0.0)}
        for size in (1e3, 1e6, 1e9):
            shapes[f"rectangle of {size:g}"] = Rectangle(to_world=[{"scale": size}, *steps])
            shapes[f"disk of {size:g}"] = Disk(to_world=[{"scale": size}, *steps])
        for name, shape in shapes.items():
            yield make.ask(f"{name}, {'turned' if turned else 'upright'}", [shape], o, d, hit=1)


def coplanar(make: Maker) -> Iterator[Question]:
    """Two in one plane: the same twice, and one turned within it; the lower number where both are."""
    c, s = 3.0 / 5.0, 4.0 / 5.0
    spin = np.array([[3.0, -4.0, 0.0], [4.0, 3.0, 0.0], [0.0, 0.0, 5.0]])
    assert c * c + s * s == 1.0
    for kind in (Rectangle, Disk):
        m, _ = integer_shapes.whole_turn(make.rng)
        center = integer_shapes.whole(make.rng, 3)
        first = kind(to_world=integer_shapes.matrix_steps(20.0 * m, center))
        second = kind(to_world=integer_shapes.matrix_steps(4.0 * m @ spin, center))
        count = make.count(60)
        p = center + 2.0 * np.column_stack([make.rng.integers(-12, 13, (count, 2)), np.zeros(count)]) @ m.T
        o = center + integer_shapes.whole(make.rng, count, 3) + 40.0 * m[:, 2]
        for name, pair in {
            "the same": [first, first],
            "turned": [first, second],
            "turned, the other first": [second, first],
        }.items():
            named = [shape.model_copy(update={"name": f"s{i}"}) for i, shape in enumerate(pair)]
            yield make.ask(
                f"{kind.__name__.lower()}s, {name}",
                named,
                o * integer_shapes.UNIT,
                (p - o) * integer_shapes.UNIT,
                tie=20,
                exact=20,
            )
    plane = Plane(normal=(0, 0, 1), offset=-2.0)
    o = make.rng.uniform(1.0, 3.0, (make.count(30), 3))
    o[:, 2] += 2.0
    planes = [plane.model_copy(update={"name": n}) for n in "ab"]
    yield make.ask("planes", planes, o, make.rng.normal(size=(len(o), 3)) - [0, 0, 4], tie=20)
    turned = Rectangle(to_world=[turn(make.rng)])
    again = Rectangle(to_world=[{"rotate": {"axis": [0, 0, 1], "degrees": 17}}, *turned.to_world])
    scene = make.scene([turned, again])
    o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(60), aim=Aim(edges=0.0))
    yield make.ask("rectangles, turned by 17 degrees and rounded", scene, o, d, hit=40)


def reflected(make: Maker) -> Iterator[Question]:
    for kind in KINDS:
        if kind == "plane":
            continue
        for mirror in ((-1.0, 1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, -1.0, -1.0)):
            scene = make.scene([shape_of(kind, make.rng, 1.0, make.rng.normal(size=3), mirror)])
            o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(12))
            yield make.ask(f"{kind} mirrored by {mirror}", scene, o, d, hit=2)


EXACT = "exact"
CASES = (
    Case(
        44,
        "borders, corners and diagonals, and one unit in the last place beside",
        "closed: the border is hit, what is beyond it is not",
        borders,
    ),
    Case(45, "rims of disks, and one unit in the last place beside", "closed, decided in integers", rims),
    Case(46, "matrices that mix scales", "the exact inverse of the matrix counts", mixed_scales),
    Case(
        50,
        "the horizon: a plane from 1 above it",
        "a plane has no end; t is rounded a few times, however far it is",
        horizon,
    ),
    Case(51, "two in one plane", "where both are, exactly, the first of the scene; else the one in front", coplanar),
    Case(52, "mirrored shapes", "outside stays outside, for every shape", reflected),
)

"""Cases 44 to 52: rectangles, disks and planes."""

import numpy as np

from cases import integer_shapes
from cases.case import Case, Maker, Questions
from cases.shapes import turn
from caster import Disk, Plane, Rectangle


def borders(make: Maker) -> Questions:
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


def rims(make: Maker) -> Questions:
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


def horizon(make: Maker) -> Questions:
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


CASES = (
    Case(44, "borders, corners and diagonals, and one unit in the last place beside", borders),
    Case(45, "rims of disks, and one unit in the last place beside", rims),
    Case(50, "the horizon: a plane from 1 above it", horizon),
)

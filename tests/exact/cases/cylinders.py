"""Cases 53 to 61: open tubes, round and elliptic."""

import numpy as np

from cases import integer_shapes
from cases.case import Case, Maker, Questions
from cases.shapes import turn
from caster import Cylinder

TUBES = (integer_shapes.cylinder, integer_shapes.elliptic)


def along_the_axis(make: Maker) -> Questions:
    """From inside, at 10^-1 to 10^-7 (10^-12 in float64) to the axis, in tubes as long as it takes."""
    for angle in (1e-1, 1e-3, 1e-5, 1e-7 if make.single else 1e-12):
        for name, stretch in (("cylinder", [1.0, 1.0]), ("elliptic cylinder", [1.0, 0.3])):
            for turned in (False, True):
                steps = [{"scale": [*stretch, 10.0 / angle]}, *([turn(make.rng)] if turned else [])]
                matrix = Cylinder(to_world=steps).matrix[:3, :3]
                count = make.count(25)
                side = make.rng.uniform(0.0, 2.0 * np.pi, count)
                unit = matrix / np.linalg.norm(matrix, axis=0)
                d = np.column_stack([angle * np.cos(side), angle * np.sin(side), np.ones(count)]) @ unit.T
                o = np.column_stack([0.2 * make.rng.normal(size=(count, 2)), np.full(count, 0.01)]) @ matrix.T
                where = "turned" if turned else "upright"
                yield make.ask(f"{name} at {angle:g}, {where}", [Cylinder(to_world=steps)], o, d, hit=10)


def parallel(make: Maker) -> Questions:
    """Exactly: inside, outside, and within the wall. By the convention, all of them miss."""
    for each in integer_shapes.each(make.rng, TUBES, 3):
        m = each.shape.matrix[:3, :3]
        axis = m[:, 2] / 8.0
        rows = make.rng.integers(0, len(each.p), make.count(40))
        outward = each.n[rows] * integer_shapes.UNIT * make.rng.choice([0.0, 0.0, -0.25, 0.5], (len(rows), 1))
        d = axis * make.rng.choice([-1.0, 1.0, 3.0], (len(rows), 1))
        o = each.p[rows] + outward - 2.0 * d
        yield make.ask(f"{each.kind}, turned", [each.shape], o, d, never=("hit",))
    o = [[0.5, 0, -1], [1.5, 0, -1], [1.0, 0, -1], [0.0, -1.0, -1]]
    yield make.ask("upright", [Cylinder()], o, (0.0, 0.0, 1.0), never=("hit",))


def ends(make: Maker) -> Questions:
    """At z = 0, -0, 1, one unit in the last place around them, and the smallest numbers around 0."""
    least = 2.0**-149 if make.single else 2.0**-1074
    for z, inside in (
        (0.0, True),
        (-0.0, True),
        (least, True),
        (-least, False),
        (1.0, True),
        (float(make.beside(1.0, -1)), True),
        (float(make.beside(1.0, 1)), False),
    ):
        for name, shape in (("cylinder", Cylinder()), ("elliptic cylinder", Cylinder(to_world=[{"scale": [1, 2, 1]}]))):
            yield make.ask(
                f"{name}, z = {z!r}", [shape], (-3.0, 0.25, z), (1.0, 0.0, 0.0), **{"hit" if inside else "miss": 1}
            )
    for each in integer_shapes.each(make.rng, TUBES, 3):
        rows = np.flatnonzero(~each.inside)
        d = -(each.n[rows] + 0.0) * integer_shapes.UNIT
        yield make.ask(
            f"{each.kind}, turned", [each.shape], each.p[rows] - 2.0 * d, d, rim=12, exact=12, never=("miss",)
        )
        for step in (-1, 1):
            yield make.ask(
                f"{each.kind}, turned, step {step}", [each.shape], make.beside(each.p[rows] - 2.0 * d, step), d, hit=1
            )


CASES = (
    Case(53, "from inside, nearly along the axis", along_the_axis),
    Case(54, "parallel to the axis, exactly", parallel),
    Case(56, "the ends, and one unit in the last place beside", ends),
)

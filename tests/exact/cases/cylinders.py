"""Cases 53 to 61: open tubes, round and elliptic."""

from collections.abc import Iterator

import numpy as np
from aimed_rays import direction

from cases import integer_shapes
from cases.case import FLOAT64, Case, Maker, Question
from cases.shapes import Aim, place, rays_at, shape_of, turn
from cases.spheres import tangents
from caster import Cylinder, cast

TUBES = (integer_shapes.cylinder, integer_shapes.elliptic)


def tube(make: Maker, steps: list, radius: float = 1.0, **more: object) -> Cylinder:
    return Cylinder(radius=radius, to_world=steps, **more)


def along_the_axis(make: Maker) -> Iterator[Question]:
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
                yield make.ask(f"{name} at {angle:g}, {where}", [tube(make, steps)], o, d, hit=10)


def parallel(make: Maker) -> Iterator[Question]:
    """Exactly: inside, outside, and within the wall. By the convention, all of them miss."""
    for each in integer_shapes.each(make.rng, TUBES, 3):
        m = each.shape.matrix[:3, :3]
        axis = m[:, 2] / 8.0
        rows = make.rng.integers(0, len(each.p), make.count(40))
        outward = each.n[rows] * integer_shapes.UNIT * make.rng.choice([0.0, 0.0, -0.25, 0.5], (len(rows), 1))
        d = axis * make.rng.choice([-1.0, 1.0, 3.0], (len(rows), 1))
        o = each.p[rows] + outward - 2.0 * d
        yield make.ask(f"{each.kind}, turned", [each.shape], o, d, edge_on=10, never=("hit",))
    o = [[0.5, 0, -1], [1.5, 0, -1], [1.0, 0, -1], [0.0, -1.0, -1]]
    yield make.ask("upright", [Cylinder()], o, (0.0, 0.0, 1.0), edge_on=2, never=("hit",))


def tangent_tubes(make: Maker) -> Iterator[Question]:
    """Touched exactly, and with the ray's origin moved by a unit in the last place."""
    for each, o, d in tangents(make, TUBES):
        yield make.ask(f"{each.kind}, touched", [each.shape], o, d, tangent=10, exact=15, never=("miss",))
        for step in (-1, 1):
            yield make.ask(f"{each.kind}, step {step}", [each.shape], make.beside(o, step), d, hit=1, miss=1)


def ends(make: Maker) -> Iterator[Question]:
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


def far_and_thin(make: Maker) -> Iterator[Question]:
    for away in (1e2, 1e4, 1e6, 1e5 if make.single else 1e12):
        scene = make.scene([shape_of("cylinder", make.rng)])
        o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(30), aim=Aim((away, 2.0 * away)))
        yield make.ask(f"from {away:g}", scene, o, d, hit=5)
    for thin in (1e-1, 1e-3, 1e-6):
        for kind in ("cylinder", "elliptic cylinder"):
            scene = make.scene([shape_of(kind, make.rng, 1.0, stretch=[thin, thin, 1.0])])
            o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(30))
            yield make.ask(f"{kind} of radius {thin:g}", scene, o, d, hit=2)


def stretched(make: Maker) -> Iterator[Question]:
    for factors in ((1e3, 1, 1), (2, 1, 1), (-1, 1, 1), (1, 1, -1), (-1, -1, -1), (-3, 1, 1)):
        scene = make.scene([Cylinder(to_world=place(make.rng, 1.0, make.rng.normal(size=3), factors))])
        o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(40))
        yield make.ask(f"scaled by {factors}", scene, o, d, hit=10)


def through_the_end(make: Maker) -> Iterator[Question]:
    """In at one end, onto the wall from inside."""
    for name, stretch in (
        ("cylinder", (1.0, 1.0, 4.0)),
        ("elliptic cylinder", (1.0, 0.5, 4.0)),
        ("mirrored", (-1.0, 1.0, 4.0)),
    ):
        shape = Cylinder(to_world=place(make.rng, 1.0, make.rng.normal(size=3), stretch))
        yield make.ask(name, [shape], *inwards(make, shape, make.count(50)), hit=45)


def inwards(make: Maker, shape: Cylinder, count: int) -> tuple[np.ndarray, np.ndarray]:
    """From before the end z = 0 to a place within, and beyond it onto the wall."""
    side, depth = make.rng.uniform(0.0, 2.0 * np.pi, count), make.rng.uniform(0.3, 0.8, count)
    wall = np.column_stack([np.cos(side), np.sin(side), depth])
    door = np.column_stack([0.3 * make.rng.normal(size=(count, 2)).clip(-1, 1), np.zeros(count)])
    m, c = shape.matrix[:3, :3], shape.matrix[:3, 3]
    o = (door - 0.5 * (wall - door)) @ m.T + c
    return o, (wall - door) @ m.T


def outward_inside() -> int:
    """The normal of the wall points away from the axis, seen from inside, too: it is not turned to the ray."""
    make, count = Maker(59, FLOAT64), 0
    for stretch in ((1.0, 1.0, 4.0), (1.0, 0.5, 4.0), (-1.0, 1.0, 4.0)):
        shape = Cylinder(to_world=place(make.rng, 1.0, make.rng.normal(size=3), stretch))
        o, d = inwards(make, shape, 50)
        hits = cast(make.scene([shape]), o, d)
        hit = hits.prim_id >= 0
        assert ((hits.surface.n * d).sum(axis=1)[hit] > 0.0).all()
        count += int(hit.sum())
    return count


def far_wall(make: Maker) -> Iterator[Question]:
    """From the middle to a point of the wall at t = 1 exactly, with t_max there and beside."""
    for each in integer_shapes.each(
        make.rng, (integer_shapes.cylinder, integer_shapes.elliptic, integer_shapes.sphere, integer_shapes.ellipsoid), 2
    ):
        center = each.shape.matrix[:3, 3] + (np.array(each.shape.center) if each.kind == "sphere" else 0.0)
        if "cylinder" in each.kind:
            center = center + each.shape.matrix[:3, 2] * 3.0 / 8.0
        rows = np.flatnonzero(each.inside)
        d = each.p[rows] - center
        for step, meets in ((-1, "miss"), (0, "hit"), (1, "hit")):
            other = {"hit": "miss", "miss": "hit"}[meets]
            t_max = float(make.beside(1.0, step))
            yield make.ask(
                f"{each.kind}, step {step}", [each.shape], center, d, t_max=t_max, never=(other,), **{meets: 8}
            )


def offset_tubes(make: Maker) -> Iterator[Question]:
    for offset in (1e2, 1e4, 1e6, 1e8 if make.single else 1e14):
        for kind in ("cylinder", "elliptic cylinder"):
            scene = make.scene([shape_of(kind, make.rng, 1.0, offset * direction(make.rng, 1)[0])])
            o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(40), aim=Aim(edges=0.6))
            yield make.ask(f"{kind} at {offset:g}", scene, o, d, hit=0 if offset > 1e6 else 5)


EXACT = "exact"
CASES = (
    Case(53, "from inside, nearly along the axis", EXACT, along_the_axis),
    Case(54, "parallel to the axis, exactly", "a miss, inside, outside and within the wall", parallel),
    Case(
        55,
        "a cylinder touched exactly, and one unit in the last place beside",
        "a hit (closed), decided in integers",
        tangent_tubes,
    ),
    Case(56, "the ends, and one unit in the last place beside", "0 <= z <= 1, decided in integers", ends),
    Case(57, "far away and thin", EXACT, far_and_thin),
    Case(58, "stretched and mirrored cylinders", EXACT, stretched),
    Case(
        59,
        "in through the open end",
        "the wall is hit from inside; its normal points away from the axis all the same",
        through_the_end,
        {"outward": outward_inside},
    ),
    Case(60, "from inside, the far wall at t_max exactly", "closed at t_max", far_wall),
    Case(61, "cylinders far from the origin, at ends and tangents", EXACT, offset_tubes),
)

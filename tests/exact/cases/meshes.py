"""Cases 29 to 41: limits of t, odd directions, sizes, coincident faces, and what is wrong with a mesh."""

from collections.abc import Iterator

import numpy as np

from cases import integer_shapes
from cases.case import FLOAT64, Case, Maker, Question
from cases.shapes import Aim, every_kind, mesh_of, rays_at
from caster import Triangle, cast


def at_t_max(make: Maker) -> Iterator[Question]:
    """t = 2 exactly, with t_max there and one unit in the last place around it: the end belongs to the ray."""
    two = [float(make.beside(2.0, step)) for step in (-1, 0, 1)]
    for each in integer_shapes.each(make.rng, integer_shapes.ALL):
        rows = np.flatnonzero(each.inside)[make.rng.integers(0, int(each.inside.sum()), make.count(20))]
        # straight at the surface: nothing of it comes before
        d = -each.n[rows] * 2.0 * integer_shapes.UNIT if each.kind != "mesh" else -each.p[rows] * 0.25
        for t_max, meets in zip(two, ("miss", "hit", "hit"), strict=True):
            other = {"hit": "miss", "miss": "hit"}[meets]
            o = each.p[rows] - 2.0 * d
            yield make.ask(
                f"{each.kind}, t_max {t_max!r}", [each.shape], o, d, t_max=t_max, never=(other,), **{meets: 20}
            )
        yield make.ask(f"{each.kind}, t_min 2", [each.shape], o, d, t_min=2.0)


def odd_directions(make: Maker) -> Iterator[Question]:
    """Components of -0.0, 10^-19, 10^-30, 10^-45 and the smallest beside one that is not small."""
    small = np.array([0.0, -0.0, 1e-19, -1e-19, 1e-30, 1e-45, *(() if make.single else (1e-300, -(2.0**-1074)))])
    for kind, shape in every_kind(make.rng):
        scene = make.scene([shape])
        p, _ = rays_at(make, scene.derived["packed"].parts[0], make.count(40), aim=Aim((1e-9, 2e-9)))
        axis = make.rng.integers(0, 3, len(p))
        d = make.rng.choice(small, (len(p), 3))
        d[np.arange(len(p)), axis] = make.rng.choice([-1.0, 1.0], len(p))
        d = make.rounded(d)
        yield make.ask(kind, scene, p - 4.0 * np.where(np.abs(d) == 1.0, d, 0.0), d, hit=10)


def sizes(make: Maker) -> Iterator[Question]:
    """Triangles of size 10^-37 to 10^17, in float64 down to 10^-290."""
    ends = (1e-37, 1e-19, 1e-12, 1e12, 1e17) if make.single else (1e-290, 1e-150, 1e-100, 1e-12, 1e17)
    for size in ends:
        corners = make.rng.uniform(-1.0, 1.0, (3, 3)) * size
        shape = mesh_of(corners, [[0, 1, 2]])
        scene = make.scene([shape])
        o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(30), size)
        yield make.ask(f"of size {size:g}", scene, o, d, hit=10)


def coincident(make: Maker) -> Iterator[Question]:
    """The same thing twice, once the other way round: the first of the scene is hit."""
    corners = make.rng.uniform(-1.0, 1.0, (3, 3))
    pairs = {
        "faces": [mesh_of(corners, [[0, 1, 2], [0, 1, 2], [1, 2, 0]])],
        "faces of both sides": [mesh_of(corners, [[0, 2, 1], [0, 1, 2]])],
        "triangles": [Triangle(vertices=corners)] * 2,
    }
    for kind, shape in every_kind(make.rng):
        pairs[f"{kind}, twice"] = [shape, shape]
    for name, shapes in pairs.items():
        scene = make.scene([s.model_copy(update={"name": f"s{i}"}) for i, s in enumerate(shapes)])
        o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(25))
        yield make.ask(name, scene, o, d, tie=8, exact=8)


def corner_rays(make: Maker) -> Iterator[Question]:
    for each in integer_shapes.each(make.rng, (integer_shapes.ball,), 2):
        corners = np.flatnonzero(~each.inside)
        rows = corners[make.rng.integers(0, len(corners), make.count(150))]
        o = integer_shapes.whole(make.rng, len(rows), 3) * 100.0 * integer_shapes.UNIT
        yield make.ask("from anywhere", [each.shape], o, each.p[rows] - o, tie=30, vertex=20, edge=10)


def any_order() -> int:
    """Ties do not depend on the order of the rays or on how many come at once: the bits are the same."""
    make, count = Maker(37, FLOAT64), 0
    for question in corner_rays(make):
        whole_cast = cast(question.scene, question.o, question.d)
        for size in (1, 7, 64):
            order = make.rng.permutation(len(question.o))
            for start in range(0, len(order), size):
                rows = order[start : start + size]
                part = cast(question.scene, question.o[rows], question.d[rows])
                assert part.t.tobytes() == whole_cast.t[rows].tobytes()
                assert (part.prim_id == whole_cast.prim_id[rows]).all()
            count += len(order)
    return count


REPEATED_FACES = 100_000


def crowd() -> int:
    """100,000 times the same triangle: the tree ends, and the first is hit."""
    corners = np.random.default_rng(41).normal(size=(3, 3))
    make = Maker(41, FLOAT64)
    scene = make.scene([mesh_of(corners, np.tile([[0, 1, 2]], (REPEATED_FACES, 1)))])
    o = np.array([[5.0, 6.0, 7.0]])
    hits, alone = (cast(s, o, corners.mean(axis=0) - o) for s in (scene, make.scene([Triangle(vertices=corners)])))
    assert hits.prim_id[0] == alone.prim_id[0] == 0 and hits.t.tobytes() == alone.t.tobytes()
    return REPEATED_FACES


def small_crowd(make: Maker) -> Iterator[Question]:
    corners = make.rng.normal(size=(3, 3))
    scene = make.scene([mesh_of(corners, np.tile([[0, 1, 2]], (300, 1)))])
    o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(30))
    yield make.ask("300 times the same triangle", scene, o, d, tie=10)


EXACT = "exact"
CASES = (
    Case(
        29,
        "a hit at t_max exactly",
        "the ray is t_min < t <= t_max, compared exactly: hit at t_max, and not at t_min",
        at_t_max,
    ),
    Case(
        31,
        "directions with components of -0.0 and down to the smallest number",
        "the box test treats -0.0 as 0.0; as exact arithmetic",
        odd_directions,
        every_shape=True,
    ),
    Case(33, "triangles of size 10^-290 to 10^17", "products that underflow are left to integers", sizes),
    Case(
        36,
        "the same thing twice in one place",
        "the first of the scene is hit: the lowest number",
        coincident,
        every_shape=True,
    ),
    Case(
        37,
        "ties at corners, in any order of rays",
        "the lowest number, whatever comes with the ray: bit for bit",
        corner_rays,
        {"alike": any_order},
    ),
    Case(
        41, "100,000 times the same triangle", "the first is hit; the tree stops halving", small_crowd, {"faces": crowd}
    ),
)

"""Cases 62 to 65: boxes, both as shapes and as what a tree is made of."""

from collections.abc import Iterator

import numpy as np
from aimed_rays import direction

from cases import integer_shapes
from cases.case import Case, Maker, Question
from cases.shapes import mesh_of, rays_at, shape_of
from caster import Cube, Icosphere, Mesh


def random_boxes(make: Maker, offsets: tuple[float, ...] = (0.0, 1e6)) -> Iterator[Question]:
    """Boxes along the axes and turned, at their corners and edges."""
    for offset in offsets:
        for turned in (False, True):
            middle = offset * direction(make.rng, 1)[0]
            boxes = []
            for _ in range(6):
                place, sides = middle + 2.0 * make.rng.normal(size=3), make.rng.uniform(0.2, 1.0, 3)
                cube = shape_of("cube", make.rng, 1.0, place, sides)
                boxes.append(cube if turned else Cube(to_world=[{"scale": sides}, {"translate": place}]))
            scene = make.scene(boxes)
            packed = scene.derived["packed"].kinds[0].prims
            count = make.count(120)
            corners = packed.vertices[packed.faces[make.rng.integers(0, len(packed.faces), count)]]
            share = make.rng.choice([0.0, 0.5, 0.3], (count, 1))
            o = make.rounded(middle + 8.0 * direction(make.rng, count))
            aim = corners[:, 0] + share * (corners[:, 1] - corners[:, 0])
            yield make.ask(f"{'turned' if turned else 'upright'}, at {offset:g}", scene, o, aim - o, hit=30)


def many_boxes(make: Maker) -> Mesh:
    """A mesh of flat and thick boxes on a coarse grid, so that rays along axes lie in their planes."""
    unit = Cube().mesh()
    places = make.rng.integers(-4, 5, (12, 1, 3)) * 1.0
    sizes = make.rng.choice([0.5, 0.25, 0.0], (12, 1, 3))
    sizes[(sizes == 0.0).sum(axis=2) > 1] = 0.5
    vertices = (places + sizes * unit.vertices).reshape(-1, 3)
    faces = (unit.faces[None] + len(unit.vertices) * np.arange(12)[:, None, None]).reshape(-1, 3)
    return mesh_of(vertices, faces)


def on_a_slab_plane(make: Maker) -> Iterator[Question]:
    """Origins in the planes of box sides, and no motion across them: 0 times infinity in a naive slab test."""
    for name, mesh in (("boxes", many_boxes(make)), ("a closed ball", mesh_of(*scaled_ball(make)))):
        scene = make.scene([mesh])
        vertices = scene.derived["packed"].parts[0].vertices
        count = make.count(240)
        o, aim = (vertices[make.rng.integers(0, len(vertices), count)] for _ in range(2))
        axis = make.rng.integers(0, 3, count)
        rows = np.arange(count)
        d = aim - o
        zero = make.rng.choice([0.0, -0.0], count)
        d[rows, axis] = zero
        second = make.rng.random(count) < 0.5
        d[rows[second], (axis[second] + 1) % 3] = zero[second]
        d[~d.any(axis=1), 0] = 1.0
        d[rows, axis] = np.where(d[rows, axis] == 0.0, zero, d[rows, axis])
        start = o - 2.0 * d
        start[:, :] = np.where(d == 0.0, o, start)
        yield make.ask(name, scene, start, d, hit=20, exact=20)


def scaled_ball(make: Maker) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = integer_shapes.coarse_ball(make.rng, 1)
    return vertices * integer_shapes.UNIT, faces


def hardly_moving(make: Maker) -> Iterator[Question]:
    """Components so small that 1 / d is infinite; flat boxes; along edges and in the planes of sides of a cube."""
    least = 2.0**-149 if make.single else 2.0**-1074
    for scene in (make.scene([many_boxes(make)]), make.scene([Icosphere(subdivisions=1)])):
        o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(80))
        tiny = make.rng.random(d.shape) < 0.4
        d = np.where(tiny, make.rng.choice([least, -least], d.shape), d)
        yield make.ask("the smallest components", scene, o, np.where(tiny.all(axis=1, keepdims=True), 1.0, d), hit=3)
    x = [float(make.beside(1.0, step)) for step in (-1, 0, 1)]
    for along in x:
        for height in (0.25, 1.0, along):
            wants = {"hit": 2} if max(along, height) < 1.0 else {}
            o = [[along, height, 5.0], [height, 5.0, along]]
            yield make.ask(f"beside a cube's side at {along!r}", [Cube()], o, [[0, 0, -1.0], [0, -1.0, 0]], **wants)
    for each in integer_shapes.each(make.rng, (integer_shapes.cube,), 2):
        m = each.shape.matrix[:3, :3]
        rows = np.flatnonzero(~each.inside)
        axis = make.rng.integers(0, 3, len(rows))
        d = m.T[axis] * 0.5
        yield make.ask("along edges and sides, turned", [each.shape], each.p[rows] - 4.0 * d, d, exact=10)


EXACT = "exact"
CASES = (
    Case(62, "random boxes, at corners and edges", "boxes of the tree are widened: no face is left out", random_boxes),
    Case(
        63,
        "from the plane of a box's side, moving within it",
        "a component of 0.0 or -0.0 is looked at apart from the division",
        on_a_slab_plane,
    ),
    Case(65, "components whose inverse is infinite; along sides and edges of a cube", EXACT, hardly_moving),
)

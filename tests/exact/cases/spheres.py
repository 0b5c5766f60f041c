"""Cases 1 to 14: balls, and what else is round."""

from collections.abc import Iterator

import numpy as np
from aimed_rays import decades, direction

from cases import integer_shapes
from cases.case import Case, Maker, Questions
from cases.shapes import CLOSED, KINDS, ROUND, Aim, across, every_kind, rays_at, shape_of, turn
from caster import Cube, Cylinder, Sphere


def distances(make: Maker) -> Questions:
    """From 10 to 10^8 sizes away, through the middle and at rims."""
    for kind, shape in every_kind(make.rng):
        scene = make.scene([shape])
        o, d = rays_at(make, scene, make.count(60), aim=Aim((10.0, 1e8), (0.05, 1.0)))
        yield make.ask(kind, scene, o, d, hit=10)


def through_the_origin(make: Maker, count: int, away: float = 2.0**10) -> tuple[np.ndarray, np.ndarray]:
    """Rays that pass the origin exactly: `away`, a power of two, is how often d goes from o to there."""
    d = make.rounded(direction(make.rng, count))
    return -away * d, d


def tiny(make: Maker) -> Questions:
    """Sizes 1 to 10^-8 at a distance of 1000: only a normal from the closest approach is right."""
    for size in (1.0, 1e-2, 1e-4, 1e-6, 1e-8):
        o, d = through_the_origin(make, make.count(40))
        c = make.rounded(0.9 * size * direction(make.rng, 1)[0])
        balls = [
            Sphere(center=c, radius=size),
            Sphere(to_world=[{"scale": size * np.array([1, 0.7, 0.5])}, turn(make.rng)]),
        ]
        for name, shape in zip(("sphere", "ellipsoid"), balls, strict=True):
            yield make.ask(f"{name} of size {size:g}", [shape], o, d, hit=20)
        for kind in ("cylinder", "disk", "triangle", "cube"):
            scene = make.scene([shape_of(kind, make.rng, size)])
            yield make.ask(f"{kind} of size {size:g}", scene, o, d, hit=0 if kind == "triangle" else 5)


def huge(make: Maker) -> Questions:
    """R = 10^3 to 10^8, passing at R (1 +- 10^-5) and nearer, started 3 R away."""
    for kind in ROUND:
        for size in (1e3, 1e5, 1e8):
            turned = turn(make.rng)
            stretch = {"ellipsoid": [1.0, 1.0, 0.5], "elliptic cylinder": [1.0, 0.5, 3.0], "cylinder": [1.0, 1.0, 3.0]}
            steps = [{"scale": size * np.array(stretch.get(kind, 1.0))}, turned]
            shape = Cylinder(to_world=steps) if "cylinder" in kind else Sphere(to_world=steps)
            count = make.count(40)
            # in object space, beside the silhouette as seen along -y: at x = 1 +- gap
            gap = 10.0 ** make.rng.uniform(-7.0 if make.single else -15.0, -5.0, count) * make.rng.choice(
                [-1, 1], count
            )
            scene = make.scene([shape])
            matrix = shape.matrix[:3, :3]
            q = np.column_stack([1.0 + gap, np.full(count, 3.0), make.rng.uniform(0.1, 0.2, count)])
            if kind == "ellipsoid" or kind == "sphere":
                q[:, 2] = 0.0
            o, d = q @ matrix.T, np.broadcast_to(-matrix[:, 1] / size, (count, 3))
            yield make.ask(f"{kind} of size {size:g}", scene, o, d, hit=5, miss=5)


def tangents(make: Maker) -> Iterator[tuple[integer_shapes.Whole, np.ndarray, np.ndarray]]:
    """Rays that touch in one point, exactly: from some whole steps before it, at any slope."""
    for each in integer_shapes.each(make.rng, integer_shapes.ROUND, 3):
        rows = make.rng.integers(0, len(each.p), make.count(24))
        if "cylinder" in each.kind:  # along its wall, there is nothing to touch
            rows = rows[np.cross(each.tangent[rows], each.shape.matrix[:3, 2]).any(axis=1)]
        d = each.tangent[rows] * integer_shapes.UNIT
        steps = make.rng.integers(1, 4, (len(rows), 1))
        yield each, each.p[rows] - steps * d, d


def tangent(make: Maker) -> Questions:
    for shape in (
        Sphere(),
        Sphere(to_world=[{"scale": [1.0, 3.0, 2.0]}]),
        Cylinder(to_world=[{"translate": [0, 0, -0.5]}]),
    ):
        d = (0.0, 1.0, 0.0)
        yield make.ask("along an axis", [shape], (1.0, -5.0, 0.0), d, tangent=1)
    for each, o, d in tangents(make):
        yield make.ask(f"{each.kind}, turned", [each.shape], o, d, tangent=15, exact=15, never=("miss",))


def nearly_tangent(make: Maker) -> Questions:
    """One unit in the last place of one coordinate beside it."""
    for x in make.beside(1.0, -1), make.beside(1.0, 1):
        for shape in (Sphere(), Cylinder(to_world=[{"translate": [0, 0, -0.5]}])):
            yield make.ask(
                "along an axis", [shape], (x, -5.0, 0.0), (0.0, 1.0, 0.0), **{"hit" if x < 1.0 else "miss": 1}
            )
    for each, o, d in tangents(make):
        moved = o.copy()
        rows = np.arange(len(o))
        axis = make.rng.integers(0, 3, len(o))
        steps = make.rng.choice([-1, 1], len(o))
        for sign in (-1, 1):
            here = rows[steps == sign]
            moved[here, axis[here]] = make.beside(o[here, axis[here]], sign)
        yield make.ask(f"{each.kind}, turned", [each.shape], moved, d, hit=2, miss=2)


def inside(make: Maker) -> Questions:
    """From the middle, from anywhere, and from 10^-2 to 10^-16 off the wall, outwards."""
    for kind in CLOSED:
        shape = shape_of(kind, make.rng)
        scene = make.scene([shape])
        count = make.count(60)
        o, d = rays_at(make, scene, count, aim=Aim(distances=(1e-16, 1e-2), edges=0.0))
        middle = np.zeros((len(o), 3))
        inward = 0.999 * make.rng.random((len(o), 1)) * (o + d * 0)
        choice = make.rng.integers(0, 3, len(o))[:, None]
        start = np.where(choice == 0, middle, np.where(choice == 1, inward, o))
        if kind == "torus":
            start = o
        yield make.ask(kind, scene, start, d, hit=len(o) // 3)


def on_the_surface(make: Maker) -> Questions:
    """From a rounded point of the surface, and from an exact one, where t = 0 is no hit: outwards, inwards, along."""
    for kind, shape in every_kind(make.rng):
        scene = make.scene([shape])
        o, _ = rays_at(make, scene, make.count(45), aim=Aim(distances=(1e-30, 2e-30)))
        yield make.ask(f"{kind}, rounded", scene, o, direction(make.rng, len(o)), miss=5)
    for each in integer_shapes.each(make.rng, integer_shapes.ALL):
        rows = make.rng.integers(0, len(each.p), make.count(30))
        sort = make.rng.integers(0, 3, len(rows))[:, None]
        d = np.where(sort == 0, each.n[rows], np.where(sort == 1, -each.n[rows], each.tangent[rows]))
        yield make.ask(f"{each.kind}, exact", [each.shape], each.p[rows], d * integer_shapes.UNIT, exact=5, miss=5)


def lengths(make: Maker) -> Questions:
    """|d| from 10^-30 to 10^30, in float64 from 10^-290 to 10^290."""
    ends = (1e-30, 1e30) if make.single else (1e-290, 1e290)
    for kind, shape in every_kind(make.rng):
        scene = make.scene([shape])
        o, d = rays_at(make, scene, make.count(50))
        yield make.ask(kind, scene, o, d * decades(make.rng, *ends, len(d))[:, None], hit=15)


def offsets(make: Maker) -> Questions:
    """Around (K, K, K), K = 10^2 to 10^8, and 10^15 in float64."""
    for offset in (1e2, 1e5, 1e7, 1e8 if make.single else 1e15):
        for kind, shape in every_kind(make.rng, 1.0, np.full(3, offset)):
            scene = make.scene([shape])
            o, d = rays_at(make, scene, make.count(15))
            yield make.ask(f"{kind} at {offset:g}", scene, o, d, hit=0 if offset > 1e6 else 4)


def scales(make: Maker) -> Questions:
    """Everything of one size, seen from some sizes away; faces reach up to where they are left out."""
    for size in (1e-30, 1e-15, 1e-5, 1e8, 1e17):
        for kind in KINDS:
            scene = make.scene([shape_of(kind, make.rng, size)])
            o, d = rays_at(make, scene, make.count(12), size)
            yield make.ask(f"{kind} of size {size:g}", scene, o, d, hit=3)


def radii(make: Maker) -> Questions:
    """Down to the smallest numbers there are."""
    for r in (1e-38, 2.0**-149, *(() if make.single else (1e-300, 2.0**-1074))):
        for kind, shape in (("sphere", Sphere(radius=r)), ("cylinder", Cylinder(radius=max(r, 1e-300), p0=(0, 0, -1)))):
            if make.single and kind == "cylinder" and r < 1e-38:
                continue  # its inverse is beyond what float32 numbers lead to
            o, d = through_the_origin(make, make.count(20), 4.0)
            yield make.ask(f"{kind} of radius {r:g}", [shape], o, d, hit=20, never=("miss",))
            aside = make.rounded(o + 1e-30 * across(make.rng, d) + 0.0)
            yield make.ask(f"{kind} of radius {r:g}, passed", [shape], aside, d)


def concentric(make: Maker) -> Questions:
    """Two shapes in one place, one of them larger by a unit in the last place: order is decided exactly."""
    up = float(make.beside(1.0, 1))
    rays = make.count(80)
    for name, pair in {
        "spheres": [Sphere(radius=1.0), Sphere(radius=up)],
        "spheres, the other way round": [Sphere(radius=up), Sphere(radius=1.0)],
        "a sphere and an ellipsoid": [Sphere(), Sphere(to_world=[{"scale": [1.0, 1.0, up]}])],
        "ellipsoids": [Sphere(to_world=[{"scale": [2.0, 3.0, z]}]) for z in (1.0, up)],
        "cylinders": [Cylinder(radius=r, p0=(0, 0, -1), p1=(0, 0, 1)) for r in (1.0, up)],
        "cubes": [Cube(to_world=[{"scale": s}]) for s in (1.0, up)],
    }.items():
        o = make.rounded(10.0 * direction(make.rng, rays))
        yield make.ask(
            name, pair, o, make.rounded(0.5 * direction(make.rng, rays)) - o, hit=10, exact=0 if make.single else 10
        )


CASES = (
    Case(1, "from far away, up to 10^8 sizes", distances, every_shape=True),
    Case(2, "tiny and far: the normal of a sphere of radius 10^-8", tiny),
    Case(3, "huge and passed near its silhouette", huge),
    Case(4, "touched in one point, exactly", tangent),
    Case(5, "one unit in the last place beside a tangent", nearly_tangent),
    Case(6, "from inside, down to 10^-16 off the wall", inside),
    Case(7, "from a point of the surface itself", on_the_surface, every_shape=True),
    Case(8, "directions of length 10^-290 to 10^290", lengths, every_shape=True),
    Case(9, "far from the origin, up to 10^15", offsets, every_shape=True),
    Case(10, "scenes of size 10^-30 to 10^17", scales, every_shape=True),
    Case(11, "the smallest radii there are", radii),
    Case(13, "two surfaces one unit in the last place apart", concentric),
)

"""The error models bound what they say they bound, and not much more: against decimals of 60 digits."""

import itertools
from collections.abc import Iterator
from decimal import localcontext
from typing import Any

import numpy as np
import pytest
from aimed_rays import KINDS, Setting
from decimal_intersections import DIGITS, Met, exactly, triangle
from ray_primitive_pairs import Pairs, pose, rounding

from mitsuba_ref.error_model.intersections import Intersections, norm
from mitsuba_ref.error_model.tolerances import KU, KU_OURS, U32
from mitsuba_ref.shapes import plane
from mitsuba_ref.shapes.cylinder import mitsuba_accepts_matrix
from mitsuba_ref.shapes.plane import PATCH_FACES, _face_of_hit, as_triangles
from mitsuba_ref.shapes.surface_errors import UNRESOLVABLE

SINGLE = [kind for kind in KINDS if kind != "meshes"]  # kinds with one primitive a shape
SETTINGS = {
    "near": Setting(),
    "far": Setting(distances=(1e3, 1e4)),
    "tiny": Setting(size=1e-3, distances=(3.0, 1e3)),
    "off centre": Setting(size=10.0, offset=1e5),
    "slivers": Setting(thin=1e-3, shear=1e-2),
    "edge-on": Setting(slopes=(1e-7, 1e-2)),
    "close by": Setting(distances=(1e-3, 1.0)),
}
every_kind = pytest.mark.parametrize("kind", SINGLE)

# How often a product's rounding counts where its factors are rounded: a ball's numbers and a triangle's corners meet
# few others, so once; of what goes through a matrix, both the matrix and the vector. A normal is a product of two.
NORMAL_COUNTS = 2
COUNTS = {"Triangles": 1, "Spheres": 1, "Ellipsoids": 2, "Cylinders": 2, "Disks": 2, "Planes": 2}


@pytest.fixture(autouse=True)
def sixty_digits() -> Iterator[None]:
    with localcontext(DIGITS):
        yield


def share(at: Intersections, met: Met, name: str, error: str) -> np.ndarray:
    """|the model's - exact| over its bound, where there is a hit that is resolved; (m,)."""
    there = met.hit & np.isfinite(at.t_error)
    model, true = np.array(getattr(at, name)[there]), getattr(met, name)[there]
    away = (exactly(model) - true).astype(float).reshape(len(model), -1)
    return norm(away) / getattr(at, error)[there]


def shares(at: Intersections, met: Met) -> dict[str, float]:
    """The largest of each quantity."""
    pairs = {"t": "t_error", "n": "n_error", "sh_n": "sh_error"}
    return {name: share(at, met, name, error).max(initial=0.0) for name, error in pairs.items()}


@every_kind
def test_bounds_hold_for_all_roundings_of_the_inputs_and_are_reached_by_some(kind):
    """The judge's own arithmetic is right to float64. Inputs moved by up to u of themselves, and solved anew without
    any rounding, stay within the bound; for some ray they use up a third of it, and hits and misses do flip."""
    most, flips = 0.0, 0
    for number, (name, setting) in enumerate(SETTINGS.items()):
        pairs = pose(kind, setting, [100, number])
        exact, moved = pairs.solve(), pairs.solve(rounding(np.random.default_rng([102, number]), U32))
        for at, met in zip(pairs.intersect(KU_OURS, ours=True), exact, strict=True):
            assert max(shares(at, met).values()) <= 0.5, name  # the other half is the caster's
            assert not (at.certain & ~met.hit).any() and not (met.hit & ~at.possible).any(), name
        ours = pairs.name == "Planes"  # of a patch, the corners are rounded: see below
        models = pairs.intersect(COUNTS[pairs.name] * U32, ours=ours)
        normals = pairs.intersect(NORMAL_COUNTS * U32, ours=ours)
        for at, twice, met, unmoved in zip(models, normals, moved, exact, strict=True):
            share_of_t = shares(at, met)["t"]
            assert share_of_t <= 1.0 and max(shares(twice, met).values()) <= 1.0, name
            assert not (at.certain & ~met.hit).any() and not (met.hit & ~at.possible).any(), name
            most, flips = max(most, share_of_t), flips + int((met.hit != unmoved.hit).sum())
        assert sum(int(met.hit.sum()) for met in exact) >= 100, name
    assert most >= 0.3
    assert flips >= 20 or kind == "planes"


CORNER_SIGNS = np.array(list(itertools.product([-1.0, 1.0], repeat=9))).reshape(-1, 3, 3)


@pytest.mark.parametrize("setting", ["far", "edge-on"])
def test_where_a_triangle_is_resolved_no_rounding_of_its_corners_turns_it_edge_on(setting):
    """N.d is linear in each number of the corners as the origin sees them: it is extreme where all of them are."""
    pairs = pose("triangles", SETTINGS[setting], [108])
    (at,) = pairs.intersect(KU)
    corners, d = pairs.prims.vertices[pairs.prims.faces[pairs.k]] - pairs.o[:, None], pairs.d

    def slope(a, b, c):
        return np.einsum("ij,ij->i", np.cross(b - a, c - a), d)

    exact = slope(*corners.transpose(1, 0, 2))
    moved = [corners * (1.0 + U32 * signs) for signs in CORNER_SIGNS]
    off = np.max([np.abs(slope(*each.transpose(1, 0, 2)) - exact) for each in moved], axis=0) / np.abs(exact)
    resolved = np.isfinite(at.t_error)
    assert (off[resolved] < UNRESOLVABLE).all()
    assert resolved.sum() >= 100 and np.sum(off > (0.1 if setting == "far" else 1.0)) >= 10


def test_a_patch_stands_in_for_its_plane_within_the_bound():
    """The float32 corners tilt and shift each triangle: hits on it, exactly, against hits on the plane, exactly."""
    for number, setting in enumerate(SETTINGS.values()):
        pairs = pose("planes", setting, [105, number])
        (at,), (met,) = pairs.intersect(KU), pairs.solve()
        face, within = _face_of_hit(pairs.seen, pairs.k, pairs.o, pairs.d, at.t)
        mesh = as_triangles(pairs.seen)
        corners = mesh.vertices[mesh.faces[pairs.k * len(PATCH_FACES) + face]]
        seen = exactly(corners) - exactly(pairs.o)[:, None, :]
        (patch,) = triangle(seen, exactly(pairs.d), exactly(corners))
        fine = within & np.isfinite(at.t_error)
        off = np.abs((patch.t - met.t).astype(float))[fine] / at.t_error[fine]
        assert fine.sum() >= 200
        assert 1e-3 <= off.max() <= 1.0


@every_kind
def test_what_is_neither_certain_nor_impossible_is_near_an_edge(kind):
    """All rays that aim at an edge, a rim or a silhouette are in doubt, few of the others are."""
    edges = Setting(distances=(3.0, 10.0), slopes=(0.1, 1.0), edges=1.0)
    inside = edges._replace(edges=0.0)
    doubtful = []
    for setting in (edges, inside):
        pairs = pose(kind, setting, [106])
        at = pairs.intersect(KU)[0]
        doubtful.append(np.mean(at.possible & ~at.certain))
    if kind in ("triangles", "disks"):  # of a tube every other end is hidden behind its wall
        assert doubtful[0] >= 0.99
    assert doubtful[1] <= 0.01


def planted(pairs: Pairs, fault: str) -> Intersections:
    """What a caster with a small fault would say of the first root."""
    (near, *_), prims = pairs.intersect(KU_OURS, ours=True), pairs.prims
    if fault == "t by 3e-6":
        return near._replace(t=near.t * (1.0 + 3e-6))
    if fault == "normal by 3e-5":
        sideways = np.cross(near.n, np.roll(near.n, 1, axis=1))
        return near._replace(n=near.n + 3e-5 * sideways / norm(sideways)[:, None])
    changed = moved(prims) if fault == "moved by 3e-5" else grown(prims, 1.0 + 1e-5)
    faulty = Pairs(changed, pairs.k, pairs.o, pairs.d, pairs.model, changed)
    return faulty.intersect(KU_OURS, ours=True)[0]


def moved(prims: Any) -> Any:
    if hasattr(prims, "normal"):
        return prims._replace(point=prims.point + 3e-5 * prims.normal)
    where = prims._fields[0]  # vertices or center
    return prims._replace(**{where: getattr(prims, where) + 3e-5 * np.array([0.6, -0.48, 0.64])})


def grown(prims: Any, factor: float) -> Any:
    if hasattr(prims, "radius"):
        return prims._replace(radius=prims.radius * factor)
    if hasattr(prims, "vertices"):
        return prims._replace(vertices=prims.vertices * factor)
    if hasattr(prims, "normal"):
        return prims
    return prims._replace(to_world=prims.to_world * factor, to_object=prims.to_object / factor)


# The least share of ordinary hits where a fault must be beyond the bound; the measured ones are a little larger.
# A disk that grows within its plane is hit where it was, and a plane cannot grow.
FAULTS = ("t by 3e-6", "normal by 3e-5", "moved by 3e-5", "grown by 1e-5")
CAUGHT = {
    "triangles": (0.95, 0.95, 0.8, 0.6),
    "spheres": (0.95, 0.95, 0.95, 0.9),
    "ellipsoids": (0.55, 0.15, 0.8, 0.3),
    "disks": (0.95, 0.95, 0.95, 0.0),
    "cylinders": (0.75, 0.35, 0.75, 0.25),
    "stretched cylinders": (0.75, 0.3, 0.8, 0.25),
    "planes": (0.15, 0.95, 0.6, 0.0),
}


@every_kind
def test_a_fault_of_a_few_millionths_is_beyond_the_bound(kind):
    pairs = pose(kind, Setting(distances=(3.0, 10.0), slopes=(0.3, 1.0), edges=0.0), [107])
    bound = pairs.intersect(KU)[0]
    sure = bound.certain
    assert sure.sum() >= 200
    for fault, least in zip(FAULTS, CAUGHT[kind], strict=True):
        faulty = planted(pairs, fault)
        beyond = (np.abs(faulty.t - bound.t) > bound.t_error) | (norm(faulty.n - bound.n) > bound.n_error)
        caught = np.mean(beyond[sure])
        print(f"{kind}: {fault} caught at {caught:.3f} of {sure.sum()}")
        assert caught >= least, fault


def test_the_least_height_around_a_face_of_a_patch_is_that_of_its_triangles():
    """Of its own ring and of those within and around it; triangle by triangle."""
    sizes = 0.5 * 2.0 ** np.arange(plane.PATCH_RINGS + 1)
    corners = (sizes[:, None, None] * plane.SQUARE_CORNERS).reshape(-1, 2)
    sides = corners[plane.PATCH_FACES]
    (ax, ay), (bx, by) = (sides[:, 1] - sides[:, 0]).T, (sides[:, 2] - sides[:, 0]).T
    longest = np.linalg.norm(sides - np.roll(sides, 1, axis=1), axis=2).max(axis=1)
    heights = np.abs(ax * by - ay * bx) / longest
    rings = np.array([0] * 2 + [1 + k // 8 for k in range(8 * plane.PATCH_RINGS)])
    for face in range(0, len(rings), 2):
        least = heights[np.abs(rings - rings[face]) <= 1].min()
        assert plane._least_height(np.array([0.5]), np.array([face]))[0] == pytest.approx(least, rel=1e-12)


STRETCHES = {
    "as it is": (np.eye(3), True),
    "longer": (np.diag([1.0, 1.0, 1.5]), True),
    "larger": (2.0 * np.eye(3), True),
    "so large that float32 may shear it": (3.0 * np.eye(3), False),
    "mirrored": (np.diag([1.0, -1.0, 1.0]), False),
    "wider along x": (np.diag([1.5, 1.0, 1.0]), False),
    "xy": (np.eye(3) + 1e-3 * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]]), False),
    "xz": (np.eye(3) + 1e-3 * np.array([[0, 0, 1], [0, 0, 0], [1, 0, 0]]), False),
    "yz": (np.eye(3) + 1e-3 * np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0]]), False),
}


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("name", STRETCHES)
def test_mitsuba_takes_a_cylinder_that_is_round_straight_and_not_mirrored(name, turned):
    """The matrix is a rotation times a symmetric stretching, which may not shear any two axes."""
    stretch, accepted = STRETCHES[name]
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    assert mitsuba_accepts_matrix(turn @ stretch if turned else stretch) == accepted

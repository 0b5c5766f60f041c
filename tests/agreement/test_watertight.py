"""No ray leaves a closed mesh without meeting it, not between two triangles and not at a corner."""

import numpy as np
import pytest
from random_fields import direction

from caster.cameras import Pinhole
from caster.rendering.hits import cast, packed
from caster.scene.model import Scene
from caster.shapes import Icosphere, Torus
from caster.shapes.mesh import MeshFile

RAYS = 10_000  # at edges, and as many at vertices; `make nightly` casts millions
OFFSETS = (0.0, 1e3, 1e6)


def turned(shape: type, rng: np.random.Generator, offset: float, **fields) -> Scene:
    """One mesh, stretched and turned so that no coordinate is a round number, far from the origin or not."""
    turn = {"axis": direction(rng), "degrees": rng.uniform(0.0, 360.0)}
    place = [{"scale": rng.uniform(0.7, 1.3, 3)}, {"rotate": turn}, {"translate": offset * direction(rng)}]
    return Scene(camera=Pinhole(eye=(9, 0, 0), look_at=(0, 0, 0)), shapes=[shape(**fields, to_world=place)])


def places_inside(scene: Scene, rng: np.random.Generator, count: int) -> np.ndarray:
    """Within half the radius of a ball's middle."""
    matrix = scene.shapes[0].matrix
    place = 0.5 * rng.uniform(-1.0, 1.0, (count, 3)) / np.sqrt(3.0)
    return place @ matrix[:3, :3].T + matrix[:3, 3]


def places_in_the_tube(scene: Scene, rng: np.random.Generator, count: int) -> np.ndarray:
    """Near the circle around which a torus is bent."""
    matrix, turn = scene.shapes[0].matrix, rng.uniform(0.0, 2.0 * np.pi, count)
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    return (circle + rng.uniform(-0.05, 0.05, (count, 3))) @ matrix[:3, :3].T + matrix[:3, 3]


def aims(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """(2 RAYS, 3): points on edges, then vertices; all as exactly as float64 has them."""
    prims = packed(scene).kinds[0].prims
    corners = prims.vertices[prims.faces[rng.integers(len(prims.faces), size=RAYS)]]
    share = rng.random((RAYS, 1))
    on_edges = corners[:, 0] + share * (corners[:, 1] - corners[:, 0])
    return np.concatenate([on_edges, prims.vertices[rng.integers(len(prims.vertices), size=RAYS)]])


def count_leaks(scene: Scene, o: np.ndarray, aim: np.ndarray) -> int:
    """How many rays from inside get out."""
    return int((cast(scene, o, aim - o).prim_id < 0).sum())


@pytest.mark.parametrize("offset", OFFSETS)
def test_a_sphere_does_not_leak_at_edges_and_vertices(offset):
    rng = np.random.default_rng([60, OFFSETS.index(offset)])
    scene = turned(Icosphere, rng, offset, subdivisions=4)
    aim = aims(scene, rng)
    assert len(aim) == 2 * RAYS
    assert count_leaks(scene, places_inside(scene, rng, len(aim)), aim) == 0


@pytest.mark.parametrize("offset", OFFSETS)
def test_a_ring_does_not_leak_where_its_own_faces_stand_edge_on(offset):
    """From inside a tube many rays graze the inner wall before they reach the edge they were aimed at."""
    rng = np.random.default_rng([61, OFFSETS.index(offset)])
    scene = turned(Torus, rng, offset, segments=48, sides=24)
    aim = aims(scene, rng)
    assert count_leaks(scene, places_in_the_tube(scene, rng, len(aim)), aim) == 0


def test_a_missing_face_is_a_leak(tmp_path):
    """The count sees one hole: it is 1 of 80 faces, so about 1 ray of 80 gets out."""
    rng = np.random.default_rng(62)
    mesh = Icosphere(subdivisions=1).mesh()
    path = tmp_path / "open.obj"
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += ["f {} {} {}".format(*face) for face in (mesh.faces[1:] + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
    scene = turned(MeshFile, rng, 0.0, file=str(path))
    o = places_inside(scene, rng, 10_000)
    assert count_leaks(scene, o, o + rng.normal(size=o.shape)) >= 50

"""The meshes of the benchmark: triangles of float32 numbers, so that everybody is given the very same ones."""

from pathlib import Path

import numpy as np

from caster.packing import Triangles
from caster.procedural import heightfield, torus
from caster.shapes import MeshFile
from caster.whole_files import write_bytes
from mitsuba_ref.ply import ply_bytes


def written(folder: Path, name: str, vertices: np.ndarray, faces: np.ndarray, **more: str) -> MeshFile:
    """A mesh as a PLY file, and the shape that reads it. vertices: (n, 3), rounded to float32 here; faces: (m, 3)."""
    corners = np.asarray(vertices, np.float32).astype(np.float64)
    flat = np.zeros(len(faces), bool)
    none, no_uv = np.zeros_like(corners), np.zeros((len(corners), 2))
    file = folder / f"{name}.ply"
    write_bytes(file, ply_bytes(Triangles(corners, np.asarray(faces, np.int32), none, no_uv, flat, flat)))
    return MeshFile(file=str(file), face_normals=True, **more)


def ring(folder: Path, segments: int, sides: int, **more: str) -> MeshFile:
    """A closed torus of 2 * segments * sides triangles: silhouettes, and surface behind surface."""
    mesh = torus(1.0, 0.4, segments, sides)
    return written(folder, "ring", mesh.vertices, mesh.faces, **more)


def hills(folder: Path, triangles: int, **more: str) -> MeshFile:
    """About so many triangles of a hilly square of side 2."""
    resolution = max(1, round((triangles / 2) ** 0.5))
    mesh = heightfield(2.0, resolution, 0.2, 8, 0)
    return written(folder, "hills", mesh.vertices, mesh.faces, **more)


def layers(folder: Path, count: int) -> MeshFile:
    """Squares behind each other, in an order drawn by chance: every ray crosses all of them."""
    order = np.random.default_rng(0).permutation(count)
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    vertices = np.concatenate([corners - [0.0, 0.0, place / 64.0] for place in order])
    return written(folder, "layers", vertices, quads(4 * np.arange(count)[:, None] + np.arange(4)))


def square(folder: Path, half: float) -> MeshFile:
    """Two triangles in the plane z = 0."""
    vertices = half * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return written(folder, "square", vertices, quads(np.arange(4)[None]))


def quads(corners: np.ndarray) -> np.ndarray:
    """(n, 4) corners around -> (2 n, 3) triangles."""
    return np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


# Corners as Cornell University published them, in millimetres; x, y, z of each quad in turn.
ROOM = (
    ((552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)),
    ((556, 548.8, 0), (556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0)),
    ((549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2)),
    ((0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2)),
    ((552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0)),
)
BLOCKS = (  # height; x and z around the top
    (165.0, ((130, 65), (82, 225), (240, 272), (290, 114))),
    (330.0, ((423, 247), (265, 296), (314, 456), (472, 406))),
)


def cornell(folder: Path) -> MeshFile:
    """Walls and blocks as one mesh."""
    every = [np.array(wall, np.float64) for wall in ROOM]
    for height, top in BLOCKS:
        above = np.array([(x, height, z) for x, z in top])
        below = above * [1.0, 0.0, 1.0]
        every.append(above)
        for i in range(4):
            j = (i + 1) % 4
            every.append(np.stack([below[i], below[j], above[j], above[i]]))
    vertices = np.concatenate(every)
    return written(folder, "cornell", vertices, quads(np.arange(len(vertices)).reshape(-1, 4)))

"""Mesh files that the fuzzer draws from: shared edges and corners, slivers, faces without an area."""

import atexit
import functools
import shutil
import tempfile
from pathlib import Path

import numpy as np

from caster.shapes.icosphere import tessellate_icosphere

MeshArrays = tuple[np.ndarray, np.ndarray]  # vertices (n, 3), faces (m, 3)


def octahedron() -> MeshArrays:
    """Eight faces, all numbers whole."""
    vertices = np.vstack([np.eye(3), -np.eye(3)])
    signs = [(i, j, k) for i in (0, 3) for j in (1, 4) for k in (2, 5)]
    faces = [f if sum(v >= 3 for v in f) % 2 == 0 else (f[0], f[2], f[1]) for f in signs]
    return vertices, np.array(faces)


def dented_icosphere() -> MeshArrays:
    mesh = tessellate_icosphere(0)
    shares = np.random.default_rng(5).uniform(0.6, 1.0, (len(mesh.vertices), 1))
    return mesh.vertices * shares, mesh.faces


def fan_of_slivers() -> MeshArrays:
    """Twelve needles around one corner, the thinnest 1e-9 wide."""
    angles = np.concatenate([[0.0], np.cumsum(10.0 ** np.linspace(-9.0, 0.0, 12))])
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    faces = [(0, i, i + 1) for i in range(1, len(angles))]
    return np.vstack([np.zeros((1, 3)), rim]), np.array(faces)


def pinched_sheet() -> MeshArrays:
    """A 3 x 3 sheet of lattice squares, with faces that are a line or a point among its triangles."""
    y, x = np.divmod(np.arange(9), 3)
    vertices = np.column_stack([x - 1.0, y - 1.0, np.zeros(9)])
    squares = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (3, 4, 7), (3, 7, 6), (4, 5, 8), (4, 8, 7)]
    return vertices, np.array([*squares, (0, 4, 8), (4, 4, 5), (7, 7, 7), (0, 1, 2)])


def doubled_square() -> MeshArrays:
    """The same square three times: as given, reversed, and with duplicated vertices."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    faces = [(0, 1, 2), (0, 2, 3), (2, 1, 0), (3, 2, 0), (4, 5, 6), (4, 6, 7)]
    return np.vstack([vertices, vertices]), np.array(faces)


MESH_BUILDERS = (octahedron, dented_icosphere, fan_of_slivers, pinched_sheet, doubled_square)


@functools.cache
def mesh_files() -> tuple[str, ...]:
    """These meshes as OBJ files, in a folder that goes away with this process."""
    folder = Path(tempfile.mkdtemp(prefix="mitsuba-ref-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return tuple(_write_obj(folder / f"{make.__name__}.obj", *make()) for make in MESH_BUILDERS)


def _write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> str:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["f {} {} {}".format(*face) for face in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(path)

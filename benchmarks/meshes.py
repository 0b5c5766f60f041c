"""How long a mesh file takes to load: the caster beside Mitsuba's scalar_rgb, in turns, in one process each.

    python benchmarks/meshes.py [--triangles 70000] [--turns 7]

Files are written to a temporary folder: PLY in binary and in ascii, OBJ. Prints the median of each and their ratio.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np

from caster.geometry.mesh_files import load_mesh
from caster.geometry.triangle_mesh import Mesh
from caster.shapes.heightfield import tessellate_heightfield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=70_000)
    parser.add_argument("--turns", type=int, default=7)
    args = parser.parse_args()
    mi.set_variant("scalar_rgb")
    mesh = tessellate_heightfield(2.0, max(1, round((args.triangles / 2) ** 0.5)), 0.2, 8, 1)
    with tempfile.TemporaryDirectory() as folder:
        print(f"{len(mesh.faces)} triangles     caster    Mitsuba   ratio")
        for name, write in (("binary.ply", write_binary), ("ascii.ply", write_ascii), ("mesh.obj", write_obj)):
            path = Path(folder) / name
            write(path, mesh)
            ours, theirs = paired(path, args.turns)
            print(f"{name:12} {ours * 1e3:13.1f} ms {theirs * 1e3:7.1f} ms {ours / theirs:7.2f}")


def paired(path: Path, turns: int) -> tuple[float, float]:
    """Median seconds of the caster and of Mitsuba."""
    plugin = {"type": path.suffix[1:], "filename": str(path)}
    both = [seconds(lambda: load_mesh(path)), seconds(lambda: mi.load_dict(plugin))]  # the first is for the caches
    both = [(seconds(lambda: load_mesh(path)), seconds(lambda: mi.load_dict(plugin))) for _ in range(turns)]
    ours, theirs = zip(*both, strict=True)
    return statistics.median(ours), statistics.median(theirs)


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def write_binary(path: Path, mesh: Mesh) -> None:
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    vertices = np.ascontiguousarray(mesh.vertices, "<f4")
    path.write_bytes(header(mesh, "binary_little_endian").encode() + vertices.tobytes() + faces.tobytes())


def write_ascii(path: Path, mesh: Mesh) -> None:
    with path.open("w") as file:
        file.write(header(mesh, "ascii"))
        np.savetxt(file, mesh.vertices, "%.9g")
        np.savetxt(file, np.insert(mesh.faces, 0, 3, axis=1), "%d")


def write_obj(path: Path, mesh: Mesh) -> None:
    with path.open("w") as file:
        np.savetxt(file, mesh.vertices, "v %.9g %.9g %.9g")
        np.savetxt(file, mesh.faces + 1, "f %d %d %d")


def header(mesh: Mesh, form: str) -> str:
    return (
        f"ply\nformat {form} 1.0\nelement vertex {len(mesh.vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )


if __name__ == "__main__":
    main()

"""Meshes of `validate --builtin`, made from integers, sums, products and roots: the same bits on every machine.

    python benchmarks/builtin_meshes.py mitsuba_ref/runner/builtin/triangles

A scan has what scans have: noise in every vertex, triangles of a millionth of the others' size, slivers, faces of
no area, and holes. tests/unit/test_builtin_scenes.py holds the files to this.
"""

import sys
from pathlib import Path

import numpy as np

LEVELS = 5  # of subdivision of an octahedron
SCAN_SIZE, SCAN_PLACE = 83.0, (412.3, -155.7, 903.1)  # millimetres, in the frame of the machine
MASK = (1 << 64) - 1


def uniform(*numbers: int) -> float:
    """A number in [0, 1) that depends on these integers alone: SplitMix64."""
    z = 0x9E3779B97F4A7C15
    for number in numbers:
        z = (z + (number & MASK) * 0xD1342543DE82EF95 + 0x9E3779B97F4A7C15) & MASK
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        z ^= z >> 31
    return (z >> 11) * 2.0**-53


def unit(p: np.ndarray) -> np.ndarray:
    """Divided by the length; three products and two sums, in this order."""
    x, y, z = (float(c) for c in p)
    return np.array([x, y, z]) / np.sqrt(x * x + y * y + z * z)


def octahedron(levels: int) -> tuple[list[np.ndarray], list[tuple[int, int, int]]]:
    """(points on the unit sphere, triangles that wind counter-clockwise seen from outside)."""
    points = [np.array(p, float) for p in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))]
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    for _ in range(levels):
        middles: dict[tuple[int, int], int] = {}

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                middles[key] = len(points)
                points.append(unit(points[a] + points[b]))
            return middles[key]

        split = []
        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            split += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = split
    return points, faces


def lattice_noise(p: np.ndarray, frequency: float, seed: int) -> float:
    """Smooth noise in [0, 1): random values at the points of a lattice, interpolated."""
    cell = [int(np.floor(c * frequency)) for c in p]
    share = [float(c) * frequency - i for c, i in zip(p, cell, strict=True)]
    total = 0.0
    for corner in range(8):
        weight, place = 1.0, []
        for axis in range(3):
            up = (corner >> axis) & 1
            weight *= share[axis] if up else 1.0 - share[axis]
            place.append(cell[axis] + up)
        total += weight * uniform(seed, *place)
    return total


def scan() -> tuple[np.ndarray, np.ndarray]:
    points, faces = octahedron(LEVELS)
    p = np.array([q * (1.0 + 0.3 * lattice_noise(q, 2.0, 1) + 0.06 * lattice_noise(q, 7.0, 2)) for q in points])
    p = np.array([q * (1.0 + 0.003 * uniform(3, i)) for i, q in enumerate(p)])
    for number, (a, b, c) in enumerate(faces):
        choice = uniform(4, number)
        if choice < 0.02:  # all corners close together: a triangle down to a millionth of its neighbours' size
            k = int(3 + 18 * uniform(5, number))
            p[b], p[c] = p[a] + (p[b] - p[a]) * 2.0**-k, p[a] + (p[c] - p[a]) * 2.0**-k
        elif choice < 0.04:  # a corner next to another: a needle
            p[b] = p[a] + (p[b] - p[a]) * 2.0 ** -int(3 + 18 * uniform(6, number))
        elif choice < 0.06:  # a corner next to the opposite edge: a sliver
            q = p[b] + (p[c] - p[b]) * uniform(7, number)
            p[a] = q + (p[a] - q) * 2.0 ** -int(3 + 18 * uniform(8, number))
        elif choice < 0.065:  # no area at all
            p[b] = p[a]
    kept = [face for number, face in enumerate(faces) if uniform(9, number) >= 0.01]
    return p * SCAN_SIZE + np.array(SCAN_PLACE), np.array(kept)


def needles() -> tuple[np.ndarray, np.ndarray]:
    """Triangles that are up to a million times as long as they are wide, across each other."""
    vertices, faces = [], []
    for i in range(240):
        start = np.array([uniform(20, i, k) - 0.5 for k in range(3)])
        along = unit(np.array([uniform(21, i, k) - 0.5 for k in range(3)]))
        aside = unit(np.array([uniform(22, i, k) - 0.5 for k in range(3)]))
        width = 2.0 ** -(2 + 18 * uniform(23, i) // 1)
        faces.append([3 * i, 3 * i + 1, 3 * i + 2])
        vertices += [start - along, start - along + aside * width, start + along]
    return np.array(vertices), np.array(faces)


def grid() -> tuple[np.ndarray, np.ndarray]:
    """A plane of 32 by 32 squares, whose corners are on multiples of 1/8, with diagonals of either direction."""
    side = 33
    vertices = [((i - 16) / 8.0, (j - 16) / 8.0, 0.0) for j in range(side) for i in range(side)]
    faces = []
    for j in range(side - 1):
        for i in range(side - 1):
            a, b, c, d = (j * side + i, j * side + i + 1, (j + 1) * side + i + 1, (j + 1) * side + i)
            faces += [(a, b, c), (a, c, d)] if (i + j) % 2 else [(a, b, d), (b, c, d)]
    return np.array(vertices), np.array(faces)


def pile() -> tuple[np.ndarray, np.ndarray]:
    """Sheets on top of each other: at the same place, and from 2^-22 to 2^-3 apart."""
    heights = [0.0, 0.0, 0.0, *(-(2.0 ** -(22 - k)) for k in range(20)), -0.25, -0.25]
    vertices, faces = [], []
    for k, z in enumerate(heights):
        x, y = uniform(30, k) * 0.5, uniform(31, k) * 0.5
        corners = [(-1 + x, -1 + y, z), (1 - y, -1 + x, z), (1 - x, 1 - y, z), (-1 + y, 1 - x, z)]
        first = len(vertices)
        vertices += corners
        faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return np.array(vertices), np.array(faces)


MESHES = {"scan": scan, "needles": needles, "grid": grid, "pile": pile}


def ply(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """Binary PLY of float32."""
    rows = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return head.encode("ascii") + vertices.astype("<f4").tobytes() + rows.tobytes()


if __name__ == "__main__":
    for name, make in MESHES.items():
        (Path(sys.argv[1]) / f"{name}.ply").write_bytes(ply(*make()))

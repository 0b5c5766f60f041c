"""Corners of OBJ faces, v/vt/vn with an index each, and how they become vertices."""

import numpy as np
from numpy.typing import NDArray

from caster.mesh import Floats, Mesh, vertex_normals
from caster.mesh_files.polygons import fans

Corner = tuple[int, int, int]  # v, vt, vn counted from 0; -1 where there is none


def read_corner(word: bytes, counts: Corner) -> Corner:
    """b"3/-1", with counts of (v, vt, vn), -> (2, last vt, -1). Raises ValueError that says what is wrong."""
    parts = word.split(b"/")
    if len(parts) > 3 or not parts[0] or b"_" in word:
        raise ValueError(f"expected a corner v, v/vt, v//vn or v/vt/vn, got {quoted(word)}")
    parts += [b""] * (3 - len(parts))
    v, vt, vn = map(_index, parts, counts, ("v", "vt", "vn"))
    return v, vt, vn


def _index(text: bytes, count: int, kind: str) -> int:
    if not text:
        return -1
    try:
        index = int(text)
    except ValueError:
        raise ValueError(f"expected a whole number as {kind} of a corner, got {quoted(text)}") from None
    if index == 0 or not -count <= index <= count:
        limits = f"1 to {count} or -{count} to -1" if count else f"none, as there is no {kind}"
        raise ValueError(f"{kind} of a corner must be {limits}, got {quoted(text)}")
    return index - 1 if index > 0 else count + index


def join_corners(
    positions: Floats,
    uv: Floats,
    normals: Floats,
    known: dict[bytes, Corner],
    words: list[bytes],
    sizes: list[int],
) -> Mesh:
    """The mesh of polygons whose corners are `words`, `sizes` of them at a time."""
    table = np.array(list(known.values()), np.int64).reshape(-1, 3)
    number = {word: k for k, word in enumerate(known)}
    row = np.fromiter((number[word] for word in words), np.int64, len(words))
    triangles = row[fans(np.array(sizes, np.int64))]
    by_position = table[triangles, 0].astype(np.int32)
    if np.all(table[:, 1:] < 0):
        return Mesh(positions, by_position)
    used, vertex = np.unique(table, axis=0, return_inverse=True)
    return Mesh(
        positions[used[:, 0]],
        vertex.ravel()[triangles].astype(np.int32),
        _normals_of(used, normals, positions, by_position),
        _uv_of(used, uv),
    )


def join_table(
    positions: Floats, uv: Floats, normals: Floats, corners: NDArray[np.int64], sizes: NDArray[np.int64]
) -> Mesh:
    """The same, of corners (words, 3) of v, vt, vn each."""
    triangles = np.arange(len(corners)).reshape(-1, 3) if np.all(sizes == 3) else fans(sizes)
    by_position = corners[triangles, 0].astype(np.int32)
    if np.all(corners[:, 1:] < 0):
        return Mesh(positions, by_position)
    # One whole number for each combination, in the order of (v, vt, vn): where it fits, sorting is much faster.
    bases = len(positions), len(uv) + 1, len(normals) + 1
    if bases[0] * bases[1] * bases[2] < 2**62:
        number = (corners[:, 0] * bases[1] + corners[:, 1] + 1) * bases[2] + corners[:, 2] + 1
        _, first, vertex = np.unique(number, return_index=True, return_inverse=True)
        used = corners[first]
    else:
        used, vertex = np.unique(corners, axis=0, return_inverse=True)
    return Mesh(
        positions[used[:, 0]],
        vertex.ravel()[triangles].astype(np.int32),
        _normals_of(used, normals, positions, by_position),
        _uv_of(used, uv),
    )


def _normals_of(
    used: NDArray[np.int64], normals: Floats, positions: Floats, faces: NDArray[np.int32]
) -> Floats | None:
    """The file's normals; where only some corners have one, the others get generated ones."""
    absent = used[:, 2] < 0
    if absent.all():
        return None
    found = normals[used[:, 2]]
    if absent.any():
        found[absent] = vertex_normals(positions, faces)[used[absent, 0]]
    return found


def _uv_of(used: NDArray[np.int64], uv: Floats) -> Floats | None:
    absent = used[:, 1] < 0
    if absent.all():
        return None
    flipped = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)
    found = flipped[used[:, 1]]
    found[absent] = 0.0
    return found


def quoted(text: bytes) -> str:
    """Text of a file, shortened, for an error message."""
    return repr(text[:60].decode("ascii", "backslashreplace"))

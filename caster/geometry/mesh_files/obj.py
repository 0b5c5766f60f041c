"""Reader of Wavefront OBJ files.

All objects and groups of a file become one mesh; materials, lines, points and free-form surfaces are ignored.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caster.description.errors import SceneError
from caster.geometry.triangle_mesh import Floats, Mesh, format_row, triangle_fans, vertex_normals

# Statements without triangles. An unknown keyword is an error: it may be a misspelt face.
WITHOUT_TRIANGLES = frozenset(
    b"vp p l o g s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj ctech "
    b"stech cstype deg bmat step curv curv2 surf parm trim hole scrv sp end con call csh".split()
)


def parse_obj(data: bytes, where: str) -> Mesh:
    """Text of an OBJ file -> Mesh. Raises SceneError with `where`:line.

    Without vt and vn the vertices are the file's, in its order. With them there is a vertex for each
    combination in use, ordered by (v, vt, vn). Corners without vn, in a file that has some, get generated
    normals; corners without vt get uv (0, 0). v of uv becomes 1 - v, as in Mitsuba.
    """
    rows: dict[bytes, list[list[float]]] = {b"v": [], b"vt": [], b"vn": []}
    known: dict[bytes, int] = {}  # a number for each corner, by its text
    first_lines: list[int] = []  # the line where each text occurs first
    spelled: list[int] = []  # the numbers of the corners of all faces
    sizes: list[int] = []  # of the faces
    for line, words in _statements(data):
        keyword = words[0]
        if keyword in rows:
            rows[keyword].append(_numbers(words, f"{where}:{line}"))
        elif keyword in (b"f", b"fo"):
            if len(words) < 4:
                raise SceneError(f"{where}:{line}: a face needs at least 3 vertices, got {len(words) - 1}")
            if b"-" in b"".join(words):  # negative indices count back from their statement
                words[1:] = [_absolute(word, rows, f"{where}:{line}") for word in words[1:]]
            for word in words[1:]:
                if word not in known:
                    known[word] = len(known)
                    first_lines.append(line)
                spelled.append(known[word])
            sizes.append(len(words) - 1)
        elif keyword not in WITHOUT_TRIANGLES:
            raise SceneError(
                f"{where}:{line}: expected an OBJ statement (v, vt, vn, f, ...), got {quote_bytes(keyword)}"
            )
    indices = [_read_corner(word, rows, f"{where}:{line}") for word, line in zip(known, first_lines, strict=True)]
    triangles = np.array(spelled, np.int64)[triangle_fans(np.array(sizes, np.int64))]
    v, vt, vn = (np.array(each, np.float64).reshape(-1, 2 if key == b"vt" else 3) for key, each in rows.items())
    return _joined(v, vt, vn, np.array(indices, np.int64).reshape(-1, 3), triangles)


def _statements(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """(line, words) of each statement; a backslash at the end of a line joins the next one to it."""
    lines = iter(enumerate(data.removeprefix(b"\xef\xbb\xbf").splitlines(), 1))
    for number, line in lines:
        text = line.partition(b"#")[0].rstrip()
        while text.endswith(b"\\"):
            text = text[:-1] + b" " + next(lines, (0, b""))[1].partition(b"#")[0].rstrip()
        if words := text.split():
            yield number, words


def _numbers(words: list[bytes], place: str) -> list[float]:
    """The numbers of a statement v, vt or vn, as many as are kept."""
    keyword = words[0].decode()
    least = 1 if keyword == "vt" else 3
    numbers = read_numbers(words[1:], place)
    if len(numbers) < least:
        raise SceneError(f"{place}: {keyword} needs {least} numbers, got {len(numbers)}")
    row = [*numbers, 0.0][:2] if keyword == "vt" else numbers[:3]
    if keyword != "v" and not all(map(math.isfinite, row)):  # faces with such a vertex are rejected later
        raise SceneError(f"{place}: {keyword} must be finite numbers, got {format_row(row)}")
    return row


def _absolute(word: bytes, rows: dict[bytes, list[list[float]]], place: str) -> bytes:
    """A corner whose indices count from 1."""
    return b"/".join(b"" if i < 0 else b"%d" % (i + 1) for i in _read_corner(word, rows, place))


def _read_corner(word: bytes, rows: dict[bytes, list[list[float]]], place: str) -> list[int]:
    """b"3/-1" -> [2, the last vt, -1]: indices of v, vt and vn from 0 on, -1 for none."""
    parts = word.split(b"/")
    if len(parts) > 3 or not parts[0] or b"_" in word:
        raise SceneError(f"{place}: expected a corner v, v/vt, v//vn or v/vt/vn, got {quote_bytes(word)}")
    found = [-1, -1, -1]
    for k, (text, kind) in enumerate(zip(parts, rows, strict=False)):
        if not text:
            continue
        name, count = kind.decode(), len(rows[kind])
        try:
            index = int(text)
        except ValueError:
            raise SceneError(
                f"{place}: expected a whole number as {name} of a corner, got {quote_bytes(text)}"
            ) from None
        if index == 0 or not -count <= index <= count:
            limits = f"1 to {count} or -{count} to -1" if count else f"none, as there is no {name}"
            raise SceneError(f"{place}: {name} of a corner must be {limits}, got {quote_bytes(text)}")
        found[k] = index - 1 if index > 0 else count + index
    return found


def _joined(v: Floats, vt: Floats, vn: Floats, corners: NDArray[np.int64], triangles: NDArray[np.int64]) -> Mesh:
    """The mesh of triangles (m, 3), whose numbers are rows of corners (n, 3): indices of v, vt and vn."""
    by_position = corners[triangles, 0].astype(np.int32)
    if np.all(corners[:, 1:] < 0):
        return Mesh(v, by_position)
    used, vertex = np.unique(corners, axis=0, return_inverse=True)
    faces = vertex.ravel()[triangles].astype(np.int32)
    without_uv, without_normal = used[:, 1:].T < 0
    uv = normals = None
    if not without_uv.all():
        uv = np.stack([vt[:, 0], 1.0 - vt[:, 1]], axis=1)[used[:, 1]]
        uv[without_uv] = 0.0
    if not without_normal.all():
        normals = vn[used[:, 2]]
        if without_normal.any():
            normals[without_normal] = vertex_normals(v, by_position)[used[without_normal, 0]]
    return Mesh(v[used[:, 0]], faces, normals, uv)


def read_numbers(words: list[bytes], place: str, kind: Callable[[bytes], Any] = float) -> list[Any]:
    """Words as numbers. Raises SceneError with their place in the file."""
    try:
        if b"_" in b"".join(words):  # Python accepts 1_000
            raise ValueError
        return list(map(kind, words))
    except ValueError:
        raise SceneError(f"{place}: expected numbers, got {quote_bytes(b' '.join(words))}") from None


def quote_bytes(text: bytes) -> str:
    """Bytes of a file as quoted text for a message, truncated."""
    return repr(text[:60].decode("ascii", "backslashreplace"))

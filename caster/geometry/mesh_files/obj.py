"""Reader of Wavefront OBJ files.

All objects and groups of a file become one mesh; materials, lines, points and free-form surfaces are ignored.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from caster.description.errors import SceneError
from caster.geometry.mesh_files.plain_text import read_plain_obj
from caster.geometry.triangle_mesh import Floats, Mesh, format_row, triangle_fans, vertex_normals

Corner = tuple[int, int, int]  # 0-based indices v, vt, vn; -1 if absent


def read_corner(word: bytes, counts: Corner) -> Corner:
    """b"3/-1", with counts of (v, vt, vn), -> (2, last vt, -1). Raises ValueError with a message."""
    parts = word.split(b"/")
    if len(parts) > 3 or not parts[0] or b"_" in word:
        raise ValueError(f"expected a corner v, v/vt, v//vn or v/vt/vn, got {quote_bytes(word)}")
    parts += [b""] * (3 - len(parts))
    v, vt, vn = map(_index, parts, counts, ("v", "vt", "vn"))
    return v, vt, vn


def _index(text: bytes, count: int, kind: str) -> int:
    if not text:
        return -1
    try:
        index = int(text)
    except ValueError:
        raise ValueError(f"expected a whole number as {kind} of a corner, got {quote_bytes(text)}") from None
    if index == 0 or not -count <= index <= count:
        limits = f"1 to {count} or -{count} to -1" if count else f"none, as there is no {kind}"
        raise ValueError(f"{kind} of a corner must be {limits}, got {quote_bytes(text)}")
    return index - 1 if index > 0 else count + index


def join_corners(
    positions: Floats, uv: Floats, normals: Floats, known: dict[bytes, Corner], words: list[bytes], sizes: list[int]
) -> Mesh:
    """The mesh of polygons with `sizes` corners each; `words` are all corners in order."""
    table = np.array(list(known.values()), np.int64).reshape(-1, 3)
    number = {word: k for k, word in enumerate(known)}
    row = np.fromiter((number[word] for word in words), np.int64, len(words))
    triangles = row[triangle_fans(np.array(sizes, np.int64))]
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
    """The same for corners as an array (corners, 3) of v, vt, vn."""
    triangles = np.arange(len(corners)).reshape(-1, 3) if np.all(sizes == 3) else triangle_fans(sizes)
    by_position = corners[triangles, 0].astype(np.int32)
    if np.all(corners[:, 1:] < 0):
        return Mesh(positions, by_position)
    # One integer key per combination, ordered like (v, vt, vn): sorting integers is much faster.
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


def _normals_of(used: NDArray[np.int64], normals: Floats, positions: Floats, faces: NDArray[np.int32]) -> Floats | None:
    """The normals of the file; generated ones for corners without, if some have one."""
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


def quote_bytes(text: bytes) -> str:
    """Bytes of a file as quoted text for a message, truncated."""
    return repr(text[:60].decode("ascii", "backslashreplace"))


# Statements without triangles. An unknown keyword is an error: it may be a misspelt face.
WITHOUT_TRIANGLES = frozenset(
    b"vp p l o g s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj ctech "
    b"stech cstype deg bmat step curv curv2 surf parm trim hole scrv sp end con call csh".split()
)


def parse_obj(data: bytes, where: str) -> Mesh:
    """Text of an OBJ file -> Mesh. Raises SceneError with `where`:line.

    Without vt and vn the vertices are the file's, in its order. With them there is a vertex for each
    combination in use, ordered by (v, vt, vn). Corners without vn, in a file that has some, get generated
    normals; corners without vt get uv (0, 0). v of uv becomes 1 - v, as Mitsuba does it.
    """
    plain = read_plain_obj(data)
    if plain is not None:
        return join_table(*plain.rows, plain.corners, plain.sizes)
    return parse_any_obj(data, where)


def parse_any_obj(data: bytes, where: str) -> Mesh:
    """The same in Python, statement by statement, with errors that name the line."""
    obj = _Obj(where)
    for line, words in _statements(data):
        obj.add(line, words)
    return obj.mesh()


class _Rows:
    """Numbers of all statements with one keyword, and their lines."""

    def __init__(self, keyword: str, needs: int, width: int) -> None:
        self.keyword, self.needs, self.width = keyword, needs, width
        self.rows: list[list[float]] = []
        self.lines: list[int] = []

    def add(self, line: int, words: list[bytes], where: str) -> None:
        numbers = _numbers(words, f"{where}:{line}")
        if len(numbers) < self.needs:
            raise SceneError(f"{where}:{line}: {self.keyword} needs {self.needs} numbers, got {len(numbers)}")
        self.rows.append([*numbers, 0.0][: self.width])  # vt may have one number
        self.lines.append(line)

    def array(self, where: str) -> Floats:
        rows = np.array(self.rows, np.float64).reshape(-1, self.width)
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(bad) and self.keyword != "v":  # faces with such a vertex are rejected later
            line, got = self.lines[bad[0]], format_row(rows[bad[0]])
            raise SceneError(f"{where}:{line}: {self.keyword} must be finite numbers, got {got}")
        return rows


class _Obj:
    """State of the reader: numbers and faces so far."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.numbers = {b"v": _Rows("v", 3, 3), b"vt": _Rows("vt", 1, 2), b"vn": _Rows("vn", 3, 3)}
        self.face_lines: list[int] = []
        self.face_sizes: list[int] = []
        self.corners: list[bytes] = []

    def add(self, line: int, words: list[bytes]) -> None:
        keyword = words[0]
        rows = self.numbers.get(keyword)
        if rows is not None:
            rows.add(line, words[1:], self.where)
        elif keyword in (b"f", b"fo"):
            self._add_face(line, words[1:])
        elif keyword not in WITHOUT_TRIANGLES:
            place, got = f"{self.where}:{line}", quote_bytes(keyword)
            raise SceneError(f"{place}: expected an OBJ statement (v, vt, vn, f, ...), got {got}")

    def _add_face(self, line: int, words: list[bytes]) -> None:
        if len(words) < 3:
            raise SceneError(f"{self.where}:{line}: a face needs at least 3 vertices, got {len(words)}")
        self.face_lines.append(line)
        self.face_sizes.append(len(words))
        self.corners.extend(words)
        if any(b"-" in word for word in words):
            self._make_absolute(len(words))

    def _make_absolute(self, count: int) -> None:
        """Resolve negative indices, which count back from the current statement."""
        so_far = self._counts()
        for k in range(len(self.corners) - count, len(self.corners)):
            corner = self._corner(self.corners[k], so_far)
            self.corners[k] = b"/".join(b"" if i < 0 else b"%d" % (i + 1) for i in corner)

    def mesh(self) -> Mesh:
        positions, uv, normals = (rows.array(self.where) for rows in self.numbers.values())
        counts = self._counts()
        corners = {word: self._corner(word, counts) for word in dict.fromkeys(self.corners)}
        return join_corners(positions, uv, normals, corners, self.corners, self.face_sizes)

    def _counts(self) -> Corner:
        v, vt, vn = (len(rows.rows) for rows in self.numbers.values())
        return v, vt, vn

    def _corner(self, word: bytes, counts: Corner) -> Corner:
        try:
            return read_corner(word, counts)
        except ValueError as error:
            raise SceneError(f"{self._place(word)}: {error}") from error

    def _place(self, word: bytes) -> str:
        face = np.searchsorted(np.cumsum(self.face_sizes), self.corners.index(word), side="right")
        return f"{self.where}:{self.face_lines[face]}"


def _statements(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """(line, words) of each statement; a backslash at the end of a line joins the next one to it."""
    lines = iter(enumerate(data.removeprefix(b"\xef\xbb\xbf").splitlines(), 1))
    for number, line in lines:
        text = _without_comment(line)
        while text.endswith(b"\\"):
            text = text[:-1] + b" " + _without_comment(next(lines, (0, b""))[1])
        words = text.split()
        if words:
            yield number, words


def _without_comment(line: bytes) -> bytes:
    return line.partition(b"#")[0].rstrip() if b"#" in line else line.rstrip()


def _numbers(words: list[bytes], where: str) -> list[float]:
    try:
        numbers = list(map(float, words))
    except ValueError as error:
        raise SceneError(f"{where}: expected numbers, got {quote_bytes(b' '.join(words))}") from error
    if b"_" in b"".join(words):  # Python accepts 1_000
        raise SceneError(f"{where}: expected numbers, got {quote_bytes(b' '.join(words))}")
    return numbers

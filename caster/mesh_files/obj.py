"""Wavefront OBJ: one pass over the statements, then arrays.

All objects and groups of a file become one mesh; materials, lines, points and free surfaces are left out.
"""

from collections.abc import Iterator

import numpy as np

from caster.fields import SceneError
from caster.mesh import Floats, Mesh, show
from caster.mesh_files.obj_corners import Corner, join_corners, join_table, quoted, read_corner
from caster.mesh_files.plain_text import read_plain_obj

# Statements that draw no triangle. A word that is not OBJ at all is an error: it may be a face, misspelt.
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
    """The same, statement by statement."""
    obj = _Obj(where)
    for line, words in _statements(data):
        obj.add(line, words)
    return obj.mesh()


class _Rows:
    """The numbers of all statements of one kind, and the lines they are on."""

    def __init__(self, keyword: str, needs: int, width: int) -> None:
        self.keyword, self.needs, self.width = keyword, needs, width
        self.rows: list[list[float]] = []
        self.lines: list[int] = []

    def add(self, line: int, words: list[bytes], where: str) -> None:
        numbers = _numbers(words, f"{where}:{line}")
        if len(numbers) < self.needs:
            raise SceneError(f"{where}:{line}: {self.keyword} needs {self.needs} numbers, got {len(numbers)}")
        self.rows.append([*numbers, 0.0][: self.width])  # a vt may have one number only
        self.lines.append(line)

    def array(self, where: str) -> Floats:
        rows = np.array(self.rows, np.float64).reshape(-1, self.width)
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(bad) and self.keyword != "v":  # faces with such a corner are left out later, and counted
            line, got = self.lines[bad[0]], show(rows[bad[0]])
            raise SceneError(f"{where}:{line}: {self.keyword} must be finite numbers, got {got}")
        return rows


class _Obj:
    """What the statements read so far amount to."""

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
            place, got = f"{self.where}:{line}", quoted(keyword)
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
        """Negative indices count back from the statement they are in: settle them while that is known."""
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
        raise SceneError(f"{where}: expected numbers, got {quoted(b' '.join(words))}") from error
    if b"_" in b"".join(words):  # Python would read 1_000 as a thousand
        raise SceneError(f"{where}: expected numbers, got {quoted(b' '.join(words))}")
    return numbers

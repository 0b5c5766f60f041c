"""Mesh files read again, by Mitsuba's own loader and by plain Python, both against the mesh that the caster has read.

A mesh reaches both sides of a comparison as the caster has read it, so no pixel shows an error of its reader. Here the
original file goes to Mitsuba's `obj` or `ply` plug-in: its faces, corner by corner in the file's order, are the
caster's, and corners share a vertex where they do there. Mitsuba parses a number to the nearest float32 at once, the
caster to float64, which is rounded to float32 later. Both agree, but where that float64 lies in the middle between two
float32, when either of these is right. The same file by Python's `float` and `struct` shows what float32 does not:
positions and uv are the caster's to the bit, and so is the number of vertices, on which generated normals depend.
"""

import base64
import json
import re
import struct
from collections.abc import Callable, Iterator
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from urllib.parse import unquote

import numpy as np

from caster.scene.model import Scene
from caster.shapes.mesh import MeshFile
from caster.shapes.sphere import SphereCloud
from mitsuba_ref.error_model.bounds import error_over_bound
from mitsuba_ref.error_model.independent_transform import angle_weighted_normals
from mitsuba_ref.error_model.intersections import unit
from mitsuba_ref.error_model.tolerances import FILE_NORMAL_ROUNDINGS, FILE_UV_ROUNDINGS, TRANSFORM_ROUNDINGS, U32
from mitsuba_ref.judge.checks import Shares, check
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.reference.messages import LoadedMesh
from mitsuba_ref.reference.rendering import ReferenceResult

T = TypeVar("T")

MAX_PLAIN_BYTES = 2_000_000  # of files that plain Python reads, too: a second
PLAIN_SPHERES = 50_000  # of a file of spheres, from its beginning: half a second
REFUSED = "not compared: Mitsuba's loader says"
READ_ONCE = "not compared, large, or with what plain Python does not read: triangles"
AT_SOME = "not compared, some corners of a large file have none: those"


POSITION, UV, NORMAL = range(3)  # columns of PlainMesh.indices


class PlainMesh(NamedTuple):
    """A file's numbers, and its faces as triangles of them. Corners with the same three indices share a vertex."""

    points: np.ndarray  # (n, 3) float64
    indices: np.ndarray  # (f, 3, 3) of position, uv and normal at each corner, -1 for none
    vertices: int  # of the mesh
    plain: bool = False  # Mitsuba's loader supports all that is in the file
    uv: np.ndarray = np.zeros((0, 2))  # as the mesh has them
    normals: np.ndarray = np.zeros((0, 3))  # of any length

    @property
    def corners(self) -> np.ndarray:
        """(f, 3, 3) float64: the positions."""
        return self.points[self.indices[..., POSITION]]

    def has(self, column: int) -> np.ndarray:
        """(f, 3) bool: the corners that have a UV or NORMAL."""
        return self.indices[..., column] >= 0


def positions_alone(points: np.ndarray, faces: np.ndarray, plain: bool = False) -> PlainMesh:
    """A mesh of points (n, 3), whose faces (f, 3) have neither normals nor uv."""
    indices = np.full((*faces.shape, 3), -1)
    indices[..., POSITION] = faces
    return PlainMesh(points, indices, len(points), plain)


def files_of(scene: Scene) -> dict[Path, Any]:
    """The mesh files of a scene, each once, as the caster read them."""
    return {Path(each.file): each.mesh() for each in scene.shapes if isinstance(each, MeshFile)}


def read_plainly(file: Path) -> PlainMesh | None:
    """The faces of a file by plain Python; None for a large one, or a glTF."""
    read = PLAIN_READERS.get(file.suffix.lower())
    return None if read is None or file.stat().st_size > MAX_PLAIN_BYTES else read(file.read_bytes())


def for_mitsuba(file: Path, folder: Path, number: int) -> Path:
    """The file itself; where Mitsuba's loader does not support all that is in it, the same faces in a file of its kind.

    Its OBJ has neither negative indices nor continued lines, its PLY no polygons, and it has no STL or OFF.
    """
    found = read_plainly(file)
    if found is None or found.plain:
        return file
    copy = folder / f"mesh-file-{number}.obj"
    if file.suffix.lower() == ".obj":
        copy.write_bytes(b"".join(b" ".join(words) + b"\n" for words, _ in obj_statements(file.read_bytes())))
        return copy
    lines = ["v " + " ".join(map(repr, corner)) for corner in found.corners.reshape(-1, 3).tolist()]
    lines += [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(len(found.corners))]
    copy.write_text("\n".join(lines) + "\n", encoding="ascii")
    return copy


@check()
def check_mesh_files(scene: Scene, result: ReferenceResult) -> SceneCheck:
    """Every mesh file of the scene as others read it: by Mitsuba, in the order of `files_of`."""
    files, loaded = files_of(scene), result.answer.meshes
    if len(loaded) != len(files):
        return SceneCheck("mesh_files", np.inf, f"{len(files)} files, Mitsuba has read {len(loaded)}")
    shares, names = Shares(), [file.name for file in files]
    for (file, mesh), theirs in zip(files.items(), loaded, strict=True):
        found = read_plainly(file)
        is_gltf = file.suffix.lower() in GLTF_SUFFIXES
        claims = _against_gltf(mesh, file) if is_gltf else _against_mitsuba(mesh, theirs, found, file)
        if found is not None:
            claims |= _against_plain(mesh, found)
        shown = file.name if names.count(file.name) == 1 else file
        for what, share in claims.items():
            shares.add(f"{what} of {shown}", share)
    for number, file, share in _files_of_spheres(scene):
        shares.add(f"spheres of {file.name}, shape {number}", share)
    what, worst = shares.worst()
    return SceneCheck("mesh_files", worst, what)


def _files_of_spheres(scene: Scene) -> Iterator[tuple[int, Path, float]]:
    """(number, file, share) of shapes of spheres from files: 0 if plain Python reads the same numbers, else inf."""
    for number, shape in enumerate(scene.shapes):
        if isinstance(shape, SphereCloud) and shape.file is not None:
            centers, radii = shape.load()
            expected, sizes = plain_ply_spheres(Path(shape.file).read_bytes(), PLAIN_SPHERES)
            given = np.zeros((len(centers), 0)) if radii is None else radii[:, None]
            complete = len(expected) == min(len(centers), PLAIN_SPHERES)
            same = _same(centers[:PLAIN_SPHERES], expected) + _same(given[:PLAIN_SPHERES], sizes)
            yield number, Path(shape.file), same if complete else float("inf")


def _against_mitsuba(mesh: Any, theirs: LoadedMesh, found: PlainMesh | None, file: Path) -> dict[str, float]:
    """Errors over their bounds of positions, normals and uv at the corners of all faces."""
    ending = file.suffix.lower()
    if theirs.problem and found is None and ending not in (".obj", ".ply"):
        return {READ_ONCE: 0.0}
    if theirs.problem:
        return {f"{REFUSED} {theirs.problem!r}": 0.0 if found is not None else np.inf}
    given = mesh.vertices[mesh.faces]
    shares = {"corners": _same_in_float32(given, theirs.corners)}
    as_is = found is None or found.plain or ending == ".obj"  # or the copy has positions alone
    if not as_is or shares["corners"] != 0.0:
        return shares
    shares["shared vertices"] = _one_to_one(mesh.faces, theirs.vertices)
    of_uv, of_normals = (None, None) if found is None else (found.has(UV), found.has(NORMAL))
    some_uv, some_normals = given_at_some(file.read_bytes()) if found is None and ending == ".obj" else (False, False)
    if some_normals:
        shares[f"normals {AT_SOME}"] = 0.0
    elif mesh.normals is not None:
        with np.errstate(all="ignore"):  # of corners without, Mitsuba's are whatever was in its memory
            normals = theirs.normals / np.linalg.norm(theirs.normals, axis=2, keepdims=True)
        bound = FILE_NORMAL_ROUNDINGS * U32
        shares["normals"] = _share(mesh.normals[mesh.faces], normals, bound, of_normals)
    if some_uv:
        shares[f"uv {AT_SOME}"] = 0.0
    elif mesh.uv is not None:
        uv = mesh.uv[mesh.faces]
        shares["uv"] = _share(uv, theirs.uv, FILE_UV_ROUNDINGS * U32 * (1.0 + np.abs(uv)), of_uv)
    return shares


def _against_plain(mesh: Any, found: PlainMesh) -> dict[str, float]:
    """Vertices and faces, normals and uv where the file has some, generated normals and uv (0, 0) where it has none."""
    shares = {"float64": _same(mesh.vertices[mesh.faces], found.corners)} | _vertices(mesh, found)
    of_uv, of_normals = found.has(UV), found.has(NORMAL)
    if of_uv.shape != mesh.faces.shape:
        return shares
    if mesh.uv is not None:
        uv, expected = mesh.uv[mesh.faces], found.uv[found.indices[..., UV]] if of_uv.any() else None
        if expected is not None:
            shares["float64 uv"] = _share(uv, expected, 0.0, of_uv)
        if not of_uv.all():
            shares["uv where the file has none"] = _share(uv, np.zeros(uv.shape), 0.0, ~of_uv)
    if mesh.normals is not None and of_normals.any():
        normals = mesh.normals[mesh.faces]
        expected = unit(_near_one(found.normals))[found.indices[..., NORMAL]]
        shares["float64 normals"] = _share(normals, expected, 2.0 * FILE_NORMAL_ROUNDINGS * 2.0**-53, of_normals)
        if not of_normals.all():
            expected, bound = _generated_normals(found)
            among = ~of_normals & np.isfinite(bound[..., 0])  # but those that cancel: their direction is undefined
            shares["generated normals"] = _share(normals, expected, bound, among)
    return shares


def _vertices(mesh: Any, found: PlainMesh) -> dict[str, float]:
    """What generated normals and smooth shading depend on, beside positions.

    The number of vertices, which corners share one, and that there are normals and uv where the file has some.
    """
    _, triple = np.unique(found.indices.reshape(-1, 3), axis=0, return_inverse=True)
    return {
        "number of vertices": 0.0 if len(mesh.vertices) == found.vertices else float("inf"),
        "shared vertices by plain Python": _one_to_one(mesh.faces, triple.reshape(found.indices.shape[:2])),
        "uv or none": _present(mesh.uv, found.has(UV)),
        "normals or none": _present(mesh.normals, found.has(NORMAL)),
    }


def _present(values: np.ndarray | None, given: np.ndarray) -> float:
    return 0.0 if (values is not None) == bool(given.any()) else float("inf")


def _one_to_one(ours: np.ndarray, theirs: np.ndarray) -> float:
    """0 if corners (f, 3) have the same number on one side where they do on the other; else inf."""
    if ours.shape != theirs.shape:
        return float("inf")
    same = True
    for a, b in ((ours, theirs), (theirs, ours)):
        other = np.zeros(int(a.max(initial=0)) + 1, np.int64)
        other[a] = b
        same = same and bool((other[a] == b).all())
    return 0.0 if same else float("inf")


def _near_one(vectors: np.ndarray) -> np.ndarray:
    """(n, 3) the same times powers of two, so that squares neither overflow nor underflow."""
    scaled: np.ndarray = np.ldexp(vectors, -np.frexp(np.abs(vectors).max(axis=1, initial=0.0))[1][:, None])
    return scaled


def _generated_normals(found: PlainMesh) -> tuple[np.ndarray, np.ndarray]:
    """(normals (f, 3, 3) at the corners, by the angles of all finite faces; how far ours may be off)."""
    of_corners = found.indices[..., POSITION]
    faces = of_corners[np.isfinite(found.corners).all(axis=(1, 2))]
    used = np.isin(np.arange(len(found.points)), faces)
    normals, size = angle_weighted_normals(np.where(used[:, None], found.points, 0.0), faces)
    return normals[of_corners], TRANSFORM_ROUNDINGS * 2.0**-53 * size[of_corners]


def _share(ours: np.ndarray, theirs: np.ndarray, bound: Any, among: np.ndarray | None = None) -> float:
    """The largest error over its bound, of all corners or of those in `among` (f, 3)."""
    if ours.shape != theirs.shape:
        return float("inf")
    bounds = np.broadcast_to(bound, ours.shape)
    if among is not None:
        ours, theirs, bounds = ours[among], theirs[among], bounds[among]
    return float(error_over_bound(np.abs(ours - theirs), bounds).max(initial=0.0))


def _same(ours: np.ndarray, expected: np.ndarray) -> float:
    """0 if they are the same numbers, NaN included; else inf."""
    return 0.0 if ours.shape == expected.shape and np.array_equal(ours, expected, equal_nan=True) else float("inf")


def _same_in_float32(ours: np.ndarray, theirs: np.ndarray) -> float:
    """0 if theirs are ours in float32; of two that are equally near, either."""
    if ours.shape != theirs.shape:
        return float("inf")
    with np.errstate(all="ignore"):
        rounded = ours.astype(np.float32).astype(np.float64)
        tie = np.abs(ours - theirs) == np.abs(ours - rounded)
    same = (theirs == rounded) | (np.isnan(theirs) & np.isnan(rounded)) | tie
    return 0.0 if same.all() else float("inf")


# ---- plain readers, of files that the caster has accepted


def obj_statements(data: bytes) -> Iterator[tuple[list[bytes], bool]]:
    """(words, whether they stand so in the file) of v, vt, vn and f, with indices that count from 1."""
    counts = {b"v": 0, b"vt": 0, b"vn": 0}
    before: list[bytes] = []
    for line in data.removeprefix(b"\xef\xbb\xbf").splitlines():
        text = line.split(b"#")[0].rstrip()
        words, before, continued = before + text.removesuffix(b"\\").split(), [], bool(before)
        if text.endswith(b"\\"):
            before = words
        elif words and words[0] in counts:
            counts[words[0]] += 1
            yield words, not continued
        elif words and words[0] in (b"f", b"fo"):
            corners = [_absolute(word, [*counts.values()]) for word in words[1:]]
            yield [b"f", *corners], not continued and words == [b"f", *corners]


DIGITS_ALIKE = bytes.maketrans(b"0123456789", b"0" * 10)


def given_at_some(data: bytes) -> tuple[bool, bool]:
    """Whether some corners of an OBJ file have a uv, a normal, and others none; of a face's first line alone."""
    kinds: set[bytes] = set()
    for line in re.finditer(rb"(?m)^[ \t]*fo?[ \t]([^\r\n#\\]*)", data):
        kinds.update(line[1].translate(DIGITS_ALIKE).split())
    corners = [(kind + b"//").split(b"/") for kind in kinds]
    uv, normals = ({bool(corner[place]) for corner in corners} for place in (1, 2))
    return len(uv) > 1, len(normals) > 1


def _absolute(word: bytes, counts: list[int]) -> bytes:
    numbers = zip(word.split(b"/"), counts, strict=False)
    return b"/".join(b"%d" % (count + 1 + int(text)) if text[:1] == b"-" else text for text, count in numbers)


def plain_obj(data: bytes) -> PlainMesh:
    """An OBJ file; polygons as fans around their first corner.

    A file with normals or uv has a vertex for each combination in use, any other those of the file.
    """
    rows: dict[bytes, list[list[float]]] = {b"v": [], b"vt": [], b"vn": []}
    triangles: list[tuple[list[int], list[int], list[int]]] = []
    plain = True
    for words, as_is in obj_statements(data):
        plain = plain and as_is
        if words[0] == b"f":
            parts = [(word + b"//").split(b"/")[:3] for word in words[1:]]
            triangles += _fan([[int(text) - 1 if text else -1 for text in part] for part in parts])
        elif words[0] == b"vt":
            u, v = [*map(float, words[1:3]), 0.0][:2]
            rows[b"vt"].append([u, 1.0 - v])
        else:
            rows[words[0]].append([float(word) for word in words[1:4]])
    indices, points = np.array(triangles), np.array(rows[b"v"])
    joined = bool((indices[..., UV:] >= 0).any())
    vertices = len(np.unique(indices.reshape(-1, 3), axis=0)) if joined else len(points)
    uv, normals = np.array(rows[b"vt"]).reshape(-1, 2), np.array(rows[b"vn"]).reshape(-1, 3)
    return PlainMesh(points, indices, vertices, plain, uv, normals)


def _fan(polygon: list[T]) -> list[tuple[T, T, T]]:
    return [(polygon[0], b, c) for b, c in pairwise(polygon[1:])]


PLY_TYPES = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip


PLY_NAMES = ("x y z", "u v", "s t", "texture_u texture_v", "nx ny nz")  # of positions, uv and normals


def plain_ply(data: bytes) -> PlainMesh:
    """A PLY file, number by number; polygons as fans around their first corner."""
    rows: dict[str, list[list[float]]] = {names: [] for names in PLY_NAMES}
    polygons: list[list[int]] = []
    for element, row in plain_ply_rows(data):
        if element == "vertex":
            for names, numbers in rows.items():
                if all(name in row for name in names.split()):
                    numbers.append([float(row[name][0]) for name in names.split()])
        elif element == "face":
            polygons.append([int(i) for i in row.get("vertex_indices", row.get("vertex_index", []))])
    triangles = np.array([triangle for polygon in polygons for triangle in _fan(polygon)])
    points, *every_uv, normals = map(np.array, rows.values())
    uv = next((each for each in every_uv if len(each)), np.zeros((0, 2)))
    indices = np.stack([triangles if len(each) else np.full(triangles.shape, -1) for each in (points, uv, normals)], 2)
    plain = all(len(polygon) == 3 for polygon in polygons)
    return PlainMesh(points, indices, len(points), plain, uv, normals.reshape(-1, 3))


def plain_ply_spheres(data: bytes, most: int) -> tuple[np.ndarray, np.ndarray]:
    """(centres (n, 3), radii (n, 1) or (n, 0)) of the first vertices of a PLY file, at most so many."""
    rows = (row for element, row in plain_ply_rows(data) if element == "vertex")
    found = [
        ([float(row[axis][0]) for axis in "xyz"], list(map(float, row.get("radius", [])))) for row in islice(rows, most)
    ]
    return np.array([center for center, _ in found]), np.array([radius for _, radius in found])


def plain_ply_rows(data: bytes) -> Iterator[tuple[str, dict[str, list[float]]]]:
    """(element, its properties) of each row of a PLY file, in order; numbers are read as they are asked for."""
    end = data.index(b"\n" if b"\n" in data[:6] else b"\r", data.index(b"end_header")) + 1
    header = [line.split() for line in data[:end].decode("ascii", "replace").splitlines()]
    encoding = next(words[1] for words in header if words[:1] == ["format"])
    read = _ascii_numbers(data[end:]) if encoding == "ascii" else _binary_numbers(data, end, encoding)
    for at, words in enumerate(header):
        if words[:1] != ["element"]:
            continue
        following = header[at + 1 :]
        last = next((k for k, each in enumerate(following) if each[:1] in (["element"], ["end_header"])), 0)
        properties = [each for each in following[:last] if each[:1] == ["property"]]
        for _ in range(int(words[2])):
            yield (
                words[1],
                {
                    each[-1]: [read(each[3]) for _ in range(int(read(each[2])))]
                    if each[1] == "list"
                    else [read(each[1])]
                    for each in properties
                },
            )


def plain_stl(data: bytes) -> PlainMesh:
    """Facets of an STL file, binary where its size is that of so many facets; each has three vertices of its own."""
    size = STL_HEAD + STL_FACET * (int.from_bytes(data[80:84], "little") if len(data) >= STL_HEAD else 0)
    if len(data) == size:
        facets = struct.iter_unpack("<12fH", data[STL_HEAD:])
        points = np.array([facet[3:12] for facet in facets]).reshape(-1, 3)
    else:
        words = data.split()
        rows = [[float(number) for number in words[i + 1 : i + 4]] for i, word in enumerate(words) if word == b"vertex"]
        points = np.array(rows).reshape(-1, 3)
    return positions_alone(points, np.arange(len(points)).reshape(-1, 3))


STL_HEAD, STL_FACET = 84, 50  # bytes


def plain_off(data: bytes) -> PlainMesh:
    """An OFF file in text; polygons as fans around their first corner."""
    rows = [words for line in data.splitlines() if (words := line.split(b"#")[0].split())]
    counts, *rows = [rows[0][1:], *rows[1:]] if len(rows[0]) > 1 else rows[1:]  # behind OFF, or in the next line
    vertices, faces = int(counts[0]), int(counts[1])
    points = [[float(word) for word in row[:3]] for row in rows[:vertices]]
    polygons = ([int(i) for i in row[1 : 1 + int(row[0])]] for row in rows[vertices : vertices + faces])
    triangles = [each for polygon in polygons for each in _fan(polygon)]
    return positions_alone(np.array(points), np.array(triangles))


# ---- glTF, whose nodes place meshes; trimesh decides on their order

GLTF_SUFFIXES = (".glb", ".gltf")
GLTF_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
GLTF_COLUMNS = {"SCALAR": 1, "VEC3": 3}
GLB_HEAD = 12  # bytes: magic, version, length
GLTF_TRIANGLES = 4  # the mode of a primitive, by default


class PlacedMeshes(NamedTuple):
    """Those of a glTF scene in its world: one for each primitive of each node that has a mesh."""

    meshes: list[PlainMesh]
    error: float  # of a coordinate: two readers differ by no more than twice that


def _against_gltf(mesh: Any, file: Path) -> dict[str, float]:
    """Whether the triangles are those of the file's meshes: face by face in each, and one mesh after the other.

    Which mesh comes first is not the file's to say, so any order of them will do.
    """
    try:
        found = plain_gltf(file) if file.stat().st_size <= MAX_PLAIN_BYTES else None
    except (LookupError, TypeError, ValueError, AttributeError, OSError):  # the file is not what the format demands
        found = None
    if found is None:
        return {READ_ONCE: 0.0}
    placed = _in_order_of(mesh.vertices[mesh.faces], found)
    return {"triangles": np.inf} if placed is None else {"triangles": 0.0} | _vertices(mesh, placed)


def _in_order_of(given: np.ndarray, found: PlacedMeshes) -> PlainMesh | None:
    """The placed meshes as one, in the order in which corners (f, 3, 3) follow each other; None if in none."""
    left, start = list(found.meshes), 0
    chosen: list[PlainMesh] = []
    while left and start < len(given):
        place = next((i for i, each in enumerate(left) if _begins_with(given[start:], each, found.error)), None)
        if place is None:
            return None
        chosen.append(left.pop(place))
        start += len(chosen[-1].indices)
    if start < len(given) or any(len(each.indices) for each in left):
        return None
    chosen += left
    first = np.cumsum([0, *(len(each.points) for each in chosen)])
    faces = [each.indices[..., POSITION] + shift for each, shift in zip(chosen, first[:-1], strict=True)]
    return positions_alone(np.concatenate([each.points for each in chosen]), np.concatenate(faces))


def _begins_with(given: np.ndarray, mesh: PlainMesh, error: float) -> bool:
    """Whether the first of these corners (f, 3, 3) are those of a mesh."""
    expected = mesh.corners
    with np.errstate(over="ignore"):
        apart = np.abs(np.nan_to_num(given[: len(expected)]) - np.nan_to_num(expected[: len(given)]))
    return len(given) >= len(expected) and bool((apart <= 2.0 * error).all())


def plain_gltf(file: Path) -> PlacedMeshes | None:
    """The meshes of a glTF file's scene in its world; None for strips, sparse or packed data, as few have."""
    data, chunks = file.read_bytes(), []
    if data[:4] == b"glTF":
        at = GLB_HEAD
        while at < len(data):
            length = int.from_bytes(data[at : at + 4], "little")
            chunks.append(data[at + 8 : at + 8 + length])
            at += 8 + length
    tree = json.loads(chunks[0] if chunks else data)
    if tree.get("extensionsRequired"):
        return None
    buffers = [_gltf_buffer(buffer, file, chunks) for buffer in tree.get("buffers", [])]

    def numbers(number: int) -> np.ndarray:
        accessor = tree["accessors"][number]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise NotImplementedError
        view, dtype = tree["bufferViews"][accessor["bufferView"]], np.dtype(GLTF_TYPES[accessor["componentType"]])
        columns = GLTF_COLUMNS[accessor["type"]]
        return np.ndarray(
            (accessor["count"], columns),
            dtype,
            buffers[view["buffer"]],
            view.get("byteOffset", 0) + accessor.get("byteOffset", 0),
            (view.get("byteStride", columns * dtype.itemsize), dtype.itemsize),
        )

    scene = tree.get("scenes", [{}])[tree.get("scene", 0)]
    waiting = [(node, np.eye(4), np.eye(4), 1) for node in scene.get("nodes", range(len(tree.get("nodes", []))))]
    sizes, visited = [0.0], 0
    found: list[PlainMesh] = []
    try:
        while waiting:
            number, matrix, size, depth = waiting.pop()
            visited += 1
            if visited > len(tree["nodes"]):  # no tree: a node has several parents, or is below itself
                raise NotImplementedError
            node = tree["nodes"][number]
            own = _gltf_matrix(node)
            matrix, size = matrix @ own, size @ np.abs(own)
            waiting += [(child, matrix, size, depth + 1) for child in node.get("children", [])]
            for part in tree["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
                if part.get("mode", GLTF_TRIANGLES) != GLTF_TRIANGLES:
                    raise NotImplementedError
                points = numbers(part["attributes"]["POSITION"]).astype(np.float64)
                order = numbers(part["indices"])[:, 0] if "indices" in part else np.arange(len(points))
                placed, faces = points @ matrix[:3, :3].T + matrix[:3, 3], order.reshape(-1, 3).astype(int)
                mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
                found.append(positions_alone(placed, faces[:, ::-1] if mirrored else faces))
                sizes.append(depth * float((np.abs(points) @ size[:3, :3].T + size[:3, 3]).max(initial=0.0)))
    except NotImplementedError:
        return None
    return PlacedMeshes(found, GLTF_ROUNDINGS * 2.0**-53 * max(sizes))


# Of a coordinate and each matrix on its way: 7 for a sum of four products, and 9 for an entry of a rotation by a
# quaternion that is normalised first.
GLTF_ROUNDINGS = 16.0


def _gltf_buffer(buffer: Any, file: Path, chunks: list[bytes]) -> bytes:
    uri = buffer.get("uri")
    if uri is None:
        return chunks[1]
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    return (file.parent / unquote(uri)).read_bytes()


def _gltf_matrix(node: Any) -> np.ndarray:
    """(4, 4) of a node: its matrix, or translation times rotation times scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0))) / np.linalg.norm(node.get("rotation", 1.0))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


PLAIN_READERS: dict[str, Callable[[bytes], PlainMesh]] = {
    ".obj": plain_obj,
    ".ply": plain_ply,
    ".stl": plain_stl,
    ".off": plain_off,
}


def _ascii_numbers(body: bytes) -> Any:
    words = re.finditer(rb"\S+", body)
    return lambda kind: float(next(words)[0])


def _binary_numbers(data: bytes, at: int, encoding: str) -> Any:
    order = "<" if "little" in encoding else ">"
    place = at

    def read(kind: str) -> float:
        nonlocal place
        layout = order + PLY_TYPES[kind]
        (number,) = struct.unpack_from(layout, data, place)
        place += struct.calcsize(layout)
        return number

    return read

"""Compare the mesh files of a scene, as Mitsuba's own loader reads them, with the meshes that the caster reads.

Both sides of a comparison trace a mesh as the caster has read it, so that no pixel shows an error of its reader. This
check gives the original file to Mitsuba's `obj` or `ply` plug-in. Faces have to be the same corner by corner, in the
file's order; corners have to share vertices in the same way; normals and uv have to agree. Mitsuba parses a number to
the nearest float32 at once, the caster to float64, which is rounded to float32 later. Both results agree, unless the
float64 number lies halfway between two float32 numbers; then either is right.

Mitsuba's OBJ reader supports neither negative indices nor continued lines: such a file is rewritten first. Files that
its loader refuses, such as STL, OFF, glTF and PLY with polygons, are reported as not compared.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from caster.scene.model import Scene
from caster.shapes.mesh import Mesh
from mitsuba_ref.error_model.bounds import error_over_bound
from mitsuba_ref.error_model.intersections import Array, rounded, without_float_warnings, without_overflow_warnings
from mitsuba_ref.error_model.tolerances import FILE_NORMAL_ROUNDINGS, FILE_UV_ROUNDINGS, U32
from mitsuba_ref.judge.checks import Found, check
from mitsuba_ref.reference.messages import LoadedMesh


def files_of(scene: Scene) -> dict[Path, Any]:
    """The mesh files of a scene, each once, with the mesh that the caster reads."""
    return {Path(each.file): each.mesh() for each in scene.shapes if isinstance(each, Mesh) and each.file}


# ---- files for Mitsuba


def for_mitsuba(file: Path, folder: Path, number: int) -> Path:
    """The file itself, or an OBJ with the same faces in `folder` if Mitsuba's loader does not support the file."""
    if file.suffix.lower() != ".obj" or not NEEDS_REWRITING.search(data := file.read_bytes()):
        return file
    copy = folder / f"mesh-file-{number}.obj"
    copy.write_bytes(_plain_obj(data))
    return copy


NEEDS_REWRITING = re.compile(rb"\\|\r(?!\n)|\A\xef\xbb\xbf|^[ \t]*(fo[ \t]|f[^\r\n#]*-)", re.MULTILINE)


def _plain_obj(data: bytes) -> bytes:
    """An OBJ file with absolute indices and without continued lines."""
    counts = {b"v": 0, b"vt": 0, b"vn": 0}
    lines = []
    whole = re.sub(rb"\\[ \t]*(\r\n|\n|\r)", b" ", re.sub(rb"#[^\r\n]*", b"", data.removeprefix(b"\xef\xbb\xbf")))
    for words in map(bytes.split, whole.splitlines()):
        if words and words[0] in counts:
            counts[words[0]] += 1
        elif words and words[0] in (b"f", b"fo"):
            words = [b"f", *(_absolute(word, [*counts.values()]) for word in words[1:])]
        lines.append(b" ".join(words))
    return b"\n".join(lines)


def _absolute(corner: bytes, counts: list[int]) -> bytes:
    numbers = zip(corner.split(b"/"), counts, strict=False)
    return b"/".join(b"%d" % (count + 1 + int(text)) if text[:1] == b"-" else text for text, count in numbers)


# ---- comparison


@check()
def check_mesh_files(scene: Scene, loaded: tuple[LoadedMesh, ...]) -> Iterator[Found]:
    """Compare every mesh file of the scene. loaded: by Mitsuba, in the order of `files_of`."""
    files = files_of(scene)
    if len(loaded) != len(files):
        yield np.inf, f"{len(files)} files, Mitsuba has read {len(loaded)}"
    names = [file.name for file in files]
    for (file, mesh), theirs in zip(files.items(), loaded, strict=False):
        for what, share in _errors(mesh, theirs, file).items():
            yield share, f"{what} of {file.name if names.count(file.name) == 1 else file}"


@without_float_warnings
def _errors(mesh: Any, theirs: LoadedMesh, file: Path) -> dict[str, float]:
    """Error over bound at all corners of faces, by a phrase that ` of FILE` completes; a remark has an error of 0."""
    if theirs.problem:
        return {f"not compared, Mitsuba's loader says {theirs.problem!r}: triangles": 0.0}
    errors = {"corners": _same_in_float32(mesh.vertices[mesh.faces], theirs.corners)}
    if errors["corners"] != 0.0:
        return errors
    errors["shared vertices"] = _one_to_one(mesh.faces, theirs.vertices)
    their_normals = theirs.normals / np.linalg.norm(theirs.normals, axis=2, keepdims=True)
    # {True}: each corner has one, {False}: none has, both: some have
    in_file = dict(zip(("uv", "normals"), _in_file(file), strict=True))
    for name, ours, expected, roundings in (
        ("uv", mesh.uv, theirs.uv, FILE_UV_ROUNDINGS * (1.0 + np.abs(theirs.uv))),  # v may have been 1 - v
        ("normals", mesh.normals, their_normals, np.full(1, FILE_NORMAL_ROUNDINGS)),
    ):
        if (ours is not None) != any(in_file[name]):
            errors[f"presence of {name}"] = np.inf
        elif ours is not None and all(in_file[name]):
            ratio = error_over_bound(np.abs(ours[mesh.faces] - expected), roundings * U32)
            errors[name] = float(ratio.max(initial=0.0))
        elif ours is not None:  # Mitsuba leaves values of corners without one uninitialised
            errors[f"{name} not compared, some corners have none: those"] = 0.0
    return errors


DIGITS_ALIKE = bytes.maketrans(b"0123456789", b"0" * 10)


def _in_file(file: Path) -> tuple[set[bool], set[bool]]:
    """Whether corners have a uv, and whether they have a normal: {True}, {False}, or both in an OBJ file."""
    data = file.read_bytes()
    if file.suffix.lower() == ".ply":
        header = data[: data.find(b"end_header")]
        found = (re.search(rb"\bproperty\s+\w+\s+" + name, header) for name in (rb"(u|s|texture_u)\s", rb"nx\s"))
        uv, normals = ({match is not None} for match in found)
        return uv, normals
    kinds: set[bytes] = set()
    for line in re.finditer(rb"^[ \t]*fo?[ \t]([^\r\n#\\]*)", _plain_obj(data), re.MULTILINE):
        kinds.update(line[1].translate(DIGITS_ALIKE).split())
    corners = [(kind + b"//").split(b"/") for kind in kinds]
    uv, normals = ({corner[place] != b"" for corner in corners} for place in (1, 2))
    return uv, normals


def _one_to_one(ours: Array, theirs: Array) -> float:
    """0 if the same corners (f, 3) share a vertex on both sides, else inf."""
    same = True
    for a, b in ((ours, theirs), (theirs, ours)):
        other = np.zeros(int(a.max(initial=0)) + 1, np.int64)
        other[a] = b
        same = same and bool((other[a] == b).all())
    return 0.0 if same else float("inf")


@without_overflow_warnings
def _same_in_float32(ours: Array, theirs: Array) -> float:
    """0 if theirs are ours rounded to float32, where a tie may go either way; else inf."""
    if ours.shape != theirs.shape:
        return float("inf")
    nearest = rounded(ours)
    tie = np.abs(ours - theirs) == np.abs(ours - nearest)
    same = (theirs == nearest) | (np.isnan(theirs) & np.isnan(nearest)) | tie
    return 0.0 if same.all() else float("inf")

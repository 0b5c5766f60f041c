"""A user's Mitsuba file as a scene of the caster: the arrays, rays and numbers that Mitsuba itself holds of it.

The file stays the reference (originals.py). `mitsuba-ref import` writes the same scene as TOML and PLY files.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import FileMissing, SceneError, error_prefix
from caster.description.input_files import read_input
from caster.description.transform import is_mirrored, row_lengths
from caster.scene.model import Film, Scene
from caster.shapes import Cylinder, Disk, Mesh, Sphere
from caster.system.process import NOTHING_SELECTED
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.coverage import Coverage
from mitsuba_ref.reference.messages import Crash, OpenRequest, OpenResponse
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, send_request
from mitsuba_ref.reference.originals import MitsubaScene, Original
from mitsuba_ref.reference.store import key_of

SUFFIX = ".xml"

# Triangles of a scene, copies by instances included: some 200 bytes each, twice where they are packed.
MAX_TRIANGLES = 10_000_000


class NothingToJudge(SceneError):
    """A file has no shape that can be judged."""

    exit_code = NOTHING_SELECTED


class Opening(NamedTuple):
    """How a Mitsuba file is opened."""

    parameters: Mapping[str, str] = {}  # values of $names
    sensor: int = 0
    strict: bool = False  # fail what is judged in part
    robust: bool = True  # Embree's robust mode, whatever the file says


def is_original(path: str) -> bool:
    """Whether a path names a Mitsuba file."""
    return Path(path).suffix.lower() == SUFFIX


def open_scene(
    path: str, opening: Opening = Opening(), *, size: Sequence[int] | None = None, mesh_dirs: Iterable[str] = ()
) -> MitsubaScene:
    """Open a Mitsuba file: a scene whose reference is that file. size: of the film, in place of its own.

    Raises FileMissing, SceneError with Mitsuba's message where it refuses the file, NothingToJudge without shapes.
    """
    read_input(path, "Mitsuba scene file")  # raises FileMissing
    if size is not None:
        with error_prefix("--size", *size):
            Film(width=size[0], height=size[1])
    folders = tuple(str(Path(folder).absolute()) for folder in mesh_dirs)
    parameters, sensor, strict, robust = opening
    variant = variants.variant_for(has_quadrics=False)
    file = str(Path(path).absolute())
    request = OpenRequest(file, dict(parameters), sensor, size and list(size), folders, robust, variant)
    found = send_request(request, DEFAULT_TIMEOUT)
    if isinstance(found, Crash):
        raise SceneError(f"{path}: Mitsuba refuses it: {_refusal(found)}")
    if found.missing:
        raise FileMissing("\n".join([*found.missing, "expected beside the scene, in a <path>, or in a --mesh-dir"]))
    if found.problem:
        raise SceneError(f"{path}: {found.problem}")
    digest = key_of([repr(request), *(part for each in found.files for part in (each, Path(each).read_bytes()))])
    return _scene(path, replace(request, digest=digest), found, strict)


def _refusal(crash: Crash) -> str:
    """Mitsuba's message, and a way out."""
    words = crash.output.strip()
    hint = "; give it by -D NAME=VALUE" if "$" in words and "undefined" in words.lower() else ""
    return f"{words}{hint}"


def _scene(path: str, request: OpenRequest, found: OpenResponse, strict: bool) -> MitsubaScene:
    shapes: list[Any] = []
    keys: list[str] = []
    names: set[str] = set()
    left_out: list[str] = []
    materials: dict[str, Any] = {}
    triangles = 0
    parts = list(_parts(found))
    for key, number, label, matrix in found.placed:
        record = found.shapes[number]
        triangles += record["faces"]
        name = _distinct(label, f"{record['plugin']}-{key.replace('/', '-')}", names)
        too_many = f"{MAX_TRIANGLES:,} triangles are the most that a scene may have" if triangles > MAX_TRIANGLES else ""
        made, reason = (None, record["reason"] or too_many) if record["reason"] or too_many else _shape(record, parts[number], matrix)
        if made is None:
            triangles -= record["faces"]
            left_out.append(f"{record['plugin']} {name!r} at {record['place']}: {reason}")
            continue
        names.add(name)
        keys.append(key)
        more = {"name": name}
        if record["material"] is not None:
            more["material"] = record["material_name"]
            materials[record["material_name"]] = record["material"]
        shapes.append(made[0](**made[1], **more))
    if not shapes:
        reasons = "".join(f"\n  {each}" for each in left_out)
        raise NothingToJudge(f"{path}: none of its {len(found.placed)} shapes can be judged{reasons}")
    x0, y0, x1, y1 = found.crop
    whole = (x0, y0, x1, y1) == (0, 0, *found.size)
    film = Film(width=found.size[0], height=found.size[1], crop=None if whole else (x0, y0, x1, y1))
    camera, notes = camera_of(found.camera, found.size)
    o, d = found.rays[0, :3].tolist(), found.rays[0, 3:6].tolist()
    unlit = tuple(found.unlit) or (() if found.lights else ("the file has no light",))
    hidden = (f"{len(left_out)} shapes are left out, whose shadows are missing",) if left_out else ()
    coverage = Coverage(
        len(found.placed), len(shapes), tuple(left_out), found.hidden, (*unlit, *hidden), dict(found.dropped), notes, strict
    )
    view = {"type": "pinhole", "eye": o, "direction": d, "up": _across(d)}  # for whatever needs some camera
    scene = MitsubaScene(film=film, camera=camera or view, lights=tuple(found.lights), materials=materials, shapes=shapes)
    start = np.zeros(len(found.rays))
    if camera:
        eye = np.array(scene.camera.eye)
        start = row_lengths(found.rays[:, :3].astype(float) - eye) if camera["type"] == "pinhole" else start + camera["near"]
    scene._original = Original(
        request, found.variant, film, found.rays, start, tuple(keys), camera is not None, coverage
    )
    return scene


def _across(d: Sequence[float]) -> list[float]:
    """A direction that is not parallel to d."""
    return np.eye(3)[int(np.argmin(np.abs(d)))].tolist()  # type: ignore[no-any-return]


def _distinct(label: str, otherwise: str, taken: set[str]) -> str:
    """A printable name that no other shape has."""
    name = label if label.isprintable() and label else otherwise
    return name if name not in taken else f"{name}-{otherwise}"


# ---- shapes


def _parts(found: OpenResponse) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Vertices and faces of each shape."""
    v = f = 0
    for record in found.shapes:
        yield found.vertices[v : v + record["vertices"]], found.faces[f : f + record["faces"]]
        v, f = v + record["vertices"], f + record["faces"]


Made = tuple[type[Any], dict[str, Any]]  # a shape class and its fields


def _shape(
    record: Mapping[str, Any], part: tuple[np.ndarray, np.ndarray], instance: Any
) -> tuple[Made | None, str]:
    """(class and fields of a shape, or None; why there is none). instance: its 4 x 4 matrix, or None."""
    outer = np.eye(4) if instance is None else np.array(instance)
    if record["kind"] == "mesh":
        vertices, faces = part[0].astype(np.float64), part[1]
        if not np.isfinite(vertices).all():
            return None, "its vertices contain values that are not finite"
        if not len(faces):
            return None, "it has no triangles"
        sign = -1.0 if record["flipped"] else 1.0
        fields = {
            "vertices": vertices[:, :3],
            "faces": faces[:, [0, 2, 1]] if record["flipped"] else faces,
            "normals": sign * vertices[:, 3:6] if record["smooth"] else None,
            "uv": vertices[:, 6:8] if record["textured"] else None,
            "face_normals": not record["smooth"],
        }
        return (Mesh, fields | _placed(outer)), ""
    matrix = np.array(record["matrix"])
    if record["kind"] == "sphere":
        if record["flipped"]:
            return None, "flip_normals: normals of a sphere point outwards"
        turn, size, turn_back = np.linalg.svd(matrix[:3, :3])
        matrix[:3, :3] = float(size.mean()) * (turn @ turn_back)  # uniform beyond the rounding to float32
        return (Sphere, _placed(outer @ matrix)), ""
    if record["kind"] == "cylinder":
        if record["flipped"]:
            return None, "flip_normals: normals of a cylinder point outwards"
        return (Cylinder, _placed(outer @ matrix)), ""
    side = np.diag([1.0, 1.0, -1.0 if record["flipped"] else 1.0, 1.0])
    return (Disk, _placed(outer @ matrix @ side)), ""


def _placed(matrix: np.ndarray) -> dict[str, Any]:
    return {} if np.array_equal(matrix, np.eye(4)) else {"to_world": [{"matrix": matrix.tolist()}]}


# ---- cameras

DEFAULT_NEAR, DEFAULT_FAR = 0.01, 1e4  # clip planes; Mitsuba's defaults

# Mitsuba accepts a sensor matrix with a scale of up to 5e-4, so smaller differences between axes are ignored here.
SQUARE_PIXEL_RTOL = 5e-4

FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)  # to which focal lengths refer


def camera_of(about: Mapping[str, Any], size: Sequence[int]) -> tuple[dict[str, Any] | None, tuple[str, ...]]:
    """(a sensor as a camera of the caster, None where it has no such; notes). about: its numbers and its plugin."""
    plugin, matrix = about["plugin"], np.array(about["to_world"])
    near, far = about.get("near_clip", DEFAULT_NEAR), about.get("far_clip", DEFAULT_FAR)
    if plugin not in ("perspective", "thinlens", "orthographic"):
        random = ": the rays of its middle samples" if plugin in ("distant", "irradiancemeter") else ""
        return None, (f"the rays are those of Mitsuba's sensor {plugin}{random}",)
    if is_mirrored(matrix):
        return None, (f"the sensor {plugin} is mirrored: its rays are Mitsuba's",)
    eye, up, view = (matrix[:3, column].tolist() for column in (3, 1, 2))
    pose = {"eye": eye, "up": up, "direction": view}
    if plugin == "orthographic":
        across, above, along = row_lengths(matrix[:3, :3].T)
        if abs(above - across) > SQUARE_PIXEL_RTOL * across:
            return None, (f"pixels of the sensor are {above / across:g} times as high as wide: its rays are Mitsuba's",)
        start = near * float(along)  # the scale along the view does not apply to the distance of the clip planes
        return {"type": "orthographic", **pose, "width": 2.0 * float(across), "near": start, "far": start + far - near}, ()
    camera = {"type": "pinhole", **pose, "near": near, "far": far, **_field_of_view(about)}
    shift = [about.get(f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
    camera |= {"principal_point": shift} if any(shift) else {}
    return camera, ("thinlens: rays through the middle of the lens",) if plugin == "thinlens" else ()


def _field_of_view(about: Mapping[str, Any]) -> dict[str, Any]:
    if "fov" in about:
        return {"fov": about["fov"], "fov_axis": about.get("fov_axis", "x")}
    focal = float(str(about.get("focal_length", "50mm")).removesuffix("mm"))
    return {"fov": math.degrees(2.0 * math.atan(0.5 * FILM_DIAGONAL_MM / focal)), "fov_axis": "diagonal"}


# ---- import


class ImportedScene(NamedTuple):
    """A scene, and what was left out of it, a line each."""

    scene: Scene
    left_out: tuple[str, ...]


def import_xml(path: str, parameters: Mapping[str, str] = {}, mesh_dirs: Iterable[str] = ()) -> ImportedScene:
    """Import a Mitsuba file, as Mitsuba loads it, into a scene of its own. parameters: values of $names.

    Raises FileMissing for files that cannot be read, SceneError where Mitsuba refuses the file or the caster has no
    camera like its sensor, NothingToJudge where no shape can be imported.
    """
    opened = open_scene(path, Opening(parameters), mesh_dirs=mesh_dirs)
    original = opened._original
    assert original is not None
    if not original.has_camera:
        raise SceneError(f"{path}: {original.coverage.notes[0]}; a scene of its own needs perspective or orthographic")
    fields = {name: getattr(opened, name) for name in ("film", "camera", "lights", "materials", "shapes")}
    return ImportedScene(Scene(**fields), tuple(original.coverage.lines()))

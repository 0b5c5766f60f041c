"""A user's Mitsuba file as a scene of the caster: the arrays, rays and numbers that Mitsuba itself holds of it.

The file stays the reference (originals.py). `mitsuba-ref import` writes the same scene as TOML and PLY files.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from caster.description.errors import FileMissing, SceneError, error_prefix
from caster.description.fields import Shape
from caster.description.input_files import read_input
from caster.description.transform import cross, inverse, is_mirrored, product, row_lengths, unit
from caster.geometry.packing import Triangles
from caster.geometry.world_space import Rounding
from caster.scene.model import Film, Scene
from caster.shapes import Cylinder, Disk, EllipsoidCloud, LinearCurve, Mesh, Sphere
from caster.system.process import NOTHING_SELECTED
from mitsuba_ref.error_model.intersections import Array, ceil_log2
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.interpreter import as_in_file
from mitsuba_ref.reference.messages import Coverage, Crash, OpenRefusal, OpenRequest, OpenResponse
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, send_request, send_stored
from mitsuba_ref.reference.originals import MitsubaScene, Original, original_of
from mitsuba_ref.reference.rendering import trace_reference
from mitsuba_ref.reference.shared_input import model_of, shared_rays
from mitsuba_ref.reference.store import key_of
from mitsuba_ref.shapes.shape_reference import Fields

SUFFIX = ".xml"

# Triangles of a scene, copies by instances included: some 200 bytes each, twice where they are packed.
MAX_TRIANGLES = 10_000_000


class NothingToJudgeError(SceneError):
    """A file has no shape that can be judged."""

    exit_code = NOTHING_SELECTED


class Opening(NamedTuple):
    """How a Mitsuba file is opened."""

    parameters: Mapping[str, str]  # values of $names
    sensor: int = 0
    strict: bool = False  # fail what is judged in part


AS_IT_IS = Opening({})


def is_original(path: str) -> bool:
    """Whether a path names a Mitsuba file."""
    return Path(path).suffix.lower() == SUFFIX


def open_scene(
    path: str, opening: Opening = AS_IT_IS, *, size: Sequence[int] | None = None, mesh_dirs: Iterable[str] = ()
) -> MitsubaScene:
    """Open a Mitsuba file: a scene whose reference is that file. size: of the film, in place of its own.

    Raises FileMissing, SceneError with Mitsuba's message where it refuses the file, NothingToJudgeError without shapes.
    """
    read_input(path, "Mitsuba scene file")  # raises FileMissing
    if size is not None:
        with error_prefix("--size", *size):
            Film(width=size[0], height=size[1])
    folders = tuple(str(Path(folder).absolute()) for folder in mesh_dirs)
    parameters, sensor, strict = opening
    variant = variants.variant_for(has_quadrics=False)
    file = str(Path(path).absolute())
    request = OpenRequest(file, dict(parameters), sensor, size and list(size), folders, not as_in_file(), variant)
    found = send_request(request, DEFAULT_TIMEOUT)
    if isinstance(found, Crash):
        words = found.output.strip()
        hint = "; give it by -D NAME=VALUE" if "$" in words and "undefined" in words.lower() else ""
        raise SceneError(f"{path}: Mitsuba refuses it: {words}{hint}")
    if isinstance(found, OpenRefusal):
        if found.problem:
            raise SceneError(f"{path}: {found.problem}")
        raise FileMissing("\n".join([*found.missing, "expected beside the scene, in a <path>, or in a --mesh-dir"]))
    digest = key_of([repr(request), *(part for each in found.files for part in (each, Path(each).read_bytes()))])
    return _scene(path, replace(request, digest=digest), found, strict)


Placed = tuple[Shape, str, float]  # a shape, its name in Mitsuba's answers, its condition (originals.Original)


def _judged_shapes(found: OpenResponse) -> tuple[list[Placed], list[str], list[str]]:
    """The shapes that are judged, the others, with their places and reasons, and textures that have no uv."""
    judged: list[Placed] = []
    left_out, unlit, names = list[str](), list[str](), set[str]()
    triangles = 0
    for key, number, label, matrix in found.placed:
        record = found.shapes[number]
        otherwise, count = f"{record['plugin']}-{key.replace('/', '-')}", len(record.get("faces", ()))
        name = label if label and label.isprintable() else otherwise
        name = f"{name}-{otherwise}" if name in names else name
        material = record["material"]
        try:
            if triangles + count > MAX_TRIANGLES:
                raise SceneError(f"{MAX_TRIANGLES:,} triangles are the most that a scene may have")
            shape = _shape(record, matrix, {"name": name} | ({"material": material} if material else {}))
            if material and (reason := _textureless(found.materials[material], shape, matrix)):
                unlit.append(f"the texture of {record['plugin']} {name!r} at {record['place']}: {reason}")
                shape = _shape(record, matrix, {"name": name})
        except SceneError as reason:
            why = "; ".join(str(reason).splitlines())
            left_out.append(f"{record['plugin']} {name!r} at {record['place']}: {why}")
            continue
        triangles += count
        names.add(name)
        judged.append((shape, key, 0.0 if matrix is None else _condition(np.array(matrix)[:3, :3])))
    return judged, left_out, unlit


def _textureless(material: Mapping[str, Any], shape: Shape, instance: Any) -> str:
    """Why a shape cannot have the texture of its material; "" if it can or there is none."""
    texture = material.get("reflectance")
    if not isinstance(texture, dict):
        return ""
    if texture["type"] != "mesh_colors":
        return shape.without_uv()
    return "Mitsuba interpolates colours of an instance elsewhere" if instance else ""


def _scene(path: str, request: OpenRequest, found: OpenResponse, strict: bool) -> MitsubaScene:
    """The scene of an opened file. Raises NothingToJudgeError."""
    judged, left_out, without_uv = _judged_shapes(found)
    if not judged:
        reasons = "".join(f"\n  {each}" for each in left_out)
        there = f"none of its {len(found.placed)} shapes can be judged" if found.placed else "it has no shape"
        raise NothingToJudgeError(f"{path}: {there}{reasons}")
    shapes, keys, conditions = zip(*judged, strict=True)
    unlit = [*found.unlit, *without_uv] or ([] if found.lights else ["the file has no light"])
    if left_out:
        unlit.append(f"the shadows of the {len(left_out)} shapes that are left out are missing")
    film = Film(**found.film)
    camera, exact, note = camera_of(found.camera)
    o, d = found.rays[0, :3].tolist(), found.rays[0, 3:6].tolist()
    across = np.eye(3)[np.argmin(np.abs(d))].tolist()  # not parallel to d
    view = {"type": "pinhole", "eye": o, "direction": d, "up": across}  # for whatever needs some camera
    parts: Fields = {"film": film, "camera": camera or view, "lights": tuple(found.lights)}
    scene = MitsubaScene(**parts, materials=found.materials, shapes=shapes)
    start = np.zeros(len(found.rays))
    if camera and camera["type"] == "pinhole":
        start = row_lengths(found.rays[:, :3].astype(float) - np.array(scene.camera.eye))
    elif camera:
        start += camera["near"]
    coverage = Coverage(
        len(found.placed),
        len(shapes),
        tuple(left_out),
        unlit=tuple(unlit),
        dropped=dict(found.dropped),
        notes=(note,) if note else (),
        strict=strict,
    )
    scene._original = Original(request, found, film, start, keys, np.array(conditions), exact, coverage)
    if left_out:
        hides = _hits_others(scene)
        found.rays[hides, 6] = -1.0  # no ray, on either side
        scene._original = replace(scene._original, coverage=replace(coverage, hidden=int(hides.sum())))
    return scene


def _hits_others(scene: MitsubaScene) -> Array:
    """(n,) bool: rays that hit a shape in Mitsuba which is not judged."""
    rays = shared_rays(scene)
    found = trace_reference(scene, model_of(scene, rays), rays, lights=False, send=send_stored)
    if isinstance(found, Crash):
        raise SceneError(found.message)
    return found.hit & (found.shape_id < 0)


# ---- shapes


# Products of the columns of a sphere's matrix, of which each number was rounded to float32, over the squared radius.
SIMILARITY_RTOL = 8 * 2.0**-24


class MeshOfInstance(Mesh):
    """A mesh under the matrix of an instance: Mitsuba interpolates its vertex normals before it transforms them."""

    keeps_lengths: ClassVar[bool] = True  # which the matrix gives to normals, up to a common factor

    def pack(self, rounded: Rounding) -> Triangles:
        part, normals = super().pack(rounded), self.mesh().normals
        if normals is None:
            return part
        turned = product(normals, inverse(self.matrix[:3, :3]))
        return part._replace(normals=rounded(turned / row_lengths(turned).max()))


def _shape(record: Mapping[str, Any], instance: Any, named: Any) -> Shape:
    """A shape of the caster. instance: its matrix, or None. named: more fields. Raises SceneError with the reason."""
    outer = np.eye(4) if instance is None else np.array(instance)
    if not (kind := record["kind"]):
        raise SceneError(f"the caster has no {record['plugin']}")
    rows, flipped = np.array(record.get("rows", ()), np.float64), record["flipped"]
    if kind == "mesh":
        faces = record["faces"]
        mirrored = is_mirrored(outer)  # ours has the corners in another order then, and so other barycentrics
        fields: Fields = {
            "vertices": rows[:, :3],
            "faces": faces[:, [0, 2, 1]] if mirrored else faces,
            "normals": (-1.0 if mirrored else 1.0) * rows[:, 3:6] if record["smooth"] else None,
            "uv": rows[:, 6:8] if record["textured"] else None,
            "face_normals": not record["smooth"],
            "flip_normals": flipped != mirrored,
        }
        return (Mesh if instance is None else MeshOfInstance)(**fields, **_placed(outer), **named)
    if kind in ("linear_curve", "ellipsoids") and instance is not None:
        raise SceneError(f"Mitsuba places hits on {record['plugin']} in an instance elsewhere")
    if kind == "linear_curve":
        return LinearCurve(points=rows[:, :3], radii=rows[:, 3], counts=record["counts"], **named)
    if kind == "ellipsoids":
        if record["clamped"]:
            raise SceneError("extent_adaptive_clamping: its semi-axes depend on opacities")
        axes = {"centers": rows[:, :3], "scales": rows[:, 3:6], "quaternions": rows[:, 6:]}
        return EllipsoidCloud(**axes, extent=record["extent"], **named)
    matrix = np.array(record["matrix"])
    if kind == "disk":  # whose matrix Mitsuba has flipped already
        return Disk(**_placed(product(outer, matrix)), **named)
    mirrored = is_mirrored(matrix)
    if kind == "cylinder":
        return Cylinder(flip_normals=flipped != mirrored, **_placed(product(outer, matrix)), **named)
    gram, size = product(matrix[:3, :3].T, matrix[:3, :3]), record["radius"] * record["radius"]
    if np.abs(gram - size * np.eye(3)).max() > SIMILARITY_RTOL * size:
        raise SceneError("its matrix scales it non-uniformly, which Mitsuba's sphere does not follow")
    x, y = (unit(matrix[:3, column].tolist()) for column in (0, 1))
    z = unit(cross(x, y))
    matrix[:3, :3] = record["radius"] * np.column_stack([x, cross(z, x), z]) * [1.0, 1.0, -1.0 if mirrored else 1.0]
    return Sphere(flip_normals=flipped, **_placed(product(outer, matrix)), **named)


def _condition(linear: Array) -> float:
    """Condition number of an instance's matrix in the largest component, rounded up to a power of two."""
    grown = product(np.abs(linear), np.abs(inverse(linear)))
    return float(np.ldexp(1.0, int(ceil_log2(grown.sum(axis=1).max()))))


def _placed(matrix: Array) -> Fields:
    return {} if np.array_equal(matrix, np.eye(4)) else {"to_world": [{"matrix": matrix.tolist()}]}


# ---- cameras

DEFAULT_NEAR, DEFAULT_FAR = 0.01, 1e4  # clip planes; Mitsuba's defaults

# Mitsuba accepts a sensor matrix with a scale of up to 5e-4, so smaller differences between axes are ignored here.
SQUARE_PIXEL_RTOL = 5e-4

SKEW_ATOL = 4 * 2.0**-24  # products of the axes of a rotation that was rounded to float32


def camera_of(about: Mapping[str, Any]) -> tuple[Fields | None, bool, str]:
    """(camera like a sensor, or None; whether it has the sensor's rays, up to rounding; a note on it).

    about: the sensor's numbers and its plugin.
    """
    plugin, matrix = about["plugin"], np.array(about["to_world"])
    near, far = about.get("near_clip", DEFAULT_NEAR), about.get("far_clip", DEFAULT_FAR)
    its_rays = "its rays are Mitsuba's"
    if plugin == "no sensor":
        return None, False, "the file has no sensor: the view is of all its shapes"
    if plugin not in ("perspective", "thinlens", "orthographic"):
        random = ", for the middle of each sample" if plugin in ("distant", "irradiancemeter") else ""
        return None, False, f"sensor {plugin}: {its_rays}{random}"
    if is_mirrored(matrix):
        return None, False, f"sensor {plugin}: it is mirrored, so {its_rays}"
    across, above, along = row_lengths(matrix[:3, :3].T)
    axes = matrix[:3, :3] / ([across, across, along] if plugin == "orthographic" else along)
    exact = bool(np.abs(product(axes.T, axes) - np.eye(3)).max() <= SKEW_ATOL)
    note = "" if exact else f"sensor {plugin}: its axes are not perpendicular or differ in length, so {its_rays}"
    eye, up, view = (matrix[:3, column].tolist() for column in (3, 1, 2))
    pose = {"eye": eye, "up": up, "direction": view}
    if plugin == "orthographic":
        if abs(above - across) > SQUARE_PIXEL_RTOL * across:
            return None, False, f"sensor {plugin}: its pixels are not square, so {its_rays}"
        start = near * float(along)  # the scale along the view does not apply to the distance of the clip planes
        planes = {"near": start, "far": start + far - near}
        return {"type": "orthographic", **pose, "width": 2.0 * float(across), **planes}, exact, note
    fov = {"fov": about["fov"], "fov_axis": about.get("fov_axis", "x")} if "fov" in about else {"fov": about["x_fov"]}
    camera = {"type": "pinhole", **pose, "near": near, "far": far, **fov}
    shift = [about.get(f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
    camera |= {"principal_point": shift} if any(shift) else {}
    lens = "sensor thinlens: rays through the middle of its lens" if plugin == "thinlens" else ""
    return camera, exact, "; ".join(filter(None, (note, lens)))


# ---- import


class ImportedScene(NamedTuple):
    """A scene, and what was left out of it, a line each."""

    scene: Scene
    left_out: tuple[str, ...]


def import_xml(
    path: str,
    parameters: Mapping[str, str] = {},
    mesh_dirs: Iterable[str] = (),
    *,
    sensor: int = 0,
    size: Sequence[int] | None = None,
) -> ImportedScene:
    """Import a Mitsuba file, as Mitsuba loads it, into a scene of its own. parameters: values of $names.

    sensor: its number. size: width and height of the film, in place of its own.

    Raises FileMissing for files that cannot be read, SceneError where Mitsuba refuses the file or the caster has no
    camera like its sensor, NothingToJudgeError where no shape can be imported.
    """
    opened = open_scene(path, Opening(parameters, sensor), size=size, mesh_dirs=mesh_dirs)
    original = original_of(opened)
    assert original is not None
    if camera_of(original.opened.camera)[0] is None:
        raise SceneError(f"{path}: {original.coverage.notes[0]}; a scene of its own needs perspective or orthographic")
    fields = {name: getattr(opened, name) for name in ("film", "camera", "lights", "materials", "shapes")}
    return ImportedScene(Scene(**fields), tuple(original.coverage.lines()))

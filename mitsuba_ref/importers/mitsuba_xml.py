"""Import of Mitsuba XML: the whole scene, its film, its camera and its shapes."""

import math
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import Diagnostic, FileMissing, SceneError, join_words
from caster.description.transform import is_mirrored, row_lengths
from caster.geometry.mesh_files import MeshFolders
from caster.scene.files import validated
from caster.scene.model import Scene
from mitsuba_ref.importers.scene_builder import (
    SceneBuilder,
    Step,
    add_emitter,
    composed_matrix,
    is_dark,
    material_of,
    transform_steps,
)
from mitsuba_ref.scene_xml.documents import (
    ImportDiagnostic,
    Node,
    SourcePosition,
    format_diagnostics,
    load_document,
    resolve_reference,
)
from mitsuba_ref.shapes import REFERENCES

MAX_SHAPES = 10_000  # with instances: of a few kilobytes of XML they make any number


def add_shape(out: SceneBuilder, node: Node, outer: tuple[Step, ...] = (), name: str = "") -> None:
    """Add a shape. outer: transform steps of the enclosing instance, applied after its own; name: of the instance."""
    out.consumed.add(id(node))
    if node.kind == "shapegroup":
        return  # invisible by itself
    if node.kind == "instance":
        if outer:
            out.error(node, f"{node.words()}: an instance inside a shapegroup, which Mitsuba does not take either")
        else:
            _add_instance(out, node)
        return
    importers = {plugin: each for reference in REFERENCES.values() for plugin, each in reference.importers.items()}
    if node.kind not in importers:
        out.omit(node, f"{node.words()}: not supported (known: {', '.join(importers)}, instance)")
        return
    steps = [*transform_steps(out, node), *outer]
    shape = importers[node.kind](ShapeElement(out, node, steps, bool(outer)))
    material = material_of(out, node)
    for emitter in node.all("emitter", "ref"):
        target = resolve_reference(out.document, emitter)
        if target is not None and target.tag == "emitter":
            out.consumed |= {id(target), id(emitter)}
            if is_dark(out, target):
                continue
            out.omit(emitter, f"{target.words()} of {node.words()}: shapes emit no light here")
    out.omit_unread(node)
    label = name or node.id
    if label and label.isprintable() and label not in out.shape_names:
        out.shape_names.add(label)
        shape["name"] = label
    shape |= {"material": material} if material else {}
    out.positions["shape", len(out.data["shape"])] = node.position
    out.data["shape"].append(shape)


def _add_instance(out: SceneBuilder, node: Node) -> None:
    group = next((resolve_reference(out.document, ref) for ref in node.all("ref")), None)
    out.consumed.update(id(ref) for ref in node.all("ref"))
    if group is None or group.kind != "shapegroup":
        out.error(node, f"{node.words()}: expected a <ref> to a shapegroup")
        return
    steps = tuple(transform_steps(out, node)) or ({"translate": [0.0, 0.0, 0.0]},)
    parts = [
        part
        for part in (resolve_reference(out.document, each) for each in group.all("shape", "ref"))
        if part is not None
    ]
    if len(out.data["shape"]) + len(parts) > MAX_SHAPES:
        out.omit(node, f"{node.words()}: the scene has {MAX_SHAPES:,} shapes already")
        return
    for part in parts:
        add_shape(out, part, steps, node.id if len(parts) == 1 else "")
    out.omit_unread(node)
    out.omit_unread(group)


class ShapeElement:
    """A <shape> of the document, as importers of shapes read it (mitsuba_ref/shapes/shape_reference.py)."""

    def __init__(self, out: SceneBuilder, node: Node, steps: list[Step], instanced: bool) -> None:
        self.out, self.node, self.steps, self.instanced = out, node, steps, instanced
        self.number, self.vector = partial(out.number, node), partial(out.vector, node)
        self.boolean, self.text = partial(out.boolean, node), partial(out.text, node)
        self.note = partial(out.note, node)

    @property
    def matrix(self) -> np.ndarray | None:
        return composed_matrix(self.steps)

    def required_text(self, name: str) -> str:
        if self.node.named(name) is None:
            self.out.error(self.node, f'{self.node.words()}: needs <string name="{name}" ...>')
        return self.text(name)


CAMERA_KINDS = {"perspective": "pinhole", "thinlens": "pinhole", "orthographic": "orthographic"}
DEFAULT_FILM_SIZE = (768, 576)  # pixels; Mitsuba's default
DEFAULT_NEAR, DEFAULT_FAR = 0.01, 1e4  # clip planes; Mitsuba's defaults

# Mitsuba accepts a sensor matrix with a scale of up to 5e-4, so smaller differences between axes are ignored here.
SQUARE_PIXEL_RTOL = 5e-4

# The diagonal of a 36 x 24 mm film, to which focal lengths refer.
FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)


def add_sensor(out: SceneBuilder, node: Node) -> None:
    """Add the film and the camera. Values are validated with the whole scene."""
    out.data["film"] = _film(out, node)
    out.positions["film",] = out.positions["camera",] = node.position
    film = out.data["film"]
    camera: dict[str, Any] = {"type": CAMERA_KINDS[node.kind]}
    steps = transform_steps(out, node)
    matrix = composed_matrix(steps)
    camera |= _pose(out, node, steps, np.eye(4) if matrix is None else matrix)
    near, far = out.number(node, "near_clip", DEFAULT_NEAR), out.number(node, "far_clip", DEFAULT_FAR)
    if node.kind == "orthographic":
        camera |= _window(out, node, np.eye(4) if matrix is None else matrix, near, far)
    else:
        camera |= {"near": near, "far": far, **_field_of_view(out, node, film["width"], film["height"])}
        shift = [out.number(node, f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
        if any(shift):
            camera["principal_point"] = shift
    if node.kind == "thinlens":
        out.note(node, "the lens: replaced by a pinhole without depth of field")
        out.find(node, "aperture_radius", "float", "integer")
    out.find(node, "focus_distance", "float", "integer")  # without effect without a lens
    out.data["camera"] = camera
    out.omit_unread(node)


def _film(out: SceneBuilder, node: Node) -> dict[str, Any]:
    film = next(node.all("film"), None)
    if film is None:
        return {"width": DEFAULT_FILM_SIZE[0], "height": DEFAULT_FILM_SIZE[1]}
    out.consumed.add(id(film))
    width, height = (
        out.integer(film, "width", DEFAULT_FILM_SIZE[0]),
        out.integer(film, "height", DEFAULT_FILM_SIZE[1]),
    )
    x, y = out.integer(film, "crop_offset_x", 0), out.integer(film, "crop_offset_y", 0)
    w, h = out.integer(film, "crop_width", width - x), out.integer(film, "crop_height", height - y)
    out.omit_unread(film)
    size: dict[str, Any] = {"width": width, "height": height}
    return size if (x, y, w, h) == (0, 0, width, height) else size | {"crop": [x, y, x + w, y + h]}


def _pose(out: SceneBuilder, node: Node, steps: list[Step], matrix: np.ndarray) -> dict[str, Any]:
    """Camera pose of a sensor, which in Mitsuba looks along +z, with +y up and +x to the left."""
    if len(steps) == 1 and "look_at" in steps[0]:
        look = steps[0]["look_at"]
        return {"eye": look["origin"], "look_at": look["target"], "up": look["up"]}
    if is_mirrored(matrix):
        out.note(node, "the mirroring of its to_world: the image is flipped horizontally here")
    eye, up, view = matrix[:3, 3], matrix[:3, 1], matrix[:3, 2]
    return {"eye": eye.tolist(), "direction": view.tolist(), "up": up.tolist()}


def _field_of_view(out: SceneBuilder, node: Node, width: int, height: int) -> dict[str, Any]:
    if node.named("fov") is not None:
        return {"fov": out.number(node, "fov", 0.0), "fov_axis": out.text(node, "fov_axis", "x")}
    out.text(node, "fov_axis")
    text = out.text(node, "focal_length", "50mm").removesuffix("mm")
    try:
        focal = float(text)
    except ValueError:
        focal = math.nan
    if not 0.0 < focal < math.inf:
        out.error(node, f"focal_length must be a length > 0 in mm such as 50mm, got '{text}'")
        focal = 50.0
    return {"fov": math.degrees(2.0 * math.atan(0.5 * FILM_DIAGONAL_MM / focal)), "fov_axis": "diagonal"}


def _window(out: SceneBuilder, node: Node, matrix: np.ndarray, near: float, far: float) -> dict[str, Any]:
    """Width and clip distances of an orthographic sensor, whose window is [-1, 1] wide before scaling.

    Scale along the view axis applies to the near distance, not to the distance between near and far plane.
    """
    across, up, along = row_lengths(matrix[:3, :3].T)
    if abs(up - across) > SQUARE_PIXEL_RTOL * across:
        out.note(node, f"pixels that are {up / across:g} times as high as wide: pixels are square here")
    return {"width": 2.0 * float(across), "near": near * float(along), "far": near * float(along) + far - near}


# ---- the whole scene ----


class ImportedScene(NamedTuple):
    """A scene, and its omissions "file:line:column: left out: ..." in the order of the file."""

    scene: Scene
    left_out: tuple[str, ...]


def import_xml(path: str, parameters: Mapping[str, str] = {}, mesh_dirs: Iterable[str] = ()) -> ImportedScene:
    """Import Mitsuba XML with its includes and meshes. parameters: values of $names that override its defaults.

    Raises FileMissing for files that cannot be read, SceneError with every error and its line for the rest.
    """
    document = load_document(path, parameters)
    out = SceneBuilder(document)
    with np.errstate(over="ignore", invalid="ignore"):  # overflow is rejected when the scene is validated
        _add_all(out, path)
        # without a camera, any, so that other errors are found
        anywhere = {"type": "pinhole", "eye": [0, 0, 0], "direction": [0, 0, 1]}
        folders = MeshFolders(document.folder, tuple(map(Path, mesh_dirs)))
        scene, problems = validated({"camera": anywhere} | out.data, folders)
    document.errors += [_with_position(out, each) for each in problems if not each.missing]
    missing = [_with_position(out, each) for each in problems if each.missing]
    if scene is None or document.errors:
        kind_of_error = FileMissing if missing and not document.errors else SceneError
        raise kind_of_error(format_diagnostics(sorted([*document.errors, *missing]), document.texts))
    return ImportedScene(scene, tuple(note.line() for note in sorted(out.left_out)))


def _add_all(out: SceneBuilder, path: str) -> None:
    """Convert the first sensor of a supported kind, then all shapes, lights and materials.

    Area lights and materials count only where a shape refers to them.
    """
    document = out.document
    sensors = [node for node in document.nodes if node.tag == "sensor"]
    usable = [node for node in sensors if node.kind in CAMERA_KINDS]
    if usable:
        add_sensor(out, usable[0])
    else:
        there = f", got {join_words((node.kind for node in sensors), 'and')}" if sensors else ""
        position = sensors[0].position if sensors else SourcePosition(path, 1, 1)
        document.errors.append(
            ImportDiagnostic(position, f"needs a sensor of a supported kind: {join_words(CAMERA_KINDS)}{there}")
        )
    for node in document.nodes:
        if node.tag == "shape":
            add_shape(out, node)
        elif node.tag == "emitter" and node.kind != "area":
            add_emitter(out, node)
    for node in document.nodes:
        if id(node) not in out.consumed and node not in usable[:1] and node.tag not in ("shape", "alias"):
            unused = ": no shape uses it" if node.tag in ("bsdf", "emitter") else ""
            out.omit(node, f"{node.words()}{unused}")


def _with_position(out: SceneBuilder, problem: Diagnostic) -> ImportDiagnostic:
    path = problem.path
    while path and path not in out.positions:
        path = path[:-1]
    return ImportDiagnostic(out.positions.get(path, SourcePosition(next(iter(out.document.texts)), 1, 1)), problem.text)

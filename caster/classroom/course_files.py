"""Reader of 6.837 scene files (assignments 1, 2 and 4 of 2003 and 2004, 4 of 2011): text to blocks to a scene."""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from caster.description.errors import SceneError, diagnostics_of, suggestion
from caster.description.input_files import FileName, read_text
from caster.description.parsing import Span, format_excerpt, located_error
from caster.geometry.mesh_files import MeshFolders
from caster.scene.model import Scene

__all__ = ["load_course_scene"]

Data = dict[str, Any]  # of a scene or a part of one, as a scene file gives them

# The words that each block may contain: other blocks, and fields with the count of their numbers; 0: a file name.
GRAMMAR = {
    "": "PerspectiveCamera OrthographicCamera Background Lights Materials Group",
    "PerspectiveCamera": "center:3 direction:3 up:3 angle:1",
    "OrthographicCamera": "center:3 direction:3 up:3 size:1",
    "Background": "color:3 ambientLight:3 cubeMap:0",
    "Lights": "numLights:1 DirectionalLight PointLight",
    "DirectionalLight": "direction:3 color:3",
    "PointLight": "position:3 color:3 attenuation:3 falloff:1",
    "Materials": "numMaterials:1 Material PhongMaterial",
    "Material": "diffuseColor:3 specularColor:3 reflectiveColor:3 transparentColor:3 exponent:1 shininess:1 "
    "indexOfRefraction:1 texture:0 bump:0",
    "Group": "numObjects:1 MaterialIndex:1 Group Transform Sphere Plane Triangle TriangleMesh",
    "Transform": "Scale:3 UniformScale:1 Translate:3 XRotate:1 YRotate:1 ZRotate:1 Rotate:4 Matrix:16 Matrix4f:16 "
    "Group Transform Sphere Plane Triangle TriangleMesh",
    "Sphere": "center:3 radius:1",
    "Plane": "normal:3 offset:1",
    "Triangle": "vertex0:3 vertex1:3 vertex2:3",
    "TriangleMesh": "obj_file:0",
}
GRAMMAR["PhongMaterial"] = GRAMMAR["Material"]
IN_BRACES = ("Rotate", "Matrix", "Matrix4f")
MAX_NESTING = 64  # of blocks; each level takes a few frames of Python's stack
START = Span(1, 1, 1)

Token = tuple[str, Span]  # a word, a number or a brace
Falloff = tuple[float, float, float]  # of a light: its color is divided by constant + linear r + quadratic r^2


class CourseError(Exception):
    """CourseError(span, message): an error in the text of a file."""


class Field(NamedTuple):
    """A field of a block with its numbers, or its file name."""

    name: str
    at: Span
    numbers: list[float]
    word: str = ""

    def __str__(self) -> str:
        return " ".join([self.name, *(f"{x:g}" for x in self.numbers), self.word]).rstrip()


class Block(NamedTuple):
    """A block with its fields and blocks in the order of the file."""

    kind: str
    at: Span
    items: "list[Field | Block]"

    @property
    def blocks(self) -> "list[Block]":
        return [item for item in self.items if isinstance(item, Block)]

    @property
    def fields(self) -> dict[str, Field]:
        return {item.name: item for item in self.items if isinstance(item, Field)}

    def get(self, name: str, default: list[float] | None = None) -> list[float]:
        """The numbers of a field. Raises CourseError for a missing field without a default."""
        if name in self.fields:
            return self.fields[name].numbers
        if default is None:
            raise CourseError(self.at, f"{self.kind} needs '{name}'")
        return default


# ---- text to blocks ----


def _parse_block(tokens: Iterator[Token], kind: str, at: Span, depth: int = 0) -> Block:
    """The rest of a block after its opening brace; of kind "", the whole file."""
    if depth > MAX_NESTING:
        raise CourseError(at, f"blocks are nested deeper than {MAX_NESTING}")
    block, where = Block(kind, at, []), kind or "the file"
    known = {name: count for name, _, count in (word.partition(":") for word in GRAMMAR[kind].split())}
    for word, place in tokens:
        if word == "}" and kind:
            return block
        if word not in known:
            hint = suggestion(word, known) or f" (known: {', '.join(known)})"
            raise CourseError(place, f"{where}: unknown word {word}{hint}")
        if not known[word]:
            _expect(tokens, "{", word, place)
            block.items.append(_parse_block(tokens, word, place, depth + 1))
        elif word in block.fields and kind not in ("Group", "Transform"):
            raise CourseError(place, f"{where}: {word} occurs twice")
        else:
            block.items.append(_parse_field(tokens, word, place, int(known[word]), where))
    if kind:
        raise CourseError(at, f"{kind}: its '}}' is missing")
    return block


def _parse_field(tokens: Iterator[Token], name: str, at: Span, count: int, where: str) -> Field:
    if not count:
        return Field(name, at, [], next(tokens, ("", at))[0])
    if name in IN_BRACES:
        _expect(tokens, "{", name, at)
    numbers: list[float] = []
    for k in range(count):
        word, place = next(tokens, ("", at))
        if not re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", word) or math.isinf(float(word)):
            expected = "a number" if count == 1 else f"{count} numbers"
            raise CourseError(place, f"{where}: {name} must be {expected}, got '{word}' after {k}")
        numbers.append(float(word))
    if name in IN_BRACES:
        _expect(tokens, "}", name, at)
    return Field(name, at, numbers)


def _expect(tokens: Iterator[Token], brace: str, name: str, at: Span) -> None:
    word, place = next(tokens, ("the end of the file", at))
    if word != brace:
        raise CourseError(place, f"{name} must be followed by '{brace}', got '{word}'")


def _sections(text: str) -> dict[str, Block]:
    """The blocks of a file by kind; both kinds of cameras as "Camera"."""
    sections = {name: Block("", START, []) for name in ("Background", "Lights", "Materials")}
    tokens = (  # braces need no spaces around them
        (found[0], Span(number, found.start() + 1, len(found[0])))
        for number, line in enumerate(text.split("\n"), 1)
        for found in re.finditer(r"[{}]|[^\s{}]+", line)
    )
    for block in _parse_block(tokens, "", START).blocks:
        name = "Camera" if block.kind.endswith("Camera") else block.kind
        if name in sections and sections[name].kind:
            raise CourseError(block.at, f"{block.kind} occurs twice; the first is in line {sections[name].at.line}")
        sections[name] = block
    for name, needed in (("Camera", "PerspectiveCamera or OrthographicCamera"), ("Group", "Group")):
        if name not in sections:
            raise CourseError(START, f"the scene needs a block {needed}")
    return sections


# ---- blocks to a scene ----


@dataclass
class Draft:
    """The scene description under construction."""

    data: Data = field(default_factory=lambda: {"light": [], "material": {}, "shape": []})
    places: dict[tuple[str | int, ...], Span] = field(default_factory=dict)  # of the elements of the data
    left_out: list[tuple[Span, str]] = field(default_factory=list)
    falloffs: dict[int, Falloff] = field(default_factory=dict)  # of the point lights
    material: str = ""  # of the objects that follow


def _add_lights(draft: Draft, lights: list[Block], background: Block) -> None:
    """Add directional and point lights, then the ambient one: white without other lights, as in the course.

    The course reflects reflectance times colour; here it is reflectance times colour over pi. Any falloff but 1 / r^2
    is replaced by it, equal at r = 1, and reported.
    """
    for k, light in enumerate(lights):
        color = light.get("color")
        if min(color) < 0.0:
            raise CourseError(light.fields["color"].at, f"{light.kind}: {light.fields['color']} must be a colour >= 0")
        draft.places["light", k] = light.at
        if light.kind == "DirectionalLight":
            irradiance = [math.pi * c for c in color]
            shown = {"type": "directional", "direction": light.get("direction"), "irradiance": irradiance}
        else:
            constant, linear, quadratic = light.get("attenuation", [1.0, 0.0, 0.0])
            if light.get("falloff", [0.0])[0] > 0.0:
                constant, linear, (quadratic,) = 0.0, 0.0, light.get("falloff")
            draft.falloffs[k] = constant, linear, quadratic
            at_1 = constant + linear + quadratic
            if not at_1 > 0.0:
                raise CourseError(light.at, "PointLight: its attenuation must leave light at a distance of 1")
            if (constant, linear) != (0.0, 0.0):
                given = light.fields.get("attenuation", "no attenuation")
                text = f"{given}: point lights fall off by 1 / r^2 here; the value at r = 1 is kept"
                draft.left_out.append((light.at, text))
            intensity = [math.pi / at_1 * c for c in color]
            shown = {"type": "point", "position": light.get("position"), "intensity": intensity}
        draft.data["light"].append(shown)
    ambient = background.get("ambientLight", [0.0] * 3) if lights else [1.0] * 3
    if any(ambient):
        draft.places["light", len(lights)] = background.at
        draft.data["light"].append({"type": "ambient", "radiance": ambient})
    if "cubeMap" in background.fields:
        draft.left_out.append((background.at, f"{background.fields['cubeMap']}: no environment maps here"))


def _add_materials(draft: Draft, materials: list[Block], shade_back: bool) -> None:
    for i, block in enumerate(materials):
        color = block.get("diffuseColor", [1.0] * 3)
        draft.places["material", f"material-{i}"] = block.at
        reflectance = [min(c, 1.0) for c in color]
        draft.data["material"][f"material-{i}"] = {"reflectance": reflectance, "two_sided": shade_back}
        for name, item in block.fields.items():
            if name != "diffuseColor":
                draft.left_out.append((item.at, f"{item}: materials are diffuse, of one colour"))
            elif max(color) > 1.0:
                draft.left_out.append((item.at, f"the part beyond 1 of {item}: a reflectance is at most 1"))


def _add_objects(draft: Draft, block: Block, outer: list[Data]) -> None:
    """Add the objects of a group or transform. MaterialIndex applies to all objects that follow in the file.

    Of a transform's steps, the last of the file is applied first, but a matrix after all that precede it.
    """
    steps: list[Data] = []
    if block.kind == "Transform":
        if len(block.blocks) != 1:
            raise CourseError(block.at, f"Transform needs one object, got {len(block.blocks)}")
        for item in block.items:
            if isinstance(item, Field):
                steps.insert(len(steps) if item.name.startswith("Matrix") else 0, _step(item.name, item.numbers))
    steps += outer
    for item in block.items:
        if isinstance(item, Block) and item.kind in ("Group", "Transform"):
            _add_objects(draft, item, steps)
        elif isinstance(item, Block):
            shape = {"type": item.kind.lower(), "to_world": steps, "material": draft.material} | _shape(item)
            draft.places["shape", len(draft.data["shape"])] = item.at
            draft.data["shape"].append(shape)
        elif item.name == "MaterialIndex":
            draft.material = f"material-{item.numbers[0]:g}"
            if draft.material not in draft.data["material"]:
                raise CourseError(
                    item.at, f"{item}: the scene has {len(draft.data['material'])} materials, counted from 0"
                )


def _step(name: str, numbers: list[float]) -> Data:
    if name.startswith("Matrix"):
        rows = np.reshape(numbers, (4, 4))
        return {"matrix": (rows if name == "Matrix" else rows.T).tolist()}  # 2011: by columns
    if name.endswith("Rotate"):
        axis = [float(name[0] == letter) for letter in "XYZ"] if len(numbers) == 1 else numbers[:3]
        return {"rotate": {"axis": axis, "degrees": numbers[-1]}}
    return {"translate": numbers} if name == "Translate" else {"scale": numbers if len(numbers) == 3 else numbers[0]}


def _shape(block: Block) -> Data:
    """The fields that belong to this kind of shape."""
    if block.kind == "Sphere":
        return {"center": block.get("center"), "radius": block.get("radius")[0]}
    if block.kind == "Plane":  # all p with normal . p = offset, for a normal of any length
        normal = block.get("normal")
        return {"normal": normal, "offset": block.get("offset")[0] / (math.hypot(*normal) or 1.0)}
    if block.kind == "Triangle":
        return {"vertices": [block.get(f"vertex{i}") for i in range(3)]}
    block.get("obj_file")
    return {"type": "mesh", "file": block.fields["obj_file"].word, "face_normals": True}  # flat, as in 2003 and 2004


def _camera(block: Block, width: int, height: int) -> Data:
    """The camera. Its angle or size spans the longer side of the film: the course crops a square image."""
    view = {"eye": block.get("center"), "direction": block.get("direction"), "up": block.get("up")}
    if block.kind == "PerspectiveCamera":
        return {"type": "pinhole", "fov": block.get("angle")[0], "fov_axis": "larger", **view}
    return {"type": "orthographic", "width": block.get("size")[0] * width / max(width, height), **view}


@dataclass(frozen=True)
class CourseScene:
    """A scene, and the data of the course's images that a Scene has no fields for."""

    scene: Scene
    background: list[float]  # behind everything, r g b
    falloffs: dict[int, Falloff]  # of the point lights, by their places in the lights of the scene
    left_out: list[str]  # "file:line:column: left out: ...", in the order of the file


def load_course_scene(
    path: FileName,
    width: int,
    height: int,
    *,
    shade_back: bool = False,
    shadows: bool = False,
    mesh_dirs: Iterable[FileName] = (),
) -> CourseScene:
    """Load a scene file of the course and its meshes, which are found as in scene files of this project.

    width, height: of the film, in pixels. shade_back: light surfaces from behind as well. shadows: lights cast shadows.
    Raises FileMissing for a file that cannot be read, SceneError with line and column for the rest.
    """
    text, draft, origin = read_text(path), Draft(), str(path)
    try:
        sections = _sections(text)
        draft.data |= {"film": {"width": width, "height": height}, "shading": {"shadows": shadows}}
        draft.data["camera"] = _camera(sections["Camera"], width, height)
        draft.places["camera",] = sections["Camera"].at
        _add_lights(draft, sections["Lights"].blocks, sections["Background"])
        _add_materials(draft, sections["Materials"].blocks, shade_back)
        _add_objects(draft, sections["Group"], [])
    except CourseError as error:
        at, said = error.args
        raise SceneError(format_excerpt(at, said, text.split("\n"), origin)) from None
    try:
        folders = MeshFolders(Path(path).parent, tuple(map(Path, mesh_dirs)))
        scene = Scene.model_validate(draft.data, context=folders)
    except ValidationError as error:
        places, problems = draft.places, diagnostics_of(error, draft.data, Scene)
        raise located_error(
            problems, lambda path: places.get(path[:2]) or places.get(path[:1], START), text, origin
        ) from None
    left_out = [f"{origin}:{span.line}:{span.column}: left out: {note}" for span, note in sorted(draft.left_out)]
    return CourseScene(scene, sections["Background"].get("color", [0.5] * 3), draft.falloffs, left_out)

"""Reader of 6.837 scene files (assignments 1, 2 and 4 of 2003 and 2004, 4 of 2011): text to blocks to a scene."""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from caster.description.errors import FileMissing, SceneError, diagnostics_of, suggestion
from caster.description.parsing import Span, format_excerpt, list_errors, read_text
from caster.scene.files import MeshFolders, resolve_mesh_files
from caster.scene.model import Scene

__all__ = ["CourseScene", "Falloff", "load_course_scene"]

VIEW = {"center": 3, "direction": 3, "up": 3}
MATERIAL = {
    **dict.fromkeys(("diffuseColor", "specularColor", "reflectiveColor", "transparentColor"), 3),
    **{"exponent": 1, "shininess": 1, "indexOfRefraction": 1, "texture": 0, "bump": 0},
}
# The fields of each block, and the count of their numbers; 0: a word such as a file name.
FIELDS: dict[str, dict[str, int]] = {
    "": {},
    "PerspectiveCamera": VIEW | {"angle": 1},
    "OrthographicCamera": VIEW | {"size": 1},
    "Background": {"color": 3, "ambientLight": 3, "cubeMap": 0},
    "Lights": {"numLights": 1},
    "DirectionalLight": {"direction": 3, "color": 3},
    "PointLight": {"position": 3, "color": 3, "attenuation": 3, "falloff": 1},
    "Materials": {"numMaterials": 1},
    "Material": MATERIAL,
    "PhongMaterial": MATERIAL,
    "Group": {"numObjects": 1, "MaterialIndex": 1},
    "Transform": {
        **{"Scale": 3, "UniformScale": 1, "Translate": 3, "XRotate": 1, "YRotate": 1, "ZRotate": 1},
        **{"Rotate": 4, "Matrix": 16, "Matrix4f": 16},
    },
    "Sphere": {"center": 3, "radius": 1},
    "Plane": {"normal": 3, "offset": 1},
    "Triangle": {"vertex0": 3, "vertex1": 3, "vertex2": 3},
    "TriangleMesh": {"obj_file": 0},
}
IN_BRACES = ("Rotate", "Matrix", "Matrix4f")
TEXTURES = ("Checkerboard", "Noise", "Marble", "Wood")  # of later assignments; read over and reported
CAMERAS, OBJECTS = ("PerspectiveCamera", "OrthographicCamera"), ("Sphere", "Plane", "Triangle", "TriangleMesh")
# The blocks that may stand in each.
CHILDREN: dict[str, tuple[str, ...]] = {
    "": (*CAMERAS, "Background", "Lights", "Materials", "Group"),
    "Lights": ("DirectionalLight", "PointLight"),
    "Materials": ("Material", "PhongMaterial", *TEXTURES),
    "Group": ("Group", "Transform", *OBJECTS),
    "Transform": ("Group", "Transform", *OBJECTS),
}
REPEATED = ("MaterialIndex", *FIELDS["Transform"])
MAX_NESTING = 64  # of blocks; each level takes a few frames of Python's stack
WHITE, BLACK, GREY = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.5, 0.5, 0.5)


class Token(NamedTuple):
    """A word, a number or a brace, and where it stands."""

    text: str
    span: Span


class CourseError(Exception):
    """What is wrong at a token."""

    def __init__(self, at: Token, text: str) -> None:
        self.at, self.text = at, text


class Field(NamedTuple):
    """A field of a block with its numbers or its word."""

    name: str
    at: Token
    numbers: list[float]
    word: str

    def __str__(self) -> str:
        return " ".join([self.name, *(f"{x:g}" for x in self.numbers), self.word]).rstrip()


class Block(NamedTuple):
    """A block with its fields and blocks in the order of the file."""

    kind: str
    at: Token
    items: "list[Field | Block]"

    @property
    def blocks(self) -> "list[Block]":
        return [item for item in self.items if isinstance(item, Block)]

    @property
    def fields(self) -> dict[str, Field]:
        return {item.name: item for item in self.items if isinstance(item, Field)}

    def get(self, name: str, default: Iterable[float] | None = None) -> list[float]:
        """The numbers of a field. Raises CourseError for one that is missing and has no default."""
        if name in self.fields:
            return self.fields[name].numbers
        if default is None:
            raise CourseError(self.at, f"{self.kind} needs '{name}'")
        return list(default)


# ---- text to blocks


def _tokens(text: str) -> Iterator[Token]:
    """The words of a text; a brace is one also without a space beside it."""
    for number, line in enumerate(text.split("\n"), 1):
        for found in re.finditer(r"[{}]|[^\s{}]+", line):
            yield Token(found[0], Span(number, found.start() + 1, len(found[0])))


def _parse_block(tokens: Iterator[Token], kind: str, at: Token, depth: int = 0) -> Block:
    """The rest of a block after its opening brace; of kind "", the whole file."""
    if depth > MAX_NESTING:
        raise CourseError(at, f"blocks are nested deeper than {MAX_NESTING}")
    block, where = Block(kind, at, []), kind or "the file"
    known = (*FIELDS[kind], *CHILDREN.get(kind, ()))
    for token in tokens:
        if token.text == "}" and kind:
            break
        if token.text not in known:
            hint = suggestion(token.text, known) or f" (known: {', '.join(known)})"
            raise CourseError(token, f"{where}: unknown word {token.text}{hint}")
        if token.text in FIELDS[kind]:
            if token.text in block.fields and token.text not in REPEATED:
                raise CourseError(token, f"{where}: {token.text} occurs twice")
            block.items.append(_parse_field(tokens, token, FIELDS[kind][token.text], where))
            continue
        _expect(tokens, "{", token)
        if token.text in TEXTURES:
            _skip_block(tokens)
            block.items.append(Block(token.text, token, []))
        else:
            block.items.append(_parse_block(tokens, token.text, token, depth + 1))
    else:
        if kind:
            raise CourseError(at, f"{kind}: its '}}' is missing")
    for name in ("numLights", "numMaterials", "numObjects"):
        if name in FIELDS[kind] and block.get(name) != [len(block.blocks)]:
            raise CourseError(block.fields[name].at, f"{block.fields[name]}, but it contains {len(block.blocks)}")
    if kind == "Transform" and len(block.blocks) != 1:
        raise CourseError(at, f"Transform needs one object, got {len(block.blocks)}")
    return block


def _parse_field(tokens: Iterator[Token], at: Token, count: int, where: str) -> Field:
    if at.text in IN_BRACES:
        _expect(tokens, "{", at)
    numbers: list[float] = []
    token = at
    for k in range(count or 1):
        token = next(tokens, Token("", at.span))
        if not count:
            return Field(at.text, at, [], token.text)
        try:
            numbers.append(float(token.text))
        except ValueError:
            numbers.append(math.nan)
        if not math.isfinite(numbers[-1]) or "_" in token.text:
            what = "a number" if count == 1 else f"{count} numbers"
            raise CourseError(token, f"{where}: {at.text} must be {what}, got '{token.text}' after {k}")
    if at.text in IN_BRACES:
        _expect(tokens, "}", token)
    return Field(at.text, at, numbers, "")


def _expect(tokens: Iterator[Token], brace: str, after: Token) -> None:
    token = next(tokens, Token("the end of the file", after.span))
    if token.text != brace:
        raise CourseError(token, f"{after.text} must be followed by '{brace}', got '{token.text}'")


def _skip_block(tokens: Iterator[Token]) -> None:
    depth = 1
    while depth and (token := next(tokens, None)):
        depth += {"{": 1, "}": -1}.get(token.text, 0)


# ---- blocks to a scene


class Falloff(NamedTuple):
    """Attenuation of a point light at distance r: color / (constant + linear r + quadratic r^2)."""

    constant: float
    linear: float
    quadratic: float


@dataclass
class Draft:
    """The scene description under construction."""

    data: dict[str, Any] = field(default_factory=lambda: {"light": [], "material": {}, "shape": []})
    places: dict[tuple[str | int, ...], Token] = field(default_factory=dict)  # of the elements of the data
    left_out: list[tuple[Token, str]] = field(default_factory=list)
    colors: list[tuple[float, ...]] = field(default_factory=list)  # of point and directional lights
    falloffs: list[Falloff | None] = field(default_factory=list)  # None: directional
    material: str = ""  # of the objects that follow


def _add_lights(draft: Draft, lights: list[Block], background: Block) -> None:
    """Add directional and point lights, then the ambient one: white without other lights, as in the course.

    The course reflects reflectance times colour, here it is over pi. Any falloff but 1 / r^2 is replaced by it, equal
    at r = 1, and reported.
    """
    for light in lights:
        color = light.get("color")
        if min(color) < 0.0:
            raise CourseError(light.fields["color"].at, f"{light.kind}: {light.fields['color']} must be a colour >= 0")
        falloff, at_one, name = None, 1.0, "direction" if light.kind == "DirectionalLight" else "position"
        if name == "position":
            falloff = Falloff(*light.get("attenuation", (1.0, 0.0, 0.0)))
            if light.get("falloff", [0.0])[0] > 0.0:
                falloff = Falloff(0.0, 0.0, light.get("falloff")[0])
            at_one = sum(falloff)
            if not at_one > 0.0:
                raise CourseError(light.at, "PointLight: its attenuation must leave light at a distance of 1")
            if falloff[:2] != (0.0, 0.0):
                given = light.fields.get("attenuation", "no attenuation")
                text = f"{given}: point lights fall off by 1 / r^2 here; the value at r = 1 is kept"
                draft.left_out.append((light.at, text))
        kind, key = ("point", "intensity") if falloff else ("directional", "irradiance")
        draft.places["light", len(draft.colors)] = light.at
        draft.data["light"].append({"type": kind, name: light.get(name), key: [math.pi / at_one * c for c in color]})
        draft.colors.append(tuple(color))
        draft.falloffs.append(falloff)
    ambient = background.get("ambientLight", BLACK) if lights else WHITE
    if any(ambient):
        draft.places["light", len(lights)] = background.at
        draft.data["light"].append({"type": "ambient", "radiance": list(ambient)})
    if "cubeMap" in background.fields:
        draft.left_out.append((background.at, f"{background.fields['cubeMap']}: no environment maps here"))


def _add_materials(draft: Draft, materials: list[Block]) -> None:
    for i, block in enumerate(materials):
        color = GREY if block.kind in TEXTURES else block.get("diffuseColor", WHITE)
        draft.places["material", f"material-{i}"] = block.at
        draft.data["material"][f"material-{i}"] = {"reflectance": [min(c, 1.0) for c in color]}
        if block.kind in TEXTURES:
            draft.left_out.append((block.at, f"{block.kind}: no textures here; replaced by grey"))
        elif max(color) > 1.0:
            text = f"the part beyond 1 of {block.fields['diffuseColor']}: a reflectance is at most 1"
            draft.left_out.append((block.fields["diffuseColor"].at, text))
        rest = (item for name, item in block.fields.items() if name != "diffuseColor")
        draft.left_out += [(item.at, f"{item}: materials are diffuse, of one colour") for item in rest]


def _add_objects(draft: Draft, block: Block, outer: list[dict[str, Any]]) -> None:
    """Add the objects of a group or transform. MaterialIndex applies to all objects that follow in the file."""
    steps = _transform_steps(block) + outer
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
                count = len(draft.data["material"])
                raise CourseError(item.at, f"{item}: the scene has {count} materials, counted from 0")


def _transform_steps(block: Block) -> list[dict[str, Any]]:
    """Steps in the order of application: the last of the file first, but a matrix after all that precede it."""
    steps: list[dict[str, Any]] = []
    for item in block.items if block.kind == "Transform" else ():
        if isinstance(item, Field):
            steps.insert(len(steps) if item.name.startswith("Matrix") else 0, _step(item.name, item.numbers))
    return steps


def _step(name: str, numbers: list[float]) -> dict[str, Any]:
    if name.startswith("Matrix"):
        rows = [numbers[i : i + 4] for i in range(0, 16, 4)]
        return {"matrix": rows if name == "Matrix" else list(map(list, zip(*rows, strict=True)))}  # 2011: by columns
    if name.endswith("Rotate"):
        axis = [float(name[0] == letter) for letter in "XYZ"] if len(numbers) == 1 else numbers[:3]
        return {"rotate": {"axis": axis, "degrees": numbers[-1]}}
    return {"translate": numbers} if name == "Translate" else {"scale": numbers if len(numbers) == 3 else numbers[0]}


def _shape(block: Block) -> dict[str, Any]:
    """The fields of a shape of its own."""
    if block.kind == "Sphere":
        return {"center": block.get("center"), "radius": block.get("radius")[0]}
    if block.kind == "Plane":  # all p with normal . p = offset, for a normal of any length
        normal = block.get("normal")
        return {"normal": normal, "offset": block.get("offset")[0] / (math.hypot(*normal) or 1.0)}
    if block.kind == "Triangle":
        return {"vertices": [block.get(f"vertex{i}") for i in range(3)]}
    block.get("obj_file")
    return {"type": "mesh", "file": block.fields["obj_file"].word, "face_normals": True}  # flat, as in 2003 and 2004


def _camera(block: Block, width: int, height: int) -> dict[str, Any]:
    """Its angle or size spans the longer side of the film: the course crops a square image."""
    view = {"eye": block.get("center"), "direction": block.get("direction"), "up": block.get("up")}
    if block.kind == "PerspectiveCamera":
        return {"type": "pinhole", "fov": block.get("angle")[0], "fov_axis": "larger", **view}
    return {"type": "orthographic", "width": block.get("size")[0] * width / max(width, height), **view}


@dataclass(frozen=True)
class CourseScene:
    """A scene, and the data of the course's images that a Scene has no fields for."""

    scene: Scene  # lights: those of `colors` in the same order, then the ambient one
    background: tuple[float, ...]  # behind everything, r g b
    colors: tuple[tuple[float, ...], ...]  # of the lights, r g b
    falloffs: tuple[Falloff | None, ...]  # None: directional
    left_out: tuple[str, ...]  # "file:line:column: left out: ...", in the order of the file


def load_course_scene(
    path: str | PathLike[str],
    width: int,
    height: int,
    *,
    shade_back: bool = False,
    shadows: bool = False,
    mesh_dirs: Iterable[str | PathLike[str]] = (),
) -> CourseScene:
    """Load a scene file of the course and its meshes, which are looked up as in scene files of this project.

    width, height: of the film, in pixels. shade_back: surfaces are lit from behind as well. shadows: cast shadows.
    Raises FileMissing for a file that cannot be read, SceneError with line and column for the rest.
    """
    text, draft, start = read_text(path), Draft(), Token("", Span(1, 1, 1))
    try:
        sections: dict[str, Block] = {}
        for block in _parse_block(_tokens(text), "", start).blocks:
            name = "Camera" if block.kind in CAMERAS else block.kind
            if name in sections:
                first = sections[name].at.span.line
                raise CourseError(block.at, f"{block.kind} occurs twice; the first is in line {first}")
            sections[name] = block
        for name in ("Camera", "Group"):
            if name not in sections:
                raise CourseError(
                    start, f"the scene needs a block {' or '.join(CAMERAS) if name == 'Camera' else name}"
                )
        nothing = Block("", start, [])
        background = sections.get("Background", nothing)
        draft.data["film"] = {"width": width, "height": height}
        draft.data["camera"] = _camera(sections["Camera"], width, height)
        draft.places["camera",] = sections["Camera"].at
        _add_lights(draft, sections.get("Lights", nothing).blocks, background)
        _add_materials(draft, sections.get("Materials", nothing).blocks)
        _add_objects(draft, sections["Group"], [])
    except CourseError as error:
        raise SceneError(format_excerpt(error.at.span, error.text, text, str(path))) from None
    for material in draft.data["material"].values():
        material["two_sided"] = shade_back
    draft.data["shading"] = {"shadows": shadows}
    scene = _validated(draft, text, Path(path), [Path(folder) for folder in mesh_dirs])
    left_out = sorted(draft.left_out, key=lambda found: found[0].span)
    return CourseScene(
        scene,
        tuple(background.get("color", GREY)),
        tuple(draft.colors),
        tuple(draft.falloffs),
        tuple(f"{path}:{at.span.line}:{at.span.column}: left out: {what}" for at, what in left_out),
    )


def _validated(draft: Draft, text: str, path: Path, mesh_dirs: list[Path]) -> Scene:
    """The scene. Raises SceneError with each error at its block."""
    data, problems, missing = resolve_mesh_files(draft.data, MeshFolders(path.parent, tuple(mesh_dirs)), Scene)
    scene = None
    try:
        scene = Scene.model_validate(data)
        scene._folder = path.parent.resolve()
    except ValidationError as error:
        problems = problems + diagnostics_of(error, data, Scene)
    if scene is None or problems or missing:
        start = Token("", Span(1, 1, 1))
        places = [
            (next((draft.places[p.path[:n]] for n in (2, 1) if p.path[:n] in draft.places), start).span, p.text)
            for p in [*problems, *missing]
        ]
        kind_of_error = SceneError if problems else FileMissing
        listed = sorted(places)
        raise kind_of_error(list_errors(listed, lambda each: format_excerpt(*each, text, str(path)), str(path)))
    return scene

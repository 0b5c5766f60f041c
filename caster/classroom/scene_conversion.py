"""Conversion of 6.837 blocks to a scene description: lights, camera, materials, objects and their transforms."""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from caster.classroom.grammar import CAMERAS, FILE_START, TEXTURES, TRANSFORM_FIELDS, Field, Node, SourceMessage, Token

Path = tuple[str | int, ...]

WHITE, BLACK, GREY = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.5, 0.5, 0.5)


class Falloff(NamedTuple):
    """Attenuation of a point light at distance r: color / (constant + linear r + quadratic r^2)."""

    constant: float
    linear: float
    quadratic: float

    @property
    def is_inverse_square(self) -> bool:
        return self.constant == self.linear == 0.0


@dataclass
class SceneBuilder:
    """The scene description under construction, with errors and omissions."""

    data: dict[str, Any] = field(default_factory=dict)  # as in a scene file of this project
    sources: dict[Path, Token] = field(default_factory=dict)  # the token of each value of the data
    errors: list[SourceMessage] = field(default_factory=list)
    left_out: list[SourceMessage] = field(default_factory=list)
    background: tuple[float, ...] = GREY  # default of the course
    colors: list[tuple[float, ...]] = field(default_factory=list)  # of point and directional lights
    falloffs: list[Falloff | None] = field(default_factory=list)  # None: directional
    material: str = ""  # of the objects that follow

    def put(self, value: Any, at: Token, *path: str | int) -> Any:
        """Record the source of a value and return it."""
        self.sources[path] = at
        return value

    def omit(self, at: Token, text: str) -> None:
        """Record that something of the file has no counterpart."""
        self.left_out.append(SourceMessage(at, text))

    def copy(self, into: dict[str, Any], key: str, node: Node, field_name: str, *path: str | int) -> None:
        """Copy the numbers of a field into the data, if the node has it."""
        found = node.get(field_name)
        if found is not None:
            value = list(found.numbers) if len(found.numbers) > 1 else found.numbers[0]
            into[key] = self.put(value, found.at, *path, key)


# ---- lights ----


def add_lights(out: SceneBuilder, sections: dict[str, Node]) -> None:
    """Add directional and point lights, then the ambient one: white without other lights, as in the course."""
    lights: list[dict[str, Any]] = []
    out.data["light"] = lights
    node, background = sections.get("Lights"), sections.get("Background")
    for each in node.children if node else []:
        path = ("light", len(lights))
        lights.append(out.put({}, each.at, *path))
        color = each.numbers("color", BLACK)
        out.colors.append(color)
        if each.kind == "DirectionalLight":
            lights[-1]["type"] = "directional"
            out.falloffs.append(None)
            out.copy(lights[-1], "direction", each, "direction", *path)
            _color(out, lights[-1], "irradiance", each, math.pi, *path)
        else:
            lights[-1]["type"] = "point"
            out.copy(lights[-1], "position", each, "position", *path)
            _point_falloff(out, lights[-1], each, path)
    ambient, at = _ambient(out, background)
    if not lights:
        ambient = WHITE
    if any(ambient):
        path = ("light", len(lights))
        lights.append(out.put({"type": "ambient", "radiance": list(ambient)}, at, *path))


def _ambient(out: SceneBuilder, node: Node | None) -> tuple[tuple[float, ...], Token]:
    if node is None:
        return BLACK, FILE_START
    out.background = node.numbers("color", GREY)
    if (cube := node.get("cubeMap")) is not None:
        out.omit(cube.at, f"{cube.words}: no environment maps here")
    ambient = node.get("ambientLight")
    return (BLACK, node.at) if ambient is None else (ambient.numbers, ambient.at)


def _color(out: SceneBuilder, into: dict[str, Any], key: str, node: Node, factor: float, *path: str | int) -> None:
    """Set the radiometric quantity of a light: the course reflects reflectance times color, here it is over pi."""
    found = node.get("color")
    if found is None:
        return
    if min(found.numbers) < 0.0:  # checked here, to report the numbers of the file
        out.errors.append(SourceMessage(found.at, f"{node.kind}: {found.words} must be a colour >= 0"))
    into[key] = out.put([factor * abs(c) for c in found.numbers], found.at, *path, key)


def _point_falloff(out: SceneBuilder, light: dict[str, Any], node: Node, path: Path) -> None:
    """Set the intensity of a point light. Any falloff but 1 / r^2 is replaced by it, equal at r = 1, and reported."""
    falloff = Falloff(*node.numbers("attenuation", (1.0, 0.0, 0.0)))
    if (of_2011 := node.get("falloff")) is not None and of_2011.numbers[0] > 0.0:
        falloff = Falloff(0.0, 0.0, of_2011.numbers[0])
    at_one = sum(falloff)
    if not at_one > 0.0:
        out.errors.append(SourceMessage(node.at, "PointLight: its attenuation must leave light at a distance of 1"))
        at_one = 1.0
    out.falloffs.append(falloff)
    _color(out, light, "intensity", node, math.pi / at_one, *path)
    if not falloff.is_inverse_square:
        which = node.get("attenuation")
        falloff_text = which.words if which else "no attenuation"
        out.omit(
            which.at if which else node.at,
            f"{falloff_text}: point lights fall off by 1 / r^2 here; the value at r = 1 is kept",
        )


# ---- transforms ----

Step = dict[str, Any]

# The course computes in float32: the length of a unit axis may be off by four roundings.
UNIT_ATOL = 4 * 2.0**-24

AXES = {"XRotate": (1, 0, 0), "YRotate": (0, 1, 0), "ZRotate": (0, 0, 1)}


def transform_steps(out: SceneBuilder, node: Node) -> list[Step]:
    """Steps in the order of application: the last of the file first, but a matrix after all that precede it."""
    steps: list[Step] = []
    for item in node.items:
        if isinstance(item, Field):
            where = len(steps) if item.name.startswith("Matrix") else 0
            steps.insert(where, _step(out, item))
    return steps


def _step(out: SceneBuilder, item: Field) -> Step:
    numbers = list(item.numbers)
    if item.name in AXES:
        return {"rotate": {"axis": list(AXES[item.name]), "degrees": numbers[0]}}
    if item.name == "Rotate":
        length = math.hypot(*numbers[:3])
        if length > 0.0 and abs(length - 1.0) > UNIT_ATOL:
            text = f"the length {length:g} of the axis of {item.words}: it is normalised"
            out.omit(item.at, text)
        return {"rotate": {"axis": numbers[:3], "degrees": numbers[3]}}
    if item.name == "Translate":
        return {"translate": numbers}
    if item.name in ("Scale", "UniformScale"):
        return {"scale": numbers if len(numbers) == 3 else numbers[0]}
    assert item.name in TRANSFORM_FIELDS
    rows = [numbers[i : i + 4] for i in range(0, 16, 4)]
    if item.name == "Matrix4f":  # of 2011: column-major
        rows = [list(column) for column in zip(*rows, strict=True)]
    return {"matrix": rows}


# ---- materials and objects ----


def add_materials(out: SceneBuilder, node: Node | None) -> None:
    materials: dict[str, Any] = {}
    for i, each in enumerate(node.children if node else []):
        name, color = f"material-{i}", each.get("diffuseColor")
        rgb = GREY if each.kind in TEXTURES else each.numbers("diffuseColor", WHITE)
        clipped = [min(c, 1.0) for c in rgb]
        at = color.at if color else each.at
        materials[name] = out.put({"reflectance": clipped}, each.at, "material", name)
        out.put(clipped, at, "material", name, "reflectance")
        if clipped != list(rgb):
            out.omit(at, f"the part beyond 1 of {color.words if color else 'it'}: a reflectance is at most 1")
        if each.kind in TEXTURES:
            out.omit(each.at, f"{each.kind}: no textures here; replaced by grey")
        for item in each.items:
            if isinstance(item, Field) and item.name != "diffuseColor":
                out.omit(item.at, f"{item.words}: materials are diffuse, of one colour")
    out.data["material"] = materials


def add_objects(out: SceneBuilder, node: Node, outer: list[Step]) -> None:
    """Add the objects of a group. MaterialIndex applies to all objects that follow in the file."""
    for item in node.items:
        if isinstance(item, Node):
            _object(out, item, outer)
        elif item.name == "MaterialIndex":
            name = f"material-{item.numbers[0]:g}"
            out.material = name if name in out.data["material"] else ""
            if not out.material:
                count = len(out.data["material"])
                out.errors.append(
                    SourceMessage(item.at, f"{item.words}: the scene has {count} materials, counted from 0")
                )


def _object(out: SceneBuilder, node: Node, outer: list[Step]) -> None:
    if node.kind == "Group":
        add_objects(out, node, outer)
    elif node.kind == "Transform":
        for child in node.children:
            _object(out, child, transform_steps(out, node) + outer)
    else:
        _shape(out, node, outer)


def _shape(out: SceneBuilder, node: Node, steps: list[Step]) -> None:
    path = ("shape", len(out.data["shape"]))
    shape: dict[str, Any] = {"type": SHAPE_TYPES[node.kind]}
    if out.material:
        shape["material"] = out.material
    if steps:
        shape["to_world"] = out.put(steps, node.at, *path, "to_world")
    SHAPE_BUILDERS[node.kind](out, shape, node, path)
    out.data["shape"].append(out.put(shape, node.at, *path))


def _sphere(out: SceneBuilder, shape: dict[str, Any], node: Node, path: Path) -> None:
    out.copy(shape, "center", node, "center", *path)
    out.copy(shape, "radius", node, "radius", *path)


def _plane(out: SceneBuilder, shape: dict[str, Any], node: Node, path: Path) -> None:
    """Points p with normal . p = offset; the offset is divided by the length of the normal."""
    out.copy(shape, "normal", node, "normal", *path)
    normal, offset = node.numbers("normal"), node.get("offset")
    if offset is not None:
        length = math.hypot(*normal) or 1.0
        shape["offset"] = out.put(offset.numbers[0] / length, offset.at, *path, "offset")


def _triangle(out: SceneBuilder, shape: dict[str, Any], node: Node, path: Path) -> None:
    shape["vertices"] = out.put([], node.at, *path, "vertices")
    for i in range(3):
        found = node.get(f"vertex{i}")
        if found is not None:
            shape["vertices"].append(out.put(list(found.numbers), found.at, *path, "vertices", i))


def _mesh(out: SceneBuilder, shape: dict[str, Any], node: Node, path: Path) -> None:
    """A mesh with flat shading, as in 2003 and 2004."""
    file = node.get("obj_file")
    shape["face_normals"] = True
    if file is not None and file.word is not None:
        shape["file"] = out.put(file.word.text, file.word, *path, "file")


SHAPE_TYPES = {"Sphere": "sphere", "Plane": "plane", "Triangle": "triangle", "TriangleMesh": "mesh"}
SHAPE_BUILDERS = {"Sphere": _sphere, "Plane": _plane, "Triangle": _triangle, "TriangleMesh": _mesh}


# ---- the whole scene ----


def build_scene_data(sections: dict[str, Node], width: int, height: int) -> SceneBuilder:
    """Convert parsed blocks to a scene description with a film of this size; values are validated later."""
    out = SceneBuilder(data={"film": {"width": width, "height": height}, "shading": {"shadows": False}})
    if "Camera" in sections:
        _camera(out, sections["Camera"], width, height)
    add_lights(out, sections)
    add_materials(out, sections.get("Materials"))
    out.data["shape"] = []
    if "Group" in sections:
        add_objects(out, sections["Group"], [])
    return out


def _camera(out: SceneBuilder, node: Node, width: int, height: int) -> None:
    """Add the camera. Its angle or size spans the longer side of the film: the course crops a square image."""
    camera: dict[str, Any] = {"type": "pinhole" if node.kind == CAMERAS[0] else "orthographic"}
    for key, field_name in (("eye", "center"), ("direction", "direction"), ("up", "up")):
        out.copy(camera, key, node, field_name, "camera")
    if "angle" in node.mentioned:
        out.copy(camera, "fov", node, "angle", "camera")
        camera["fov_axis"] = "larger"
    elif (size := node.get("size")) is not None:
        share = width / max(width, height)
        camera["width"] = out.put(size.numbers[0] * share, size.at, "camera", "width")
    out.data["camera"] = out.put(camera, node.at, "camera")

"""The blocks of a 6.837 scene -> the data of a scene file of ours, and what is left out of it."""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from caster.classroom.grammar import CAMERAS, STEPS, TEXTURES
from caster.classroom.parser import START, Fault, Field, Node
from caster.classroom.tokens import Token

Path = tuple[str | int, ...]
Step = dict[str, Any]

# The course computes in float32: an axis of unit length may be written four roundings away from it.
UNIT_ATOL = 4 * 2.0**-24

WHITE, BLACK, GREY = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.5, 0.5, 0.5)
AXES = {"XRotate": (1, 0, 0), "YRotate": (0, 1, 0), "ZRotate": (0, 0, 1)}


class Falloff(NamedTuple):
    """A point light at distance r has color / (constant + linear r + quadratic r^2) as its brightness."""

    constant: float
    linear: float
    quadratic: float

    @property
    def is_ours(self) -> bool:
        return self.constant == self.linear == 0.0


@dataclass
class Building:
    """What has been made of the blocks so far."""

    data: dict[str, Any] = field(default_factory=dict)  # as a scene file of ours
    places: dict[Path, Token] = field(default_factory=dict)  # where each of its values is in the text
    faults: list[Fault] = field(default_factory=list)
    left_out: list[Fault] = field(default_factory=list)
    background: tuple[float, ...] = GREY  # the course's, where a file says nothing
    colors: list[tuple[float, ...]] = field(
        default_factory=list
    )  # of the lights that have a place or a direction
    falloffs: list[Falloff | None] = field(default_factory=list)  # None: directional
    material: str = ""  # of the objects to come

    def put(self, value: Any, at: Token, *path: str | int) -> Any:
        """Remember where a value comes from."""
        self.places[path] = at
        return value

    def omit(self, at: Token, text: str) -> None:
        self.left_out.append(Fault(at, text))


def build(sections: dict[str, Node], width: int, height: int) -> Building:
    """A film of this size; the blocks have the right fields, but their values may still be wrong."""
    out = Building(data={"film": {"width": width, "height": height}, "shading": {"shadows": False}})
    if "Camera" in sections:
        _camera(out, sections["Camera"], width, height)
    _lights(out, sections)
    _materials(out, sections.get("Materials"))
    out.data["shape"] = []
    if "Group" in sections:
        _group(out, sections["Group"], [])
    return out


def _camera(out: Building, node: Node, width: int, height: int) -> None:
    """Whatever the film, the longer of its sides spans the angle or the size: the course has one crop the square."""
    camera: dict[str, Any] = {"type": "pinhole" if node.kind == CAMERAS[0] else "orthographic"}
    for ours, theirs in (("eye", "center"), ("direction", "direction"), ("up", "up")):
        _copy(out, camera, ours, node, theirs, "camera")
    if "angle" in node.tried:
        _copy(out, camera, "fov", node, "angle", "camera")
        camera["fov_axis"] = "larger"
    elif (size := node.get("size")) is not None:
        share = width / max(width, height)
        camera["width"] = out.put(size.numbers[0] * share, size.at, "camera", "width")
    out.data["camera"] = out.put(camera, node.at, "camera")


def _copy(out: Building, into: dict[str, Any], ours: str, node: Node, theirs: str, *path: str | int) -> None:
    found = node.get(theirs)
    if found is not None:
        value = list(found.numbers) if len(found.numbers) > 1 else found.numbers[0]
        into[ours] = out.put(value, found.at, *path, ours)


def _lights(out: Building, sections: dict[str, Node]) -> None:
    """Directional and point lights, then the ambient one. Without lights the course shows plain colours."""
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
            _copy(out, lights[-1], "direction", each, "direction", *path)
            _color(out, lights[-1], "irradiance", each, math.pi, *path)
        else:
            lights[-1]["type"] = "point"
            _copy(out, lights[-1], "position", each, "position", *path)
            _fading(out, lights[-1], each, path)
    ambient, at = _ambient(out, background)
    if not lights:
        ambient = WHITE
    if any(ambient):
        path = ("light", len(lights))
        lights.append(out.put({"type": "ambient", "radiance": list(ambient)}, at, *path))


def _ambient(out: Building, node: Node | None) -> tuple[tuple[float, ...], Token]:
    if node is None:
        return BLACK, START
    out.background = node.numbers("color", GREY)
    if (cube := node.get("cubeMap")) is not None:
        out.omit(cube.at, f"{cube.words}: there are no pictures behind our scenes")
    ambient = node.get("ambientLight")
    return (BLACK, node.at) if ambient is None else (ambient.numbers, ambient.at)


def _color(
    out: Building, into: dict[str, Any], key: str, node: Node, factor: float, *path: str | int
) -> None:
    """A surface across a light of the course sends back reflectance times color, one of ours that over pi."""
    found = node.get("color")
    if found is None:
        return
    if min(found.numbers) < 0.0:  # said here, in the numbers of the file
        out.faults.append(Fault(found.at, f"{node.kind}: {found.words} must be a colour >= 0"))
    into[key] = out.put([factor * abs(c) for c in found.numbers], found.at, *path, key)


def _fading(out: Building, light: dict[str, Any], node: Node, path: Path) -> None:
    """Ours fade by 1 / r^2. Others come as bright as they are at r = 1, which is told."""
    falloff = Falloff(*node.numbers("attenuation", (1.0, 0.0, 0.0)))
    if (of_2011 := node.get("falloff")) is not None and of_2011.numbers[0] > 0.0:
        falloff = Falloff(0.0, 0.0, of_2011.numbers[0])
    at_one = sum(falloff)
    if not at_one > 0.0:
        out.faults.append(Fault(node.at, "PointLight: its attenuation must leave light at a distance of 1"))
        at_one = 1.0
    out.falloffs.append(falloff)
    _color(out, light, "intensity", node, math.pi / at_one, *path)
    if not falloff.is_ours:
        which = node.get("attenuation")
        says = which.words if which else "light that does not fade"
        out.omit(
            which.at if which else node.at,
            f"{says}: our point lights fade by 1 / r^2; it keeps what it has at r = 1",
        )


def _materials(out: Building, node: Node | None) -> None:
    materials: dict[str, Any] = {}
    for i, each in enumerate(node.children if node else []):
        name, color = f"material-{i}", each.get("diffuseColor")
        rgb = GREY if each.kind in TEXTURES else each.numbers("diffuseColor", WHITE)
        clipped = [min(c, 1.0) for c in rgb]
        at = color.at if color else each.at
        materials[name] = out.put({"reflectance": clipped}, each.at, "material", name)
        out.put(clipped, at, "material", name, "reflectance")
        if clipped != list(rgb):
            out.omit(
                at,
                f"what is beyond 1 in {color.words if color else 'it'}: a surface sends back no more than it gets",
            )
        if each.kind in TEXTURES:
            out.omit(each.at, f"{each.kind}: our materials have one colour; grey stands for it")
        for item in each.items:
            if isinstance(item, Field) and item.name != "diffuseColor":
                out.omit(item.at, f"{item.words}: our materials are diffuse, of one colour")
    out.data["material"] = materials


def _group(out: Building, node: Node, outer: list[Step]) -> None:
    """MaterialIndex holds for what follows in the file, also outside the group that it stands in."""
    for item in node.items:
        if isinstance(item, Node):
            _object(out, item, outer)
        elif item.name == "MaterialIndex":
            name = f"material-{item.numbers[0]:g}"
            out.material = name if name in out.data["material"] else ""
            if not out.material:
                count = len(out.data["material"])
                out.faults.append(
                    Fault(item.at, f"{item.words}: the scene has {count} materials, counted from 0")
                )


def _object(out: Building, node: Node, outer: list[Step]) -> None:
    if node.kind == "Group":
        _group(out, node, outer)
    elif node.kind == "Transform":
        for child in node.children:
            _object(out, child, _steps(out, node) + outer)
    else:
        _shape(out, node, outer)


def _steps(out: Building, node: Node) -> list[Step]:
    """In the order they act: the last of the file first. But a matrix acts after all that stand before it."""
    steps: list[Step] = []
    for item in node.items:
        if isinstance(item, Field):
            where = len(steps) if item.name.startswith("Matrix") else 0
            steps.insert(where, _step(out, item))
    return steps


def _step(out: Building, item: Field) -> Step:
    numbers = list(item.numbers)
    if item.name in AXES:
        return {"rotate": {"axis": list(AXES[item.name]), "degrees": numbers[0]}}
    if item.name == "Rotate":
        length = math.hypot(*numbers[:3])
        if length > 0.0 and abs(length - 1.0) > UNIT_ATOL:
            text = f"the length {length:g} of the axis of {item.words}: we turn about its direction"
            out.omit(item.at, text)
        return {"rotate": {"axis": numbers[:3], "degrees": numbers[3]}}
    if item.name == "Translate":
        return {"translate": numbers}
    if item.name in ("Scale", "UniformScale"):
        return {"scale": numbers if len(numbers) == 3 else numbers[0]}
    assert item.name in STEPS
    rows = [numbers[i : i + 4] for i in range(0, 16, 4)]
    if item.name == "Matrix4f":  # of 2011, which reads it column by column
        rows = [list(column) for column in zip(*rows, strict=True)]
    return {"matrix": rows}


def _shape(out: Building, node: Node, steps: list[Step]) -> None:
    path = ("shape", len(out.data["shape"]))
    shape: dict[str, Any] = {"type": OURS[node.kind]}
    if out.material:
        shape["material"] = out.material
    if steps:
        shape["to_world"] = out.put(steps, node.at, *path, "to_world")
    MAKE[node.kind](out, shape, node, path)
    out.data["shape"].append(out.put(shape, node.at, *path))


def _sphere(out: Building, shape: dict[str, Any], node: Node, path: Path) -> None:
    _copy(out, shape, "center", node, "center", *path)
    _copy(out, shape, "radius", node, "radius", *path)


def _plane(out: Building, shape: dict[str, Any], node: Node, path: Path) -> None:
    """All p with normal . p = offset, the normal as it is written; ours has it at length 1."""
    _copy(out, shape, "normal", node, "normal", *path)
    normal, offset = node.numbers("normal"), node.get("offset")
    if offset is not None:
        length = math.hypot(*normal) or 1.0
        shape["offset"] = out.put(offset.numbers[0] / length, offset.at, *path, "offset")


def _triangle(out: Building, shape: dict[str, Any], node: Node, path: Path) -> None:
    shape["vertices"] = out.put([], node.at, *path, "vertices")
    for i in range(3):
        found = node.get(f"vertex{i}")
        if found is not None:
            shape["vertices"].append(out.put(list(found.numbers), found.at, *path, "vertices", i))


def _mesh(out: Building, shape: dict[str, Any], node: Node, path: Path) -> None:
    """Flat faces, as in 2003 and 2004."""
    file = node.get("obj_file")
    shape["face_normals"] = True
    if file is not None and file.word is not None:
        shape["file"] = out.put(file.word.text, file.word, *path, "file")


OURS = {"Sphere": "sphere", "Plane": "plane", "Triangle": "triangle", "TriangleMesh": "mesh"}
MAKE = {"Sphere": _sphere, "Plane": _plane, "Triangle": _triangle, "TriangleMesh": _mesh}

"""The scene description that a document is converted to, with omissions: its transforms, materials and lights."""

import math
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numpy as np

from caster.description.transform import sine_and_cosine
from mitsuba_ref.scene_xml.documents import ImportDiagnostic, Node, SourcePosition, XmlDocument, resolve_reference

Path = tuple[str | int, ...]


@dataclass
class SceneBuilder:
    """The scene description under construction. Values are read through it, so that unread ones are reported."""

    document: XmlDocument
    data: dict[str, Any] = field(default_factory=lambda: {"light": [], "material": {}, "shape": []})
    positions: dict[Path, SourcePosition] = field(default_factory=dict)  # of each element of the data
    left_out: list[ImportDiagnostic] = field(default_factory=list)
    consumed: set[int] = field(default_factory=set)  # id() of the nodes that were read
    shape_names: set[str] = field(default_factory=set)
    materials: dict[int, str] = field(default_factory=dict)  # names by id() of their node
    in_progress: set[int] = field(default_factory=set)  # id() of the bsdfs that are being made

    def error(self, node: Node, text: str) -> None:
        self.document.errors.append(ImportDiagnostic(node.position, text))

    def omit(self, node: Node, text: str) -> None:
        self.consumed.add(id(node))
        self.left_out.append(ImportDiagnostic(node.position, text))

    def note(self, node: Node, text: str) -> None:
        """Report a property of an element that is converted only approximately."""
        self.left_out.append(ImportDiagnostic(node.position, f"{text} ({node.words()})"))

    def omit_unread(self, node: Node) -> None:
        """Report all children of a node that were not read."""
        for child in node.children:
            if id(child) not in self.consumed:
                self.omit(child, f"{child.words()} of {node.words()}")

    def find(self, node: Node, name: str, *tags: str) -> Node | None:
        """The child of a name and one of the tags, marked as read."""
        child = node.named(name)
        if child is None:
            return None
        if child.tag not in tags:
            self.error(child, f"{node.words()}: {name} must be a <{tags[0]}>, got <{child.tag}>")
        self.consumed.add(id(child))
        return child if child.tag in tags else None

    def number(self, node: Node, name: str, default: float) -> float:
        child = self.find(node, name, "float", "integer")
        return default if child is None else self.numbers(child, "value", 1)[0]

    def integer(self, node: Node, name: str, default: int) -> int:
        child = self.find(node, name, "integer")
        if child is None:
            return default
        value = self.numbers(child, "value", 1)[0]
        if value != int(value):
            self.error(child, f"{child.words()}: expected a whole number, got {child.attributes.get('value')}")
        return int(value)

    def boolean(self, node: Node, name: str) -> bool:
        child = self.find(node, name, "boolean")
        if child is None:
            return False
        text = child.attributes.get("value", "").lower()
        if text not in ("true", "false"):
            self.error(child, f"{child.words()}: expected true or false, got '{text}'")
        return text == "true"

    def text(self, node: Node, name: str, default: str = "") -> str:
        child = self.find(node, name, "string")
        return default if child is None else child.attributes.get("value", "")

    def vector(self, node: Node, name: str, default: tuple[float, ...]) -> list[float]:
        child = self.find(node, name, "point", "vector")
        return list(default) if child is None else self.xyz(child, default)

    def xyz(self, node: Node, default: tuple[float, ...]) -> list[float]:
        """A vector from x="1" y="2" z="3", value="1 2 3", or value="1" for all three."""
        if "value" in node.attributes:
            found = self.numbers(node, "value", 3)
            return found * 3 if len(found) == 1 else found
        return [
            self.numbers(node, axis, 1)[0] if axis in node.attributes else start
            for axis, start in zip("xyz", default, strict=True)
        ]

    def numbers(self, node: Node, attribute: str, count: int) -> list[float]:
        """`count` numbers or one, separated by spaces or commas; else an error and zeros."""
        words = node.attributes.get(attribute, "").replace(",", " ").split()
        try:
            found = [float(word) for word in words]
        except ValueError:
            found = []
        if len(found) not in (1, count) or not all(map(math.isfinite, found)):
            many = "a number" if count == 1 else f"{count} numbers"
            got = node.attributes.get(attribute, "nothing")
            self.error(node, f"{node.words()}: {attribute} must be {many}, got '{got:.60}'")
            return [0.0] * count
        return found


# ---- transforms: steps of to_world, applied in the order of the file as in Mitsuba ----

Step = dict[str, Any]
TRANSFORM_TAGS = ("translate", "rotate", "scale", "lookat", "matrix")


def transform_steps(out: SceneBuilder, node: Node, name: str = "to_world") -> list[Step]:
    """The steps of a transform of an element; empty without one."""
    transform = out.find(node, name, "transform")
    if transform is None:
        return []
    for child in transform.children:
        if child.tag not in TRANSFORM_TAGS:
            out.error(child, f"unknown step <{child.tag}> of a transform (known: {', '.join(TRANSFORM_TAGS)})")
    return [_step(out, child) for child in transform.children if child.tag in TRANSFORM_TAGS]


def _step(out: SceneBuilder, node: Node) -> Step:
    if node.tag == "translate":
        return {"translate": out.xyz(node, (0.0, 0.0, 0.0))}
    if node.tag == "scale":
        return {"scale": out.xyz(node, (1.0, 1.0, 1.0))}
    if node.tag == "rotate":
        return _rotation(out.xyz(node, (0.0, 0.0, 0.0)), out.numbers(node, "angle", 1)[0])
    if node.tag == "lookat":
        up = out.numbers(node, "up", 3) if "up" in node.attributes else [0.0, 1.0, 0.0]
        return {
            "look_at": {"origin": out.numbers(node, "origin", 3), "target": out.numbers(node, "target", 3), "up": up}
        }
    return {"matrix": _matrix(out, node)}


def _rotation(axis: list[float], degrees: float) -> Step:
    """A rotation. Mitsuba does not normalise the axis: a length other than exactly 1 gives a general matrix."""
    length = math.hypot(*axis)
    if length in (0.0, 1.0):  # 0 is rejected when the scene is validated
        return {"rotate": {"axis": axis, "degrees": degrees}}
    x, y, z = axis
    angle = math.radians(degrees)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    outer = np.outer(axis, axis)
    sine, cosine = sine_and_cosine(angle)
    linear = cosine * np.eye(3) + sine * cross + (1.0 - cosine) * outer
    return {"matrix": matrix_rows(linear, [0.0, 0.0, 0.0])}


def _matrix(out: SceneBuilder, node: Node) -> list[list[float]]:
    """A matrix of 16 numbers, or 9 of the linear part, in row-major order."""
    count = 9 if len(node.attributes.get("value", "").replace(",", " ").split()) == 9 else 16
    found = out.numbers(node, "value", count)
    if count == 9:
        return matrix_rows(np.array(found).reshape(3, 3), [0.0, 0.0, 0.0])
    if len(found) != 16:
        out.error(node, "matrix: value must be 16 numbers, got 1")
        return matrix_rows(np.eye(3), [0.0, 0.0, 0.0])
    return [found[i : i + 4] for i in range(0, 16, 4)]


def matrix_rows(linear: np.ndarray, move: Any) -> list[list[float]]:
    return [*([*row, float(x)] for row, x in zip(linear.tolist(), move, strict=True)), [0.0, 0.0, 0.0, 1.0]]


def composed_matrix(steps: list[Step]) -> np.ndarray | None:
    """The product of steps as a 4x4 float64 matrix; None if they are invalid (reported by validation)."""
    from caster.description.errors import SceneError
    from caster.shapes import Cube

    try:
        return np.array(Cube(to_world=steps).matrix)
    except SceneError:
        return None


# ---- <bsdf> as diffuse materials, <emitter> as lights ----

WRAPPERS = ("twosided", "mask", "bumpmap", "normalmap")  # around one bsdf
DIFFUSE_COLOR_NAMES = ("reflectance", "diffuse_reflectance", "base_color")  # names of the diffuse colour of bsdfs
DEFAULT_REFLECTANCE = [0.5, 0.5, 0.5]  # Mitsuba's default of diffuse


def material_of(out: SceneBuilder, shape: Node) -> str:
    """The name of the material of a shape; "" for the default, which is the same grey in both formats."""
    for child in shape.all("bsdf", "ref"):
        target = resolve_reference(out.document, child)
        if target is not None and target.tag == "bsdf":
            out.consumed.add(id(child))
            return _material_name(out, target)
        if target is None:
            out.consumed.add(id(child))
    return ""


def _material_name(out: SceneBuilder, node: Node) -> str:
    if id(node) not in out.materials:
        materials = out.data["material"]
        unused = (new for new in map("material-{}".format, count(len(materials))) if new not in materials)
        name = node.id if node.id.isprintable() else ""
        name = name or next(new for new in unused if new not in out.document.by_id)
        out.materials[id(node)] = name
        materials[name] = _build_material(out, node)
        out.positions["material", name] = node.position
    return out.materials[id(node)]


def _build_material(out: SceneBuilder, node: Node) -> dict[str, Any]:
    out.consumed.add(id(node))
    if id(node) in out.in_progress:
        out.error(node, f"{node.words()}: refers to itself")
        return {}
    if node.kind in WRAPPERS:
        out.in_progress.add(id(node))
        inner = [resolve_reference(out.document, child) for child in node.all("bsdf", "ref")]
        made = next((_build_material(out, each) for each in inner if each is not None and each.tag == "bsdf"), {})
        out.in_progress.remove(id(node))
        out.consumed.update(id(child) for child in node.all("bsdf", "ref"))
        if node.kind == "twosided":
            made["two_sided"] = True
        else:
            out.omit(node, f"{node.words()}: the inner bsdf is kept")
        out.omit_unread(node)
        return made
    child = next((child for child in map(node.named, DIFFUSE_COLOR_NAMES) if child is not None), None)
    made = {}
    if child is not None:
        out.consumed.add(id(child))
        found = color_of(out, child)
        if found is None:
            out.omit(child, f"{child.words()} of {node.words()}: replaced by grey")
        made["reflectance"] = found or DEFAULT_REFLECTANCE
    if node.kind != "diffuse":
        kept = f"its {child.name} is" if child is not None else "grey is"
        out.omit(node, f"{node.words()}: materials are diffuse here; {kept} kept")
    out.omit_unread(node)
    return made


def color_of(out: SceneBuilder, node: Node) -> list[float] | None:
    """r, g, b of an <rgb>, or of a <spectrum> or <float> of one number; else None."""
    value = node.attributes.get("value", "")
    if node.tag == "rgb" or (node.tag in ("spectrum", "float") and ":" not in value and value):
        found = out.numbers(node, "value", 3)
        return found * 3 if len(found) == 1 else found
    return None


# ---- emitters ----

DEFAULT_RADIANCE = [1.0, 1.0, 1.0]  # Mitsuba's default of every emitter
RADIANCE_OF = {"point": "intensity", "directional": "irradiance", "constant": "radiance"}  # its name, of each kind
EXACT_KINDS = ("point", "directional")  # converted exactly, even if they emit nothing


def is_dark(out: SceneBuilder, node: Node) -> bool:
    """Whether an emitter explicitly emits nothing, so that the image is the same without it."""
    given = next((child for child in map(node.named, RADIANCE_OF.values()) if child is not None), None)
    color = None if given is None else color_of(out, given)
    return color is not None and not any(color)


def add_emitter(out: SceneBuilder, node: Node) -> None:
    """Add a point, directional or constant emitter; report any other."""
    if node.kind not in EXACT_KINDS and is_dark(out, node):
        out.consumed.add(id(node))
        return
    if node.kind not in RADIANCE_OF:
        out.omit(node, f"{node.words()}: lights are point, directional or ambient here")
        return
    strength, light = RADIANCE_OF[node.kind], dict[str, Any](type=node.kind)
    out.consumed.add(id(node))
    if node.kind == "constant":
        out.note(node, "the occlusion of its light by shapes: ambient light is the same everywhere")
        light = {"type": "ambient"}
    else:
        matrix = composed_matrix(transform_steps(out, node))
        to_world = np.eye(4) if matrix is None else matrix
        place, column = ("position", 3) if node.kind == "point" else ("direction", 2)
        light[place] = out.vector(node, place, tuple(to_world[:3, column].tolist()))
    child = node.named(strength)
    color = DEFAULT_RADIANCE if child is None else color_of(out, child)
    if child is not None:
        out.consumed.add(id(child))
    if color is None:
        out.omit(node, f"{node.words()}: its {strength} is no colour of three numbers")
    else:
        out.positions["light", len(out.data["light"])] = node.position
        out.data["light"].append(light | {strength: color})
    out.omit_unread(node)

"""Materials and objects of a 6.837 scene."""

import math
from typing import Any

from caster.classroom.blocks import Fault, Field, Node
from caster.classroom.building import GREY, WHITE, Building, Path
from caster.classroom.grammar import TEXTURES
from caster.classroom.steps import Step, steps_of


def add_materials(out: Building, node: Node | None) -> None:
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


def add_objects(out: Building, node: Node, outer: list[Step]) -> None:
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
        add_objects(out, node, outer)
    elif node.kind == "Transform":
        for child in node.children:
            _object(out, child, steps_of(out, node) + outer)
    else:
        _shape(out, node, outer)


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
    out.copy(shape, "center", node, "center", *path)
    out.copy(shape, "radius", node, "radius", *path)


def _plane(out: Building, shape: dict[str, Any], node: Node, path: Path) -> None:
    """All p with normal . p = offset, the normal as it is written; ours has it at length 1."""
    out.copy(shape, "normal", node, "normal", *path)
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

"""<shape> -> a shape of ours, or several for an instance."""

from collections.abc import Callable
from typing import Any

import numpy as np

from mitsuba_ref.importers.building import Building
from mitsuba_ref.importers.emitters import is_dark
from mitsuba_ref.importers.expanding import followed
from mitsuba_ref.importers.materials import material_of
from mitsuba_ref.importers.transforms import Step, placed, steps_of
from mitsuba_ref.importers.xml_nodes import Node

Made = dict[str, Any]

# Of a sphere's matrix: its three columns are as long as each other up to what float32 makes of equal numbers.
ROUND = 8 * 2.0**-24

MIRROR = {"scale": [1.0, 1.0, -1.0]}


def add_shape(out: Building, node: Node, outer: tuple[Step, ...] = (), name: str = "") -> None:
    """outer: the steps of the instance that it is a part of, which act after its own. name: that of the instance."""
    out.used.add(id(node))
    if node.kind == "shapegroup":
        return  # invisible by itself
    if node.kind == "instance":
        if outer:
            out.error(
                node, f"{node.words()}: an instance inside a shapegroup, which Mitsuba does not take either"
            )
        else:
            _add_instance(out, node)
        return
    if node.kind not in MAKERS:
        out.omit(node, f"{node.words()}: no shape of ours (known: {', '.join(MAKERS)}, instance)")
        return
    steps = [*steps_of(out, node), *outer]
    shape = MAKERS[node.kind](out, node, steps, bool(outer))
    material = material_of(out, node)
    for emitter in node.all("emitter", "ref"):
        target = followed(out.document, emitter)
        if target is not None and target.tag == "emitter":
            out.used |= {id(target), id(emitter)}
            if is_dark(out, target):
                continue
            out.omit(emitter, f"{target.words()} of {node.words()}: our shapes do not shine")
    out.omit_rest(node)
    label = name or node.id
    taken = {other.get("name") for other in out.data["shape"]}
    shape |= {"name": label} if label and label.isprintable() and label not in taken else {}
    shape |= {"material": material} if material else {}
    out.places["shape", len(out.data["shape"])] = node.place
    out.data["shape"].append(shape)


def _add_instance(out: Building, node: Node) -> None:
    group = next((followed(out.document, ref) for ref in node.all("ref")), None)
    out.used.update(id(ref) for ref in node.all("ref"))
    if group is None or group.kind != "shapegroup":
        out.error(node, f"{node.words()}: expected a <ref> to a shapegroup")
        return
    steps = tuple(steps_of(out, node)) or ({"translate": [0.0, 0.0, 0.0]},)
    parts = [
        part
        for part in (followed(out.document, each) for each in group.all("shape", "ref"))
        if part is not None
    ]
    for part in parts:
        add_shape(out, part, steps, node.id if len(parts) == 1 else "")
    out.omit_rest(node)
    out.omit_rest(group)


def _to_world(steps: list[Step]) -> Made:
    return {"to_world": steps} if steps else {}


def _sphere(out: Building, node: Node, steps: list[Step], stretched: bool) -> Made:
    """Mitsuba's takes of its matrix where its centre and one radius come to lie, unless an instance stretches it."""
    center, radius = out.vector(node, "center", (0.0, 0.0, 0.0)), out.number(node, "radius", 1.0)
    inward = out.boolean(node, "flip_normals") != (radius < 0.0)
    matrix = placed(steps)
    if matrix is not None and not stretched:  # an instance keeps outwards what is
        inward ^= bool(np.linalg.det(matrix[:3, :3]) < 0.0)
    if inward:
        out.remark(node, "its normal, which points inwards: ours points outwards")
    shape = {"type": "sphere", "center": center, "radius": abs(radius)}
    if matrix is None or stretched:
        return shape | _to_world(steps)
    sizes = np.linalg.norm(matrix[:3, :3], axis=0)
    if np.ptp(sizes) > ROUND * sizes.max():
        out.remark(node, "the stretching, which Mitsuba leaves out too: it keeps the radius along x")
    center = (matrix[:3, :3] @ center + matrix[:3, 3]).tolist()
    return {"type": "sphere", "center": center, "radius": float(abs(radius) * sizes[0])}


def _flat(kind: str) -> Callable[[Building, Node, list[Step], bool], Made]:
    """A disk, rectangle or cube: our own are the same."""

    def make(out: Building, node: Node, steps: list[Step], stretched: bool) -> Made:
        turned = out.boolean(node, "flip_normals")
        if turned and kind == "disk":
            return {"type": kind, "to_world": [MIRROR, *steps]}
        _tell_of_side(out, node, turned, steps)
        return {"type": kind} | _to_world(steps)

    return make


def _cylinder(out: Building, node: Node, steps: list[Step], stretched: bool) -> Made:
    ends = out.vector(node, "p0", (0.0, 0.0, 0.0)), out.vector(node, "p1", (0.0, 0.0, 1.0))
    radius = out.number(node, "radius", 1.0)
    if out.boolean(node, "flip_normals"):
        out.remark(node, "its normal, which points inwards: ours points outwards")
    return {"type": "cylinder", "p0": ends[0], "p1": ends[1], "radius": radius} | _to_world(steps)


def _mesh(out: Building, node: Node, steps: list[Step], stretched: bool) -> Made:
    if node.named("filename") is None:
        out.error(node, f'{node.words()}: needs <string name="filename" ...>')
    shape: Made = {"type": "mesh", "file": out.text(node, "filename")}
    if out.boolean(node, "face_normals"):
        shape["face_normals"] = True
    _tell_of_side(out, node, out.boolean(node, "flip_normals"), steps)
    return shape | _to_world(steps)


def _tell_of_side(out: Building, node: Node, turned: bool, steps: list[Step]) -> None:
    matrix = placed(steps)
    if turned:
        out.remark(node, "flip_normals: our normal points to the other side")
    elif matrix is not None and np.linalg.det(matrix[:3, :3]) < 0.0:
        out.remark(
            node,
            "the side of its normal: Mitsuba's geometric and shading normals part ways under a mirror, ours do not",
        )


MAKERS: dict[str, Callable[[Building, Node, list[Step], bool], Made]] = {
    "sphere": _sphere,
    "rectangle": _flat("rectangle"),
    "disk": _flat("disk"),
    "cube": _flat("cube"),
    "cylinder": _cylinder,
    "obj": _mesh,
    "ply": _mesh,
}

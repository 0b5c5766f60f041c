"""Conversion of <shape>: one shape, or several for an instance."""

from collections.abc import Callable
from typing import Any

import numpy as np

from mitsuba_ref.importers.appearance import is_dark, material_of
from mitsuba_ref.importers.scene_builder import SceneBuilder, Step, composed_matrix, transform_steps
from mitsuba_ref.importers.xml_document import Node, resolve_reference

ShapeData = dict[str, Any]

# Column lengths of a sphere's matrix that are equal up to float32 rounding.
UNIFORM_SCALE_RTOL = 8 * 2.0**-24

MIRROR_Z = {"scale": [1.0, 1.0, -1.0]}


def add_shape(out: SceneBuilder, node: Node, outer: tuple[Step, ...] = (), name: str = "") -> None:
    """Add a shape. outer: transform steps of the enclosing instance, applied after its own; name: of the instance."""
    out.consumed.add(id(node))
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
    if node.kind not in SHAPE_BUILDERS:
        out.omit(node, f"{node.words()}: not supported (known: {', '.join(SHAPE_BUILDERS)}, instance)")
        return
    steps = [*transform_steps(out, node), *outer]
    shape = SHAPE_BUILDERS[node.kind](out, node, steps, bool(outer))
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
    taken = {other.get("name") for other in out.data["shape"]}
    shape |= {"name": label} if label and label.isprintable() and label not in taken else {}
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
    for part in parts:
        add_shape(out, part, steps, node.id if len(parts) == 1 else "")
    out.omit_unread(node)
    out.omit_unread(group)


def _to_world(steps: list[Step]) -> ShapeData:
    return {"to_world": steps} if steps else {}


def _sphere(out: SceneBuilder, node: Node, steps: list[Step], stretched: bool) -> ShapeData:
    """A sphere. Mitsuba applies its matrix to centre and radius only, unless an instance scales it non-uniformly."""
    center, radius = out.vector(node, "center", (0.0, 0.0, 0.0)), out.number(node, "radius", 1.0)
    inward = out.boolean(node, "flip_normals") != (radius < 0.0)
    matrix = composed_matrix(steps)
    if matrix is not None and not stretched:  # an instance keeps the orientation of the normal
        inward ^= bool(np.linalg.det(matrix[:3, :3]) < 0.0)
    if inward:
        out.note(node, "its normal, which points inwards: normals point outwards here")
    shape = {"type": "sphere", "center": center, "radius": abs(radius)}
    if matrix is None or stretched:
        return shape | _to_world(steps)
    sizes = np.linalg.norm(matrix[:3, :3], axis=0)
    if np.ptp(sizes) > UNIFORM_SCALE_RTOL * sizes.max():
        out.note(node, "the non-uniform scale, which Mitsuba ignores as well: the radius is that along x")
    center = (matrix[:3, :3] @ center + matrix[:3, 3]).tolist()
    return {"type": "sphere", "center": center, "radius": float(abs(radius) * sizes[0])}


def _unit_shape(kind: str) -> Callable[[SceneBuilder, Node, list[Step], bool], ShapeData]:
    """A builder for a disk, rectangle or cube, which are the same in both formats."""

    def make(out: SceneBuilder, node: Node, steps: list[Step], stretched: bool) -> ShapeData:
        flipped = out.boolean(node, "flip_normals")
        if flipped and kind == "disk":
            return {"type": kind, "to_world": [MIRROR_Z, *steps]}
        _note_normal_side(out, node, flipped, steps)
        return {"type": kind} | _to_world(steps)

    return make


def _cylinder(out: SceneBuilder, node: Node, steps: list[Step], stretched: bool) -> ShapeData:
    ends = out.vector(node, "p0", (0.0, 0.0, 0.0)), out.vector(node, "p1", (0.0, 0.0, 1.0))
    radius = out.number(node, "radius", 1.0)
    if out.boolean(node, "flip_normals"):
        out.note(node, "its normal, which points inwards: normals point outwards here")
    return {"type": "cylinder", "p0": ends[0], "p1": ends[1], "radius": radius} | _to_world(steps)


def _mesh(out: SceneBuilder, node: Node, steps: list[Step], stretched: bool) -> ShapeData:
    if node.named("filename") is None:
        out.error(node, f'{node.words()}: needs <string name="filename" ...>')
    shape: ShapeData = {"type": "mesh", "file": out.text(node, "filename")}
    if out.boolean(node, "face_normals"):
        shape["face_normals"] = True
    _note_normal_side(out, node, out.boolean(node, "flip_normals"), steps)
    return shape | _to_world(steps)


def _note_normal_side(out: SceneBuilder, node: Node, flipped: bool, steps: list[Step]) -> None:
    matrix = composed_matrix(steps)
    if flipped:
        out.note(node, "flip_normals: the normal is not flipped here")
    elif matrix is not None and np.linalg.det(matrix[:3, :3]) < 0.0:
        out.note(
            node,
            "the side of its normal: Mitsuba's mirrored geometric and shading normals point to different sides",
        )


SHAPE_BUILDERS: dict[str, Callable[[SceneBuilder, Node, list[Step], bool], ShapeData]] = {
    "sphere": _sphere,
    "rectangle": _unit_shape("rectangle"),
    "disk": _unit_shape("disk"),
    "cube": _unit_shape("cube"),
    "cylinder": _cylinder,
    "obj": _mesh,
    "ply": _mesh,
}

"""Conversion of <shape>: one shape, or several for an instance."""

import numpy as np

from mitsuba_ref.importers.appearance import is_dark, material_of
from mitsuba_ref.importers.scene_builder import SceneBuilder, Step, composed_matrix, transform_steps
from mitsuba_ref.importers.xml_document import Node, resolve_reference
from mitsuba_ref.shapes import REFERENCES
from mitsuba_ref.shapes.xml_shape import ImportShape


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
    importers = shape_importers()
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


class ShapeElement:
    """A <shape> of the document, as importers of shapes read it (mitsuba_ref/shapes/xml_shape.py)."""

    def __init__(self, out: SceneBuilder, node: Node, steps: list[Step], instanced: bool) -> None:
        self.out, self.node, self.steps, self.instanced = out, node, steps, instanced

    @property
    def matrix(self) -> np.ndarray | None:
        return composed_matrix(self.steps)

    def number(self, name: str, default: float) -> float:
        return self.out.number(self.node, name, default)

    def vector(self, name: str, default: tuple[float, ...]) -> list[float]:
        return self.out.vector(self.node, name, default)

    def boolean(self, name: str) -> bool:
        return self.out.boolean(self.node, name)

    def text(self, name: str) -> str:
        return self.out.text(self.node, name)

    def required_text(self, name: str) -> str:
        if self.node.named(name) is None:
            self.out.error(self.node, f'{self.node.words()}: needs <string name="{name}" ...>')
        return self.text(name)

    def note(self, text: str) -> None:
        self.out.note(self.node, text)


def shape_importers() -> dict[str, ImportShape]:
    """Importers of all registered shapes, by the name of Mitsuba's plugin."""
    return {plugin: each for reference in REFERENCES.values() for plugin, each in reference.importers.items()}

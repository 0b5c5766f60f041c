"""What is made of a document: the data of a scene file of ours, errors, and what was left out."""

import math
from dataclasses import dataclass, field
from typing import Any

from mitsuba_ref.importers.expanding import Document
from mitsuba_ref.importers.places import Place, Remark
from mitsuba_ref.importers.xml_nodes import Node

Path = tuple[str | int, ...]


@dataclass
class Building:
    """The scene so far. Values are read through it, so that each is either used or told of."""

    document: Document
    data: dict[str, Any] = field(default_factory=lambda: {"light": [], "material": {}, "shape": []})
    places: dict[Path, Place] = field(default_factory=dict)  # where each element of the data is in the files
    left_out: list[Remark] = field(default_factory=list)
    used: set[int] = field(default_factory=set)  # id() of the nodes that were read
    materials: dict[int, str] = field(default_factory=dict)  # names by id() of their node
    open: set[int] = field(default_factory=set)  # id() of the bsdfs that are being made

    def error(self, node: Node, text: str) -> None:
        self.document.errors.append(Remark(node.place, text))

    def omit(self, node: Node, text: str) -> None:
        self.used.add(id(node))
        self.left_out.append(Remark(node.place, text))

    def remark(self, node: Node, text: str) -> None:
        """Tell of something about an element that is used all the same."""
        self.left_out.append(Remark(node.place, f"{text} ({node.words()})"))

    def omit_rest(self, node: Node) -> None:
        """Tell of all children of a node that were not read."""
        for child in node.children:
            if id(child) not in self.used:
                self.omit(child, f"{child.words()} of {node.words()}")

    def find(self, node: Node, name: str, *tags: str) -> Node | None:
        """The child of that name and one of those tags, marked as read."""
        child = node.named(name)
        if child is None:
            return None
        if child.tag not in tags:
            self.error(child, f"{node.words()}: {name} must be a <{tags[0]}>, got <{child.tag}>")
        self.used.add(id(child))
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
            self.error(
                child, f"{child.words()}: expected a whole number, got {child.attributes.get('value')}"
            )
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
        """Of x="1" y="2" z="3" or value="1 2 3"; value="1" is all three."""
        if "value" in node.attributes:
            found = self.numbers(node, "value", 3)
            return found * 3 if len(found) == 1 else found
        return [
            self.numbers(node, axis, 1)[0] if axis in node.attributes else start
            for axis, start in zip("xyz", default, strict=True)
        ]

    def numbers(self, node: Node, attribute: str, count: int) -> list[float]:
        """So many, or one; parted by spaces or commas. An error and zeros otherwise."""
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

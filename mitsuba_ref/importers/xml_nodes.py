"""XML text -> elements that know where they stand."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from caster.wording import SceneError
from mitsuba_ref.importers.places import Place, Remark, told

DEEPEST = 64  # elements in elements; Mitsuba's own need a handful


@dataclass
class Node:
    """An element. Attributes are texts."""

    tag: str
    attributes: dict[str, str]
    place: Place
    children: list["Node"] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.attributes.get("name", "")

    @property
    def kind(self) -> str:
        """The plugin, of an element that is one."""
        return self.attributes.get("type", "")

    @property
    def id(self) -> str:
        return self.attributes.get("id", "")

    def named(self, name: str) -> "Node | None":
        """The child of that name."""
        return next((child for child in self.children if child.name == name), None)

    def all(self, *tags: str) -> Iterator["Node"]:
        return (child for child in self.children if child.tag in tags)

    def words(self) -> str:
        """sensor thinlens "camera"; or float fov"""
        label = f' "{self.id}"' if self.id else ""
        return " ".join(filter(None, (self.tag, self.kind, self.name))) + label


def parse(text: str, file: str) -> Node:
    """The root element. Raises SceneError with line and column for what is not well-formed, and for a DTD."""
    parser = expat.ParserCreate()
    open_nodes: list[Node] = []
    roots: list[Node] = []

    def here() -> Place:
        return Place(file, parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)

    def begin(tag: str, attributes: dict[str, str]) -> None:
        if len(open_nodes) == DEEPEST:
            raise SceneError(
                told([Remark(here(), f"elements are nested deeper than {DEEPEST}")], {file: text})
            )
        node = Node(tag, attributes, here())
        (open_nodes[-1].children if open_nodes else roots).append(node)
        open_nodes.append(node)

    def refuse(*_: object) -> None:
        raise SceneError(
            told([Remark(here(), "a document type is no part of a scene: remove it")], {file: text})
        )

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda tag: open_nodes.pop()
    parser.StartDoctypeDeclHandler = refuse  # entities could name other files, or grow beyond all bounds
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        place = Place(file, error.lineno, error.offset + 1)
        says = expat.errors.messages[error.code]
        raise SceneError(told([Remark(place, f"not valid XML: {says}")], {file: text})) from None
    return roots[0]

"""Where something stands in the files that were read, and what there is to say about it."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from caster.description.errors import FileMissing, SceneError, suggestion
from caster.scene.text import Span, format_excerpt, read_text


class SourcePosition(NamedTuple):
    """The start of an element; line and column count from 1."""

    file: str  # as its user or its include named it
    line: int
    column: int


class ImportDiagnostic(NamedTuple):
    """A sentence about a place: an error, or what was left out."""

    position: SourcePosition
    text: str

    def line(self) -> str:
        """ "file:line:column: left out: ..." """
        return f"{self.position.file}:{self.position.line}:{self.position.column}: left out: {self.text}"


def format_diagnostics(errors: list[ImportDiagnostic], texts: dict[str, str]) -> str:
    """All of them, each with the line itself. texts: by file."""
    return "\n".join(
        format_excerpt(
            Span(position.line, position.column, 1), text, texts.get(position.file, ""), position.file
        )
        for position, text in dict.fromkeys(errors)
    )


# XML text -> elements that know where they stand.


MAX_ELEMENT_DEPTH = 64  # elements in elements; Mitsuba's own need a handful


@dataclass
class Node:
    """An element. Attributes are texts."""

    tag: str
    attributes: dict[str, str]
    position: SourcePosition
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

    def here() -> SourcePosition:
        return SourcePosition(file, parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)

    def begin(tag: str, attributes: dict[str, str]) -> None:
        if len(open_nodes) == MAX_ELEMENT_DEPTH:
            raise SceneError(
                format_diagnostics(
                    [ImportDiagnostic(here(), f"elements are nested deeper than {MAX_ELEMENT_DEPTH}")],
                    {file: text},
                )
            )
        node = Node(tag, attributes, here())
        (open_nodes[-1].children if open_nodes else roots).append(node)
        open_nodes.append(node)

    def refuse(*_: object) -> None:
        raise SceneError(
            format_diagnostics(
                [ImportDiagnostic(here(), "a document type is no part of a scene: remove it")], {file: text}
            )
        )

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda tag: open_nodes.pop()
    parser.StartDoctypeDeclHandler = refuse  # entities could name other files, or grow beyond all bounds
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        position = SourcePosition(file, error.lineno, error.offset + 1)
        says = expat.errors.messages[error.code]
        raise SceneError(
            format_diagnostics([ImportDiagnostic(position, f"not valid XML: {says}")], {file: text})
        ) from None
    return roots[0]


# A scene with its defaults filled in, its includes read and its references followed.


MAX_INCLUDE_DEPTH = 15  # includes in includes, as Mitsuba allows
MAX_INCLUDES = 1000  # includes of one scene


@dataclass
class XmlDocument:
    """All elements of a scene, and what was wrong on the way."""

    folder: Path
    nodes: list[Node] = field(default_factory=list)  # children of the root, those of includes in their place
    by_id: dict[str, Node] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)  # of each file
    errors: list[ImportDiagnostic] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    includes: int = 0


def load_document(path: str, given: Mapping[str, str]) -> XmlDocument:
    """Read a scene. given: parameters that go before the file's defaults.

    Raises FileMissing for the file itself, SceneError for XML that cannot be read; other errors are in the document.
    """
    document = XmlDocument(Path(path).parent, parameters=dict(given))
    _read(document, path, 0)
    _index(document, document.nodes)
    for name in given:
        if not any(f"${name}" in text or f'"{name}"' in text for text in document.texts.values()):
            position = SourcePosition(path, 1, 1)
            document.errors.append(
                ImportDiagnostic(position, f"no parameter ${name} in it, which -D {name} names")
            )
    return document


def _read(document: XmlDocument, path: str, depth: int) -> None:
    text = document.texts[path] = read_text(path)
    root = parse(text, path)
    if root.tag != "scene":
        document.errors.append(ImportDiagnostic(root.position, f"expected <scene>, got <{root.tag}>"))
    for node in root.children:
        if node.tag == "default":
            document.parameters.setdefault(node.name, node.attributes.get("value", ""))
            continue
        _substitute_parameters(document, node)
        if node.tag == "include":
            _include(document, node, depth)
        else:
            document.nodes.append(node)


def _include(document: XmlDocument, node: Node, depth: int) -> None:
    """Files are looked for beside the scene. One that leads out of its folder is refused."""
    name = node.attributes.get("filename", "")
    path = document.folder / name
    document.includes += 1
    if depth == MAX_INCLUDE_DEPTH or document.includes > MAX_INCLUDES:
        limits = f"nested deeper than {MAX_INCLUDE_DEPTH}, or more than {MAX_INCLUDES}"
        text = f"includes are {limits}: does a file include itself?"
        if all(error.text != text for error in document.errors):
            document.errors.append(ImportDiagnostic(node.position, text))
    elif not path.resolve().is_relative_to(document.folder.resolve()):
        document.errors.append(
            ImportDiagnostic(node.position, f"include must lie in the scene's folder or below it, got {name}")
        )
    else:
        try:
            _read(document, str(path), depth + 1)
        except FileMissing as error:
            document.errors.append(ImportDiagnostic(node.position, str(error)))


def _substitute_parameters(document: XmlDocument, node: Node) -> None:
    """Put the parameters into the attributes, of all that is inside, too."""
    for key, value in node.attributes.items():
        if "$" in value:
            node.attributes[key] = _substituted(document, node, value)
    for child in node.children:
        _substitute_parameters(document, child)


def _substituted(document: XmlDocument, node: Node, value: str) -> str:
    """The longest name that is known goes first: $widthscale is not $width and then scale."""
    for name in sorted(document.parameters, key=len, reverse=True):
        value = value.replace(f"${name}", document.parameters[name])
    if unknown := re.search(r"\$(\w+)", value):
        hint = suggestion(unknown[1], document.parameters) or f"; give it by -D {unknown[1]}=VALUE"
        document.errors.append(ImportDiagnostic(node.position, f"parameter ${unknown[1]} has no value{hint}"))
    return value


def _index(document: XmlDocument, nodes: list[Node]) -> None:
    for node in nodes:
        if node.tag in ("ref", "alias"):
            continue
        if node.id and node.id in document.by_id:
            document.errors.append(ImportDiagnostic(node.position, f'id "{node.id}" is there twice'))
        if node.id:
            document.by_id.setdefault(node.id, node)
        _index(document, node.children)
    for node in nodes:
        if node.tag == "alias" and node.id in document.by_id:
            document.by_id.setdefault(node.attributes.get("as", ""), document.by_id[node.id])


def resolve_reference(document: XmlDocument, node: Node) -> Node | None:
    """What a <ref> stands for; any other element itself. None, and an error, for a reference to nothing."""
    if node.tag != "ref":
        return node
    if node.id in document.by_id:
        return document.by_id[node.id]
    hint = suggestion(node.id, document.by_id)
    error = ImportDiagnostic(node.position, f'no element has the id "{node.id}"{hint}')
    if error not in document.errors:
        document.errors.append(error)
    return None

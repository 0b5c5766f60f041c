"""Mitsuba XML documents: elements with source positions, default parameters, includes and references."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from caster.description.errors import FileMissing, SceneError, suggestion
from caster.description.input_files import read_text
from caster.description.parsing import Span, format_excerpt, list_errors


class SourcePosition(NamedTuple):
    """The start of an element; line and column count from 1."""

    file: str  # as named by the user or the include
    line: int
    column: int


class ImportDiagnostic(NamedTuple):
    """An error or an omission of the import, and its position."""

    position: SourcePosition
    text: str

    def line(self) -> str:
        """The omission as "file:line:column: left out: ..."."""
        return f"{self.position.file}:{self.position.line}:{self.position.column}: left out: {self.text}"


def format_diagnostics(errors: list[ImportDiagnostic], texts: dict[str, str]) -> str:
    """All diagnostics, each with its source line. texts: contents by file."""

    def excerpt(error: ImportDiagnostic) -> str:
        at = error.position
        return format_excerpt(Span(at.line, at.column, 1), error.text, texts.get(at.file, ""), at.file)

    return list_errors([*dict.fromkeys(errors)], excerpt, next(iter(texts), "the document"))


# ---- elements ----

MAX_ELEMENT_DEPTH = 64  # nesting of elements; Mitsuba's scenes need a handful


@dataclass
class Node:
    """An element with its attributes and its position."""

    tag: str
    attributes: dict[str, str]
    position: SourcePosition
    children: list["Node"] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.attributes.get("name", "")

    @property
    def kind(self) -> str:
        """The plugin type of the element, if it is a plugin."""
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
        """The element in messages: `sensor thinlens "camera"`, `float fov`."""
        label = f' "{self.id}"' if self.id else ""
        return " ".join(filter(None, (self.tag, self.kind, self.name))) + label


def parse(text: str, file: str) -> Node:
    """Parse a text to its root element. Raises SceneError with line and column for malformed XML and for a DTD."""
    parser = expat.ParserCreate()
    open_nodes: list[Node] = []
    roots: list[Node] = []

    def here() -> SourcePosition:
        return SourcePosition(file, parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)

    def refusal(reason: str, position: SourcePosition) -> SceneError:
        return SceneError(format_diagnostics([ImportDiagnostic(position, reason)], {file: text}))

    def begin(tag: str, attributes: dict[str, str]) -> None:
        if len(open_nodes) == MAX_ELEMENT_DEPTH:
            raise refusal(f"elements are nested deeper than {MAX_ELEMENT_DEPTH}", here())
        node = Node(tag, attributes, here())
        (open_nodes[-1].children if open_nodes else roots).append(node)
        open_nodes.append(node)

    def refuse(*_: object) -> None:
        raise refusal("a document type is no part of a scene: remove it", here())

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda tag: open_nodes.pop()
    parser.StartDoctypeDeclHandler = refuse  # entities could read other files or expand exponentially
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        reason = f"not valid XML: {expat.errors.messages[error.code]}"
        raise refusal(reason, SourcePosition(file, error.lineno, error.offset + 1)) from None
    return roots[0]


# ---- defaults, includes, references ----

MAX_INCLUDE_DEPTH = 15  # nesting of includes, as in Mitsuba
MAX_INCLUDES = 1000  # per scene
MAX_SUBSTITUTIONS = 64  # per value
MAX_VALUE_CHARACTERS = 2**16  # of a value with substituted parameters


@dataclass
class XmlDocument:
    """All elements of a scene and its includes, and the errors so far."""

    folder: Path
    nodes: list[Node] = field(default_factory=list)  # children of the root; includes are replaced by their contents
    by_id: dict[str, Node] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)  # of each file
    errors: list[ImportDiagnostic] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    includes: int = 0


def load_document(path: str, given: Mapping[str, str]) -> XmlDocument:
    """Load a document with its includes. given: parameters that override the defaults of the file.

    Raises FileMissing for the file itself, SceneError for malformed XML; other errors are collected in the document.
    """
    document = XmlDocument(Path(path).parent, parameters=dict(given))
    _read(document, path, 0)
    _index(document, document.nodes)
    for name in given:
        if not any(f"${name}" in text or f'"{name}"' in text for text in document.texts.values()):
            position = SourcePosition(path, 1, 1)
            document.errors.append(ImportDiagnostic(position, f"no parameter ${name} in it, which -D {name} names"))
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
    """Load an include, whose file must lie in the folder of the scene or below."""
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
    """Substitute parameters in the attributes of an element and its descendants."""
    for key, value in node.attributes.items():
        if "$" in value:
            node.attributes[key] = _substituted(document, node, value)
    for child in node.children:
        _substitute_parameters(document, child)


def _substituted(document: XmlDocument, node: Node, value: str) -> str:
    """Substitute parameters in a value, longest name first: $widthscale is not $width followed by "scale"."""
    longest = max(map(len, document.parameters), default=0)
    for _ in range(MAX_SUBSTITUTIONS):
        starts = [found.end() for found in re.finditer(r"\$", value[:MAX_VALUE_CHARACTERS])]
        names = (value[at : at + n] for at in starts for n in range(min(longest, len(value) - at), 0, -1))
        name = max((name for name in names if name in document.parameters), key=len, default=None)
        if name is None or len(value) > MAX_VALUE_CHARACTERS:
            break
        value = value.replace(f"${name}", document.parameters[name])
    else:
        document.errors.append(ImportDiagnostic(node.position, "parameters refer to each other without end"))
        return ""
    if unknown := re.search(r"\$(\w+)", value):
        hint = suggestion(unknown[1], document.parameters) or f"; give it by -D {unknown[1]}=VALUE"
        document.errors.append(ImportDiagnostic(node.position, f"parameter ${unknown[1]} has no value{hint}"))
    return value


def _index(document: XmlDocument, nodes: list[Node]) -> None:
    for node in nodes:
        if node.tag in ("ref", "alias"):
            continue
        if node.id and node.id in document.by_id:
            document.errors.append(ImportDiagnostic(node.position, f'id "{node.id}" occurs twice'))
        if node.id:
            document.by_id.setdefault(node.id, node)
        _index(document, node.children)
    for node in nodes:
        if node.tag == "alias" and node.id in document.by_id:
            document.by_id.setdefault(node.attributes.get("as", ""), document.by_id[node.id])


def resolve_reference(document: XmlDocument, node: Node) -> Node | None:
    """The element that a <ref> refers to, or the element itself; None, with an error, for an unknown id."""
    if node.tag != "ref":
        return node
    if node.id in document.by_id:
        return document.by_id[node.id]
    hint = suggestion(node.id, document.by_id)
    document.errors.append(ImportDiagnostic(node.position, f'no element has the id "{node.id}"{hint}'))
    return None

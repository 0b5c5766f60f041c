"""A scene with its defaults filled in, its includes read and its references followed."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from caster.scene_text import text_of
from caster.wording import FileMissing, suggestion
from mitsuba_ref.importers.places import Place, Remark
from mitsuba_ref.importers.xml_nodes import Node, parse

DEEPEST = 15  # includes in includes, as Mitsuba allows
MOST = 1000  # includes of one scene


@dataclass
class Document:
    """All elements of a scene, and what was wrong on the way."""

    folder: Path
    nodes: list[Node] = field(default_factory=list)  # children of the root, those of includes in their place
    by_id: dict[str, Node] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)  # of each file
    errors: list[Remark] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    includes: int = 0


def expand(path: str, given: Mapping[str, str]) -> Document:
    """Read a scene. given: parameters that go before the file's defaults.

    Raises FileMissing for the file itself, SceneError for XML that cannot be read; other errors are in the document.
    """
    document = Document(Path(path).parent, parameters=dict(given))
    _read(document, path, 0)
    _index(document, document.nodes)
    for name in given:
        if not any(f"${name}" in text or f'"{name}"' in text for text in document.texts.values()):
            place = Place(path, 1, 1)
            document.errors.append(Remark(place, f"no parameter ${name} in it, which -D {name} names"))
    return document


def _read(document: Document, path: str, depth: int) -> None:
    text = document.texts[path] = text_of(path)
    root = parse(text, path)
    if root.tag != "scene":
        document.errors.append(Remark(root.place, f"expected <scene>, got <{root.tag}>"))
    for node in root.children:
        if node.tag == "default":
            document.parameters.setdefault(node.name, node.attributes.get("value", ""))
            continue
        _fill(document, node)
        if node.tag == "include":
            _include(document, node, depth)
        else:
            document.nodes.append(node)


def _include(document: Document, node: Node, depth: int) -> None:
    """Files are looked for beside the scene. One that leads out of its folder is refused."""
    name = node.attributes.get("filename", "")
    path = document.folder / name
    document.includes += 1
    if depth == DEEPEST or document.includes > MOST:
        text = f"includes are nested deeper than {DEEPEST}, or more than {MOST}: does a file include itself?"
        if all(error.text != text for error in document.errors):
            document.errors.append(Remark(node.place, text))
    elif not path.resolve().is_relative_to(document.folder.resolve()):
        document.errors.append(
            Remark(node.place, f"include must lie in the scene's folder or below it, got {name}")
        )
    else:
        try:
            _read(document, str(path), depth + 1)
        except FileMissing as error:
            document.errors.append(Remark(node.place, str(error)))


def _fill(document: Document, node: Node) -> None:
    """Put the parameters into the attributes, of all that is inside, too."""
    for key, value in node.attributes.items():
        if "$" in value:
            node.attributes[key] = _filled(document, node, value)
    for child in node.children:
        _fill(document, child)


def _filled(document: Document, node: Node, value: str) -> str:
    """The longest name that is known goes first: $widthscale is not $width and then scale."""
    for name in sorted(document.parameters, key=len, reverse=True):
        value = value.replace(f"${name}", document.parameters[name])
    if unknown := re.search(r"\$(\w+)", value):
        hint = suggestion(unknown[1], document.parameters) or f"; give it by -D {unknown[1]}=VALUE"
        document.errors.append(Remark(node.place, f"parameter ${unknown[1]} has no value{hint}"))
    return value


def _index(document: Document, nodes: list[Node]) -> None:
    for node in nodes:
        if node.tag in ("ref", "alias"):
            continue
        if node.id and node.id in document.by_id:
            document.errors.append(Remark(node.place, f'id "{node.id}" is there twice'))
        if node.id:
            document.by_id.setdefault(node.id, node)
        _index(document, node.children)
    for node in nodes:
        if node.tag == "alias" and node.id in document.by_id:
            document.by_id.setdefault(node.attributes.get("as", ""), document.by_id[node.id])


def followed(document: Document, node: Node) -> Node | None:
    """What a <ref> stands for; any other element itself. None, and an error, for a reference to nothing."""
    if node.tag != "ref":
        return node
    if node.id in document.by_id:
        return document.by_id[node.id]
    hint = suggestion(node.id, document.by_id)
    error = Remark(node.place, f'no element has the id "{node.id}"{hint}')
    if error not in document.errors:
        document.errors.append(error)
    return None

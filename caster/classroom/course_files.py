"""Reader of 6.837 scene files: text to blocks to a scene, with every error and its line."""

from collections.abc import Iterable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from pydantic import ValidationError

from caster.classroom.grammar import (
    BLOCK_RULES,
    CAMERAS,
    FILE_START,
    SECTIONS,
    TEXTURES,
    BlockRule,
    Field,
    Node,
    SourceMessage,
    Token,
    ValueFormat,
    tokens_of,
)
from caster.classroom.scene_conversion import Falloff, SceneBuilder, build_scene_data
from caster.description.errors import Diagnostic, FileMissing, SceneError, diagnostics_of, join_words, suggestion
from caster.description.parsing import format_excerpt, list_errors, read_text
from caster.scene.files import MeshFolders, resolve_mesh_files
from caster.scene.model import Scene

__all__ = ["load_course_scene"]


MAX_NESTING = 64  # of blocks; each level takes a few frames of Python's stack


class Parser:
    """A recursive-descent parser that recovers from errors and collects all of them in `errors`."""

    def __init__(self, text: str) -> None:
        self.tokens = tokens_of(text)
        self.position = self.depth = 0
        self.errors: list[SourceMessage] = []

    def sections(self) -> dict[str, Node]:
        """The top-level blocks by name; either camera is "Camera"."""
        found: dict[str, Node] = {}
        while (token := self._next()) is not None:
            if token.text not in SECTIONS:
                self._unknown(token, "the file", SECTIONS)
                continue
            name = "Camera" if token.text in CAMERAS else token.text
            node = self._block(token)
            if name in found:
                self._error(token, f"{token.text} occurs twice; the first is in line {found[name].at.line}")
            found.setdefault(name, node)
        for name, required in (("Camera", join_words(CAMERAS)), ("Group", "Group, which holds the objects")):
            if name not in found:
                self._error(FILE_START, f"the scene needs a block {required}")
        return found

    def _block(self, at: Token) -> Node:
        node, block = Node(at.text, at), BLOCK_RULES[at.text]
        if self.depth == MAX_NESTING:
            self._error(at, f"{node.kind}: blocks are nested deeper than {MAX_NESTING}")
            self._skip_braces()
            return node
        if not self._expect_open_brace(at):
            return node
        self.depth += 1
        while (token := self._next()) is not None and token.text != "}":
            if token.text in block.fields:
                node.mentioned.add(token.text)
                found = self._field(token, block.fields[token.text], node)
                node.items += [] if found is None else [found]
            elif token.text in TEXTURES and token.text in block.children:
                node.items.append(Node(token.text, token))
                self._skip_braces()
            elif token.text in block.children:
                node.items.append(self._block(token))
            else:
                node.unknown += self._unknown(token, node.kind, (*block.fields, *block.children))
        self.depth -= 1
        if token is None:
            self._error(at, f"{node.kind}: its '}}' is missing")
        self._check(node, block)
        return node

    def _field(self, at: Token, form: ValueFormat, node: Node) -> Field | None:
        where = f"{node.kind}: {at.text}"
        if not form.numbers:
            word = self._peek()
            if word is None or word.text in "{}":
                self._error(word or at, f"{where} must be a word, got {_token_text(word)}")
                return None
            return Field(at.text, at, (), self._next())
        if form.braced and not self._expect_open_brace(at):
            return None
        numbers = self._numbers(at, form, where)
        if form.braced:
            self._expect_close_brace(at, where)
        return None if numbers is None else Field(at.text, at, numbers, None)

    def _numbers(self, at: Token, form: ValueFormat, where: str) -> tuple[float, ...] | None:
        numbers: list[float] = []
        while len(numbers) < form.numbers:
            token = self._peek()
            value = None if token is None else token.number
            if token is None or value is None:
                self._error(token or at, f"{where} must be {form.text}, got {_token_text(token)} after {len(numbers)}")
                if token is not None and token.text not in "{}" and token.text not in KEYWORDS:
                    self._next()  # a misspelt number: continue after it and the rest
                    self._skip_numbers()
                return None
            numbers.append(value)
            self._next()
        extra = self._peek()
        if extra is not None and extra.number is not None:
            self._error(extra, f"{where} must be {form.text}, got {extra.text} as well")
            self._skip_numbers()
        return tuple(numbers)

    def _check(self, node: Node, block: BlockRule) -> None:
        """Report missing and repeated fields, and a wrong number of children."""
        names = [item.name for item in node.items if isinstance(item, Field)]
        for name in block.fields:
            if name not in block.optional and name not in node.mentioned:
                self._error(node.at, f"{node.kind} needs '{name}'")
            if names.count(name) > 1 and name not in block.repeated:
                again = [item for item in node.items if isinstance(item, Field) and item.name == name][1]
                self._error(again.at, f"{node.kind}: {name} occurs twice")
        counted = node.get(block.counted_by) if block.counted_by else None
        found = len(node.children) + node.unknown
        if counted is not None and counted.numbers != (found,):
            self._error(counted.at, f"{node.kind}: {counted.words}, but it contains {found}")
        if node.kind == "Transform" and found != 1:
            self._error(node.at, f"Transform needs one object, got {found}")

    def _unknown(self, token: Token, where: str, known: Iterable[str]) -> bool:
        """Report an unknown token and skip it; True if it was a block."""
        known = list(known)
        if token.text == "}":
            self._error(token, "a '}' too many: no block is open")
        elif token.text == "{":
            self._error(token, f"{where}: expected {join_words(known)}, got '{{'")
            self.position -= 1
            self._skip_braces()
        elif token.number is not None:
            self._error(token, f"{where}: expected {join_words(known)}, got the number {token.text}")
            self._skip_numbers()
        else:
            hint = suggestion(token.text, known) or f" (known: {', '.join(known)})"
            self._error(token, f"{where}: unknown word {token.text}{hint}")
            if self._next_is("{"):
                self._skip_braces()
                return True
            self._skip_numbers()
        return False

    def _expect_open_brace(self, at: Token) -> bool:
        if self._next_is("{"):
            self._next()
            return True
        self._error(self._peek() or at, f"{at.text} must be followed by '{{', got {_token_text(self._peek())}")
        return False

    def _expect_close_brace(self, at: Token, where: str) -> None:
        if self._next_is("}"):
            self._next()
        else:
            self._error(self._peek() or at, f"{where}: expected '}}', got {_token_text(self._peek())}")

    def _skip_numbers(self) -> None:
        while (token := self._peek()) is not None and token.number is not None:
            self.position += 1

    def _skip_braces(self) -> None:
        """Skip a block in braces with its contents."""
        depth = 0
        while (token := self._next()) is not None:
            depth += {"{": 1, "}": -1}.get(token.text, 0)
            if depth <= 0:
                return

    def _next_is(self, text: str) -> bool:
        token = self._peek()
        return token is not None and token.text == text

    def _peek(self) -> Token | None:
        return self.tokens[self.position] if self.position < len(self.tokens) else None

    def _next(self) -> Token | None:
        token = self._peek()
        self.position += token is not None
        return token

    def _error(self, at: Token, text: str) -> None:
        self.errors.append(SourceMessage(at, text))


KEYWORDS = frozenset(BLOCK_RULES) | frozenset(name for block in BLOCK_RULES.values() for name in block.fields)


def _token_text(token: Token | None) -> str:
    return "the end of the file" if token is None else f"'{token.text}'"


@dataclass(frozen=True)
class CourseScene:
    """A scene, and the data of the course's images that a Scene has no fields for."""

    scene: Scene  # lights: those of `colors` in the same order, then the ambient one
    background: tuple[float, ...]  # behind everything, r g b
    colors: tuple[tuple[float, ...], ...]  # of the lights, r g b
    falloffs: tuple[Falloff | None, ...]  # None: directional
    left_out: tuple[str, ...]  # "file:line:column: left out: ...", in the order of the file


def load_course_scene(
    path: str | PathLike[str],
    width: int,
    height: int,
    *,
    shade_back: bool = False,
    shadows: bool = False,
    mesh_dirs: Iterable[str | PathLike[str]] = (),
) -> CourseScene:
    """Load a scene file of the course and its meshes, which are looked up as in scene files of this project.

    width, height: of the film, in pixels. shade_back: surfaces are lit from behind as well. shadows: cast shadows.
    Raises FileMissing for a file that cannot be read, SceneError with every error and its line for the rest.
    """
    text = read_text(path)
    parser = Parser(text)
    builder = build_scene_data(parser.sections(), width, height)
    for material in builder.data["material"].values():
        material["two_sided"] = shade_back
    builder.data["shading"]["shadows"] = shadows
    folders = MeshFolders(Path(path).parent, tuple(Path(folder) for folder in mesh_dirs))
    scene, errors, missing = _scene_of(builder, folders, whole=not parser.errors)
    if bad := [*parser.errors, *builder.errors, *errors, *missing]:
        kind_of_error = FileMissing if len(missing) == len(bad) else SceneError
        raise kind_of_error(_format_errors(bad, text, str(path)))
    assert scene is not None  # or there would be faults
    left_out = tuple(f"{path}:{at.line}:{at.column}: left out: {what}" for at, what in _by_position(builder.left_out))
    return CourseScene(scene, builder.background, tuple(builder.colors), tuple(builder.falloffs), left_out)


def _scene_of(
    builder: SceneBuilder, folders: MeshFolders, whole: bool
) -> tuple[Scene | None, list[SourceMessage], list[SourceMessage]]:
    """(the scene, faults of it, meshes that are missing). whole: False if required fields are missing already."""
    data, unusable, missing = resolve_mesh_files(builder.data, folders, Scene)
    scene, problems = None, unusable
    try:
        scene = Scene.model_validate(data)
        scene._folder = folders.folder.resolve()
    except ValidationError as error:
        found = diagnostics_of(error, data, Scene)
        problems = problems + [problem for problem in found if whole or "needs the key" not in problem.text]
    return (
        scene,
        [_with_source(builder, each) for each in problems],
        [_with_source(builder, each) for each in missing],
    )


def _with_source(builder: SceneBuilder, problem: Diagnostic) -> SourceMessage:
    path = problem.path
    while path and path not in builder.sources:
        path = path[:-1]
    return SourceMessage(builder.sources.get(path, FILE_START), problem.text)


def _by_position(errors: Iterable[SourceMessage]) -> list[SourceMessage]:
    return sorted(errors, key=lambda fault: (fault.at.line, fault.at.column))


def _format_errors(errors: Iterable[SourceMessage], text: str, origin: str) -> str:
    ordered = _by_position(dict.fromkeys(errors))
    return list_errors(ordered, lambda error: format_excerpt(error.at.span, error.text, text, origin), origin)

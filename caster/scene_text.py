"""The text of scene files: into plain data, and errors back to the line they are in."""

import json
import re
import tomllib
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from caster.locate import Positions, Span
from caster.problems import Problem
from caster.wording import FileMissing, SceneError

Kind = Literal["toml", "json"]
LINE_SHOWN = 100  # characters of a line that are shown around the place of an error


def text_of(path: str | PathLike[str]) -> str:
    """The text of a scene file of any kind. Raises FileMissing, or SceneError for bytes that are no UTF-8."""
    try:
        return Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: not a text in UTF-8: byte {error.start + 1} is none of it") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileMissing(f"{path}: cannot read this scene file: {reason}") from None


def parse(text: str, kind: Kind, origin: str) -> tuple[Any, list[Problem]]:
    """The data of a TOML or JSON text, and problems that JSON itself does not see. Raises SceneError."""
    try:
        return (tomllib.loads(text), []) if kind == "toml" else _parse_json(text)
    except RecursionError:
        raise SceneError(f"{origin}: not a scene: lists or tables are nested too deeply to be read") from None
    except ValueError as error:
        raise SceneError(_syntax_error(error, text, kind, origin)) from None


def report(problems: Sequence[Problem], text: str, kind: Kind, origin: str) -> str:
    """All problems in the order of their lines, each with the line itself."""
    positions = Positions(text, kind)
    located = sorted(((positions.of(path), said) for path, said in problems), key=lambda found: found[0][:2])
    return "\n".join(shown(span, said, text, origin) for span, said in located)


def _parse_json(text: str) -> tuple[Any, list[Problem]]:
    repeats = 0

    def table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        nonlocal repeats
        repeats += len(pairs) - len(dict(pairs))
        return dict(pairs)

    data = json.loads(text, object_pairs_hook=table)
    repeated = Positions(text, "json").repeated if repeats else []
    if isinstance(data, dict):
        data.pop("$schema", None)  # for editors
    return data, [Problem(path, f"the key '{path[-1]}' is there twice") for path in repeated]


def _syntax_error(error: ValueError, text: str, kind: Kind, origin: str) -> str:
    line, column, message = _place_of(error, text)
    span = Span(line, column, 1)
    rest = text.split("\n")[line - 1][column - 1 :]
    way_out = ": a number needs a digit before its point" if re.match(r"[+-]?\.\d", rest) else ""
    return shown(span, f"not valid {kind.upper()}: {message[0].lower()}{message[1:]}{way_out}", text, origin)


def _place_of(error: ValueError, text: str) -> tuple[int, int, str]:
    if isinstance(error, json.JSONDecodeError):
        return error.lineno, error.colno, error.msg
    found = re.fullmatch(r"(.*) \(at (?:line (\d+), column (\d+)|end of document)\)", str(error), re.DOTALL)
    if found and found[2]:
        return int(found[2]), int(found[3]), found[1]
    lines = text.rstrip().split("\n")
    return len(lines), len(lines[-1]) + 1, found[1] if found else str(error)


def shown(span: Span, sentence: str, text: str, origin: str) -> str:
    """file:line:column: the sentence, below it the line itself, and marks below the place."""
    lines = text.split("\n")
    line = lines[span.line - 1].rstrip("\r") if span.line <= len(lines) else ""
    start = max(0, span.column - 1 - LINE_SHOWN // 2) if len(line) > LINE_SHOWN else 0
    part = line[start : start + LINE_SHOWN]
    before = re.sub(r"[^\t]", " ", line[start : span.column - 1])  # tabs stay, so that the marks stand below
    marks = "^" * min(span.length, max(len(part) - len(before), 1))
    number = f"{span.line:3}"
    head = f"{origin}:{span.line}:{span.column}: {sentence}"
    return f"{head}\n{number} | {part}\n{' ' * len(number)} | {before}{marks}"

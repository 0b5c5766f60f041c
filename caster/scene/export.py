"""Scenes as text: TOML, canonical JSON and fingerprints."""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from caster.description.input_files import opened_input

__all__ = ["format_toml", "to_toml"]

BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def format_toml(data: Mapping[str, Any]) -> str:
    """TOML of the tables of a scene; floats round-trip exactly."""
    lines = []
    for header, values in _tables(data):
        lines += [header, *(f"{_key(key)} = {_value(value)}" for key, value in values.items()), ""]
    return "\n".join(lines)


def _tables(data: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """(header, keys with their values) of each table."""
    for name in SECTION_ORDER:
        value = data.get(name, ())
        if not isinstance(value, Mapping):
            yield from ((f"[[{name}]]", part) for part in value)
        elif value and all(isinstance(part, Mapping) for part in value.values()):
            yield from ((f"[{name}.{_key(key)}]", part) for key, part in value.items())
        else:
            yield f"[{name}]", value


def _key(key: str) -> str:
    return key if BARE_KEY.fullmatch(key) else _string(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value, value)) + "]"
    return repr(value)  # of a float: the shortest digits that round-trip


def _string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


SECTION_ORDER = ("film", "camera", "shading", "light", "material", "shape", "check")


def canonical_json(scene: BaseModel, folder: Path | None) -> str:
    """The whole scene on one line with sorted keys. Paths of files in `folder` are relative to it."""
    return _sorted_json(_named_from(folder, scene.model_dump(by_alias=True, exclude_none=True)))


def fingerprint(scene: BaseModel) -> str:
    """SHA-256 of the canonical JSON, with each mesh or picture file replaced by the SHA-256 of its bytes."""
    data = scene.model_dump(by_alias=True, exclude_none=True)
    for element in _with_files(data):
        with opened_input(element["file"], "mesh file") as stream:
            element["file"] = "sha256:" + hashlib.file_digest(stream, "sha256").hexdigest()
    return hashlib.sha256(_sorted_json(data).encode()).hexdigest()


def to_toml(scene: BaseModel, folder: Path | None) -> str:
    """The scene as TOML without default values. Paths of files in `folder` are relative to it."""
    data = scene.model_dump(by_alias=True, exclude_none=True, exclude_defaults=True)
    return format_toml(_named_from(folder, data))


def _named_from(folder: Path | None, data: dict[str, Any]) -> dict[str, Any]:
    for element in _with_files(data):
        if folder is not None and Path(element["file"]).is_relative_to(folder):
            element["file"] = Path(element["file"]).relative_to(folder).as_posix()
    return data


def _with_files(data: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The shapes and textures that name a file."""
    textures = (material.get("reflectance") for material in data.get("material", {}).values())
    for element in (*data.get("shape", ()), *textures):
        if isinstance(element, dict) and "file" in element:
            yield element


def _sorted_json(data: Any) -> str:
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)

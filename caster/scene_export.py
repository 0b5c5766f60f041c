"""A scene as data and as text: JSON for machines and fingerprints, TOML for people."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from caster.toml_text import toml_of
from caster.wording import FileMissing

ORDER = ("film", "camera", "shading", "light", "material", "shape", "check")


def canonical_json(scene: BaseModel, folder: Path | None) -> str:
    """All of the scene, keys sorted, on one line. Files in `folder` are named relative to it."""
    return _sorted_json(_named_from(folder, scene.model_dump(by_alias=True, exclude_none=True)))


def fingerprint(scene: BaseModel) -> str:
    """SHA-256 of the canonical JSON, with each mesh file replaced by the SHA-256 of its bytes."""
    data = scene.model_dump(by_alias=True, exclude_none=True)
    for shape in data["shape"]:
        if "file" in shape:
            shape["file"] = _sha256_of(shape["file"])
    return hashlib.sha256(_sorted_json(data).encode()).hexdigest()


def to_toml(scene: BaseModel, folder: Path | None) -> str:
    """The scene as TOML, without what is default anyway. Files in `folder` are named relative to it."""
    data = scene.model_dump(by_alias=True, exclude_none=True)
    brief = scene.model_dump(by_alias=True, exclude_none=True, exclude_defaults=True)
    for key in {"camera", "light", "shape"} & brief.keys():
        for element, short in zip(_listed(data[key]), _listed(brief[key]), strict=True):
            short["type"] = element["type"]
    return toml_of(_named_from(folder, brief), ORDER)


def _listed(value: Any) -> Sequence[Any]:
    return value if isinstance(value, (list, tuple)) else [value]


def _named_from(folder: Path | None, data: dict[str, Any]) -> dict[str, Any]:
    for shape in data.get("shape", ()):
        if folder is not None and "file" in shape and Path(shape["file"]).is_relative_to(folder):
            shape["file"] = Path(shape["file"]).relative_to(folder).as_posix()
    return data


def _sorted_json(data: Any) -> str:
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _sha256_of(file: str) -> str:
    try:
        with open(file, "rb") as stream:
            return "sha256:" + hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise FileMissing(f"{file}: cannot read this mesh file: {error.strerror or error}") from error

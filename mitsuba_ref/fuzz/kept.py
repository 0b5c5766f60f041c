"""Failing scenes on disk: scene files like any other, with a line of comment that says what fails and for which ray.

A camera of type "ray" casts the very ray, so that `caster probe` and `mitsuba-ref validate` show it; what it cannot
say, a t_min, is in the comment alone.
"""

import json
import math
import shutil
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from caster.scene_export import ORDER
from caster.scene_files import load_scene
from caster.toml_text import toml_of
from caster.whole_files import check_folder, write_text
from caster.wording import FileMissing, SceneError
from mitsuba_ref.fuzz.case import Case, one_ray
from mitsuba_ref.fuzz.finding import KINDS
from mitsuba_ref.reproducer import to_the_bit

MARK = "# fuzz: "
RAY_FIELDS = ("o", "d", "t_min", "t_max")


@dataclass(frozen=True)
class Kept:
    """What a file says."""

    kind: str
    case: Case
    found_by: str  # the options that made the scene it was shrunk from


def write(folder: Path, name: str, kind: str, what: str, found_by: str, case: Case) -> Path:
    """Write the case and the meshes it needs; the file. Raises OutputError."""
    check_folder(folder)
    data = case.scene_data()
    data["shape"] = [_with_its_mesh(shape, folder) for shape in data["shape"]]
    record: dict[str, Any] = {"kind": kind, "found_by": found_by}
    if case.ray is not None:
        record["ray"] = _ray_record(case)
    head = [
        f"# Found by mitsuba-ref fuzz {found_by}: {KINDS[kind]}.",
        f"# {what}".replace("\n", " "),
        f"# Again: mitsuba-ref fuzz --replay {name}.toml",
        MARK + json.dumps(record),
    ]
    path = folder / f"{name}.toml"
    write_text(path, "\n".join([*head, "", toml_of(to_the_bit(data), ORDER)]))
    return path


def _with_its_mesh(shape: dict[str, Any], folder: Path) -> dict[str, Any]:
    if "file" not in shape:
        return shape
    source = Path(shape["file"])
    if source.resolve() != (folder / source.name).resolve():
        shutil.copyfile(source, folder / source.name)
    return {**shape, "file": source.name}


def _ray_record(case: Case) -> dict[str, Any]:
    data = case.to_data()["ray"]
    return {key: to_the_bit(data[key]) for key in RAY_FIELDS}


def read(path: Path) -> Kept:
    """Raises FileMissing, and SceneError with what is wrong for a file that is damaged."""
    scene = load_scene(path)
    text = path.read_text(encoding="utf-8-sig")
    record = _record(path, text)
    data = tomllib.loads(text)
    for shape, loaded in zip(data["shape"], scene.shapes, strict=True):
        if "file" in shape:
            shape["file"] = getattr(loaded, "file", shape["file"])
    ray = one_ray(**record["ray"]) if "ray" in record else None
    case = Case(data["film"], numbers(data["camera"]), numbers(data["shape"]), ray)
    return Kept(record["kind"], case, record["found_by"])


def _record(path: Path, text: str) -> dict[str, Any]:
    """The comment's content, checked."""
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.startswith(MARK)]
    if len(lines) != 1:
        raise SceneError(
            f"{path}: expected one line that begins with '{MARK.strip()}', found {len(lines)}: "
            "not a file that fuzz has kept, or a damaged one; plain scenes are for `mitsuba-ref validate`"
        )
    ((number, line),) = lines
    try:
        return checked(json.loads(line.removeprefix(MARK)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SceneError(
            f"{path}:{number}: damaged: expected '{MARK}' and JSON with kind, found_by and ray "
            f"(o, d, t_min, t_max), got {line[:80]!r} ({type(error).__name__}: {error})"
        ) from None


def checked(record: dict[str, Any]) -> dict[str, Any]:
    """The record with floats for hex floats. Raises ValueError, KeyError or TypeError where something is amiss."""
    if record["kind"] not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {record['kind']!r}")
    out: dict[str, Any] = {"kind": record["kind"], "found_by": str(record["found_by"])}
    if "ray" in record:
        given = record["ray"]
        o, d = ([float.fromhex(x) for x in given[key]] for key in ("o", "d"))
        t_min, t_max = (float.fromhex(given[key]) for key in ("t_min", "t_max"))
        if not (len(o) == len(d) == 3 and all(map(math.isfinite, (*o, *d, t_min))) and any(d)):
            raise ValueError("o and d must be three finite numbers each, d not zero, and t_min finite")
        out["ray"] = {"o": o, "d": d, "t_min": t_min, "t_max": t_max}
    return out


def numbers(value: Any) -> Any:
    """Hex floats as floats, in whatever holds them; other text stays."""
    if isinstance(value, dict):
        return {key: numbers(each) for key, each in value.items()}
    if isinstance(value, list):
        return [numbers(each) for each in value]
    if isinstance(value, str) and value.lstrip("+-").lower().startswith("0x"):
        return float.fromhex(value)
    return value


def files_in(place: str) -> list[Path]:
    """Kept files: one, or all of a folder. Raises FileMissing."""
    path = Path(place)
    if path.is_dir():
        return sorted(path.glob("*.toml"))
    if not path.is_file():
        raise FileMissing(
            f"{place}: expected a scene file that fuzz has kept, or a folder of them, found nothing"
        )
    return [path]

"""Cases: a scene as plain data, with one ray or its camera's image; and their files.

Kept cases are scene files with a comment line that gives the kind of the finding and, of a single ray, its limits. A
camera of type "ray" casts that ray, so that `caster probe` and `mitsuba-ref validate` show it.
"""

import copy
import re
import shlex
import shutil
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import FileMissing, SceneError
from caster.scene.export import SECTION_ORDER, format_toml
from caster.scene.files import load_scene
from caster.system.atomic_files import check_folder, write_text
from mitsuba_ref.fuzz.findings import FINDING_KINDS, Finding
from mitsuba_ref.hard.rays import RayBatch

Case = dict[str, Any]  # a scene as a scene file gives it, and under "ray" a single ray: o, d, t_min, t_max


def case_of(data: dict[str, Any], ray: RayBatch | None = None) -> Case:
    """A case of its own, of the scene's image or of one ray."""
    case = copy.deepcopy({key: value for key, value in data.items() if key != "ray"})
    if ray is not None:
        case["ray"] = {name: values[0].tolist() for name, values in ray._asdict().items()}
    return case


def ray_of(case: Case) -> RayBatch | None:
    """The single ray; None where a case has the rays of its camera."""
    return RayBatch(**{name: np.array([value]) for name, value in case["ray"].items()}) if "ray" in case else None


def scene_data(case: Case) -> dict[str, Any]:
    """The scene; a single ray becomes its camera, without its t_min."""
    data = {key: value for key, value in case.items() if key != "ray"}
    if "ray" in case:
        ray = case["ray"]
        camera = {"type": "ray", "origin": ray["o"], "direction": ray["d"]}
        data |= {"film": {"width": 1, "height": 1}, "camera": camera}
        if 0.0 < ray["t_max"] < np.inf:
            camera["t_max"] = ray["t_max"]
    return data


RECORD = re.compile(r"^# fuzz: (\w+)(?: t_min=(\S+) t_max=(\S+))?$", re.MULTILINE)


class KeptCase(NamedTuple):
    """A kept case as read from its file."""

    kind: str
    case: Case


def write_kept(
    folder: Path, name: str, finding: Finding, found_by: str, case: Case, options: Sequence[str] = ()
) -> Path:
    """Write the case and the meshes it needs; returns the file. Raises OutputError.

    found_by: options that make the scene it was shrunk from; options: those that name a candidate.
    """
    check_folder(folder)
    data = scene_data(case)
    data["shape"] = [_with_copied_mesh(shape, folder) for shape in data["shape"]]
    limits = [f"{key}={case['ray'][key]!r}" for key in ("t_min", "t_max") if "ray" in case]
    head = [
        f"# Found by mitsuba-ref fuzz {found_by}: {FINDING_KINDS[finding.kind]}.",
        f"# {finding.what}".replace("\n", " "),
        f"# Again: {shlex.join(['mitsuba-ref', 'fuzz', '--replay', f'{name}.toml', *options])}",
        " ".join(["# fuzz:", finding.kind, *limits]),
    ]
    path = folder / f"{name}.toml"
    write_text(path, "\n".join([*head, "", format_toml(data, SECTION_ORDER)]))
    return path


def _with_copied_mesh(shape: dict[str, Any], folder: Path) -> dict[str, Any]:
    if "file" not in shape:
        return shape
    source = Path(shape["file"])
    if source.resolve() != (folder / source.name).resolve():
        shutil.copyfile(source, folder / source.name)
    return {**shape, "file": source.name}


def read_kept(path: Path) -> KeptCase:
    """Raises FileMissing, and SceneError with what is wrong for a file that is damaged."""
    scene, text = load_scene(path), path.read_text(encoding="utf-8-sig")
    kind, *limits = _record(path, text)
    data = tomllib.loads(text)
    for shape, loaded in zip(data["shape"], scene.shapes, strict=True):
        if "file" in shape:
            shape["file"] = getattr(loaded, "file", shape["file"])
    camera = data["camera"]
    if limits and "origin" in camera:
        ray = zip(("o", "d", "t_min", "t_max"), (camera["origin"], camera["direction"], *limits), strict=True)
        data["ray"] = dict(ray)
    return KeptCase(kind, data)


def _record(path: Path, text: str) -> tuple[Any, ...]:
    """(kind,), of a ray (kind, t_min, t_max), from the comment. Raises SceneError."""
    found = RECORD.findall(text)
    try:
        ((kind, *limits),) = found
        t_min, t_max = (float(limit or "inf") for limit in limits)
        if kind in FINDING_KINDS and 0.0 <= t_min <= t_max:
            return (kind, t_min, t_max) if limits[0] else (kind,)
    except ValueError:
        pass
    raise SceneError(
        f"{path}: expected one comment line '# fuzz: KIND', of a ray with ' t_min=NUMBER t_max=NUMBER', "
        f"got {len(found)} such lines: not a file that fuzz has kept, or a damaged one "
        f"(kinds: {', '.join(FINDING_KINDS)}); plain scenes are for `mitsuba-ref validate`"
    )


def kept_files(place: str) -> list[Path]:
    """Kept files: one, or all of a folder. Raises FileMissing."""
    path = Path(place)
    if path.is_dir():
        return sorted(path.glob("*.toml"))
    if not path.is_file():
        raise FileMissing(f"{place}: expected a scene file that fuzz has kept, or a folder of them, found nothing")
    return [path]

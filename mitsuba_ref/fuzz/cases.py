"""Cases: a scene as plain data, with one ray or its camera's image; kept on disk and checked again.

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
from mitsuba_ref.fuzz.checks import SCENE_ERRORS, check_image, check_rays, exception_finding
from mitsuba_ref.fuzz.findings import FINDING_KINDS, Finding, Tally
from mitsuba_ref.hard.family import scene_of
from mitsuba_ref.hard.rays import RayBatch
from mitsuba_ref.judge.checks.knife_edges import prepared_scene
from mitsuba_ref.report.reproducers import with_hex_floats

Case = dict[str, Any]  # a scene as a scene file gives it, and under "ray" a single ray: o, d, t_min, t_max


def case_of(data: dict[str, Any], ray: RayBatch | None) -> Case:
    """A case of its own, of the scene's image or of one ray."""
    case = copy.deepcopy({key: value for key, value in data.items() if key != "ray"})
    if ray is not None:
        (o,), (d,), (t_min,), (t_max,) = (a.tolist() for a in ray)
        case["ray"] = {"o": o, "d": d, "t_min": t_min, "t_max": t_max}
    return case


def ray_of(case: Case) -> RayBatch | None:
    """The single ray; None where a case has the rays of its camera."""
    return (
        RayBatch(*(np.array([case["ray"][name]]) for name in ("o", "d", "t_min", "t_max"))) if "ray" in case else None
    )


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


def findings_of(case: Case) -> list[Finding]:
    """Findings about a case without Mitsuba; none where it is no valid scene."""
    try:
        try:
            subject, ray = prepared_scene(scene_of(scene_data(case))), ray_of(case)
        except SCENE_ERRORS:
            return []
        return check_image(subject, Tally()) if ray is None else check_rays(subject, ray, Tally())
    except Exception as error:
        return [exception_finding(error)]


RECORD_PREFIX = "# fuzz:"
RECORD = re.compile(r"# fuzz: (\w+)(?: t_min=(\S+) t_max=(\S+))?")


class KeptCase(NamedTuple):
    """A kept case as read from its file."""

    kind: str
    case: Case


def write_kept(
    folder: Path, name: str, finding: Finding, found_by: str, case: Case, options: Sequence[str] = ()
) -> Path:
    """Write the case and the meshes it needs; the file. Raises OutputError.

    found_by: options that make the scene it was shrunk from; options: those that name a candidate.
    """
    check_folder(folder)
    data = scene_data(case)
    data["shape"] = [_with_copied_mesh(shape, folder) for shape in data["shape"]]
    limits = [f"{key}={float(case['ray'][key]).hex()}" for key in ("t_min", "t_max") if "ray" in case]
    head = [
        f"# Found by mitsuba-ref fuzz {found_by}: {FINDING_KINDS[finding.kind]}.",
        f"# {finding.what}".replace("\n", " "),
        f"# Again: {shlex.join(['mitsuba-ref', 'fuzz', '--replay', f'{name}.toml', *options])}",
        " ".join([RECORD_PREFIX, finding.kind, *limits]),
    ]
    path = folder / f"{name}.toml"
    write_text(path, "\n".join([*head, "", format_toml(with_hex_floats(data), SECTION_ORDER)]))
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
    scene = load_scene(path)
    text = path.read_text(encoding="utf-8-sig")
    kind, limits = _parse_record(path, text)
    data = parse_hex_floats(tomllib.loads(text))
    for shape, loaded in zip(data["shape"], scene.shapes, strict=True):
        if "file" in shape:
            shape["file"] = getattr(loaded, "file", shape["file"])
    camera = data["camera"]
    if limits and "origin" in camera:
        data["ray"] = {"o": camera["origin"], "d": camera["direction"], **limits}
    return KeptCase(kind, data)


def _parse_record(path: Path, text: str) -> tuple[str, dict[str, float]]:
    """(kind, limits of a ray) of the comment. Raises SceneError."""
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.startswith(RECORD_PREFIX)]
    if len(lines) != 1:
        raise SceneError(
            f"{path}: expected one line that begins with '{RECORD_PREFIX}', found {len(lines)}: "
            "not a file that fuzz has kept, or a damaged one; plain scenes are for `mitsuba-ref validate`"
        )
    ((number, line),) = lines
    found = RECORD.fullmatch(line.strip())
    try:
        if found is None or found[1] not in FINDING_KINDS:
            raise ValueError(f"kinds: {', '.join(FINDING_KINDS)}")
        limits = {"t_min": float.fromhex(found[2]), "t_max": float.fromhex(found[3])} if found[2] else {}
        if np.isnan([*limits.values()]).any():
            raise ValueError("a limit is not a number")
    except (ValueError, OverflowError) as error:
        raise SceneError(
            f"{path}:{number}: damaged: expected '{RECORD_PREFIX} KIND', of a ray with ' t_min=HEX t_max=HEX', "
            f"got {line[:80]!r}: {error}"
        ) from None
    return found[1], limits


def parse_hex_floats(value: Any) -> Any:
    """Hex floats as floats, in whatever holds them; other text stays."""
    if isinstance(value, dict):
        return {key: parse_hex_floats(each) for key, each in value.items()}
    if isinstance(value, list):
        return [parse_hex_floats(each) for each in value]
    if isinstance(value, str) and value.lstrip("+-").lower().startswith("0x"):
        return float.fromhex(value)
    return value


def kept_files(place: str) -> list[Path]:
    """Kept files: one, or all of a folder. Raises FileMissing."""
    path = Path(place)
    if path.is_dir():
        return sorted(path.glob("*.toml"))
    if not path.is_file():
        raise FileMissing(f"{place}: expected a scene file that fuzz has kept, or a folder of them, found nothing")
    return [path]

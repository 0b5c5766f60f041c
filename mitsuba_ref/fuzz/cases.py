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
from typing import Any

import numpy as np

from caster.description.errors import SceneError
from caster.scene.export import format_toml
from caster.scene.files import load_scene
from caster.system.atomic_files import check_folder, write_text
from mitsuba_ref.error_model.intersections import Rays
from mitsuba_ref.fuzz.findings import FINDING_KINDS, Finding

Case = dict[str, Any]  # a scene as a scene file gives it; with "limits", t_min and t_max of its camera's one ray


def case_of(data: dict[str, Any], ray: Rays | None = None) -> Case:
    """A case of its own, of the scene's image or of one ray."""
    case = copy.deepcopy(data)
    if ray is not None:
        o, d, *limits = (values[0].tolist() for values in ray)
        camera = {"type": "ray", "origin": o, "direction": d}
        case |= {"film": {"width": 1, "height": 1}, "camera": camera, "limits": limits}
    return case


def ray_of(case: Case) -> Rays | None:
    """The single ray; None where a case has the rays of its camera."""
    if "limits" not in case:
        return None
    ray = case["camera"]["origin"], case["camera"]["direction"], *case["limits"]
    return Rays(*(np.array([values], np.float64) for values in ray))


def scene_data(case: Case) -> dict[str, Any]:
    """The scene; a single ray is its camera, without limits."""
    return {key: value for key, value in case.items() if key != "limits"}


RECORD = re.compile(r"^# fuzz: (\w+)(?: t_min=(\S+) t_max=(\S+))?$", re.MULTILINE)


def write_kept(
    folder: Path, name: str, finding: Finding, found_by: str, case: Case, options: Sequence[str] = ()
) -> Path:
    """Write the case and the meshes it needs; returns the file. Raises OutputError.

    found_by: options that make the scene it was shrunk from; options: those that name a candidate.
    """
    check_folder(folder)
    data, record = copy.deepcopy(scene_data(case)), f"# fuzz: {finding.kind}"
    for shape in data["shape"]:
        if "file" in shape:
            source = Path(shape["file"])
            shape["file"] = source.name
            if source.resolve() != (folder / source.name).resolve():
                shutil.copyfile(source, folder / source.name)
    if "limits" in case:
        t_min, t_max = case["limits"]
        record += f" t_min={t_min!r} t_max={t_max!r}"
        data["camera"] |= {"t_max": t_max} if 0.0 < t_max < np.inf else {}
    head = [
        f"# Found by mitsuba-ref fuzz {found_by}: {FINDING_KINDS[finding.kind]}.",
        f"# {finding.what}".replace("\n", " "),
        f"# Again: {shlex.join(['mitsuba-ref', 'fuzz', '--replay', f'{name}.toml', *options])}",
        record,
    ]
    path = folder / f"{name}.toml"
    write_text(path, "\n".join([*head, "", format_toml(data)]))
    return path


def read_kept(path: Path) -> tuple[str, Case]:
    """A kept case, after the kind of its finding.

    Raises FileMissing, and SceneError with what is wrong for a file that is damaged.
    """
    scene, text = load_scene(path), path.read_text(encoding="utf-8-sig")
    data, found = tomllib.loads(text), RECORD.findall(text)
    try:
        ((kind, *limits),) = found
        t_min, t_max = (float(limit or "inf") for limit in limits)
    except ValueError:
        kind, t_min, t_max = "", 0.0, 0.0
    if kind not in FINDING_KINDS or not 0.0 <= t_min <= t_max:
        raise SceneError(
            f"{path}: expected one comment line '# fuzz: KIND', of a ray with ' t_min=NUMBER t_max=NUMBER', "
            f"got {len(found)} such lines: not a file that fuzz has kept, or a damaged one "
            f"(kinds: {', '.join(FINDING_KINDS)}); plain scenes are for `mitsuba-ref validate`"
        )
    for shape, loaded in zip(data["shape"], scene.shapes, strict=True):
        if "file" in shape:
            shape["file"] = getattr(loaded, "file", shape["file"])
    if t_min < np.inf and "origin" in data["camera"]:
        data["limits"] = [t_min, t_max]
    return kind, data

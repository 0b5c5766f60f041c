"""Cases: a scene with one ray, or with its camera's image; shrunk, kept on disk and checked again.

Kept cases are scene files with a comment line that gives the finding and the ray. A camera of type "ray" casts the very
ray, so that `caster probe` and `mitsuba-ref validate` show it; a t_min, which it lacks, is in the comment alone.
"""

import copy
import shlex
import shutil
import tomllib
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import AfterValidator, AllowInfNan, BaseModel, BeforeValidator, PlainSerializer, Strict, ValidationError

from caster.description.errors import FileMissing, SceneError
from caster.scene.export import SECTION_ORDER, format_toml
from caster.scene.files import load_scene
from caster.scene.model import Scene
from caster.system.atomic_files import check_folder, write_text
from mitsuba_ref.fuzz.checks import check_image, check_rays
from mitsuba_ref.fuzz.families import scene_of
from mitsuba_ref.fuzz.findings import FINDING_KINDS, Finding, Tally
from mitsuba_ref.judge.checks.adversarial_rays import RayBatch
from mitsuba_ref.judge.checks.knife_edges import prepared_scene
from mitsuba_ref.oracle.oracle import OutsideDomain
from mitsuba_ref.report.reproducers import with_hex_floats


class Case(NamedTuple):
    """Parts of a scene as a scene file describes them."""

    film: dict[str, Any]
    camera: dict[str, Any]
    shapes: list[dict[str, Any]]
    ray: RayBatch | None = None  # one row; None: the rays of the camera
    rest: Mapping[str, Any] = MappingProxyType({})  # lights, materials and what else there is

    def scene_data(self) -> dict[str, Any]:
        """The scene; a single ray becomes its camera, without its t_min."""
        if self.ray is None:
            return {"film": self.film, "camera": self.camera, "shape": self.shapes, **self.rest}
        camera: dict[str, Any] = {"type": "ray", "origin": self.ray.o[0].tolist(), "direction": self.ray.d[0].tolist()}
        if 0.0 < self.ray.t_max[0] < np.inf:
            camera["t_max"] = float(self.ray.t_max[0])
        return {"film": {"width": 1, "height": 1}, "camera": camera, "shape": self.shapes, **self.rest}

    def scene(self) -> Scene:
        return scene_of(self.scene_data())

    def to_data(self) -> dict[str, Any]:
        """Plain data, for the shrinker."""
        data = {"film": self.film, "camera": self.camera, "shape": self.shapes, **self.rest}
        if self.ray is not None:
            (o,), (d,), (t_min,), (t_max,) = (a.tolist() for a in self.ray)
            data["ray"] = {"o": o, "d": d, "t_min": t_min, "t_max": t_max}
        return copy.deepcopy(data)

    @classmethod
    def of(cls, data: dict[str, Any]) -> "Case":
        ray = one_ray(**data["ray"]) if "ray" in data else None
        rest = {key: value for key, value in data.items() if key not in ("film", "camera", "shape", "ray")}
        return cls(data["film"], data["camera"], data["shape"], ray, rest)


def one_ray(o: Sequence[float], d: Sequence[float], t_min: float, t_max: float) -> RayBatch:
    return RayBatch(np.array([o]), np.array([d]), np.array([t_min]), np.array([t_max]))


SCENE_ERRORS = (SceneError, ValidationError, OutsideDomain)  # raised by scenes that cannot be checked


def findings_of(case: Case) -> list[Finding]:
    """Findings about a case without Mitsuba; none where it is no valid scene."""
    try:
        subject = prepared_scene(case.scene())
    except SCENE_ERRORS:
        return []
    except Exception as error:
        return [exception_finding(error)]
    try:
        if case.ray is not None:
            return check_rays(subject, case.ray, Tally())
        return check_image(subject, Tally())
    except Exception as error:
        return [exception_finding(error)]


def exception_finding(error: Exception) -> Finding:
    """The finding that an exception was raised."""
    (place, *_) = traceback.extract_tb(error.__traceback__)[::-1]
    where = f"{Path(place.filename).name}:{place.lineno}"
    return Finding("error", f"{type(error).__name__} at {where}: {error}")


RECORD_PREFIX = "# fuzz: "


def _from_hex(value: Any) -> float:
    if not isinstance(value, str):
        raise ValueError(f"expected a hex float as text, got {value!r}")
    try:
        return float.fromhex(value)
    except OverflowError as error:
        raise ValueError(f"{error}, got {value!r}") from None


HexFloat = Annotated[float, BeforeValidator(_from_hex), PlainSerializer(with_hex_floats)]
FiniteHexFloat = Annotated[HexFloat, AllowInfNan(False)]
Vector = tuple[FiniteHexFloat, FiniteHexFloat, FiniteHexFloat]


def _not_zero(value: Vector) -> Vector:
    if not any(value):
        raise ValueError("d must not be zero")
    return value


def _known(kind: str) -> str:
    if kind not in FINDING_KINDS:
        raise ValueError(f"expected one of {', '.join(FINDING_KINDS)}, got {kind!r}")
    return kind


class RayRecord(BaseModel, extra="forbid", frozen=True):
    """The ray of a kept case, in hex floats."""

    o: Vector
    d: Annotated[Vector, AfterValidator(_not_zero)]
    t_min: FiniteHexFloat
    t_max: HexFloat


class CaseRecord(BaseModel, extra="forbid", frozen=True, strict=True):
    """The comment line of a kept case, as JSON."""

    kind: Annotated[str, AfterValidator(_known)]
    found_by: str  # the options that made the scene it was shrunk from
    ray: Annotated[RayRecord, Strict(False)] | None = None


@dataclass(frozen=True)
class KeptCase:
    """A kept case as read from its file."""

    kind: str
    case: Case
    found_by: str  # the options that made the scene it was shrunk from


def write_kept(
    folder: Path, name: str, kind: str, what: str, found_by: str, case: Case, options: Sequence[str] = ()
) -> Path:
    """Write the case and the meshes it needs; the file. options: that name a candidate. Raises OutputError."""
    check_folder(folder)
    data = case.scene_data()
    data["shape"] = [_with_copied_mesh(shape, folder) for shape in data["shape"]]
    ray = None if case.ray is None else RayRecord(**with_hex_floats(case.to_data()["ray"]))
    record = CaseRecord(kind=kind, found_by=found_by, ray=ray)
    head = [
        f"# Found by mitsuba-ref fuzz {found_by}: {FINDING_KINDS[kind]}.",
        f"# {what}".replace("\n", " "),
        f"# Again: {shlex.join(['mitsuba-ref', 'fuzz', '--replay', f'{name}.toml', *options])}",
        RECORD_PREFIX + record.model_dump_json(exclude_none=True),
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
    record = _parse_record(path, text)
    data = tomllib.loads(text)
    for shape, loaded in zip(data["shape"], scene.shapes, strict=True):
        if "file" in shape:
            shape["file"] = getattr(loaded, "file", shape["file"])
    case = Case.of(parse_hex_floats(data))
    ray = None if record.ray is None else one_ray(**dict(record.ray))
    return KeptCase(record.kind, case._replace(ray=ray), record.found_by)


def _parse_record(path: Path, text: str) -> CaseRecord:
    """The content of the comment. Raises SceneError."""
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.startswith(RECORD_PREFIX)]
    if len(lines) != 1:
        raise SceneError(
            f"{path}: expected one line that begins with '{RECORD_PREFIX.strip()}', found {len(lines)}: "
            "not a file that fuzz has kept, or a damaged one; plain scenes are for `mitsuba-ref validate`"
        )
    ((number, line),) = lines
    try:
        return CaseRecord.model_validate_json(line.removeprefix(RECORD_PREFIX))
    except ValidationError as error:
        first = error.errors()[0]
        what = ": ".join(filter(None, [".".join(map(str, first["loc"])), first["msg"]]))
        raise SceneError(
            f"{path}:{number}: damaged: expected '{RECORD_PREFIX}' and JSON with kind, found_by and ray "
            f"(o, d, t_min, t_max), got {line[:80]!r}: {what}"
        ) from None


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

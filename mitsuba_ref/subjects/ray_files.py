"""Files of rays and of hits: reading and writing them, and hits from a file as a subject."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.cameras.single_ray import Ray
from caster.description.errors import FileMissing, SceneError
from caster.description.input_files import opened_input
from caster.geometry.packing import Packed
from caster.scene.model import MAX_FILM_SIDE, Film, Scene
from caster.system.atomic_files import write_bytes
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.subjects.subject import Answer, CastRequest, NoAnswer, Subject, checked_answer, checked_array, spread

COLUMNS = 8  # of a ray: o (3), d (3), t_min, t_max
ZIP_MAGIC = b"PK"
HIT_ARRAYS = ("t", "n", "shape_id", "prim_id", "any_hit")
RAY_ARRAYS = ("rays", "width", "parent", "kind", "pixels")  # which a file of hits may hold as well
STRIP_WIDTH = 256  # of the film on which rays are laid out, if the list names none


class RayList(NamedTuple):
    """Rays o + t d with t_min < t <= t_max, and the width of the film that they fill."""

    rows: Array  # (n, 8) float32 or float64
    width: int = 0  # pixels; 0: any


# ---- arrays of .npz files


def read_arrays(path: str | Path, names: Sequence[str] = (), required: Sequence[str] = ()) -> dict[str, Array]:
    """The arrays `names` of a .npz file, or all, of which `required` have to be there. Nothing is unpickled.

    Raises FileMissing, also for files that hold objects, are cut short or do not fit into memory.
    """
    path = Path(path)
    with opened_input(path, "file of arrays") as file:
        start = file.read(len(ZIP_MAGIC))
        if start != ZIP_MAGIC:
            raise FileMissing(f"{path}: expected a .npz file of NumPy, got one that starts with {start!r}")
        file.seek(0)
        try:
            loaded: Any = np.load(file, allow_pickle=False)
            found = {name: loaded[name] for name in loaded.files if not names or name in names}
        except Exception as error:  # NumPy and zipfile raise various types for damaged bytes
            raise FileMissing(f"{path}: cannot be read: {error}") from error
    if not found or not found.keys() >= set(required):
        expected = f" of {', '.join(required or names)}" if names else ""
        raise FileMissing(f"{path}: expected arrays{expected}, got {', '.join(loaded.files) or 'none'}")
    for name, values in found.items():
        kind = getattr(values, "dtype", None)  # bytes, where a member of the archive is no array
        if kind is None or kind.kind not in "fiub":
            raise FileMissing(f"{path}: {name}: expected numbers, got {kind or 'no array'}")
    return found


# ---- rays


def read_rays(path: str | Path) -> RayList:
    """The array `rays` of a .npz file, (n, 8).

    Raises FileMissing, SceneError.
    """
    arrays = read_arrays(path, ("rays", "width"), ("rays",))
    width = int(arrays["width"]) if arrays.get("width", np.zeros(3)).size == 1 else 0
    return checked_rays(arrays["rays"], str(path), width)


def checked_rays(rows: Array, where: str, width: int = 0) -> RayList:
    """The rays as a list. Raises SceneError that names the first ray that cannot be traced."""
    if rows.ndim != 2 or rows.shape[1] != COLUMNS:
        raise SceneError(f"{where}: expected rays of shape (n, {COLUMNS}): o, d, t_min, t_max; got {rows.shape}")
    native = rows.dtype.newbyteorder("=")
    if native not in (np.float32, np.float64):
        raise SceneError(f"{where}: expected float32 or float64 rays, got {rows.dtype}")
    if not len(rows):
        raise SceneError(f"{where}: expected at least one ray, got none")
    rows = np.ascontiguousarray(rows.astype(native, copy=False))
    with np.errstate(over="ignore", invalid="ignore"):
        line, limits = rows[:, :6].astype(np.float32), rows[:, 6:]
        start = line[:, :3].astype(np.float64) + limits[:, :1].astype(np.float64) * line[:, 3:]
    for good, expected in (
        (np.isfinite(rows[:, :6]).all(axis=1), "finite numbers in o and d"),
        (np.isfinite(line).all(axis=1), "o and d within float32, in which Mitsuba traces"),
        (line[:, 3:].any(axis=1), "a direction that is not zero, also as float32"),
        ((limits[:, 0] >= 0.0) & np.isfinite(limits[:, 0]), "a finite t_min >= 0"),
        (limits[:, 1] >= limits[:, 0], "t_max >= t_min; inf for a ray without end"),
        (
            (np.abs(start) <= np.finfo(np.float32).max).all(axis=1),
            "a start o + t_min d not beyond float32, in which Mitsuba traces",
        ),
    ):
        if not good.all():
            i = int(np.argmin(good))
            raise SceneError(f"{where}: rays[{i}]: expected {expected}, got {rows[i].tolist()}")
    return RayList(rows, width if 0 < width <= MAX_FILM_SIDE else 0)


def write_rays(path: str | Path, rays: RayList, **more: Array) -> None:
    """Write rays to a .npz file. Raises OutputError."""
    out = io.BytesIO()
    np.savez_compressed(out, rays=rays.rows, width=np.int64(rays.width), **more)  # type: ignore[arg-type]
    write_bytes(Path(path), out.getvalue())


def lay_out(scene: Scene, rays: RayList) -> tuple[Scene, SharedRays]:
    """(the scene with a film of one pixel per ray, row by row; the rays). Remaining pixels have no ray."""
    count = len(rays.rows)
    width = min(rays.width or max(STRIP_WIDTH, int(np.ceil(np.sqrt(count)))), count)
    height = -(-count // width)
    rows = np.zeros((width * height, COLUMNS))
    rows[:, 5], rows[:, 7] = 1.0, -1.0
    rows[:count] = rays.rows
    camera = Ray(origin=tuple(rows[0, :3].tolist()), direction=tuple(rows[0, 3:6].tolist()))
    film = Film(width=width, height=height)
    o, d, t_min, t_max = (np.ascontiguousarray(columns) for columns in np.split(rows, [3, 6, 7], axis=1))
    shared = SharedRays(o, d, t_max.ravel(), np.zeros(len(rows)), t_min.ravel())
    return scene.model_copy(update={"film": film, "camera": camera}), shared


# ---- hits


@dataclass(frozen=True)
class HitsFile(Subject):
    """Hits that were computed beforehand, one per ray of the list."""

    arrays: dict[str, Array]
    precision: str | None  # None: that of t and n
    any_hit: bool = False  # judge its any-hit answers, not its nearest hits

    def answer(self, request: CastRequest) -> Answer:
        """The answer from its arrays. Raises NoAnswer."""
        return answer_of_hits(self.arrays, request.rays.t_max >= 0.0, self.precision, self.any_hit)


def answer_of_hits(
    arrays: Mapping[str, Any],
    there: Array,
    precision: str | None = None,
    any_hit: bool = False,
    t_max: Array | float = np.inf,
) -> Answer:
    """The answer from nearest hits, or from any-hit answers, one for each pixel in `there`. Raises NoAnswer.

    t_max: a nearest hit beyond it counts as a miss.
    """
    names = ("any_hit",) if any_hit else ("shape_id", "prim_id")
    shape = (int(there.sum()),)
    numbers = {name: checked_array(name, arrays[name], shape, -1, whole=True) for name in names if name in arrays}
    if any_hit:
        blocked = numbers["any_hit"]
        if (unknown := ~np.isin(blocked, (0, 1))).any():
            i = int(np.argmax(unknown))
            raise NoAnswer(f"any_hit[{i}]: expected 0 or 1, got {blocked[i]}")
        t = np.where(blocked == 1, 0.0, np.inf)
        return checked_answer(t, None, there, precision=precision or "float64", hits_only=True)
    found = checked_answer(arrays["t"], arrays.get("n"), there, precision=precision, t_max=t_max)
    ids = {name: np.where(found.hit, spread(values, there, -1), -1) for name, values in numbers.items()}
    # -1 at every hit means that ids are not given
    named: dict[str, Any] = {
        name: values for name, values in ids.items() if not found.hit.any() or (values[found.hit] != -1).any()
    }
    return replace(found, **named)


def answer_of_numbered_hits(
    hits: Mapping[str, Any], rays: SharedRays, packed: Packed, precision: str | None, *, limits: bool
) -> Answer:
    """The answer from nearest hits, with prim_id numbered through the scene. Raises NoAnswer.

    limits: whether the subject is given t_max, so that a hit beyond it is no answer; else it counts as a miss.
    """
    t_max = rays.t_max.astype(np.float64)
    found = answer_of_hits(hits, t_max >= 0.0, precision, t_max=np.inf if limits else t_max)
    if found.prim_id is not None:
        inside = found.hit & (found.prim_id >= 0) & (found.prim_id < packed.first[-1])
        known = np.where(inside, found.prim_id, -1)
        found = replace(found, shape_id=packed.shape_of(known), prim_id=packed.index_in_shape(known))
    late = found.hit & (found.t > t_max)
    return replace(found, broken={**found.broken, **({"a hit beyond t_max": late} if late.any() else {})})

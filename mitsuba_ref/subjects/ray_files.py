"""Files of rays and of hits: read without trust, judged as the answer of a subject that is not there."""

import os
import tokenize
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy

from caster.cameras.single_ray import Ray
from caster.description.errors import FileMissing, SceneError
from caster.description.input_files import opened_input
from caster.scene.model import MAX_FILM_SIDE, Film, Scene
from caster.system.atomic_files import write_bytes
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.subjects.subject import Answer, CastRequest, NoAnswer, checked_answer

COLUMNS = 8  # of a row of rays: o (3), d (3), t_min, t_max
NPY_MAGIC, ZIP_MAGIC = b"\x93NUMPY", b"PK"
HIT_ARRAYS = ("t", "n", "shape_id", "prim_id", "any_hit")
HIT_COLUMNS = {1: "t", 4: "t, n", 5: "t, n, prim_id"}  # of hits in one .npy array
STRIP_WIDTH = 256  # pixels of the film that rays are laid out on, if the list names none
# What judging takes at its peak: 50 arrays of 3 float64 for intersections, and as much for images and evidence.
BYTES_PER_RAY = 2 * 50 * 3 * 8
HEADER_READERS: dict[tuple[int, int], Callable[[IO[bytes]], Any]] = {
    (1, 0): npy.read_array_header_1_0,
    (2, 0): npy.read_array_header_2_0,
}


class UnreadableArray(FileMissing):
    """A file that exists, and does not hold the arrays that were expected."""


class RayList(NamedTuple):
    """Rays o + t d with t_min < t <= t_max, and how wide a film they fill."""

    rows: np.ndarray  # (n, 8) float32 or float64
    width: int = 0  # pixels; 0: any


# ---- arrays of .npy and .npz files


def read_arrays(path: str | Path, names: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Arrays of a .npz file by name, those of `names` alone; "" -> the array of a .npy file. Nothing is unpickled.

    Raises FileMissing, UnreadableArray: for files of objects, cut ones, and such as do not fit into memory.
    """
    path = Path(path)
    try:
        with opened_input(path, "file of arrays") as (file, size):
            start = file.read(len(NPY_MAGIC))
            if start == NPY_MAGIC:
                file.seek(0)
                return {"": _read_array(file, str(path), size)}
            if not start.startswith(ZIP_MAGIC):
                raise UnreadableArray(
                    f"{path}: expected a .npz or .npy file of NumPy, got one that starts with {start!r}"
                )
            with zipfile.ZipFile(file) as archive:
                return _read_members(archive, path, names)
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError) as error:
        raise UnreadableArray(f"{path}: cannot be read: {error}") from error


def _read_members(archive: zipfile.ZipFile, path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    found = {}
    for info in archive.infolist():
        name = info.filename.removesuffix(".npy")
        if name in names:
            with archive.open(info) as member:
                found[name] = _read_array(member, f"{path}: {name}", info.file_size)
    if not found:
        has = ", ".join(info.filename.removesuffix(".npy") for info in archive.infolist()) or "none"
        raise UnreadableArray(f"{path}: expected arrays of {', '.join(names)}, got {has}")
    return found


def _read_array(file: IO[bytes], where: str, size: int) -> np.ndarray:
    """One array, after its header was compared with the `size` of its file in bytes."""
    try:
        version = npy.read_magic(file)
        if version not in HEADER_READERS:
            raise UnreadableArray(f"{where}: expected a plain array of numbers, got .npy version {version}")
        shape, fortran, dtype = HEADER_READERS[version](file)
    except (ValueError, SyntaxError, TypeError, tokenize.TokenError, RecursionError, MemoryError) as error:
        raise UnreadableArray(f"{where}: its header is damaged: {error}") from error
    if dtype.hasobject or dtype.kind not in "fiub":
        raise UnreadableArray(f"{where}: expected numbers, got {dtype}; objects are never unpickled")
    if any(length < 0 for length in shape):
        raise UnreadableArray(f"{where}: its header is damaged: shape {shape}")
    expected, here = dtype.itemsize, file.tell()
    for length in shape:
        expected *= length
    if expected != size - here:
        raise UnreadableArray(
            f"{where}: expected {expected} bytes of shape {shape} and type {dtype}, got {size - here}"
        )
    if expected > available_memory():
        raise UnreadableArray(f"{where}: {expected} bytes do not fit into memory; write the list in parts")
    data = file.read(expected)
    if len(data) != expected:
        raise UnreadableArray(f"{where}: expected {expected} bytes, the file ends after {len(data)}")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def available_memory() -> int:
    """Bytes of physical memory; without a limit where the system does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return 1 << 62


# ---- rays


def read_rays(path: str | Path) -> RayList:
    """Rays of a .npy file, or the array `rays` of a .npz file, (n, 8).

    Raises FileMissing, UnreadableArray, SceneError.
    """
    arrays = read_arrays(path, ("rays", "width"))
    rows = arrays.get("rays", arrays.get(""))
    if rows is None:
        raise UnreadableArray(f"{path}: expected an array `rays`, got {', '.join(arrays)}")
    width = int(arrays["width"]) if arrays.get("width", np.zeros(3)).size == 1 else 0
    return checked_rays(rows, str(path), width)


def checked_rays(rows: np.ndarray, where: str, width: int = 0) -> RayList:
    """Rays that can be traced. Raises SceneError that names the first which cannot."""
    if rows.ndim != 2 or rows.shape[1] != COLUMNS:
        raise SceneError(f"{where}: expected rays of shape (n, {COLUMNS}): o, d, t_min, t_max; got {rows.shape}")
    native = rows.dtype.newbyteorder("=")
    if native not in (np.float32, np.float64):
        raise SceneError(f"{where}: expected float32 or float64 rays, got {rows.dtype}")
    if not len(rows):
        raise SceneError(f"{where}: expected at least one ray, got none")
    rows = np.ascontiguousarray(rows.astype(native, copy=False))
    with np.errstate(over="ignore"):
        line, limits = rows[:, :6].astype(np.float32), rows[:, 6:]
    for bad, expected in (
        (~np.isfinite(rows[:, :6]).all(axis=1), "finite numbers in o and d"),
        (~np.isfinite(line).all(axis=1), "o and d within float32, in which Mitsuba traces"),
        (~line[:, 3:].any(axis=1), "a direction that is not zero, also as float32"),
        (~((limits[:, 0] >= 0.0) & np.isfinite(limits[:, 0])), "a finite t_min >= 0"),
        (~(limits[:, 1] >= limits[:, 0]), "t_max >= t_min; inf for a ray without end"),
    ):
        if bad.any():
            i = int(np.argmax(bad))
            raise SceneError(f"{where}: rays[{i}]: expected {expected}, got {rows[i].tolist()}")
    shifted = line[:, :3].astype(np.float64) + limits[:, :1].astype(np.float64) * line[:, 3:]
    if not (ok := (np.abs(shifted) <= np.finfo(np.float32).max).all(axis=1)).all():
        i = int(np.argmin(ok))
        raise SceneError(f"{where}: rays[{i}]: its start o + t_min d lies beyond float32, in which Mitsuba traces")
    return RayList(rows, width if 0 < width <= MAX_FILM_SIDE else 0)


def write_rays(path: str | Path, rays: RayList, **more: np.ndarray) -> None:
    """A .npz file of rays, or of a .npy suffix the rows alone. Raises OutputError."""
    import io

    out = io.BytesIO()
    if Path(path).suffix == ".npy":
        np.save(out, rays.rows, allow_pickle=False)
    else:
        np.savez_compressed(out, rays=rays.rows, width=np.int64(rays.width), **more)  # type: ignore[arg-type]
    write_bytes(Path(path), out.getvalue())


def lay_out(scene: Scene, rays: RayList, where: str) -> tuple[Scene, SharedRays]:
    """(the scene with a film that holds one ray a pixel, row by row, those rays). Pixels left over have no ray.

    Raises SceneError for more rays than memory holds.
    """
    count = len(rays.rows)
    if count * BYTES_PER_RAY > available_memory():
        fit = available_memory() // BYTES_PER_RAY
        raise SceneError(
            f"{where}: {count} rays, and memory holds what {fit} need; judge them in parts: --rows 0:{fit}"
        )
    width = min(rays.width or max(STRIP_WIDTH, int(np.ceil(np.sqrt(count)))), count)
    height = -(-count // width)
    rows = np.zeros((width * height, COLUMNS))
    rows[:, 5], rows[:, 7] = 1.0, -1.0
    rows[:count] = rays.rows
    camera = Ray(origin=tuple(rows[0, :3].tolist()), direction=tuple(rows[0, 3:6].tolist()))
    film = Film(width=width, height=height)
    shared = SharedRays(
        rows[:, :3].copy(), rows[:, 3:6].copy(), rows[:, 7].copy(), np.zeros(len(rows)), rows[:, 6].copy()
    )
    return scene.model_copy(update={"film": film, "camera": camera}), shared


# ---- hits


def read_hits(path: str | Path) -> dict[str, np.ndarray]:
    """Arrays of HIT_ARRAYS: of a .npz file by name, of a .npy file by HIT_COLUMNS.

    Raises FileMissing, UnreadableArray.
    """
    arrays = read_arrays(path, HIT_ARRAYS)
    return hit_columns(arrays[""], str(path)) if "" in arrays else arrays


def hit_columns(rows: np.ndarray, where: str) -> dict[str, np.ndarray]:
    """The arrays of hits (n, 1), (n, 4) or (n, 5); integers (n,) are any-hit answers. Raises UnreadableArray."""
    if rows.ndim == 1 and rows.dtype.kind in "biu":
        return {"any_hit": rows}
    if rows.ndim == 1:
        return {"t": rows}
    if rows.ndim != 2 or rows.shape[1] not in HIT_COLUMNS or rows.dtype.kind != "f":
        known = ", ".join(f"(n, {count}): {what}" for count, what in HIT_COLUMNS.items())
        raise UnreadableArray(f"{where}: expected hits of shape {known}; got {rows.shape} of {rows.dtype}")
    found = {"t": rows[:, 0]}
    if rows.shape[1] >= 4:
        found["n"] = rows[:, 1:4]
    if rows.shape[1] == 5:
        whole = np.isfinite(rows[:, 4]) & (np.abs(rows[:, 4]) < 2.0**31)
        found["prim_id"] = np.where(whole & (rows[:, 4] == np.floor(rows[:, 4])), rows[:, 4], -2).astype(np.int64)
    return found


@dataclass(frozen=True)
class HitsFile:
    """Hits that were computed beforehand, one a ray of the list."""

    name: str
    arrays: dict[str, np.ndarray]
    precision: str | None  # None: that of t and n
    any_hit: bool = False  # its any-hit answers, not its nearest hits
    reads_xml: bool = False
    takes_rays: bool = False
    takes_limits: bool = False

    def answer(self, request: CastRequest) -> Answer:
        """The arrays, checked for form. Raises NoAnswer."""
        there = request.rays.t_max >= 0.0
        return spread_answer(answer_of_hits(self.arrays, int(there.sum()), self), there)


def answer_of_hits(arrays: dict[str, np.ndarray], count: int, of: Any) -> Answer:
    """The answer to `count` rays. of: with `precision` and `any_hit`. Raises NoAnswer."""
    if of.any_hit:
        blocked = _integers("any_hit", arrays["any_hit"], count)
        if not np.isin(blocked, (0, 1)).all():
            i = int(np.argmin(np.isin(blocked, (0, 1))))
            raise NoAnswer(f"any_hit[{i}]: expected 0 or 1, got {blocked[i]}")
        t = np.where(blocked == 1, 0.0, np.inf)
        return checked_answer(t, None, count, precision=of.precision or "float64", hits_only=True)
    ids = {name: _integers(name, arrays[name], count) for name in ("shape_id", "prim_id") if name in arrays}
    found = checked_answer(arrays["t"], arrays.get("n"), count, precision=of.precision)
    named: dict[str, Any] = {
        name: np.where(found.hit, values, -1) for name, values in ids.items() if is_given(values, found.hit)
    }
    return replace(found, **named)


def is_given(ids: np.ndarray, hit: np.ndarray) -> bool:
    """Whether numbers of shapes or primitives say anything: -1 at every hit is a column that is not filled."""
    return not hit.any() or bool((ids[hit] != -1).any())


def _integers(name: str, values: np.ndarray, count: int) -> np.ndarray:
    """(count,) int64. Raises NoAnswer."""
    if values.shape != (count,):
        raise NoAnswer(f"{name}: expected shape (n,) = {(count,)}, got {values.shape}")
    if values.dtype.kind not in "biu":
        raise NoAnswer(f"{name}: expected whole numbers, got {values.dtype}")
    return values.astype(np.int64)


def spread_answer(some: Answer, there: np.ndarray) -> Answer:
    """An answer about the rays that there are -> about all pixels of their film."""

    def spread(values: np.ndarray | None, nothing: float) -> Any:
        if values is None:
            return None
        whole = np.full((len(there), *values.shape[1:]), nothing, values.dtype)
        whole[there] = values
        return whole

    t, n = spread(some.t, np.inf), spread(some.n, 0.0)
    broken = {why: spread(rows, False) for why, rows in some.broken.items()}
    ids = {name: spread(getattr(some, name), -1) for name in ("shape_id", "prim_id")}
    return replace(some, t=t, n=n, broken=broken, **ids)

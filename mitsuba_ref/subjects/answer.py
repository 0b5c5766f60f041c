"""Answers of a candidate, checked for form before anything is compared."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from caster.aovs import Aovs
from caster.system.terminal import printable
from mitsuba_ref.error_model.intersections import KU, KU_OURS

FLOAT32, FLOAT64 = "float32", "float64"
NOT_FINITE = "the normal is not finite on a hit"
LAST_WORDS = 1500  # characters kept of a candidate's output
PRECISIONS = {FLOAT32: KU, FLOAT64: KU_OURS}  # K times the unit round-off, as Model.meet takes it


DEFAULT_SECONDS = 300.0  # that a command may take for one scene


class NoAnswer(Exception):  # noqa: N818 - an outcome, not a mistake of the program
    """A candidate gave nothing that could be judged; the text is what it did, and the way out."""


@dataclass(frozen=True)
class Answer:
    """One row a ray. t is inf and n is 0 on a miss; broken rows have neither."""

    t: np.ndarray  # (n,) float64, lengths of d
    n: np.ndarray | None  # (n, 3) float64 of length 1; None: normals are not given
    precision: str  # of PRECISIONS: what the arithmetic behind it is
    broken: Mapping[str, np.ndarray]  # what is no answer at all -> (n,) bool
    t_rounding: float | np.ndarray = 0.0  # (n,) how far t is off because it was stored as something else
    own_camera: bool = False  # its rays came from a camera of its own, not from us
    as_exported: bool = False  # it saw what Mitsuba saw: patches in place of planes
    notes: tuple[str, ...] = ()
    hints: tuple[str, ...] = field(default=())  # reported only if a pixel fails
    prim: np.ndarray | None = None  # (n,) int32, numbered through the scene, -1 on a miss; None: not given
    images: Aovs | None = None  # normals, ids, diffuse, from a subject that gives more than t and n
    shape_id: np.ndarray | None = None  # (n,) named beside t, -1 on a miss; None: not given, as prim_id
    prim_id: np.ndarray | None = None  # (n,) within the shape
    hits_only: bool = False  # says whether something is hit, not where: t is 0 on a hit and means nothing
    exact_visibility: bool = False  # rounding is no excuse for another first hit than the exact one

    @property
    def hit(self) -> np.ndarray:
        """(n,) bool; a broken row counts as one."""
        found: np.ndarray = ~np.isposinf(self.t)
        return found

    @property
    def is_broken(self) -> np.ndarray:
        """(n,) bool: no answer at all."""
        return np.any([np.zeros(len(self.t), bool), *self.broken.values()], axis=0)

    def rows(self, rows: np.ndarray | slice) -> "Answer":
        """The answer to some of the rays, without images."""
        t_rounding = self.t_rounding[rows] if isinstance(self.t_rounding, np.ndarray) else self.t_rounding
        broken = {why: found[rows] for why, found in self.broken.items() if found[rows].any()}
        names = ("n", "prim", "shape_id", "prim_id")
        given = {name: getattr(self, name) for name in names}
        some: dict[str, Any] = {
            name: None if values is None else values[rows] for name, values in given.items()
        }
        return replace(self, t=self.t[rows], broken=broken, t_rounding=t_rounding, images=None, **some)

    @property
    def ku(self) -> float:
        return PRECISIONS[self.precision]


def checked_answer(t: Any, n: Any, count: int, *, precision: str | None = None, **more: Any) -> Answer:
    """The answer about `count` rays out of what came back. precision: as declared; None: that of the arrays.

    n may be None. Normals are taken as directions: each is divided by its length. A t that is NaN, negative or -inf,
    and a normal that is not finite or has no length on a hit are rows without an answer. Raises NoAnswer for arrays of
    another shape or of no floating type.
    """
    t = _floats("t", t, (count,), np.inf)
    n = None if n is None else _floats("n", n, (count, 3), 0.0)
    kinds = [a.dtype for a in (t, n) if a is not None]
    hints = _hints(t, precision)
    precision = precision or (FLOAT64 if all(kind == np.float64 for kind in kinds) else FLOAT32)
    t = t.astype(np.float64)
    broken = {"t is NaN": np.isnan(t), "t is negative": t < 0.0}
    hit = ~np.isposinf(t)
    if n is not None:
        n = n.astype(np.float64)
        whole = np.isfinite(n).all(axis=1)
        fine = hit & whole & n.any(axis=1)
        broken[NOT_FINITE] = hit & ~whole
        broken["the normal has no length on a hit"] = hit & whole & ~fine
        n = _directions(np.where(fine[:, None], n, 0.0))
    return Answer(
        t, n, precision, {why: rows for why, rows in broken.items() if rows.any()}, hints=hints, **more
    )


def _directions(n: np.ndarray) -> np.ndarray:
    """Rows (n, 3) divided by their lengths, however long or short; rows of zeros stay.

    First by the power of two next to the largest component, which is exact: a square may overflow, or vanish.
    """
    _, exponent = np.frexp(np.abs(n).max(axis=1))
    n = np.ldexp(n, -exponent[:, None])
    length = np.linalg.norm(n, axis=1)
    directions: np.ndarray = n / np.where(length > 0.0, length, 1.0)[:, None]
    return directions


def _floats(name: str, values: Any, shape: tuple[int, ...], nothing: float) -> np.ndarray:
    """As a plain array in this machine's order of bytes. nothing: what stands for no value. Raises NoAnswer."""
    expected = f"shape {'(n,)' if len(shape) == 1 else '(n, 3)'} = {shape}"
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        masked = int(np.ma.getmaskarray(values).sum())
        raise NoAnswer(f"{name}: {masked} values are masked; fill them, such as {name}.filled({nothing})")
    try:
        a = np.asarray(values)
    except KeyboardInterrupt:
        raise
    except (
        BaseException
    ) as error:  # whatever a foreign array type raises; SystemExit would end the run with a 0
        raise NoAnswer(f"{name} is no array: {type(error).__name__}: {exception_text(error)}") from error
    if a.dtype == object and not a.shape:
        raise NoAnswer(f"{name}: expected an array of {expected}, got {type(values).__name__}")
    if a.shape != shape:
        raise NoAnswer(f"{name}: expected {expected}, got {a.shape}")
    native = a.dtype.newbyteorder("=")
    if native not in (np.float32, np.float64):
        raise NoAnswer(f"{name}: expected float32 or float64 numbers, got {a.dtype}")
    return a.astype(native, copy=False)


def exception_text(error: BaseException) -> str:
    """The message of a foreign exception; even that may fail, or be very long."""
    try:
        words = str(error)
    except Exception as another:
        return f"(its message raises {type(another).__name__})"
    return printable(words[:LAST_WORDS]) + (" ..." if len(words) > LAST_WORDS else "")


def _hints(t: np.ndarray, precision: str | None) -> tuple[str, ...]:
    """Where a float64 array holds float32 numbers only, its maker may have computed in float32."""
    if precision is not None or t.dtype != np.float64:
        return ()
    finite = t[np.isfinite(t)]
    with np.errstate(over="ignore"):
        single = len(finite) > 0 and bool((finite.astype(np.float32) == finite).all())
    if not single:
        return ()
    return (
        "every t is a float32 number in a float64 array, and is held to the bounds of float64; if it was computed in "
        "float32: --candidate-precision float32",
    )

"""Subjects: the base class, answers to the rays of a scene, the scene in traced values; and our caster."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from caster.aovs import Aovs
from caster.description.fields import Shape
from caster.geometry.packing import Packed, Triangles
from caster.geometry.world_space import as_float32
from caster.rendering.hits import RayHits, trace
from caster.rendering.images import evaluate, film_window
from caster.scene.model import Scene
from caster.system.atomic_files import check_folder, write_bytes
from caster.system.terminal import printable
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.scene_model import SceneModel, Side
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.reference.originals import original_of
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.scene_xml.elements import ply_bytes, safe_name
from mitsuba_ref.shapes import kind_of
from mitsuba_ref.shapes.shape_reference import Fields

# ---- answers, checked for form before anything is compared ----

FLOAT32, FLOAT64 = "float32", "float64"
NOT_FINITE = "the normal is not finite on a hit"
LAST_WORDS = 1500  # characters of a candidate's output that are kept
PRECISIONS = {FLOAT32: KU, FLOAT64: KU_OURS}  # K times the unit round-off, for SceneModel.intersect
DEFAULT_SECONDS = 300.0  # time limit of a command for one scene


class NoAnswer(Exception):  # noqa: N818 - an outcome, not a mistake of the program
    """A candidate gave no answer that can be judged; the text says why and what to do."""


class Unsupported(NoAnswer):
    """A candidate declined the scene, for example because it lacks a shape or camera."""


@dataclass(frozen=True)
class Answer:
    """A subject's answer, one row per ray. On a miss, t is inf and n is 0; rows in `broken` are no answer."""

    t: Array  # (n,) float64, lengths of d
    n: Array | None  # (n, 3) float64 of length 1; None: normals are not given
    precision: str  # of PRECISIONS: its arithmetic
    broken: Mapping[str, Array]  # reason why rows are no answer -> (n,) bool
    t_rounding: float | Array = 0.0  # (n,) error of t from its conversion
    own_camera: bool = False  # it cast the rays of its own camera, not ours
    own_geometry: bool = False  # its primitives have the values of the scene file, not rounded to float32
    as_exported: bool = False  # it traced the exported scene, with patches in place of planes
    notes: tuple[str, ...] = ()
    prim: Array | None = None  # (n,) int32, numbered through the scene, -1 on a miss; None: not given
    images: Aovs | None = None  # normals, ids, diffuse, from a subject that gives more than t and n
    shape_id: Array | None = None  # (n,) named beside t, -1 on a miss; None: not given, as prim_id
    prim_id: Array | None = None  # (n,) within the shape
    hits_only: bool = False  # it says whether something is hit, not where: t is 0 on a hit
    exact_visibility: bool = False  # its first hits have to be the exact ones, whatever the rounding

    @property
    def hit(self) -> Array:
        """(n,) bool; a broken row counts as a hit."""
        return ~np.isposinf(self.t)

    @property
    def is_broken(self) -> Array:
        """(n,) bool: no answer at all."""
        return np.any([np.zeros(len(self.t), bool), *self.broken.values()], axis=0)

    def rows(self, rows: Array | slice) -> "Answer":
        """Some rows, without images."""
        some: Fields = {name: a[rows] for name, a in vars(self).items() if isinstance(a, np.ndarray)}
        broken = {why: found[rows] for why, found in self.broken.items() if found[rows].any()}
        return replace(self, **some, broken=broken, images=None)

    @property
    def ku(self) -> float:
        return PRECISIONS[self.precision]

    @property
    def side(self) -> Side:
        """The side that its bounds are of."""
        return Side(self.ku, own=not self.as_exported, foreign=not self.exact_visibility)


def checked_answer(
    t: Any, n: Any, there: Array, *, precision: str | None = None, t_max: Array | float = np.inf, **more: Any
) -> Answer:
    """The answer from a candidate's arrays. precision: as declared; None: that of the arrays.

    there: (m,) bool, the pixels that have a row of the arrays; the others miss. t_max: a hit beyond it counts as a
    miss. n may be None. Each normal is divided by its length. Rows are no answer where t is NaN, negative or -inf, or
    where a hit has a normal that is not finite or has no length. Raises NoAnswer for arrays of another shape or type.
    """
    count = int(there.sum())
    t = spread(checked_array("t", t, (count,), np.inf), there, np.inf)
    n = None if n is None else spread(checked_array("n", n, (count, 3), 0.0), there, 0.0)
    precision = precision or str(min(a.dtype for a in (t, n) if a is not None))
    t = t.astype(np.float64)
    t = np.where(t > t_max, np.inf, t)
    broken = {"t is NaN": np.isnan(t), "t is negative": t < 0.0}
    hit = ~np.isposinf(t)
    if n is not None:
        n = n.astype(np.float64)
        whole = np.isfinite(n).all(axis=1)
        fine = hit & whole & n.any(axis=1)
        broken[NOT_FINITE] = hit & ~whole
        broken["the normal has no length on a hit"] = hit & whole & ~fine
        n = _directions(np.where(fine[:, None], n, 0.0))
    return Answer(t, n, precision, {why: rows for why, rows in broken.items() if rows.any()}, **more)


def spread(values: Array, there: Array, nothing: float) -> Array:
    """The values as rows of the pixels in `there`, (m,) bool; `nothing` at the others."""
    found = np.full((len(there), *values.shape[1:]), nothing, values.dtype)
    found[there] = values
    return found


def _directions(n: Array) -> Array:
    """Rows (n, 3) divided by their lengths; rows of zeros stay.

    Each is first divided by a power of two near its largest component, which is exact, so that squares neither overflow
    nor vanish.
    """
    _, exponent = np.frexp(np.abs(n).max(axis=1))
    n = np.ldexp(n, -exponent[:, None])
    length = np.linalg.norm(n, axis=1)
    return n / np.where(length > 0.0, length, 1.0)[:, None]


def checked_array(name: str, values: Any, shape: tuple[int, ...], nothing: float, *, whole: bool = False) -> Array:
    """A plain array of floats in native byte order, or of int64. nothing: that of a miss. Raises NoAnswer."""
    expected = f"shape {'(n,)' if len(shape) == 1 else '(n, 3)'} = {shape}"
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        masked = int(np.ma.getmaskarray(values).sum())
        raise NoAnswer(f"{name}: {masked} values are masked; fill them, such as {name}.filled({nothing})")
    try:
        a = np.asarray(values)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a foreign array type may raise anything; SystemExit would end the run with 0
        raise NoAnswer(f"{name} is no array: {type(error).__name__}: {exception_text(error)}") from error
    if a.dtype == object and not a.shape:
        raise NoAnswer(f"{name}: expected an array of {expected}, got {type(values).__name__}")
    if a.shape != shape:
        raise NoAnswer(f"{name}: expected {expected}, got {a.shape}")
    native = a.dtype.newbyteorder("=")
    if whole and a.dtype.kind in "biu":
        return a.astype(np.int64)
    if whole:
        raise NoAnswer(f"{name}: expected whole numbers, got {a.dtype}")
    if native not in (np.float32, np.float64):
        raise NoAnswer(f"{name}: expected float32 or float64 numbers, got {a.dtype}")
    return a.astype(native, copy=False)


def exception_text(error: BaseException) -> str:
    """The message of a foreign exception, which may be very long or itself raise."""
    try:
        words = str(error)
    except Exception as another:
        return f"(its message raises {type(another).__name__})"
    return printable(words[:LAST_WORDS]) + (" ..." if len(words) > LAST_WORDS else "")


# ---- the scene as both sides trace it: float32 values, meshes in world space ----


def describe_surface(part: Any, k: int) -> Fields:
    """A description of the same surface, not bit by bit. Raises LookupError for a kind without descriptions."""
    kind = kind_of(part)
    return (kind.describe_surface or kind.describe)(part, k)


def packs_identically(part: Any, k: int, packed: Packed) -> bool:
    """Whether a scene packs to just primitive k of these arrays, apart from a sphere's rotation, used for uv."""
    if len(packed.parts) != 1 or type(packed.parts[0]) is not type(part):
        return False
    describe = kind_of(part).describe
    return bool(describe(packed.parts[0], 0) == describe(part, k))


def kept_fields(shape: Shape) -> Fields:
    """Fields that apply to each primitive of a shape, whatever it is described as."""
    return {name: value for name in ("flip_normals", "material") if (value := getattr(shape, name, None))}


def scene_as_traced(scene: Scene, packed: Packed, folder: Path) -> Scene:
    """The scene with its shapes described by the float32 values that are traced. packed: by as_float32.

    Anything made of triangles becomes a `mesh` without a to_world, its PLY file in `folder`/meshes; a sphere becomes a
    `sphere` with centre and radius, or many in one shape `spheres` with a file; ellipsoids, cylinders and disks become
    their unit shape with one matrix; planes have a normal and a point. If a shape has several primitives and no such
    description, each becomes a shape, so that numbers of primitives through the scene stay as they are.
    """
    check_folder(folder / "meshes")
    shapes: list[Fields] = []
    for i, (shape, name, part) in enumerate(zip(scene.shapes, scene.shape_names(), packed.parts, strict=True)):
        named = {"name": name, **kept_fields(shape)}
        path = folder / "meshes" / f"{i:04d}-{safe_name(name)}.ply"
        count, describe_all = int(packed.first[i + 1] - packed.first[i]), kind_of(part).describe_all
        if isinstance(part, Triangles):
            write_bytes(path, ply_bytes(part))
            flat = {} if part.smooth.any() else {"face_normals": True}
            shapes.append({"type": "mesh", "file": str(path), **flat, **named})
        elif count != 1 and describe_all:
            shapes.append(describe_all(part, path) | named)
        else:
            shapes += [describe_surface(part, k) | named | ({"name": f"{name}-{k}"} if k else {}) for k in range(count)]
    fields = {name: getattr(scene, name) for name in ("film", "camera", "lights", "materials", "shading")}
    return Scene(**fields, shapes=shapes)


# ---- subjects ----


@dataclass(frozen=True)
class CastRequest:
    """One scene, its primitives in the float32 values that Mitsuba traces, and its rays."""

    scene: Scene  # as described
    model: SceneModel
    rays: SharedRays
    folder: Path  # a temporary one

    @cached_property
    def traced(self) -> Scene:
        """The scene described by the values that are traced; its meshes are files in `folder`."""
        return scene_as_traced(self.scene, self.model.packed, self.folder)

    def with_rays(self, rays: SharedRays) -> "CastRequest":
        """A request with other rays and the same scene object, so that a candidate can reuse what it cached for it."""
        other = replace(self, rays=rays)
        other.__dict__["traced"] = self.traced
        return other


@dataclass(frozen=True)
class Subject:
    """A ray caster to judge: ours, or a candidate in its place."""

    name: str  # as the user named it; "" for ours
    takes_rays: ClassVar[bool] = False  # it casts given rays, so that it can be asked about some of them

    @property
    def takes_limits(self) -> bool:
        """Whether it is given t_min and t_max of each ray, and heeds them."""
        return False

    @property
    def reads_xml(self) -> bool:
        """Whether it reads the XML that is exported for plain Mitsuba."""
        return False

    def answer(self, request: CastRequest) -> Answer:
        """The answer to every ray. Raises NoAnswer."""
        raise NotImplementedError


# ---- our own caster ----

# AOVs that are compared, beside the hit mask.
COMPARED_AOVS = ("depth", "position", "normal", "shading_normal", "uv", "shape_id", "diffuse")

# Further AOVs that follow from the hits.
DERIVED_AOVS = ("hit", "albedo", "prim_id")


def cast_ours(scene: Scene, rays: SharedRays) -> RayHits:
    """Cast the shared rays with our caster, on the float32 geometry."""
    return trace(scene, rays.o, rays.d, rays.t_max, rays.start, rounded=as_float32)


def answer_of_view(scene: Scene, view: RayHits) -> Answer:
    """The answer to the rays of a view, one per pixel of the film's window."""
    original, names = original_of(scene), [*COMPARED_AOVS, *DERIVED_AOVS]
    if original and original.coverage.unlit:
        names.remove("diffuse")
    images = evaluate(view, names, film_window(scene))
    nearest = view.nearest
    return Answer(nearest.t, None, FLOAT64, {}, prim=nearest.prim, images=images, exact_visibility=True)


@dataclass(frozen=True)
class OurCaster(Subject):
    """The subject `ours`."""

    takes_rays: ClassVar[bool] = True

    def answer(self, request: CastRequest) -> Answer:
        """Cast the request's rays."""
        return answer_of_view(request.scene, cast_ours(request.scene, request.rays))


OURS = OurCaster("")

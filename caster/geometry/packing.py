"""Packing: a scene as one NamedTuple of arrays per primitive kind, its numbering, and counts of rejected faces."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from caster.description.errors import SceneError, value_message
from caster.description.transform import cross, subtract
from caster.geometry.world_space import AnyScene, Rounding, as_float32, as_given
from caster.kernels.bvh.build import bound_hulls_in_space, hulls_of
from caster.kernels.protocol import hull_size
from caster.kernels.triangles import Triangles as Triangles

__all__ = ["Packed", "Triangles", "concatenate_parts", "forget_packed", "pack", "packed", "primitive_count"]


@dataclass(frozen=True)
class Kind:
    """All primitives of one kind, and their numbers in the scene."""

    prims: Any
    ids: np.ndarray  # (n,) int32
    # Data computed from these primitives on first use, such as their BVH (caster/rendering/bvh_construction.py).
    derived: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def bounded(self) -> bool:
        """Whether the primitives have bounding boxes; all of a kind do, or none."""
        return bool(hull_size(self.prims) > 0)

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounding boxes as (low, high) corners, (n, 3) each; not cached, since there may be millions."""
        low, high = np.empty((len(self.ids), 3)), np.empty((len(self.ids), 3))
        bound_hulls_in_space(*hulls_of(self.prims, len(low)), low, high)
        return low, high

    @cached_property
    def extent(self) -> float:
        """The largest |coordinate| of any bounding box."""
        return largest_coordinate(self.prims)


@dataclass(frozen=True)
class Packed:
    """A scene as kernels read it. Primitives are numbered consecutively, shape by shape."""

    kinds: tuple[Kind, ...]
    parts: tuple[Any, ...]  # the arrays of each shape, before concatenation by kind
    first: np.ndarray  # (shapes + 1,) int64, number of the first primitive of each shape
    flipped: np.ndarray | None = None  # (shapes,) bool, whether its normals are reversed; None: none are

    def shape_of(self, prim: np.ndarray) -> np.ndarray:
        """Shape index of each primitive number, -1 for -1; int32."""
        if len(self.parts) == 1:
            return np.where(prim < 0, np.int32(-1), np.int32(0))
        return (np.searchsorted(self.first, prim, side="right") - 1).astype(np.int32)

    @cached_property
    def prim_ids(self) -> np.ndarray:
        """(n,) int32, the number in the scene of each primitive, kind by kind: the order of PRIM in a tile."""
        ids = [kind.ids for kind in self.kinds]
        return ids[0] if len(ids) == 1 else np.concatenate([*ids, np.zeros(0, np.int32)])

    @cached_property
    def places(self) -> np.ndarray:
        """(n,) int32, where each primitive stands in `prim_ids`."""
        places = np.empty_like(self.prim_ids)
        places[self.prim_ids] = np.arange(len(places))
        return places

    @cached_property
    def prim_shapes(self) -> np.ndarray:
        """(n,) int32, shape of each primitive, kind by kind."""
        return self.shape_of(self.prim_ids)

    @cached_property
    def shape_extents(self) -> np.ndarray:
        """(shapes,) float64: the largest |coordinate| of the bounding boxes of each shape; 0 if it is unbounded."""
        return np.array([largest_coordinate(part) for part in self.parts])

    def place_of(self, prim: int) -> tuple[Kind, int]:
        """The kind of a primitive, and its index within the kind."""
        kind, k = self.kinds_of(np.array(prim))
        return self.kinds[int(kind)], int(k)

    def kinds_of(self, prim: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(index of the kind, index within the kind) of each primitive number."""
        place, ends = self.places[prim], np.cumsum([0, *(len(kind.ids) for kind in self.kinds)])
        kind = np.searchsorted(ends, place, side="right") - 1
        return kind, place - ends[kind]

    def index_in_shape(self, prim: np.ndarray) -> np.ndarray:
        """Index within its shape of each primitive number, -1 for -1; int32."""
        shape = self.shape_of(prim)
        return np.where(prim < 0, -1, prim - self.first[np.maximum(shape, 0)]).astype(np.int32)


def pack(scene: AnyScene, rounded: Rounding = as_given) -> Packed:
    """Pack all shapes into world-space arrays, with `rounded` applied to the numbers that define the geometry.

    Raises SceneError for a shape whose numbers do not stay finite.
    """
    parts = tuple(pack_shape(scene, i, rounded) for i in range(len(scene.shapes)))
    first = np.cumsum([0, *map(primitive_count, parts)])
    kinds = []
    for cls in dict.fromkeys(map(type, parts)):
        members = [s for s, part in enumerate(parts) if type(part) is cls]
        ids = np.concatenate([np.arange(first[s], first[s + 1], dtype=np.int32) for s in members])
        kinds.append(Kind(concatenate_parts([parts[s] for s in members]), ids))
    flipped = np.array([getattr(shape, "flip_normals", False) for shape in scene.shapes], bool)
    return Packed(tuple(kinds), parts, first, flipped if flipped.any() else None)


CACHED_AS: dict[Rounding, str] = {as_given: "packed", as_float32: "packed float32"}  # keys of Scene.derived


def packed(scene: AnyScene, rounded: Rounding = as_given) -> Packed:
    """The packing of a scene, cached with it and so with its bounding boxes and BVHs; see `pack`."""
    key = CACHED_AS[rounded]
    if key not in scene.derived:
        scene.derived[key] = pack(scene, rounded)
    return scene.derived[key]


def forget_packed(scene: AnyScene, rounded: Rounding, at_least: int) -> None:
    """Drop a cached packing of `at_least` primitives, with its BVHs; the scene is packed again when needed."""
    key = CACHED_AS[rounded]
    if key in scene.derived and scene.derived[key].first[-1] >= at_least:
        del scene.derived[key]


def pack_shape(scene: AnyScene, i: int, rounded: Rounding) -> Any:
    """Pack one shape. Raises SceneError unless all numbers are finite, ValueError for a mesh with arrays too short."""
    part: Any = None
    with np.errstate(all="ignore"), contextlib.suppress(np.linalg.LinAlgError):
        part = scene.shapes[i].pack(rounded)
    if part is None or not all(np.isfinite(array).all() for array in part):
        text = "must stay finite in world space, but its numbers are too large or too small together"
        raise SceneError(value_message(("shapes", i), text, scene, type(scene)))
    if isinstance(part, Triangles):  # whose arrays kernels would read beyond their ends
        shape, vertices, faces = type(scene.shapes[i]).__name__, len(part.vertices), len(part.faces)
        for name, expected in (("normals", vertices), ("uv", vertices), ("smooth", faces), ("textured", faces)):
            if (found := len(getattr(part, name))) != expected:
                raise ValueError(f"{shape}.pack: {name} must have {expected} rows, got {found}; fill up with zeros")
    return part


def largest_coordinate(prims: Any) -> float:
    """The largest |coordinate| of the bounding boxes of primitives; 0 without primitives or bounds."""
    if isinstance(prims, Triangles):  # from vertices: boxes of millions of triangles take seconds and hundreds of MB
        used = np.zeros(len(prims.vertices), bool)
        used[prims.faces] = True
        points = prims.vertices if used.all() else prims.vertices[used]
    else:
        points, _ = hulls_of(concatenate_parts([prims]), primitive_count(prims))
    return float(max(points.max(initial=0.0), -points.min(initial=0.0)))


def primitive_count(part: Any) -> int:
    """Number of primitives of a NamedTuple of arrays."""
    return len(part.faces if isinstance(part, Triangles) else part[0])


def concatenate_parts(parts: Sequence[Any]) -> Any:
    """Concatenate parts of one kind; vertex numbers in `faces` are shifted, since vertices are concatenated, too."""
    if len(parts) == 1:  # copied only where Numba would compile kernels again for another layout
        return type(parts[0])(*(np.require(array, None, ("C", "A", "W")) for array in parts[0]))
    if isinstance(parts[0], Triangles):
        ends = np.cumsum([len(part.vertices) for part in parts])
        shifts = [0, *ends.tolist()[:-1]]
        faces = [(part.faces + shift).astype(np.int32) for part, shift in zip(parts, shifts, strict=True)]
        parts = [part._replace(faces=each) for part, each in zip(parts, faces, strict=True)]
    fields = zip(*parts, strict=True)
    return type(parts[0])(*(np.ascontiguousarray(np.concatenate(arrays)) for arrays in fields))


# Counts of rejected faces: not finite, too far out or degenerate (docs/scene-format.md, "Rejected faces").


# The error of a component of a cross product of two differences is at most 4 u of its two terms, each of which is at
# most the product of the largest components; u = 2^-53. The error of products that underflow is 2^-1074, far below
# CROSS_UNDERFLOW.
CROSS_RELATIVE_ERROR, CROSS_UNDERFLOW = 10.0 * 2.0**-53, 2.0**-1000

FACES_PER_CHUNK = 1 << 16  # faces; temporaries take some 300 bytes each, and there may be millions


def rejected_faces(scene: AnyScene) -> dict[str, int]:
    """Counts of degenerate faces by shape name, where there are any; packing makes degenerate what else it rejects."""
    counts = {
        name: sum(
            _count_degenerate(part.vertices[part.faces[start : start + FACES_PER_CHUNK]])
            for start in range(0, len(part.faces), FACES_PER_CHUNK)
        )
        for name, part in zip(scene.shape_names(), packed(scene).parts, strict=True)
        if isinstance(part, Triangles)
    }
    return {name: count for name, count in counts.items() if count}


def _count_degenerate(corners: np.ndarray) -> int:
    """corners: (m, 3, 3), finite."""
    alike = (corners == np.roll(corners, 1, axis=1)).all(axis=2).any(axis=1)  # two corners in one place
    repeated, corners = int(alike.sum()), corners[~alike]
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    error = CROSS_RELATIVE_ERROR * np.abs(e).max(axis=1) * np.abs(f).max(axis=1) + CROSS_UNDERFLOW
    sure = np.abs(np.cross(e, f)).max(axis=1) > error
    for face in corners[~sure].tolist():
        a, b, c = ([*map(Fraction, corner)] for corner in face)
        repeated += not any(cross(subtract(b, a), subtract(c, a)))
    return repeated


def in_words(scene: AnyScene) -> str:
    """The counts as text; "" if there are none."""
    return ", ".join(f"{count} of {name}" for name, count in rejected_faces(scene).items())

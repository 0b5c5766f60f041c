"""Comparison of a subject with the reference, pixel by pixel: error over bound of every quantity, and self-checks.

A subject that names the primitive it hits, as our caster does, is compared with the reference's image within
float32's bounds at that primitive, and with an independent computation at that primitive within the bounds of its own
precision. Any other subject is compared with the primitive that the reference names, within bounds of its precision.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from caster.aovs import Aovs
from caster.rendering.images import film_window
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, error_over_bound, intersections_at, row_distance
from mitsuba_ref.error_model.intersections import (
    Array,
    Intersections,
    Rays,
    any_of_columns,
    norm,
    without_float_warnings,
    without_overflow_warnings,
)
from mitsuba_ref.error_model.scene_model import OUR_SIDE, REFERENCE_SIDE, SceneModel
from mitsuba_ref.error_model.textures import ColoredPoints, color_ratios
from mitsuba_ref.error_model.tolerances import KU_OURS
from mitsuba_ref.reference.rendering import ReferenceResult, aovs_of
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.subjects.subject import COMPARED_AOVS, NOT_FINITE, Answer

# Quantities whose bound a scene's own [check.AOV] may scale; the others are compared exactly.
BOUNDED_AOVS = ("depth", "position", "normal", "shading_normal", "uv", "diffuse")

# Expected values of AOVs on a miss, independent of the caster's; 0 for all others.
MISS_VALUES = {"depth": np.inf, "shape_id": -1, "prim_id": -1}


# AOVs of the reference that a subject is compared with if it answers t and n alone.
CLAIMED_AOVS = ("depth", "position", "normal", "shading_normal", "shape_id")


@dataclass(frozen=True)
class ImagePair:
    """The answers of a subject and of the reference along the same rays, and both as images of one scene."""

    rays: SharedRays
    answer: Answer
    subject: Aovs  # the AOVs that the subject gives, and no others
    reference: Aovs  # at least the same
    result: ReferenceResult


def pair_images(scene: Scene, rays: SharedRays, answer: Answer, result: ReferenceResult) -> ImagePair:
    """Both answers as images under the same names."""
    window = film_window(scene)
    shape = window.height, window.width
    subject = _images_of(answer, rays, shape) if answer.images is None else answer.images
    names = CLAIMED_AOVS if answer.images is None else [name for name in COMPARED_AOVS if name in answer.images]
    return ImagePair(rays, answer, subject, aovs_of(result, rays, shape, names), result)


@without_overflow_warnings
def _images_of(answer: Answer, rays: SharedRays, shape: tuple[int, int]) -> Aovs:
    """t and n as images, with depth from the eye like the reference's. A normal that is not finite becomes NaN."""
    depth = rays.start + answer.t * norm(rays.d.astype(np.float64))
    images = {"depth": depth.reshape(shape)}
    if answer.n is not None:
        none = answer.broken.get(NOT_FINITE, np.zeros(len(answer.t), bool))
        images["normal"] = np.where(none[:, None], np.nan, answer.n).reshape(*shape, 3)
    for name, ids in (("shape_id", answer.shape_id), ("prim_id", answer.prim_id)):
        if ids is not None:
            images[name] = ids.reshape(shape)
    return Aovs(images, answer.hit.reshape(shape))


def reference_prims(result: ReferenceResult, model: SceneModel) -> Array:
    """(n,) the number in the scene of the primitive that Mitsuba names, -1 on a miss.

    A shape with a stand-in counts as its first primitive, since Mitsuba numbers the stand-in's own triangles.
    """
    shape = result.shape_id
    first, last = model.packed.first[shape], model.packed.first[shape + 1]
    prim = first + result.answer.prim
    prim = np.where((prim >= first) & (prim < last), prim, first)
    return np.where(result.hit & (shape >= 0), prim, -1).astype(np.int32)


class UvPair(NamedTuple):
    """uv of both sides in the UvSpace of the primitive in question."""

    subject: Array  # (n, 3)
    reference: Array  # (n, 3) the subject's, where the reference has no uv of that primitive
    bound: Array  # (n,) of their distance


class SelfCheck(NamedTuple):
    """One quantity of the subject, compared in float64 with the primitive that it names."""

    error: Array  # (n,) distance from the primitive's own value
    bound: Array  # (n,) that float64 allows
    counts: Array  # (n,) bool: where it is compared

    @property
    def fails(self) -> Array:
        """(n,) bool."""
        return self.counts & ~(self.error <= self.bound)


class Pixels:
    """The pixels of a film, row by row: the answers of both sides along the same rays, and the bounds between them."""

    def __init__(self, scene: Scene, model: SceneModel, pair: ImagePair, view: SceneModel | None = None):
        """view: the model as the subject may see it, if not `model`."""
        self.scene, self.model, self.pair, self.view = scene, model, pair, view or model
        self.rays, self.answer, self.result = pair.rays, pair.answer, pair.result
        o, d, t_max = (a.astype(np.float64) for a in self.rays[:3])
        self.lines = Rays(o, d, np.broadcast_to(np.asarray(self.rays.t_min, np.float64), t_max.shape), t_max)
        self.o, self.d, self.t_min, self.t_max = self.lines
        self.subject, self.reference = pair.subject, pair.reference
        self.hit = self.subject.hit.ravel()
        self.reference_prim = reference_prims(self.result, model)
        # The primitive at which the subject is held to bounds: its own, or if it names none, the reference's.
        self.names_prims = self.answer.prim is not None
        self.prim = self.reference_prim if self.answer.prim is None else self.answer.prim
        t, reference_t = (self.answer.t,) * 2 if self.names_prims else (self.result.t, self.reference_t)
        # The intersections with it: in the subject's precision, and with the reference's error bounds.
        self.own = self.near(slice(None), self.prim, t)
        self.at = intersections_at(model, self.prim, *self.reference_lines[:2], reference_t, REFERENCE_SIDE)
        with np.errstate(invalid="ignore"):
            self.point = self.o + self.answer.t[:, None] * self.d
        if self.answer.prim_id is not None:  # as packed: Mitsuba counts the triangles of a stand-in by itself
            numbers = model.packed.index_in_shape(self.reference_prim).reshape(self.shape)
            self.reference = Aovs({**pair.reference, "prim_id": numbers}, pair.reference.hit)
        self.uv = self._uv_pair() if "uv" in self.subject else None
        # No rounding excuses images that contradict themselves.
        self.inconsistent = inconsistent_aovs(self)
        self.consistent = ~np.any([np.zeros(len(self.hit), bool), *self.inconsistent.values()], axis=0)

    def _uv_pair(self) -> UvPair:
        """uv of both sides; if the reference names the other face of an edge, its uv are compared at that face."""
        prim, theirs = self.prim, aov_rows(self.reference, "uv")
        ours = self.model.uv_points(prim, aov_rows(self.subject, "uv"), OUR_SIDE)
        reference = self.model.uv_points(prim, theirs, REFERENCE_SIDE)
        known, bound = self.model.reference_has_uv(prim), self.at.uv_error.copy()
        rows = np.flatnonzero((prim >= 0) & (self.reference_prim >= 0) & (self.reference_prim != prim) & known)
        if len(rows):
            other, lines = self.reference_prim[rows], self.reference_lines.take(rows)
            at = intersections_at(self.model, other, *lines[:2], self.reference_t[rows], REFERENCE_SIDE)
            moved = self.model.uv_points(other, theirs[rows], REFERENCE_SIDE) - at.uv
            reference[rows], bound[rows] = ours[rows] + moved, at.uv_error
        return UvPair(ours, np.where(known[:, None], reference, ours), bound)

    def near(self, rows: Array | slice, prim: Array, t: Array) -> Intersections:
        """Intersections of some rays with these primitives as the subject may see them; the root nearest to t."""
        return intersections_at(self.view, prim, self.o[rows], self.d[rows], t, self.answer.side)

    @cached_property
    def reference_lines(self) -> Rays:
        """The rays as Mitsuba traced them: `lines`, but for rays of a list."""
        o, d, t_max = (a.astype(np.float64) for a in self.rays.for_reference()[:3])
        return Rays(o, d, np.zeros(len(o)), t_max)

    @property
    def reference_t(self) -> Array:
        """(n,) Mitsuba's t along `reference_lines`, where self.result.t counts from o."""
        return self.result.answer.t.astype(np.float64)

    @property
    def n(self) -> Array | None:
        """(n, 3) the subject's geometric normals, if it gives any."""
        return aov_rows(self.subject, "normal") if self.answer.n is None and self.names_prims else self.answer.n

    def sides(self, name: str) -> tuple[Array, Array]:
        """(the subject's, the reference's) values of one AOV, (n,) or (n, c)."""
        return aov_rows(self.subject, name), aov_rows(self.reference, name)

    def distance(self, name: str) -> Array:
        """(n,) between both sides, uv in the space of their kind, where seams and poles are no jumps."""
        uv = self.uv[:2] if name == "uv" and self.uv else None
        sides = uv or (values.reshape(len(values), -1) for values in self.sides(name))
        return row_distance(*sides)

    @cached_property
    @without_overflow_warnings
    def allowed_distance(self) -> dict[str, Array]:
        """(n,) bound on the distance of each AOV of a subject that names its primitives.

        That of depth is the bound of t, in scene units, plus one rounding of our own sum of start and t |d|. That of a
        position includes the bound of t along the ray, and how Mitsuba computes a position from it (barycentrics on
        triangles, a pull onto the wall of a cylinder). Normals are unit vectors: one of another length, or reversed,
        differs by far more than any bound.
        """
        at = self.at
        depth = at.t_error * self.length + KU_OURS * np.abs(aov_rows(self.subject, "depth"))
        found = {"depth": depth, "position": at.p_error, "normal": at.n_error, "shading_normal": at.sh_error}
        return found if self.uv is None else found | {"uv": self.uv.bound}

    @cached_property
    def self_checks(self) -> dict[str, SelfCheck]:
        """Vectors wherever the subject hits, also where the reference does not; none if it names no primitive.

        Where float64 does not resolve t, only the geometric normal is compared: the others follow from t.
        """
        prim, own = self.answer.prim, self.own
        if prim is None:
            return {}
        hit = prim >= 0
        resolved = hit & np.isfinite(own.t_error)
        held = [
            ("normal", own.n, own.n_error, hit),
            ("shading_normal", own.sh_n, own.sh_error, resolved),
            ("position", self.point, own.p_error, resolved),
        ]
        found = {
            name: SelfCheck(row_distance(aov_rows(self.subject, name), value), bound, counts)
            for name, value, bound, counts in held
        }
        if self.uv is not None:
            found["uv"] = SelfCheck(row_distance(self.uv.subject, own.uv), own.uv_error, resolved)
        return found

    @property
    def both_hit(self) -> Array:
        """(n,) bool."""
        return self.hit & self.reference.hit.ravel()

    @property
    def any_hit(self) -> Array:
        """(n,) bool: hit by either side."""
        return self.hit | self.result.hit

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        height, width = self.subject.hit.shape
        return height, width

    @cached_property
    def length(self) -> Array:
        """(n,) of each ray's d."""
        return norm(self.d)

    @property
    def subject_prim(self) -> Array:
        """(n,) the subject's primitives, numbered through the scene; -1 on a miss, or if it names none."""
        return np.full(len(self.hit), -1, np.int32) if self.answer.prim is None else self.answer.prim


@without_float_warnings
def check_ratios(pixels: Pixels) -> dict[str, Array]:
    """Error over bound of each check whose quantities are given, (n,) each; inf for another hit, shape or primitive."""
    answer, own, hit, both = pixels.answer, pixels.own, pixels.hit, pixels.both_hit

    def unequal(subject: Array, reference: Array) -> Array:
        return np.where(subject == reference, 0.0, np.inf)

    found = {"mask": unequal(hit, pixels.reference.hit.ravel())}
    # |t - t computed anew at the primitive|; inf if the ray misses it. All other bounds belong to this primitive: if it
    # were the wrong one, they would be worthless.
    error = np.abs(answer.t - own.t)
    ratio = np.where(own.possible, error_over_bound(error, own.t_error + answer.t_rounding), np.inf)
    on_surface = np.where(hit, ratio, 0.0)
    if answer.prim is None:  # the primitive that the reference names
        if not answer.hits_only:
            found["depth"] = np.where(both, on_surface, 0.0)
        if answer.n is not None:
            found["normal"] = np.where(both, error_over_bound(row_distance(answer.n, own.n), own.n_error), 0.0)
        given = {"shape_id": answer.shape_id, "prim_id": answer.prim_id}
        return found | {name: unequal(*pixels.sides(name)) for name, ids in given.items() if ids is not None}
    found |= {"shape_id": unequal(*pixels.sides("shape_id")), "on_surface": on_surface}
    for name, bound in pixels.allowed_distance.items():
        found[name] = np.where(both, error_over_bound(pixels.distance(name), bound), 0.0)
        if check := pixels.self_checks.get(name):
            own_ratio = np.where(both | check.fails, error_over_bound(check.error, check.bound), 0.0)
            found[name] = np.maximum(found[name], own_ratio)
    return found


@without_float_warnings
def inconsistent_aovs(pixels: Pixels) -> dict[str, Array]:
    """Where the AOVs of a subject that names its primitives contradict its hits; (n,) bool, by check.

    No rounding excuses a number that is not finite on a hit, a value on a miss, or a depth, mask, primitive or albedo
    that does not follow from the hit.
    """
    scene, packed, prim = pixels.scene, pixels.model.packed, pixels.answer.prim
    if prim is None:
        return {}
    subject, t = pixels.subject, pixels.answer.t
    hit = np.isfinite(t)
    found = {}
    for name in COMPARED_AOVS:
        if name in subject:
            values = aov_rows(subject, name).reshape(len(hit), -1)
            unfit = np.where(hit[:, None], ~np.isfinite(values), values != MISS_VALUES.get(name, 0))
            found[name] = any_of_columns(unfit)
    depth = pixels.rays.start + t * pixels.length  # from the eye, up to three roundings
    found["depth"] |= hit & ~(np.abs(aov_rows(subject, "depth") - depth) <= KU_OURS * np.abs(depth))
    found["mask"] = (subject.hit.ravel() != hit) | (aov_rows(subject, "hit") != hit)
    shape = aov_rows(subject, "shape_id")
    prim_id = np.where(hit, prim - packed.first[np.maximum(shape, 0)], MISS_VALUES["prim_id"])
    found["shape_id"] |= aov_rows(subject, "prim_id") != prim_id
    if "diffuse" not in subject:  # a Mitsuba file with lights or materials that the caster has not
        return found
    colors = np.array([scene.material_of(each).color for each in scene.shapes]).reshape(-1, 3)
    albedo, textures = aov_rows(subject, "albedo"), scene.textures
    expected = np.where(hit[:, None], colors[shape], 0.0) if len(colors) else np.zeros((len(hit), 3))
    untextured = ~(hit & np.array([*(texture is not None for texture in textures), False])[shape])
    found["diffuse"] |= untextured & any_of_columns(albedo != expected)
    if any(textures):
        at = ColoredPoints(shape, prim_id, *(aov_rows(subject, name) for name in ("uv", "position", "albedo")))
        found["diffuse"] |= color_ratios(textures, packed.parts, at, KU_OURS) > 1.0
    return found

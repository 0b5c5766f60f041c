"""Comparison of a subject with the reference, pixel by pixel: error over bound of every quantity, and self-checks.

A subject that names the primitive it hits, as our caster does, is compared with the reference's image within
float32's bounds at that primitive, and with an independent computation at that primitive within the bounds of its own
precision. Any other subject is compared with the primitive that the reference names, within bounds of its precision.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from caster.aovs import Aovs
from caster.description.errors import SceneError
from caster.geometry.packing import Packed
from caster.rendering.images import film_window
from caster.scene.model import Check, Scene
from mitsuba_ref.error_model.bounds import Bounds, aov_rows, error_over_bound, row_distance
from mitsuba_ref.error_model.intersections import (
    Array,
    any_of_columns,
    norm,
    without_float_warnings,
    without_overflow_warnings,
)
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

    @cached_property
    def length(self) -> Array:
        """(n,) of each ray's d."""
        return norm(self.rays.d.astype(np.float64))

    @property
    def t(self) -> Array:
        """(n,) the subject's."""
        return self.answer.t

    @property
    def prim(self) -> Array:
        """(n,) the subject's primitives, numbered through the scene; -1 on a miss, or if it names none."""
        return np.full(len(self.t), -1, np.int32) if self.answer.prim is None else self.answer.prim

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        height, width = self.subject.hit.shape
        return height, width

    @property
    def any_hit(self) -> Array:
        """(n,) bool: hit by either side."""
        return self.subject.hit.ravel() | self.result.hit


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


@dataclass(frozen=True)
class PixelPairs:
    """Input of the checks: both sides' images, n pixels row by row, and the bounds between them."""

    subject: Aovs
    reference: Aovs
    bounds: Bounds
    answer: Answer  # of the subject
    length: Array  # (n,) of each ray's d
    point: Array  # (n, 3) o + t d at the subject's hits
    uv: UvPair | None = None  # None: not given

    def pair(self, name: str) -> tuple[Array, Array]:
        """(the subject's, the reference's) values of one AOV, (n,) or (n, c)."""
        return aov_rows(self.subject, name), aov_rows(self.reference, name)

    def distance(self, name: str) -> Array:
        """(n,) between both sides, uv in the space of their kind, where seams and poles are no jumps."""
        uv = self.uv[:2] if name == "uv" and self.uv else None
        sides = uv or (values.reshape(len(values), -1) for values in self.pair(name))
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
        at = self.bounds.at
        depth = at.t_error * self.length + KU_OURS * np.abs(aov_rows(self.subject, "depth"))
        found = {"depth": depth, "position": at.p_error, "normal": at.n_error, "shading_normal": at.sh_error}
        return found if self.uv is None else found | {"uv": self.uv.bound}

    @cached_property
    def self_checks(self) -> dict[str, SelfCheck]:
        """Vectors wherever the subject hits, also where the reference does not; none if it names no primitive.

        Where float64 does not resolve t, only the geometric normal is compared: the others follow from t.
        """
        prim, own = self.answer.prim, self.bounds.own
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
        return self.subject.hit.ravel() & self.reference.hit.ravel()


@without_float_warnings
def check_ratios(pixels: PixelPairs) -> dict[str, Array]:
    """Error over bound of each check whose quantities are given, (n,) each; inf for another hit, shape or primitive."""
    answer, own, both = pixels.answer, pixels.bounds.own, pixels.both_hit

    def unequal(subject: Array, reference: Array) -> Array:
        return np.where(subject == reference, 0.0, np.inf)

    hit = pixels.subject.hit.ravel()
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
        return found | {name: unequal(*pixels.pair(name)) for name, ids in given.items() if ids is not None}
    found |= {"shape_id": unequal(*pixels.pair("shape_id")), "on_surface": on_surface}
    for name, bound in pixels.allowed_distance.items():
        found[name] = np.where(both, error_over_bound(pixels.distance(name), bound), 0.0)
        if check := pixels.self_checks.get(name):
            own_ratio = np.where(both | check.fails, error_over_bound(check.error, check.bound), 0.0)
            found[name] = np.maximum(found[name], own_ratio)
    return found


def allowed_shares(checks: Mapping[str, Check]) -> dict[str, float]:
    """The share of its bound that each check may use, if the scene sets one by [check.AOV].

    Raises SceneError for a [check.AOV] that has no effect.
    """
    for name in checks:
        if name not in BOUNDED_AOVS:
            raise SceneError(f"check.{name}: {name} has no bound to scale; only {', '.join(BOUNDED_AOVS)} have one")
    return {name: check.ratio for name, check in checks.items()}


@without_float_warnings
def inconsistent_aovs(scene: Scene, packed: Packed, pair: ImagePair) -> dict[str, Array]:
    """Where the AOVs of a subject that names its primitives contradict its hits; (n,) bool, by check.

    No rounding excuses a number that is not finite on a hit, a value on a miss, or a depth, mask, primitive or albedo
    that does not follow from the hit.
    """
    if pair.answer.prim is None:
        return {}
    subject, hit = pair.subject, np.isfinite(pair.t)
    found = {}
    for name in COMPARED_AOVS:
        if name in subject:
            values = aov_rows(subject, name).reshape(len(hit), -1)
            unfit = np.where(hit[:, None], ~np.isfinite(values), values != MISS_VALUES.get(name, 0))
            found[name] = any_of_columns(unfit)
    depth = pair.rays.start + pair.t * pair.length  # from the eye, up to three roundings
    found["depth"] |= hit & ~(np.abs(aov_rows(subject, "depth") - depth) <= KU_OURS * np.abs(depth))
    found["mask"] = (subject.hit.ravel() != hit) | (aov_rows(subject, "hit") != hit)
    shape = aov_rows(subject, "shape_id")
    prim_id = np.where(hit, pair.answer.prim - packed.first[np.maximum(shape, 0)], MISS_VALUES["prim_id"])
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

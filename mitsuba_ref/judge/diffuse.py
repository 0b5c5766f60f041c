"""Comparison of the diffuse AOV with the sum of Mitsuba's lights, up to bounds and to shadows that may differ."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from caster.scene.model import Scene
from mitsuba_ref.error_model import lambert
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.bracket import Bracket
from mitsuba_ref.error_model.intersections import Array, Intersections, without_float_warnings
from mitsuba_ref.error_model.lambert import LightChoices, LightContribution, ShadingPoints, smallest_error_ratio
from mitsuba_ref.error_model.textures import ColoredPoints, color_ratios
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.judge.comparison import Pixels
from mitsuba_ref.reference.rendering import ReferenceResult


class Lights(NamedTuple):
    """All lights but the ambient ones at m pixels, by their definitions, without shadows."""

    each: list[LightContribution]
    radiance: Array  # (lights, m, 3)
    error: Array  # (lights, m, 3)
    doubtful: Array  # (lights, m) bool: at such a grazing angle


def judge_diffuse(pixels: Pixels, rows: Array, brackets: tuple[Bracket, Bracket]) -> tuple[Array, Array, Array]:
    """Compare the pixels `rows`, where geometry agrees; brackets: the subject's and the reference's.

    Returns (n,) each: the difference over its bound with Mitsuba's own shadows, 0 elsewhere; whether other shadows that
    rounding allows both sides give our value; whether Mitsuba's own value has no useful bound.
    """
    scene, result, count = pixels.scene, pixels.result, len(pixels.hit)
    ratio, explained, unresolvable = np.zeros(count), np.zeros(count, bool), np.zeros(count, bool)
    lights = _lights(scene, hits_of(pixels, pixels.at, rows), KU)
    textures, reference_ratio = scene.textures, np.zeros(count)
    if any(textures):
        answer = result.answer
        p, uv = (each[rows].astype(np.float64) for each in (answer.p, answer.uv))
        at = ColoredPoints(result.shape_id[rows], answer.prim[rows], uv, p, answer.albedo[rows])
        reference_ratio[rows] = color_ratios(textures, pixels.model.packed.parts, at, KU)
        result = _for_our_albedo(pixels, rows, lights)
    given, no_doubt = _as_given(result, lights, rows), np.zeros_like(lights.doubtful)
    ratio[rows] = _ratio(pixels, result, rows, LightChoices(*given, *given, no_doubt))
    ratio = np.maximum(ratio, reference_ratio)
    beyond = rows[ratio[rows] > 1.0]
    if len(beyond):
        hit = hits_of(pixels, pixels.at, beyond)
        lights = _lights(scene, hit, KU)
        choices = _choices(pixels, result, lights, hit, beyond, brackets)
        explained[beyond] = _ratio(pixels, result, beyond, choices) <= 1.0
        explained &= reference_ratio <= 1.0
        unresolvable[beyond] = ~np.isfinite(lights.error).all(axis=(0, 2))
    return ratio, explained, unresolvable


def diffuse_within_float64(scene: Scene, hit: ShadingPoints, prim: Array, values: Array, bracket: Bracket) -> Array:
    """(m,) bool: our values (m, 3) follow Lambert's law, with some shadows that float64 rounding allows us.

    hit: in float64, with float64's bounds; prim (m,): the primitives that are hit.
    """
    lights = _lights(scene, hit, KU_OURS)
    lit, shaded = np.ones_like(lights.doubtful), np.zeros_like(lights.doubtful)
    if scene.shading.shadows:
        for i, light in enumerate(lights.each):
            shaded[i], certain = lambert.our_shadows(bracket, hit, light, prim)
            lit[i] = ~certain
    first, error = (np.where(lit[..., None], each, 0.0) for each in (lights.radiance, lights.error))
    dark = np.zeros_like(first)
    choices = LightChoices(first, error, dark, dark, lit & (shaded | lights.doubtful))
    ambient = hit.reflectance * lambert.ambient_radiance(scene.lights)
    return smallest_error_ratio(values, ambient, choices, KU_OURS) <= 1.0


def hits_of(pixels: Pixels, at: Intersections, rows: Array) -> ShadingPoints:
    """Our hits at some pixels, with the bounds `at`."""
    shape, albedo = (aov_rows(pixels.subject, name)[rows] for name in ("shape_id", "albedo"))
    return shading_points(pixels.scene, pixels.point[rows], pixels.d[rows], at.take(rows), shape, albedo)


def shading_points(scene: Scene, p: Array, d: Array, at: Intersections, shape: Array, albedo: Array) -> ShadingPoints:
    """Hits on shapes (m,). albedo: (m, 3) the subject's, which is used where a texture decides it."""
    materials = [scene.material_of(each) for each in scene.shapes]
    textured = np.array([each.texture is not None for each in materials], bool)[shape, None]
    colors = np.array([each.color for each in materials]).reshape(-1, 3)[shape]
    two_sided = np.array([each.two_sided for each in materials], bool)[shape]
    return ShadingPoints(p, d, at, np.where(textured, albedo, colors), two_sided)


@without_float_warnings
def _for_our_albedo(pixels: Pixels, rows: Array, lights: Lights) -> ReferenceResult:
    """Mitsuba's light reflected by our textures: the reflectances are compared by themselves.

    Where Mitsuba's reflectance is 0, which hides its light, the light is that of the definitions.
    """
    scene, result, ours = pixels.scene, pixels.result, aov_rows(pixels.subject, "albedo")[rows]
    theirs = result.answer.albedo[rows].astype(np.float64)
    textured = np.array([texture is not None for texture in scene.textures])[aov_rows(pixels.subject, "shape_id")[rows]]
    unshadowed, ambient = result.unshadowed.copy(), result.ambient.copy()
    light = np.where(theirs > 0.0, unshadowed[:, rows] * (ours / theirs), lights.radiance)
    unshadowed[:, rows] = np.where(textured[:, None], light, unshadowed[:, rows])
    ambient[rows] = np.where(textured[:, None], ours * lambert.ambient_radiance(scene.lights), ambient[rows])
    return replace(result, unshadowed=unshadowed, ambient=ambient)


def _lights(scene: Scene, hit: ShadingPoints, ku: float) -> Lights:
    each = [lambert.light_contribution(light, hit, ku) for light in scene.lights if light.type != "ambient"]
    shape = len(each), len(hit.p)
    doubtful = np.array([light.doubtful for light in each], bool).reshape(shape)
    radiance, error = (
        np.array([getattr(light, name) for light in each]).reshape(*shape, 3) for name in ("radiance", "error")
    )
    return Lights(each, radiance, error, doubtful)


def _as_given(result: ReferenceResult, lights: Lights, rows: Array) -> tuple[Array, Array]:
    """(lights, m, 3) each: Mitsuba's radiance, its shadows included, and its error."""
    visible = result.visible[:, rows, None]
    return np.where(visible, result.unshadowed[:, rows], 0.0), np.where(visible, lights.error, 0.0)


def _ratio(pixels: Pixels, result: ReferenceResult, rows: Array, choices: LightChoices) -> Array:
    return smallest_error_ratio(aov_rows(pixels.subject, "diffuse")[rows], result.ambient[rows], choices, KU)


def _choices(
    pixels: Pixels,
    result: ReferenceResult,
    lights: Lights,
    hit: ShadingPoints,
    rows: Array,
    brackets: tuple[Bracket, Bracket],
) -> LightChoices:
    """Mitsuba's answer for each light, or the contrary where rounding allows each side its own answer.

    A face lit at a grazing angle may be lit or not, and a shadow may be there or not.
    """
    ours, theirs = brackets
    doubt = lights.doubtful.copy()
    p, n = (aov_rows(pixels.reference, name)[rows] for name in ("position", "normal"))
    for i, light in enumerate(lights.each if pixels.scene.shading.shadows else ()):
        they_may, they_must = theirs.blocked(lambert.reference_shadow_rays(hit, light, p, n))
        we_may, we_must = lambert.our_shadows(ours, hit, light, pixels.subject_prim[rows])
        doubt[i] |= np.where(result.visible[i, rows], we_may & ~they_must, they_may & ~we_must)
    given, error = _as_given(result, lights, rows)
    bright = np.asarray(given.any(axis=-1))[..., None]
    contrary, its_error = (np.where(bright, 0.0, each) for each in (lights.radiance, lights.error))
    return LightChoices(given, error, contrary, its_error, doubt)

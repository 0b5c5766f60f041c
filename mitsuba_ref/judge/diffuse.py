"""Comparison of the diffuse AOV with the sum of Mitsuba's lights, up to bounds and to shadows that may differ."""

from typing import NamedTuple

import numpy as np

from caster.scene.model import Scene
from mitsuba_ref.error_model import lambert
from mitsuba_ref.error_model.bounds import Bounds, aov_rows
from mitsuba_ref.error_model.bracket import Bracket
from mitsuba_ref.error_model.intersections import Intersections
from mitsuba_ref.error_model.lambert import (
    LightChoices,
    LightContribution,
    Materials,
    ShadingPoints,
    certain_lights,
    smallest_error_ratio,
)
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.judge.comparison import ImagePair


class DiffuseComparison(NamedTuple):
    """One row a pixel; pixels that are not judged have ratio 0."""

    ratio: np.ndarray  # (n,) difference over bound with Mitsuba's own shadows
    explained: np.ndarray  # (n,) bool: other shadows that rounding allows both sides give our value
    unresolvable: np.ndarray  # (n,) bool: Mitsuba's own value has no useful bound


class LightAnswers(NamedTuple):
    """All lights at m pixels: contributions with bounds, and Mitsuba's answers."""

    each: list[LightContribution]
    given: np.ndarray  # (lights, m, 3) Mitsuba's radiance, its shadows included
    error: np.ndarray  # (lights, m, 3)
    visible: np.ndarray  # (lights, m) bool, Mitsuba's shadow test


def judge_diffuse(
    scene: Scene, pair: ImagePair, bounds: Bounds, rows: np.ndarray, brackets: tuple[Bracket, Bracket]
) -> DiffuseComparison:
    """Compare the pixels `rows`, where geometry agrees; brackets: the subject's and the reference's."""
    count = len(pair.t)
    ratio, explained, unresolvable = np.zeros(count), np.zeros(count, bool), np.zeros(count, bool)
    lights = _lights(scene, pair, bounds.at, rows)
    ratio[rows] = _share(pair, rows, certain_lights(lights.given, lights.error))
    beyond = rows[ratio[rows] > 1.0]
    if len(beyond):
        lights = _lights(scene, pair, bounds.at, beyond)
        choices = _choices(scene, pair, lights, shading_points(pair, bounds.at, beyond), beyond, brackets)
        explained[beyond] = _share(pair, beyond, choices) <= 1.0
        unresolvable[beyond] = ~np.isfinite([lit.error for lit in lights.each]).all(axis=(0, 2))
    return DiffuseComparison(ratio, explained, unresolvable)


def diffuse_within_float64(
    scene: Scene, hit: ShadingPoints, prim: np.ndarray, values: np.ndarray, bracket: Bracket
) -> np.ndarray:
    """(m,) bool: our values (m, 3) follow Lambert's law, with some shadows that float64 rounding allows us.

    hit: in float64, with float64's bounds; prim (m,): the primitives that are hit.
    """
    each = _lit(scene, hit, KU_OURS)
    shape = (len(each), len(prim))
    lit, shaded = np.ones(shape, bool), np.zeros(shape, bool)
    if scene.shading.shadows:
        for i, light in enumerate(each):
            lit[i], shaded[i] = lambert.our_visibility(bracket, hit, light, prim)
    doubtful = np.array([light.doubtful for light in each], bool).reshape(shape)
    either = [np.where(light.doubtful[:, None], light.either_side, light.radiance) for light in each]
    first = np.where(lit[..., None], _stacked(either, prim), 0.0)
    error = np.where(lit[..., None], _stacked([light.error for light in each], prim), 0.0)
    dark = np.zeros_like(first)
    choices = LightChoices(first, error, dark, dark, lit & (shaded | doubtful))
    ambient = materials_of(scene).reflectance[hit.shape] * lambert.ambient_radiance(scene.lights)
    return smallest_error_ratio(values, ambient, choices, KU_OURS) <= 1.0


def shading_points(pair: ImagePair, at: Intersections, rows: np.ndarray) -> ShadingPoints:
    """Our hits at some pixels, with the bounds `at`."""
    d = pair.rays.d[rows].astype(np.float64)
    p = pair.rays.o[rows].astype(np.float64) + pair.t[rows, None] * d
    return ShadingPoints(p, d, aov_rows(pair.subject, "shape_id")[rows], at.take(rows))


def _lit(scene: Scene, hit: ShadingPoints, ku: float) -> list[LightContribution]:
    materials = materials_of(scene)
    return [lambert.light_contribution(materials, light, hit, ku) for light in scene.lights if light.type != "ambient"]


def materials_of(scene: Scene) -> Materials:
    """The material of each shape, as arrays."""
    found = [scene.material_of(shape) for shape in scene.shapes]
    reflectance = np.array([material.reflectance for material in found]).reshape(-1, 3)
    return Materials(reflectance, np.array([material.two_sided for material in found], bool))


def _lights(scene: Scene, pair: ImagePair, at: Intersections, rows: np.ndarray) -> LightAnswers:
    each = _lit(scene, shading_points(pair, at, rows), KU)
    visible = pair.result.visible[:, rows]
    given = np.where(visible[..., None], pair.result.unshadowed[:, rows], 0.0)
    error = np.where(visible[..., None], _stacked([lit.error for lit in each], rows), 0.0)
    return LightAnswers(each, given, error, visible)


def _stacked(values: list[np.ndarray], rows: np.ndarray) -> np.ndarray:
    """(lights, m, 3), also without any light."""
    return np.array(values).reshape(len(values), len(rows), 3)


def _share(pair: ImagePair, rows: np.ndarray, choices: LightChoices) -> np.ndarray:
    return smallest_error_ratio(aov_rows(pair.subject, "diffuse")[rows], pair.result.ambient[rows], choices, KU)


def _choices(
    scene: Scene,
    pair: ImagePair,
    lights: LightAnswers,
    hit: ShadingPoints,
    rows: np.ndarray,
    brackets: tuple[Bracket, Bracket],
) -> LightChoices:
    """Mitsuba's answer for each light, or the contrary where rounding allows each side its own answer.

    A face lit at a grazing angle may be lit or not, and a shadow may be there or not.
    """
    doubtful = np.array([lit.doubtful for lit in lights.each], bool).reshape(lights.visible.shape)
    doubt = doubtful.copy()
    if scene.shading.shadows:
        for i, lit in enumerate(lights.each):
            doubt[i] |= _shadow_may_differ(lights.visible[i], lit, hit, pair, rows, brackets)
    bright = np.asarray(lights.given.any(axis=-1))[..., None]
    lit_value = np.where(doubtful[..., None], *(_of(lights, name, rows) for name in ("either_side", "radiance")))
    second = np.where(bright, 0.0, lit_value)
    second_error = np.where(bright, 0.0, _of(lights, "error", rows))
    return LightChoices(lights.given, lights.error, second, second_error, doubt)


def _of(lights: LightAnswers, name: str, rows: np.ndarray) -> np.ndarray:
    return _stacked([getattr(lit, name) for lit in lights.each], rows)


def _shadow_may_differ(
    visible: np.ndarray,
    lit: LightContribution,
    hit: ShadingPoints,
    pair: ImagePair,
    rows: np.ndarray,
    brackets: tuple[Bracket, Bracket],
) -> np.ndarray:
    """(n,) bool: Mitsuba's answer for a light and our contrary one are both within bounds."""
    ours, theirs = brackets
    p, n = (aov_rows(pair.reference, name)[rows] for name in ("position", "normal"))
    they_lit, they_shaded = lambert.reference_visibility(theirs, hit, lit, p, n)
    we_lit, we_shaded = lambert.our_visibility(ours, hit, lit, pair.prim[rows])
    return np.where(visible, they_lit & we_shaded, they_shaded & we_lit)

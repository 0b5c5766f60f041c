"""The diffuse AOV: is ours the sum of what Mitsuba's lights give, up to bounds and to shadows that may differ?"""

from typing import NamedTuple

import numpy as np

from caster.scene import Scene
from mitsuba_ref import lambert, shadows
from mitsuba_ref.bounds import Bounds
from mitsuba_ref.bracket import Bracket
from mitsuba_ref.lambert import Hit, Lit
from mitsuba_ref.light_choices import Choices, certain, smallest_share
from mitsuba_ref.meeting import KU, KU_OURS, Meetings
from mitsuba_ref.pair import Pair
from mitsuba_ref.pixels import flat


class Shading(NamedTuple):
    """One row a pixel; pixels that are not judged have ratio 0."""

    ratio: np.ndarray  # (n,) difference over bound with Mitsuba's own shadows
    explained: np.ndarray  # (n,) bool: other shadows, which rounding allows both sides, give our value
    unresolvable: np.ndarray  # (n,) bool: Mitsuba's own value has no useful bound


class Lights(NamedTuple):
    """All lights at m pixels, as numbers with bounds and as Mitsuba answered."""

    each: list[Lit]
    given: np.ndarray  # (lights, m, 3) what Mitsuba says, its shadows included
    error: np.ndarray  # (lights, m, 3)
    visible: np.ndarray  # (lights, m) bool, Mitsuba's shadow test


def judge_diffuse(
    scene: Scene, pair: Pair, bounds: Bounds, rows: np.ndarray, brackets: tuple[Bracket, Bracket]
) -> Shading:
    """Judge the pixels `rows`, where geometry agrees; brackets: ours and the reference's."""
    count = len(pair.t)
    ratio, explained, unresolvable = np.zeros(count), np.zeros(count, bool), np.zeros(count, bool)
    lights = _lights(scene, pair, bounds.at, rows)
    ratio[rows] = _share(pair, rows, certain(lights.given, lights.error))
    beyond = rows[ratio[rows] > 1.0]
    if len(beyond):
        lights = _lights(scene, pair, bounds.at, beyond)
        choices = _choices(scene, pair, lights, hit_at(pair, bounds.at, beyond), beyond, brackets)
        explained[beyond] = _share(pair, beyond, choices) <= 1.0
        unresolvable[beyond] = ~np.isfinite([lit.error for lit in lights.each]).all(axis=(0, 2))
    return Shading(ratio, explained, unresolvable)


def right_in_float64(
    scene: Scene, hit: Hit, prim: np.ndarray, values: np.ndarray, bracket: Bracket
) -> np.ndarray:
    """(m,) bool: our values (m, 3) are Lambert's, with some shadows that float64 rounding allows us.

    hit: as float64 sees it, with float64's bounds; prim (m,): the primitives that are hit.
    """
    each = _lit(scene, hit, KU_OURS)
    shape = (len(each), len(prim))
    lit, shaded = np.ones(shape, bool), np.zeros(shape, bool)
    if scene.shading.shadows:
        for i, light in enumerate(each):
            lit[i], shaded[i] = shadows.we_may_say(bracket, hit, light, prim)
    doubtful = np.array([light.doubtful for light in each], bool).reshape(shape)
    either = [np.where(light.doubtful[:, None], light.either_side, light.radiance) for light in each]
    first = np.where(lit[..., None], _stacked(either, prim), 0.0)
    error = np.where(lit[..., None], _stacked([light.error for light in each], prim), 0.0)
    dark = np.zeros_like(first)
    choices = Choices(first, error, dark, dark, lit & (shaded | doubtful))
    return smallest_share(values, lambert.ambient(scene, hit.shape), choices, KU_OURS) <= 1.0


def hit_at(pair: Pair, at: Meetings, rows: np.ndarray) -> Hit:
    """Our hits at some pixels, with the bounds `at`."""
    d = pair.rays.d[rows].astype(np.float64)
    p = pair.rays.o[rows].astype(np.float64) + pair.t[rows, None] * d
    return Hit(p, d, flat(pair.ours, "shape_id")[rows], at.taken(rows))


def _lit(scene: Scene, hit: Hit, ku: float) -> list[Lit]:
    return [lambert.lit(scene, light, hit, ku) for light in scene.lights if light.type != "ambient"]


def _lights(scene: Scene, pair: Pair, at: Meetings, rows: np.ndarray) -> Lights:
    each = _lit(scene, hit_at(pair, at, rows), KU)
    visible = pair.witness.visible[:, rows]
    given = np.where(visible[..., None], pair.witness.unshadowed[:, rows], 0.0)
    error = np.where(visible[..., None], _stacked([lit.error for lit in each], rows), 0.0)
    return Lights(each, given, error, visible)


def _stacked(values: list[np.ndarray], rows: np.ndarray) -> np.ndarray:
    """(lights, m, 3), also without any light."""
    return np.array(values).reshape(len(values), len(rows), 3)


def _share(pair: Pair, rows: np.ndarray, choices: Choices) -> np.ndarray:
    return smallest_share(flat(pair.ours, "diffuse")[rows], pair.witness.ambient[rows], choices, KU)


def _choices(
    scene: Scene, pair: Pair, lights: Lights, hit: Hit, rows: np.ndarray, brackets: tuple[Bracket, Bracket]
) -> Choices:
    """What Mitsuba says of each light, or the contrary where each side may say what it says.

    A face seen nearly from the side may be the one or the other; and a shadow may be there or not.
    """
    doubtful = np.array([lit.doubtful for lit in lights.each], bool).reshape(lights.visible.shape)
    doubt = doubtful.copy()
    if scene.shading.shadows:
        for i, lit in enumerate(lights.each):
            doubt[i] |= _shadow_may_differ(lights.visible[i], lit, hit, pair, rows, brackets)
    bright = np.asarray(lights.given.any(axis=-1))[..., None]
    lit_value = np.where(
        doubtful[..., None], *(_of(lights, name, rows) for name in ("either_side", "radiance"))
    )
    second = np.where(bright, 0.0, lit_value)
    second_error = np.where(bright, 0.0, _of(lights, "error", rows))
    return Choices(lights.given, lights.error, second, second_error, doubt)


def _of(lights: Lights, name: str, rows: np.ndarray) -> np.ndarray:
    return _stacked([getattr(lit, name) for lit in lights.each], rows)


def _shadow_may_differ(
    visible: np.ndarray, lit: Lit, hit: Hit, pair: Pair, rows: np.ndarray, brackets: tuple[Bracket, Bracket]
) -> np.ndarray:
    """Where Mitsuba may say of a light what it says, and we may say the contrary."""
    ours, theirs = brackets
    p, n = (flat(pair.reference, name)[rows] for name in ("position", "normal"))
    they_lit, they_shaded = shadows.reference_may_say(theirs, hit, lit, p, n)
    we_lit, we_shaded = shadows.we_may_say(ours, hit, lit, pair.prim[rows])
    return np.where(visible, they_lit & we_shaded, they_shaded & we_lit)

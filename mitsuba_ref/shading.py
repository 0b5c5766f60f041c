"""The diffuse AOV: is ours the sum of what Mitsuba's lights give, up to bounds and to shadows that may differ?"""

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from caster.scene import Scene
from mitsuba_ref import lambert, shadows
from mitsuba_ref.bounds import Bounds
from mitsuba_ref.bracket import Bracket
from mitsuba_ref.lambert import Hit, Lit
from mitsuba_ref.meeting import KU, KU_OURS, Meetings
from mitsuba_ref.pair import Pair
from mitsuba_ref.pixels import flat, share_of_bound

MOST_LIGHTS = 6  # in doubt at one pixel: 2^6 combinations of lit and in shadow are tried


class Shading(NamedTuple):
    """One row a pixel; pixels that are not judged have ratio 0."""

    ratio: np.ndarray  # (n,) difference over bound with Mitsuba's own shadows
    explained: np.ndarray  # (n,) bool: another choice of shadows, which rounding allows, gives our value
    unresolvable: (
        np.ndarray
    )  # (n,) bool: a light nearer than Mitsuba's position is sure; ours is right by float64


@dataclass(frozen=True)
class _Judged:
    """The pixels that both hit on the same shape, and what each light gives there."""

    rows: np.ndarray
    hit: Hit
    lights: list[Lit]
    ours: np.ndarray  # (m, 3)
    ambient: np.ndarray  # (m, 3)
    unshadowed: np.ndarray  # (lights, m, 3), Mitsuba's
    visible: np.ndarray  # (lights, m), Mitsuba's


def judge_diffuse(
    scene: Scene, pair: Pair, bounds: Bounds, rows: np.ndarray, ours: Bracket, theirs: Bracket
) -> Shading:
    """Judge the pixels `rows`, where geometry agrees; ours and theirs: the brackets of either arithmetic."""
    ratio = _impossible(pair)
    explained, unresolvable = np.zeros(len(ratio), bool), np.zeros(len(ratio), bool)
    case = _judged(scene, pair, bounds, rows)
    shares = _share(case, np.zeros_like(case.visible))
    ratio[rows] = np.maximum(ratio[rows], shares)
    doubtful = np.flatnonzero(shares > 1.0)
    if len(doubtful):
        explained[rows[doubtful]] = _explain(scene, pair, case, doubtful, ours, theirs)
        unresolvable[rows[doubtful]] = _unresolvable(scene, pair, bounds, _part_of(case, doubtful), ours)
    return Shading(ratio, explained, unresolvable)


def _impossible(pair: Pair) -> np.ndarray:
    """(n,) inf where ours is not a number, or shines on a miss; else 0."""
    values, hit = flat(pair.ours, "diffuse"), pair.ours.hit.ravel()
    fine = np.where(hit, np.isfinite(values).all(axis=1), (values == 0.0).all(axis=1))
    return np.where(fine, 0.0, np.inf)


def _judged(scene: Scene, pair: Pair, bounds: Bounds, rows: np.ndarray) -> _Judged:
    d = pair.rays.d[rows].astype(np.float64)
    p = pair.rays.o[rows].astype(np.float64) + pair.t[rows, None] * d
    at = Meetings(*(a[rows] for a in bounds.at if a is not None))
    hit = Hit(p, d, pair.witness.shape_id[rows], at)
    lights = [lambert.lit(scene, light, hit, KU) for light in scene.lights if light.type != "ambient"]
    ours = flat(pair.ours, "diffuse")[rows]
    witness = pair.witness
    return _Judged(
        rows, hit, lights, ours, witness.ambient[rows], witness.unshadowed[:, rows], witness.visible[:, rows]
    )


def _share(case: _Judged, flipped: np.ndarray) -> np.ndarray:
    """Difference over bound (m,), with some lights (lights, m) switched over: lit to dark, dark to lit."""
    total, bound = case.ambient.copy(), KU * case.ambient
    for i, light in enumerate(case.lights):
        given = np.where(case.visible[i][:, None], case.unshadowed[i], 0.0)
        shines = np.asarray(given.any(axis=1))
        other = np.where(shines[:, None], 0.0, light.either_side)
        total += np.where(flipped[i][:, None], other, given)
        lit = np.where(flipped[i], ~shines, case.visible[i])
        bound += np.where(lit[:, None], light.error, 0.0)
    bound += KU * total
    return np.asarray(share_of_bound(np.abs(case.ours - total), bound).max(axis=1, initial=0.0))


def _explain(
    scene: Scene, pair: Pair, case: _Judged, rows: np.ndarray, ours: Bracket, theirs: Bracket
) -> np.ndarray:
    """Whether a choice of shadows that differs only where both sides may differ gives our value; (m,) bool."""
    part = _part_of(case, rows)
    either = np.array([light.doubtful for light in part.lights]).reshape(len(part.lights), len(rows))
    flippable = either.copy()
    if scene.shading.shadows:
        for i, light in enumerate(part.lights):
            flippable[i] |= _may_differ(part, i, light, pair, ours, theirs)
    explained = np.zeros(len(rows), bool)
    for flips in itertools.product((False, True), repeat=min(len(part.lights), MOST_LIGHTS)):
        if any(flips):
            flipped = np.zeros_like(part.visible)
            flipped[: len(flips)] = np.array(flips)[:, None]
            allowed = np.asarray(flippable | ~flipped).all(axis=0)
            explained |= allowed & (_share(part, flipped) <= 1.0)
    return explained


def _unresolvable(scene: Scene, pair: Pair, bounds: Bounds, part: _Judged, ours: Bracket) -> np.ndarray:
    """Where Mitsuba's position has no useful bound, and our value is what float64 gives; (m,) bool."""
    unknown = np.any([~np.isfinite(light.error).all(axis=1) for light in part.lights], axis=0)
    at = Meetings(*(a[part.rows] for a in bounds.own if a is not None))
    hit = Hit(part.hit.p, part.hit.d, part.hit.shape, at)
    lights = [lambert.lit(scene, light, hit, KU_OURS) for light in scene.lights if light.type != "ambient"]
    right = np.zeros(len(part.rows), bool)
    said = [_we_may_say(scene, ours, hit, light, pair.prim[part.rows]) for light in lights]
    for choice in itertools.product((0, 1), repeat=min(len(lights), MOST_LIGHTS)):
        total, bound = part.ambient.copy(), KU * part.ambient
        allowed = np.ones(len(part.rows), bool)
        for dark, light, may in zip(choice, lights, said, strict=False):
            allowed &= may[dark]
            total += (1 - dark) * light.radiance
            bound += (1 - dark) * light.error
        right |= allowed & (share_of_bound(np.abs(part.ours - total), bound).max(axis=1) <= 1.0)
    return unknown & right


def _we_may_say(
    scene: Scene, ours: Bracket, hit: Hit, light: Lit, prim: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    if not scene.shading.shadows:
        return np.ones(len(prim), bool), np.zeros(len(prim), bool)
    return shadows.we_may_say(ours, hit, light, prim)


def _may_differ(part: _Judged, i: int, light: Lit, pair: Pair, ours: Bracket, theirs: Bracket) -> np.ndarray:
    """Where Mitsuba may say of light i what it says, and we may say the contrary."""
    p, n = (flat(pair.reference, name)[part.rows] for name in ("position", "normal"))
    lit, shaded = shadows.reference_may_say(theirs, part.hit, light, p, n)
    we_lit, we_shaded = shadows.we_may_say(ours, part.hit, light, pair.prim[part.rows])
    return np.where(part.visible[i], lit & we_shaded, shaded & we_lit)


def _part_of(case: _Judged, rows: np.ndarray) -> _Judged:
    hit = case.hit
    at = Meetings(*(a[rows] for a in hit.at if a is not None))
    return _Judged(
        case.rows[rows],
        Hit(hit.p[rows], hit.d[rows], hit.shape[rows], at),
        [Lit(*(a[rows] for a in light)) for light in case.lights],
        case.ours[rows],
        case.ambient[rows],
        case.unshadowed[:, rows],
        case.visible[:, rows],
    )

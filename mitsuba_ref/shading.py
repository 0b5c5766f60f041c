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
from mitsuba_ref.meeting import KU, Meetings
from mitsuba_ref.pixels import flat, share_of_bound
from mitsuba_ref.pair import Pair

MOST_LIGHTS = 6  # in doubt at one pixel: 2^6 combinations of lit and in shadow are tried


class Shading(NamedTuple):
    """One row a pixel; pixels that are not judged have ratio 0."""

    ratio: np.ndarray  # (n,) difference over bound with Mitsuba's own shadows
    explained: np.ndarray  # (n,) bool: another choice of shadows, which rounding allows, gives our value


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


def judge_diffuse(scene: Scene, pair: Pair, bounds: Bounds, rows: np.ndarray, ours: Bracket, theirs: Bracket) -> Shading:
    """Judge the pixels `rows`, where geometry agrees; ours and theirs: the brackets of either arithmetic."""
    count = len(pair.witness.t)
    ratio, explained = np.zeros(count), np.zeros(count, bool)
    case = _judged(scene, pair, bounds, rows)
    shares = _share(case, np.zeros_like(case.visible))
    ratio[rows] = shares
    doubtful = np.flatnonzero(shares > 1.0)
    if len(doubtful):
        explained[rows[doubtful]] = _explain(scene, pair, case, doubtful, ours, theirs)
    return Shading(ratio, explained)


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
        shines = given.any(axis=1)
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
            flippable[i] |= _may_differ(part, i, light, pair.prim[part.rows], ours, theirs)
    explained = np.zeros(len(rows), bool)
    for flips in itertools.product((False, True), repeat=min(len(part.lights), MOST_LIGHTS)):
        if any(flips):
            flipped = np.zeros_like(part.visible)
            flipped[: len(flips)] = np.array(flips)[:, None]
            allowed = np.all(flippable | ~flipped, axis=0)
            explained |= allowed & (_share(part, flipped) <= 1.0)
    return explained


def _may_differ(
    part: _Judged, i: int, light: Lit, prim: np.ndarray, ours: Bracket, theirs: Bracket
) -> np.ndarray:
    """Where Mitsuba may say of light i what it says, and we may say the contrary."""
    lit, shaded = shadows.reference_may_say(theirs, part.hit, light)
    we_lit, we_shaded = shadows.we_may_say(ours, part.hit, light, prim)
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

"""What the page is told about one scene, in parts: its verdict, what is known of each pixel, and both pictures."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.checks import CHECKS
from mitsuba_ref.judge import CODE
from mitsuba_ref.pixels import Pixels, apart, flat, share_of_bound
from mitsuba_ref.report.arrays import coarse, narrowest, packed, rounded
from mitsuba_ref.report.seen import Seen
from mitsuba_ref.report.thumbnail import thumbnail
from mitsuba_ref.report.words import exact_answers, reasons
from mitsuba_ref.verdict import CLASSES, REFERENCE_WRONG, SceneVerdict

UNLISTED_CODE = len(CLASSES)  # a class of the page's own: the reference is wrong in no known way, which fails

# Pictures in the order in which they are given up last where space is short; "ratio" is the worst of all checks.
LAYERS = ("ids", "ratio", "depth", "normal", "diffuse", "shading_normal", "position")
FLOATS = ("depth", "normal", "diffuse", "shading_normal", "position")
# A share that is worked out twice, by a square root of a square here and without there, is the same up to 4 roundings.
ROUNDING = 1.0 + 4 * 2.0**-53
CHECK = {check.NAME: check for check in CHECKS}


class Record(NamedTuple):
    """One scene. All but the thumbnail can be written as JSON."""

    about: dict[str, Any]
    layers: dict[str, dict[str, Any]]
    thumbnail: str  # PNG as a data URI


def record(verdict: SceneVerdict, seen: Seen, *, exact: bool) -> Record:
    """exact: both pictures to the bit and every bound; otherwise as float32, which takes a third of the space."""
    judge, judgement = seen
    scene, pair = judge.scene, judge.pair
    about = {
        "verdict": verdict.to_dict(),
        "window": list(scene.film.window),
        "shapes": list(scene.shape_names()),
        "exactly": exact,
        "class": packed(classes(seen)),
        "hit": packed((pair.ours.hit.ravel() + 2 * pair.reference.hit.ravel()).astype(np.uint8)),
        "reasons": reasons(seen),
        "exact": exact_answers(seen),
    }
    if exact:
        about["shares"] = {
            name: packed(coarse(judgement.ratio(name))) for name in judgement.names if name not in FLOATS
        }
    return Record(about, dict(layers(seen, exact=exact)), thumbnail(pair.ours))


def classes(seen: Seen) -> np.ndarray:
    """(n,) uint8 class of each pixel, UNLISTED_CODE among them."""
    found = seen.judgement.classes.astype(np.uint8)
    unlisted = [row for row, case in seen.judgement.cases.items() if case is None]
    found[unlisted] = np.where(found[unlisted] == CODE[REFERENCE_WRONG], UNLISTED_CODE, found[unlisted])
    return found


def layers(seen: Seen, *, exact: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """What there is of LAYERS: an AOV may be missing on either side."""
    judge, judgement = seen
    pair = judge.pair
    pixels = Pixels(pair.ours, pair.reference, judge.bounds, pair.t, pair.length, judge.point)
    yield "ids", ids(seen)
    worst = np.max([judgement.ratio(name) for name in judgement.names], axis=0)
    yield "ratio", {"ratio": packed(coarse(worst))}
    for name in FLOATS:
        if name in pair.ours and name in pair.reference:
            yield name, values(pixels, name, exact=exact) | (bounds(seen, pixels, name) if exact else {})


def values(pixels: Pixels, name: str, *, exact: bool) -> dict[str, Any]:
    """Ours and the reference's, ours as what its bits differ by."""
    ours, reference = pixels.pair(name)
    if exact:
        return {"reference": packed(narrowest(reference)), "ours": packed(ours, narrowest(reference))}
    return {"reference": packed(rounded(reference)), "ours": packed(rounded(ours), rounded(reference))}


def bounds(seen: Seen, pixels: Pixels, name: str) -> dict[str, Any]:
    """Error over bound of the check of this name, the bound between both sides, and where it is not that one which
    counts, but float64's between ours and our own surface. `diffuse` has no one bound."""
    ratio, check = seen.judgement.ratio(name), CHECK.get(name)
    found = {"ratio": packed(coarse(ratio))}
    if check is not None:
        bound = check.bound(pixels)
        sides = (aov.reshape(len(ratio), -1) for aov in pixels.pair(name))
        alone = pixels.both_hit & (ratio > share_of_bound(apart(*sides), bound) * ROUNDING)
        found["bound"] = packed(coarse(np.where(pixels.both_hit, bound, 0.0)))
        found["alone"] = packed(alone.astype(np.uint8))
    return found


def ids(seen: Seen) -> dict[str, Any]:
    """Shape, and primitive within its shape, of both sides, -1 on a miss."""
    pair, number = seen.judge.pair, seen.judge.model.packed.number_in_shape
    shapes = (flat(aovs, "shape_id").astype(np.int32) for aovs in (pair.reference, pair.ours))
    theirs = np.where(pair.reference.hit.ravel(), pair.witness.answer.prim.astype(np.int64), -1)
    names = ("shape_reference", "shape_ours", "prim_reference", "prim_ours")
    return dict(zip(names, map(packed, (*shapes, theirs.astype(np.int32), number(pair.prim))), strict=True))

"""What the page is told about one scene, in parts: its verdict, what is known of each pixel, and both pictures."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.judge import CODE
from mitsuba_ref.pixels import flat
from mitsuba_ref.report.arrays import coarse, narrowest, packed, rounded
from mitsuba_ref.report.seen import Seen
from mitsuba_ref.report.thumbnail import thumbnail
from mitsuba_ref.report.words import exact_answers, reasons
from mitsuba_ref.verdict import CLASSES, REFERENCE_WRONG, SceneVerdict

UNLISTED_CODE = len(CLASSES)  # a class of the page's own: the reference is wrong in no known way, which fails

# Pictures in the order in which they are given up last where space is short; "ratio" is the worst of all checks.
LAYERS = ("ids", "ratio", "depth", "normal", "diffuse", "shading_normal", "position")
FLOATS = ("depth", "normal", "diffuse", "shading_normal", "position")


class Record(NamedTuple):
    """One scene. All but the thumbnail can be written as JSON."""

    about: dict[str, Any]
    layers: dict[str, dict[str, Any]]
    thumbnail: str  # PNG as a data URI


def record(verdict: SceneVerdict, seen: Seen, *, exact: bool) -> Record:
    """exact: both pictures to the bit and every bound; otherwise as float32, which takes a third of the space."""
    hit = seen.ours.hit.ravel() + 2 * seen.reference.hit.ravel()
    about = {
        "verdict": verdict.to_dict(),
        "window": list(seen.scene.film.window),
        "shapes": list(seen.scene.shape_names()),
        "exactly": exact,
        "class": packed(classes(seen)),
        "hit": packed(hit.astype(np.uint8)),
        "reasons": reasons(seen),
        "exact": exact_answers(seen),
    }
    if exact:
        judgement = seen.judgement
        others = [name for name in judgement.names if name not in FLOATS]
        about["shares"] = {name: packed(coarse(judgement.ratio(name))) for name in others}
    return Record(about, dict(layers(seen, exact=exact)), thumbnail(seen.ours))


def classes(seen: Seen) -> np.ndarray:
    """(n,) uint8 class of each pixel, UNLISTED_CODE among them."""
    found = seen.judgement.classes.astype(np.uint8)
    unlisted = [row for row, case in seen.judgement.cases.items() if case is None]
    found[unlisted] = np.where(found[unlisted] == CODE[REFERENCE_WRONG], UNLISTED_CODE, found[unlisted])
    return found


def layers(seen: Seen, *, exact: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """What there is of LAYERS: an AOV may be missing on either side."""
    judgement = seen.judgement
    yield "ids", ids(seen, exact=exact)
    worst = np.max([judgement.ratio(name) for name in judgement.names], axis=0)
    yield "ratio", {"ratio": packed(coarse(worst))}
    for name in FLOATS:
        if name in seen.ours and name in seen.reference:
            sides = values(flat(seen.ours, name), flat(seen.reference, name), exact=exact)
            yield name, sides | (bounds(seen, name) if exact else {})


def values(ours: np.ndarray, reference: np.ndarray, *, exact: bool) -> dict[str, Any]:
    """Both sides, ours as what its bits differ by."""
    if exact:
        return {"reference": packed(narrowest(reference)), "ours": packed(ours, narrowest(reference))}
    return {"reference": packed(rounded(reference)), "ours": packed(rounded(ours), rounded(reference))}


def bounds(seen: Seen, name: str) -> dict[str, Any]:
    """Error over bound of the check of this name, and that bound, if there is one."""
    bound = seen.bound(name)
    found = {"ratio": packed(coarse(seen.judgement.ratio(name)))}
    if bound.between is not None:
        found["bound"] = packed(coarse(bound.between))
    if bound.alone is not None:
        found["alone"] = packed(bound.alone.astype(np.uint8))
    if bound.own is not None:
        found["own"] = packed(coarse(bound.own))
    return found


def ids(seen: Seen, *, exact: bool) -> dict[str, Any]:
    """Shape, and primitive within its shape, of both sides, -1 on a miss; and t, where depth does not say it all."""
    found = {name: packed(numbers.astype(np.int32)) for name, numbers in seen.ids().items()}
    t = seen.t()
    sides = {} if t is None else values(*t, exact=exact)
    return found | {f"t_{side}": each for side, each in sides.items()}

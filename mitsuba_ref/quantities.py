"""The quantities of one pixel in words: which are beyond their bounds, and by what factor; which were not judged."""

from collections.abc import Mapping

import numpy as np

from mitsuba_ref.judge import EXACT, Judge, Judgement
from mitsuba_ref.verdict import AGREE, CLASSES, OUR_WORD, UNDECIDED

SPOKEN = {EXACT: "t by exact arithmetic", "mask": "hit or miss", "shape_id": "the shape"}
AT_A_HIT = ("depth", "position", "normal", "shading_normal")  # compared where both sides hit


def shares(judge: Judge, judgement: Judgement, row: int) -> dict[str, float]:
    """Error over bound of every quantity of ours, against Mitsuba or against float64 alone, whichever is more."""
    found = {name: float(judgement.ratio(name)[row]) for name in judgement.names}
    for name, share in own_shares(judge, row).items():
        found[name] = max(found[name], share)
    return found


def own_shares(judge: Judge, row: int) -> dict[str, float]:
    """Of what is beyond float64's bound at our own primitive."""
    found = {}
    for each in judge.held:
        if each.is_beyond(row):
            error, bound = float(each.error[row]), float(each.bound[row])
            found[each.name] = error / bound if bound > 0.0 and np.isfinite(error) else np.inf
    return found


def beyond(shares: Mapping[str, float]) -> str:
    """Which are beyond their bounds, and by what factor; "" where none is.

    A hit in place of a miss has no factor. That t is not the exact one says the least, where it has none either.
    """
    found = {name: share for name, share in shares.items() if not share <= 1.0}
    if len(found) > 1 and not np.isfinite(found.get(EXACT, 0.0)):
        del found[EXACT]
    factors = {name: f" {share:.3g}x" if np.isfinite(share) else "" for name, share in found.items()}
    told = [f"{SPOKEN.get(name, name)}{factor}" for name, factor in factors.items()]
    return f"beyond {'its bound' if len(told) == 1 else 'their bounds'}: {', '.join(told)}" if told else ""


def not_judged(judge: Judge, judgement: Judgement, row: int) -> dict[str, str]:
    """What was not judged of ours, and why: a share of 0 would pass for agreement."""
    ours, theirs = bool(judge.pair.ours.hit.ravel()[row]), bool(judge.pair.reference.hit.ravel()[row])
    found = at_no_common_hit(ours, theirs, "ours", AT_A_HIT)
    if not ours:
        found["on_surface"] = "ours hits nothing"
    if why := _diffuse(judge, judgement, row):
        found["diffuse"] = why
    if judgement.exact.of(row) is None:
        found[EXACT] = "there is no ray" if judge.t_max[row] < 0.0 else "exact arithmetic gave no answer"
    # What contradicts something else is told as beyond all bounds, whatever else was not judged.
    return {name: why for name, why in found.items() if not judgement.ratio(name)[row] > 0.0}


def at_no_common_hit(judged: bool, reference: bool, who: str, names: tuple[str, ...]) -> dict[str, str]:
    """Why these are not compared, where the one who is judged or Mitsuba misses; nothing where both hit."""
    if judged and reference:
        return {}
    why = f"{who if judged else 'Mitsuba'} alone hits" if judged or reference else "nothing is hit"
    return dict.fromkeys(names, why)


def _diffuse(judge: Judge, judgement: Judgement, row: int) -> str:
    """Light is compared with Mitsuba's where geometry agrees, and else held to float64 where ours is right."""
    name = CLASSES[int(judgement.classes[row])]
    if not judge.pair.ours.hit.ravel()[row]:
        return "ours hits nothing"
    if name == AGREE:
        return ""
    if name not in OUR_WORD:
        already = "undecided" if name == UNDECIDED else "wrong"
        return f"what is hit, or where, is {already} already"
    if not np.isfinite(judge.bounds.own.t_error[row]):
        return "float64 does not resolve where the hit is"
    return "not against Mitsuba's, which is of another surface or place; it is what float64 gives on ours"

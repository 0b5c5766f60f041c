"""How far a candidate is from the exact answer at one pixel: in units of the last place, and of its bounds."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mitsuba_ref.candidate.judge import CandidateJudge, CandidateJudgement, meets_again
from mitsuba_ref.exact import ExactAnswer
from mitsuba_ref.pixels import apart
from mitsuba_ref.quantities import beyond
from mitsuba_ref.witnesses import CANDIDATE, Saying, in_ulps, over


def off_from_exact(judge: CandidateJudge, exact: ExactAnswer | None) -> dict[str, Any]:
    """How far t and the normal are from those of the exact answer, at the member of a tie that fits best.

    In units of the last place (t), as a share of its length (the normal), and of their bounds.
    """
    t = float(judge.answer.t[0])
    if exact is None or exact.t is None or not np.isfinite(t):
        return {}
    prim = np.array([each.prim for each in exact.ties])
    row = np.zeros(len(prim), int)
    at = meets_again(judge, row, prim, np.full(len(prim), float(exact.t)))
    off = exact.t.off(t) * -exact.t.compare(t)
    t_share = [over(abs(off), float(bound)) for bound in at.t_error + np.ravel(judge.answer.t_off)[0]]
    found: dict[str, Any] = {"t": off, "t_ulps": in_ulps(off, exact, np.dtype(judge.answer.precision))}
    if judge.answer.n is None or judge.answer.is_broken[0]:
        return found | {"t_share": min(t_share)}
    turned = apart(judge.answer.n[row], at.n)
    n_share = [over(float(each), float(bound)) for each, bound in zip(turned, at.n_error, strict=True)]
    best = int(np.argmin(np.maximum(t_share, n_share)))
    return found | {
        "t_share": t_share[best],
        "normal": float(turned[best]),
        "normal_share": n_share[best],
        "exact_normal": at.n[best].tolist(),
    }


def factors(judge: CandidateJudge, off: Mapping[str, Any], ratios: Mapping[str, float]) -> str:
    """By what factors: from the exact answer if there is one, else from Mitsuba's."""
    if judge.answer.is_broken[0]:
        return ""
    exact = {name: off[f"{name}_share"] for name in ("t", "normal") if f"{name}_share" in off}
    shares = {"mask": ratios["mask"]} | exact if exact else dict(ratios)
    return beyond(shares)


def as_witness(judge: CandidateJudge, judgement: CandidateJudgement, off: Mapping[str, Any]) -> Saying:
    """Beside ours and Mitsuba. off: from the exact answer."""
    answer = judge.answer
    broken = [*answer.broken]
    right = judgement.is_right(0) if judgement.exact.of(0) is not None else None
    return Saying(
        CANDIDATE,
        "a hit" if answer.hit[0] else "miss",  # it names no shape
        -1,
        float(answer.t[0]),
        right=right and not broken,
        off=off.get("t"),
        ulps=off.get("t_ulps"),
        format=answer.precision,
        share=off.get("t_share"),
        normal_share=off.get("normal_share"),
        remark=", ".join(broken),
    )

"""Where secondary rays start: ours, and Mitsuba's for comparison, judged in exact arithmetic."""

import numpy as np

from caster.rendering.bounces import Bounce
from mitsuba_ref.judge.checks import NOT_JUDGED, OURS, Found, check
from mitsuba_ref.judge.checks.knife_edges import AimedFailure
from mitsuba_ref.judge.origin_rules import OriginFindings, judge_origins, rays_of_bounce, reference_rays
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import SendRequest

WhyWrong = list[AimedFailure]


@check(of=(OURS,))
def check_spawned_origins(bounce: Bounce, wrong_rays: WhyWrong) -> Found:
    """No ray starts beyond another surface, on the wrong side, or where it meets its own surface again.

    The parent of a failing ray is appended to `wrong_rays` as a scene of one ray.
    """
    found = judge_origins(rays_of_bounce(bounce))
    if not len(found.wrong):
        return 0.0, found.text()
    if not len(found.avoidable):
        return 0.0, f"{found.text()}, all where float32 cannot resolve the surfaces"
    return np.inf, f"{found.text()}; {_kept(found, int(found.avoidable[0]), 'spawned-origin', wrong_rays)}"


@check(of=(OURS,))
def check_reference_origins(bounce: Bounce, send: SendRequest, timeout: float, wrong_rays: WhyWrong) -> Found:
    """Count the errors of Mitsuba's spawn_ray at the same hits; they do not fail the scene.

    The parent of the first one is appended to `wrong_rays` as a scene of one ray.
    """
    leaving = reference_rays(rays_of_bounce(bounce), send, timeout)
    if isinstance(leaving, Crash):
        return np.inf, leaving.message
    if not len(leaving.rays.q):
        return 0.0, f"{NOT_JUDGED}: Mitsuba hits no surface that rays leave"
    found = judge_origins(leaving)
    if not len(found.wrong):
        return 0.0, found.text()
    return 0.0, f"{found.text()}; {_kept(found, int(found.wrong[0]), 'spawn-ray', wrong_rays)}"


def _kept(found: OriginFindings, row: int, label: str, wrong_rays: WhyWrong) -> str:
    """The example at a row, which is appended to `wrong_rays`."""
    wrong_rays.append(AimedFailure(found.example(row), found.scene_of(row), label))
    return wrong_rays[-1].what

"""Scenes held to Mitsuba by the judge itself, through one child for all of them."""

from caster.description.errors import SceneError
from caster.scene.model import Scene
from mitsuba_ref.fuzz.findings import Finding, Tally
from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.reference.session import ResidentSession
from mitsuba_ref.runner.validation import validate_scene

MITSUBA_TIMEOUT_S = 60.0  # seconds; a scene of a few dozen pixels takes a hundredth of one


def compare_with_mitsuba(scene: Scene, resident: ResidentSession, tally: Tally) -> list[Finding]:
    """What the judge says against it. Scenes that prove little pass: pictures of a few pixels may hit nothing."""
    try:
        verdict = validate_scene(scene, "fuzz", timeout=MITSUBA_TIMEOUT_S, send=resident.send)
    except SceneError:  # numbers beyond float32
        tally.outside += 1
        return []
    tally.judged += 1
    tally.pixels += verdict.pixels
    if verdict.problem:
        return [Finding("crash", verdict.problem)]
    if verdict.failing or not verdict.checks_pass:
        return [_finding_of(verdict)]
    return []


def _finding_of(verdict: SceneVerdict) -> Finding:
    for check in verdict.checks:
        if not check.ok:
            what = f"{check.name}: {check.ratio:.3g} times its bound; {check.what}"
            return Finding("judged", what, detail=check.name)
    first = verdict.failures[0]
    sides = f"ours {first.subject}; Mitsuba {first.reference}; exactly {first.exact}; {first.reason}"
    what = f"{first.verdict}: {first.check} {first.ratio:.3g} times its bound; {sides}"
    return Finding("judged", what, pixel=(first.x, first.y), detail=first.verdict)

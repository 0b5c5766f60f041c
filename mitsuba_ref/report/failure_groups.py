"""What all scenes that fail have in common, and which of them is the simplest: facts to begin with, no causes."""

from collections.abc import Callable, Iterator, Sequence

from mitsuba_ref.judge.classification import EXACT
from mitsuba_ref.judge.verdict import SceneVerdict

MIN_FAILING_SCENES = 2  # scenes that fail: of one, everything is in common
NO_ANSWER = "no comparison"


def common_traits(scenes: Sequence[SceneVerdict]) -> list[str]:
    """What is the same in all that fail, each with what is so in how many that pass; [] where that separates nothing.

    A type of shape or camera counts only if some scene that passes is without.
    """
    failing = [scene for scene in scenes if not scene.ok]
    passing = [scene for scene in scenes if scene.ok]
    if len(failing) < MIN_FAILING_SCENES:
        return []
    traits = [
        f"{each} fails" if each != NO_ANSWER else f"there is {each}"
        for each in _common_to(failing, checks_of)
    ]
    for what, of in (("shape", shapes_of), ("camera", cameras_of)):
        for each in _common_to(failing, of):
            also = sum(each in of(scene) for scene in passing)
            if also < len(passing):
                traits.append(f"{what} {each} (in {also} of {len(passing)} that pass)")
    return traits


def _common_to(scenes: Sequence[SceneVerdict], of: Callable[[SceneVerdict], frozenset[str]]) -> list[str]:
    return sorted(frozenset.intersection(*map(of, scenes)))


def checks_of(scene: SceneVerdict) -> frozenset[str]:
    """The checks that a scene fails; `exact`, which fails beside most others, only where it is alone."""
    if scene.problem:
        return frozenset([NO_ANSWER])
    named = {*scene.failing_by, *(check.name for check in scene.checks if not check.ok)}
    named |= {failure.check for failure in scene.failures}  # a candidate's, which are not counted by check
    return frozenset(named - {EXACT} or named)


def shapes_of(scene: SceneVerdict) -> frozenset[str]:
    return frozenset(scene.composition.shapes)


def cameras_of(scene: SceneVerdict) -> frozenset[str]:
    return frozenset({scene.composition.camera} - {""})


def simplest_failing(scenes: Sequence[SceneVerdict]) -> SceneVerdict | None:
    """The failing scene with the fewest primitives, then shapes, then pixels; None below MIN_FAILING_SCENES."""
    failing = [scene for scene in scenes if not scene.ok]
    known = [scene for scene in failing if scene.composition.primitives]
    if len(failing) < MIN_FAILING_SCENES or not known:
        return None
    return min(
        known, key=lambda s: (s.composition.primitives, sum(s.composition.shapes.values()), s.pixels, s.name)
    )


def group_lines(scenes: Sequence[SceneVerdict]) -> Iterator[str]:
    """Lines on what failing scenes have in common, and the simplest of them; none below MIN_FAILING_SCENES."""
    failing = sum(not scene.ok for scene in scenes)
    traits, first = common_traits(scenes), simplest_failing(scenes)
    if traits:
        yield f"in common:  of all {failing} that fail: {'; '.join(traits)}"
    if first is not None:
        count = first.composition.primitives
        size = f"{count} primitive{'s' if count > 1 else ''}, {first.pixels} pixels"
        yield f"look first: {first.name}, the simplest of them ({size})"

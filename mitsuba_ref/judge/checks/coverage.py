"""Check of what is judged of a Mitsuba file."""

import numpy as np

from caster.scene.model import Scene
from mitsuba_ref.judge.checks import Found, check
from mitsuba_ref.reference.originals import original_of


@check()
def check_coverage(scene: Scene) -> Found | None:
    """Require that every shape of a Mitsuba file is judged, if the run is strict."""
    original = original_of(scene)
    if original is None:
        return None
    covered = original.coverage
    ratio = np.inf if covered.strict and covered.partial else 0.0
    return ratio, "; ".join([covered.brief or f"all {covered.shapes} shapes", *covered.left_out])

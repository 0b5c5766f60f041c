# A test: the message of the assertion names the cause, a pixel, and the command that shows it again.
import pytest
from mine import trace

import mitsuba_ref


@pytest.mark.parametrize("scene", ["scene.toml", "builtin:needles"])
def test_my_caster(scene: str) -> None:
    verdict = mitsuba_ref.validate(scene, candidate=trace, size=(16, 16))
    assert verdict.ok, str(verdict)

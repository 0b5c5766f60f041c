"""The sweeps ask Mitsuba: with Embree's robust mode or without, by every variant there is."""

import numpy as np
import pytest
from mitsuba_scenes import job, shape, write

from mitsuba_ref.hard import BY_NAME
from mitsuba_ref.hard.swept_families import SWEPT
from mitsuba_ref.reference import mitsuba_process
from mitsuba_ref.reference.messages import Crash, TraceResponse
from mitsuba_ref.reference.variants import SCALAR, usable_variants
from mitsuba_ref.stress import sweeps
from mitsuba_ref.stress.sweeps import CASTERS, Caster, Score, SweepResult

RAYS = 16


@pytest.mark.parametrize("first", [0, 1, 2])
@pytest.mark.slow("every family before every variant", keep=1)
def test_all_casters_agree_where_a_family_is_easiest(first):
    """So later failures come from the stress, not from the way of tracing."""
    asked = ["scalar", *(["llvm", "llvm-robust"] if usable_variants().libllvm else [])]
    for family in SWEPT[first::3]:
        ready = sweeps.prepare_setting(family, 0, family.easiest, RAYS)
        result = sweeps.score_setting(ready, CASTERS)
        sweep = SweepResult.of(family, [result])
        assert sweep.ok, sweep.problems
        for key in asked:
            found = result.witnesses[key]
            assert isinstance(found, Score), (family.name, found)
            assert found.compared >= RAYS // 4, (family.name, key)
            if key != "llvm":  # which leaks at edges
                assert not found.breaks and found.worst < 1.0, (family.name, key, found)


def test_the_robust_mode_is_switched_off_where_that_is_requested():
    """Without it, some 6 of 100 rays slip through edges."""
    ready = sweeps.prepare_setting(BY_NAME["watertight-edges"], 0, 0.0, 2000)
    robust, plain = (sweeps.trace_by_reference(Caster("", "", SCALAR, robust=on), ready) for on in (True, False))
    assert np.all(robust.hit) and 40 <= np.sum(~plain.hit) <= 400


def test_a_large_sphere_which_mitsuba_warns_of_is_requested_all_the_same(tmp_path):
    xml = write(tmp_path, shape("sphere", "ball", 0, stretch="1e12 1e12 1e12"))
    question = job(xml, SCALAR, [[0.0, 0.0, 5e12]], [[0.0, 0.0, -1.0]], lights=False)
    assert isinstance(mitsuba_process.send_request(question), Crash)
    answer = mitsuba_process.send_request(
        job(xml, SCALAR, [[0.0, 0.0, 5e12]], [[0.0, 0.0, -1.0]], lights=False, strict=False)
    )
    assert isinstance(answer, TraceResponse) and answer.t.tolist() == [np.float32(4e12)]

"""Hypothesis strategies draw what they say, a fault is found and shrinks, and the example of the docs runs."""

import re
import sys
from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, find, given, settings
from places import ROOT

import caster
from mitsuba_ref.strategies import TRIANGLES, rays, scenes

FEW = settings(max_examples=20, suppress_health_check=[HealthCheck.too_slow])


@FEW
@given(rays(TRIANGLES, most=5))
def test_triangles_alone_are_drawn_with_rays_that_can_be_cast(drawn):
    scene, o, d = drawn
    assert {shape.type for shape in scene.shapes} <= set(TRIANGLES) and scene.shapes
    assert len(o) <= 5 and o.shape == d.shape and d.any(axis=1).all() and np.isfinite([o, d]).all()


@FEW
@given(scenes(families=["tangents"]))
def test_a_family_can_be_chosen(scene):
    assert {shape.type for shape in scene.shapes} <= {
        "sphere",
        "cylinder",
        "disk",
        "spheres",
        "ellipsoids",
        "linear_curve",
    }


def test_an_unknown_family_is_an_error():
    with pytest.raises(KeyError, match="tangent"):
        find(scenes(families=["tangent"]), lambda scene: True)


def test_a_fault_shrinks_to_one_shape_and_one_ray():
    """A caster that misses hits nearer than 1e-4."""

    def differs(drawn):
        return not np.array_equal(caster.cast(*drawn).t, caster.cast(*drawn, t_min=1e-4).t)

    without_explanation = settings(FEW, max_examples=500, phases=[Phase.generate, Phase.shrink])
    found = find(rays(TRIANGLES), differs, settings=without_explanation)
    assert len(found.o) == 1 and len(found.scene.shapes) == 1


@pytest.mark.parametrize("t_max", [np.inf, 1.0])
def test_the_example_of_the_docs_runs(monkeypatch, t_max):
    (code,) = (
        block
        for block in re.findall(r"```python\n(.*?)```", (ROOT / "docs/ci.md").read_text(), re.DOTALL)
        if "mitsuba_ref.strategies" in block
    )
    mine, names = ModuleType("mine"), {}
    mine.trace = lambda scene, o, d: (caster.cast(scene, o, d, t_max=t_max).t, None)
    monkeypatch.setitem(sys.modules, "mine", mine)
    exec(compile(code, "docs/ci.md", "exec"), names)
    if np.isfinite(t_max):
        with pytest.raises(AssertionError):
            names["test_no_surface_is_missed"]()
    else:
        names["test_no_surface_is_missed"]()

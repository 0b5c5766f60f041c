"""docs/method.md: its worked pixel follows from its formulas, and from the judge's own; its formulas are numbered."""

import re

import method_pixel
import numpy as np
import pytest
from places import ROOT

from caster.scene.files import load_scene
from mitsuba_ref.error_model.bounds import intersections_at
from mitsuba_ref.error_model.scene_model import REFERENCE_SIDE
from mitsuba_ref.reference.shared_input import own_model, packed_float32

PAGE = method_pixel.PAGE.read_text(encoding="utf-8")


def test_the_numbers_and_the_figure_of_the_worked_pixel_are_those_of_the_script():
    assert method_pixel.with_block(PAGE) == PAGE, "run python docs/method_pixel.py"
    it = method_pixel.bound(*method_pixel.ray_and_corners())
    drawn = method_pixel.FIGURE.read_text(encoding="utf-8")
    assert drawn == method_pixel.figure(it, method_pixel.mitsuba_t(PAGE)), "run python docs/method_pixel.py"
    assert abs(method_pixel.mitsuba_t(PAGE) - it.t) < it.t_error


def test_the_judge_has_the_same_bound_as_the_formulas_of_the_page():
    o, d, corners = method_pixel.ray_and_corners()
    it = method_pixel.bound(o, d, corners)
    model = own_model(packed_float32(load_scene(ROOT / method_pixel.SCENE)))
    at = intersections_at(model, np.array([method_pixel.SHAPE]), o[None], d[None], np.array([it.t]), REFERENCE_SIDE)
    assert at.t[0] == pytest.approx(it.t, rel=1e-14)
    assert at.t_error[0] == pytest.approx(it.t_error, rel=1e-12)


def test_every_formula_has_a_number_and_every_number_a_formula():
    numbers = [int(each) for each in re.findall(r"^    \((\d+)\) ", PAGE, re.MULTILINE)]
    assert numbers == list(range(1, len(numbers) + 1)) and len(numbers) > 20
    assert {int(each) for each in re.findall(r"\((\d+)\)", re.sub(r"```.*?```", "", PAGE, flags=re.S))} <= {*numbers}

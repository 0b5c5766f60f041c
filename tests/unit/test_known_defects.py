"""Each known defect of Mitsuba is recognised by measurements at a pixel, and an ordinary pixel matches none."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from caster.shapes.linear_curve import RoundSegments
from mitsuba_ref.error_model import defect_conditions
from mitsuba_ref.error_model.defect_conditions import DefectFeatures, DefectView
from mitsuba_ref.judge.defect_lookup import defect_name, defect_of, known_defects
from mitsuba_ref.shapes import KINDS as KINDS_OF_PRIMITIVES
from mitsuba_ref.shapes.linear_curve import view_segment

INSIDE = frozenset({"inside"})
ORDINARY = DefectFeatures(
    "Triangles", "Triangles", INSIDE, 4.2, False, 0.7, False, False, 0.3, 5.0, 3.0, 1.0, 1.0, True
)
FAR, EDGE_ON, ALONG = (
    2.0 * defect_conditions.FAR_IN_SIZES,
    0.5 * defect_conditions.NEARLY_EDGE_ON_COSINE,
    0.5 * defect_conditions.ALONG_AXIS_SINE,
)
KINDS = ("Triangles", "Planes", "Disks", "Spheres", "Ellipsoids", "Cylinders", "RoundSegments")


def at(kind, where="inside", **more):
    """An ordinary pixel of a kind, but for some measures; the reference misses it unless it says otherwise."""
    return replace(ORDINARY, ours=kind, theirs=more.pop("theirs", ""), where=frozenset({where}), **more)


EXAMPLES = {
    27: at("Triangles", theirs="Triangles", t=math.nan),
    30: at("Spheres", theirs="Planes", t=0.0, at_zero=True),
    7: at("Planes", theirs="Cylinders", t=0.0, at_zero=True),
    21: at("Planes", theirs="Triangles", without_area=True),
    28: at("", theirs="Triangles", beyond_corners=True, cosine=EDGE_ON, nearly=False),
    4: at("Spheres", "tangent"),
    55: at("Cylinders", "tangent"),
    16: at("Triangles", "vertex"),
    45: at("Disks", "rim"),
    56: at("Cylinders", "rim"),
    22: at("Triangles", slenderness=2.0**-22),
    19: at("Triangles", slenderness=2.0**-15),
    26: at("Triangles", cosine=2.0**-12),
    43: at("Disks", cosine=2.0**-12),
    53: at("Cylinders", axis_angle=ALONG),
    8: at("Ellipsoids", stretch=2.0 * defect_conditions.SQUASHED_STRETCH),
    57: at("Cylinders", distance=FAR),
    2: at("Spheres", distance=FAR),
    35: at("Triangles", distance=FAR),
    9: at("Spheres", offset=FAR),
    34: at("Triangles", offset=FAR),
    47: at("Disks", offset=FAR),
    61: at("Cylinders", offset=FAR),
    15: at("Triangles", robust=False),
    78: at("RoundSegments", starts_inside=True),
}


def test_every_case_has_an_example():
    assert [defect.number for defect in known_defects()] == list(EXAMPLES)
    assert len({defect_name(number) for number in EXAMPLES}) == len(EXAMPLES)


def test_no_two_cases_have_the_same_priority():
    assert [defect.priority for defect in known_defects()] == list(range(len(EXAMPLES)))


NEUTRAL = replace(ORDINARY, ours="", theirs="")


@pytest.mark.parametrize("kind", KINDS)
def test_a_pixel_of_several_cases_is_named_by_the_first_of_them(kind):
    """Each with each other of the same kind: the measures of both examples at once."""
    examples = [(number, example) for number, example in EXAMPLES.items() if kind in (example.ours, example.theirs)]
    pairs = 0
    for i, (first, one) in enumerate(examples):
        for second, other in examples[i + 1 :]:
            given = [name for name in vars(one) if getattr(other, name) != getattr(NEUTRAL, name)]
            shared = {name for name in given if getattr(one, name) != getattr(NEUTRAL, name)}
            if any(getattr(one, name) != getattr(other, name) for name in shared) or second == 27:
                continue
            both = replace(one, **{name: getattr(other, name) for name in given})
            assert defect_of(both) == first, (first, second)
            pairs += 1
    assert pairs >= {"Triangles": 10, "Cylinders": 4, "Spheres": 1}.get(kind, 0)


@pytest.mark.parametrize("ours", ["", *KINDS])
@pytest.mark.parametrize("theirs", ["", *KINDS])
@pytest.mark.parametrize("t", [4.2, 0.0, math.inf])
def test_an_ordinary_pixel_is_none_of_them(ours, theirs, t):
    for where in ("inside", "edge"):
        assert defect_of(at(ours, where, theirs=theirs, t=t)) is None


@pytest.mark.parametrize("number", [30, 7])
def test_a_start_on_a_surface_is_a_case_where_it_is_hit_at_zero_alone(number):
    for change in ({"t": 4.2}, {"t": -1e-30}, {"t": math.inf}, {"at_zero": False}):
        assert defect_of(replace(EXAMPLES[number], **change)) is None


@pytest.mark.parametrize("number", [4, 55, 16, 45, 56])
def test_what_the_reference_does_hit_is_no_case_of_a_miss(number):
    example = EXAMPLES[number]
    assert defect_of(replace(example, theirs=example.ours)) is None


@pytest.mark.parametrize("number", [22, 19, 26, 35, 34])
def test_an_answer_far_from_the_exact_one_is_no_case_of_rounding(number):
    assert defect_of(EXAMPLES[number]) == number
    assert defect_of(replace(EXAMPLES[number], nearly=False)) is None


def test_each_kind_measures_what_its_cases_depend_on():
    """By hand: a ray of length 5 along (0, 3, 4), primitives that stretch by (2, 1, 1/2) along the axes."""
    d, o = np.array([0.0, 3.0, 4.0]), np.ones(3)
    to_object = np.stack([np.eye(3), np.diag([0.5, 1.0, 2.0])])
    affine = SimpleNamespace(to_object=to_object, to_world=np.linalg.inv(to_object), center=np.zeros((2, 3)))
    long_way = pytest.approx(math.hypot(3.0, 8.0))
    views = {
        "Ellipsoids": {"stretch": long_way},
        "Cylinders": {"stretch": long_way, "axis_angle": pytest.approx(0.6)},
        "Disks": {"cosine": pytest.approx(0.8)},
        "Planes": {"cosine": pytest.approx(0.6)},
        "Spheres": {},
    }
    affine.normal = np.array([[1.0, 0, 0], [0, -7.0, 0]])
    for kind in KINDS_OF_PRIMITIVES.values():
        if kind.name in views:
            assert kind.defect_view(affine, 1, o, d, 1.0) == DefectView(**views.pop(kind.name))
    assert not views


@pytest.mark.parametrize(
    ("o", "inside"),
    [
        ((2.0, 0.0, 1.3), True),  # the cone's radius is 1.5 / cos there
        ((2.0, 0.0, 1.8), False),
        ((-0.9, 0.0, 0.0), True),
        ((-1.1, 0.0, 0.0), False),
        ((0.0, 0.0, 31.1), True),  # on the second segment, up to rounding
        ((0.0, 0.0, 31.2), False),
        ((0.3, 0.0, 30.0), True),  # in a sphere that holds the other end
    ],
)
def test_a_ray_from_within_any_segment_is_told_from_one_beside_it(o, inside):
    start, end = np.array([[0.0, 0, 0], [0, 0, 30], [0, 0, 30]]), np.array([[4.0, 0, 0], [0, 0, 31], [0.1, 0, 30]])
    prims = RoundSegments(start, end, np.array([[1.0, 2.0], [0.1, 0.1], [0.5, 0.01]]))
    for k in range(3):
        assert view_segment(prims, k, np.array(o), np.ones(3), 1.0) == DefectView(starts_inside=inside)

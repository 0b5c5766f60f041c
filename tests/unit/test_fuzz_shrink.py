"""Failing scenes made small: what is left still fails in the same way, and nothing can be left out of it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from caster.geometry.packing import pack
from mitsuba_ref.fuzz.cases import SCENE_ERRORS, Case, one_ray
from mitsuba_ref.fuzz.families import BY_NAME, example, scene_of
from mitsuba_ref.fuzz.findings import Finding
from mitsuba_ref.fuzz.settings import shape_types
from mitsuba_ref.fuzz.shrink import (
    Budget,
    Shrinker,
    as_packed,
    complexity,
    fewer_fields,
    fewer_shapes,
    rounder_numbers,
    simpler_numbers,
    single_ray_case,
    smallest_case,
    translated,
    walk,
)
from mitsuba_ref.oracle.oracle import Oracle

floats = st.floats(allow_nan=False, allow_infinity=False)


@given(floats)
def test_simpler_numbers_are_finite_simpler_and_finitely_many(x):
    """So replacing numbers by simpler ones ends."""
    for other in simpler_numbers(x):
        assert np.isfinite(other) and (complexity(other) < complexity(x) or (other == 0.0 and x == 0.0))


@given(floats)
def test_always_the_simplest_leads_to_zero(x):
    first = next(simpler_numbers(x), None)
    assert first == 0.0 if x != 0.0 else first in (None, 0.0)


@pytest.mark.parametrize(("simple", "less"), [(0.0, 1.0), (1.0, 3.0), (0.5, 0.75), (3.0, 0.1), (-1.0, 1e-300)])
def test_cost_orders_numbers_by_bits_then_by_size(simple, less):
    assert complexity(simple) < complexity(less)


def test_an_infinite_limit_has_nothing_simpler():
    assert list(simpler_numbers(np.inf)) == []


def has_three_and_seven(data):
    """A failure that takes two shapes, one of them with a number of three bits."""
    radii = [shape.get("radius", 1.0) for shape in data["shape"]]
    return any(r >= 6.5 for r in radii) and any(2.6 < r < 3.5 for r in radii)


def a_case():
    shapes = [
        {"type": "sphere", "radius": r, "center": [r, 0.1, -r], "name": f"n{r}"} for r in np.linspace(0.1, 9.7, 25)
    ]
    return {"film": {}, "camera": {}, "shape": shapes}


def test_everything_that_does_not_matter_goes():
    shrinker = Shrinker(a_case(), has_three_and_seven, Budget(5000))
    small = shrinker.run([fewer_shapes, fewer_fields, rounder_numbers])
    assert small["shape"] == [{"type": "sphere", "radius": 3.0}, {"type": "sphere", "radius": 8.0}]


def test_what_is_left_fails_however_few_the_attempts():
    for attempts in (0, 1, 7, 40, 200):
        shrinker = Shrinker(a_case(), has_three_and_seven, Budget(attempts))
        assert has_three_and_seven(shrinker.run([fewer_shapes, fewer_fields, rounder_numbers]))


def test_no_attempt_is_made_when_the_time_is_up():
    asked = []
    shrinker = Shrinker(a_case(), lambda data: bool(asked.append(data)), Budget(until=0.0))
    assert shrinker.run([fewer_shapes, rounder_numbers]) == a_case() and asked == []


def test_a_walk_goes_through_everything():
    data = {"shape": [{"a": [1.0, {"b": 2.0}]}]}
    paths = [path for path, _ in walk(data)]
    assert ("shape", 0, "a", 1, "b") in paths and len(paths) == 6


@pytest.mark.parametrize("kind", shape_types())
def test_shapes_written_anew_have_the_same_primitives(kind):
    """In the same order, so that ties stay what they are."""
    exercised = 0
    for number in range(200):
        data = example(6, number, [BY_NAME["any"]]).data
        for shape in data["shape"]:
            if shape["type"] != kind:
                continue
            (part,) = pack(scene_of({**data, "shape": [shape]})).parts
            parts = pack(scene_of({**data, "shape": as_packed(part)})).parts
            for k, other in enumerate(parts):
                assert type(other) is type(part)
                exercised += 1
                for ours, theirs in zip(corners(part, k), corners(other, 0), strict=True):
                    np.testing.assert_allclose(ours, theirs, rtol=4e-16, atol=0.0)
        if exercised > 20:
            break
    assert exercised >= 3


def corners(part, k):
    """The numbers that say where primitive k is."""
    if hasattr(part, "faces"):
        return [part.vertices[part.faces[k]]]
    return [a[k] for name, a in part._asdict().items() if name not in ("turn", "to_object")]


def test_what_is_moved_is_all_of_it():
    by = np.array([1.0, 2.0, 3.0])
    assert translated({"type": "sphere", "center": [0.0, 0.0, 1.0]}, by) == {
        "type": "sphere",
        "center": [1.0, 2.0, 4.0],
    }
    matrix = np.eye(4).tolist()
    (step,) = translated({"type": "disk", "to_world": [{"matrix": matrix}]}, by)["to_world"]
    assert np.array(step["matrix"])[:3, 3].tolist() == by.tolist() and matrix == np.eye(4).tolist()
    assert translated({"type": "cube"}, by) is None


def hits_something(case):
    """A stand-in for a fault: every ray that meets a triangle is said to be wrong."""
    try:
        packed = pack(case.scene())
    except SCENE_ERRORS:
        return []
    answer = Oracle(packed).first_hit(case.ray.o[0].tolist(), case.ray.d[0].tolist())
    return [Finding("prim", "it is hit", case.ray)] if answer.hit else []


@settings(deadline=None, max_examples=4)
@given(st.integers(0, 40))
def test_a_mesh_shrinks_to_one_triangle_and_round_numbers(number):
    tried = example(7, number, [BY_NAME["edges"]])
    shots = tried.rays(pack(scene_of(tried.data)))
    case = Case(tried.data["film"], tried.data["camera"], tried.data["shape"])
    for i in range(len(shots.t_min)):
        with_ray = case._replace(ray=shots.taken(slice(i, i + 1)))
        if hits_something(with_ray):
            small = smallest_case(with_ray, hits_something(with_ray)[0], hits_something)
            assert [shape["type"] for shape in small.shapes] == ["triangle"]
            assert hits_something(small)
            numbers = [x for _, x in walk(small.to_data()["shape"]) if isinstance(x, float)]
            assert len(numbers) == 9 and sum(complexity(x)[0] <= 4 for x in numbers) >= 6
            return
    raise AssertionError("no ray hits anything")


def test_a_case_is_the_same_as_plain_data():
    ray = one_ray([1.0, -0.0, 2.0], [0.0, 1.0, -0.0], 0.25, np.inf)
    case = Case({"width": 1}, {"type": "panorama"}, [{"type": "sphere"}], ray)
    again = Case.of(case.to_data())
    assert again.to_data() == case.to_data() and np.signbit(again.ray.o[0, 1])


def test_a_pixel_of_another_film_leaves_the_case_as_it_is():
    """A route may be a film of 128 pixels of a scene whose own has four; one inside becomes a case of a single ray."""
    camera = {"type": "pinhole", "eye": [0, 0, 5], "look_at": [0, 0, 0], "fov": 40}
    case = Case({"width": 4, "height": 4}, camera, [{"type": "sphere"}])
    tried = []

    def differs(each):
        tried.append(each)
        return [Finding("route", "other bits")]

    assert single_ray_case(case, Finding("route", "other bits", pixel=(99, 0)), differs) == case and not tried
    assert single_ray_case(case, Finding("route", "other bits", pixel=(3, 2)), differs).ray is not None

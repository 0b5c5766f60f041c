"""Numbers and vectors of descriptions: accepted spellings, and messages for the others."""

import math
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from caster.description import fields
from caster.description.errors import SceneError
from caster.description.fields import Description


class Thing(Description):
    """One field of each kind."""

    number: fields.Number = 0.0
    length: fields.Positive = 1.0
    share: fields.Fraction01 = 0.5
    angle: fields.FieldOfView = 45.0
    v: fields.Vec3 = (0.0, 0.0, 0.0)
    uv: fields.Vec2 = (0.0, 0.0)
    way: fields.UnitVec3 = (0.0, 0.0, 1.0)
    colour: fields.RGB = (0.0, 0.0, 0.0)
    count: Annotated[int, Field(strict=True)] = 0
    on: fields.Flag = False
    word: str = ""


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_hex_float_string_is_the_number_to_the_bit(x):
    assert Thing(number=x.hex()).number == x


@pytest.mark.parametrize(("text", "x"), [("0x1.8p-3", 0.1875), ("-0X1P+4", -16.0), ("0x10", 16.0), ("+0x1.", 1.0)])
def test_hex_floats_may_be_spelled_in_these_ways(text, x):
    assert Thing(number=text).number == x


@pytest.mark.parametrize("value", [3, 3.0, np.float32(3), np.int16(3), np.float64(3)])
def test_numbers_of_python_and_numpy_are_numbers(value):
    number = Thing(number=value).number
    assert number == 3.0 and type(number) is float


REFUSED = [
    ("number", "1.5", 'must be a finite number, got "1.5": leave out the quotes'),
    ("number", "x", 'must be a finite number, got "x"'),
    ("number", "0x1.8p99999", 'must be a finite number, got "0x1.8p99999"'),
    ("number", "nan", 'must be a finite number, got "nan"'),
    ("number", True, "must be a finite number, got true"),
    ("number", math.nan, "must be a finite number, got nan"),
    ("number", -math.inf, "must be a finite number, got -inf"),
    ("number", 10**400, "must be a finite number, got a huge whole number"),
    ("number", None, "must be a finite number, got nothing"),
    ("number", {}, "must be a finite number, got a table"),
    ("number", [1], "must be a finite number, got [1]"),
    ("length", 0, "must be > 0, got 0"),
    ("length", -0.5, "must be > 0, got -0.5"),
    ("length", math.inf, "must be a finite number, got inf"),
    ("share", 1.0000000000000002, "must be <= 1, got 1.0000000000000002"),
    ("angle", 180, "must be < 180, got 180"),
    ("angle", 0.0, "must be > 0, got 0"),
    ("v", [1, 2], "must be 3 numbers [x, y, z], got 2: [1, 2]"),
    ("v", 5, "must be 3 numbers [x, y, z], got 5"),
    ("v", "abc", 'must be 3 numbers [x, y, z], got "abc"'),
    ("uv", [1, 2, 3], "must be 2 numbers [x, y], got 3: [1, 2, 3]"),
    ("way", [0, 0.0, -0.0], "must be a direction, so not all zero, got [0, 0, 0]"),
    ("colour", np.eye(2), "must be 3 numbers [r, g, b], got 2: [[1, 0], [0, 1]]"),
    ("count", 3.0, "must be a whole number, got 3"),
    ("count", True, "must be a whole number, got true"),
    ("count", "3", 'must be a whole number, got "3"'),
    ("on", 1, "must be true or false, got 1"),
    ("on", "yes", 'must be true or false, got "yes"'),
    ("word", 3, "must be a string, got 3"),
]


@pytest.mark.parametrize(("field", "value", "says"), REFUSED, ids=lambda v: str(v)[:20])
def test_what_is_no_value_of_a_field_is_refused_in_its_words(field, value, says):
    with pytest.raises(SceneError) as caught:
        Thing(**{field: value})
    assert str(caught.value) == f"thing: {field} {says}"


def test_the_items_of_a_vector_are_named_by_their_index():
    with pytest.raises(SceneError, match=r"^thing: v\[1\] must be a finite number, got \"a\"$"):
        Thing(v=[0, "a", 1])
    with pytest.raises(SceneError, match=r"^thing: colour\[2\] must be >= 0, got -1$"):
        Thing(colour=[0, 0, -1])


def test_a_direction_is_normalised_once():
    way = Thing(way=[1, 2, 3]).way
    assert Thing(way=way).way == way and math.hypot(*way) == pytest.approx(1, abs=2.0**-51)


def test_a_changed_copy_is_checked_like_the_first():
    thing = Thing(count=3)
    assert thing.model_copy(update={"number": 2}) == Thing(count=3, number=2)
    with pytest.raises(SceneError, match="must be > 0"):
        thing.model_copy(update={"length": -2})

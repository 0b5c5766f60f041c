"""assert_same_bits detects a single changed bit."""

import numpy as np
import pytest
from same_bits import assert_same_bits

CHANGES = {
    "last bit": ("t", 0, np.nextafter(1.5, 2.0)),
    "sign of zero": ("t", 1, -0.0),
    "sign of infinity": ("t", 2, -np.inf),
    "NaN": ("t", 3, 0.0),
    "id of a miss": ("prim", 2, 0),
}


def image() -> dict[str, np.ndarray]:
    return {"t": np.array([1.5, 0.0, np.inf, np.nan]), "prim": np.array([3, 0, -1, 7], np.int32)}


@pytest.mark.parametrize("change", CHANGES)
def test_one_changed_entry_is_detected(change):
    name, at, value = CHANGES[change]
    assert_same_bits(image(), image(), "untouched")
    changed = image()
    changed[name][at] = value
    with pytest.raises(AssertionError, match=rf"planted: {name}: 1 of 4 differ, first at \({at},\)"):
        assert_same_bits(image(), changed, "planted")


def test_an_array_of_another_type_or_shape_or_name_is_detected():
    for other in ({"t": np.zeros(4)}, {"t": np.zeros(3, np.float32)}, {"u": np.zeros(3)}):
        with pytest.raises(AssertionError, match="planted"):
            assert_same_bits({"t": np.zeros(3)}, other, "planted")

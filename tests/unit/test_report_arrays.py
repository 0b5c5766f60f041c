"""Arrays of a report: to the bit where that is promised, never too small where digits are dropped."""

import base64
import zlib

import numpy as np
import pytest

from mitsuba_ref.report.scene_record import base_bits, coarse, narrowest, packed, rounded

ODD = [0.0, -0.0, 1.5, -2.25, np.inf, -np.inf, np.nan, 5e-324, 1e-45, 3.4e38, np.pi]


def unpacked(found, like=None):
    """The way back, as page/arrays.js has it."""
    dtype = np.dtype(f"<{found['type']}")
    planes = np.frombuffer(zlib.decompress(base64.b64decode(found["z"])), np.uint8)
    bits = np.ascontiguousarray(planes.reshape(dtype.itemsize, -1).T).view(f"<u{dtype.itemsize}").ravel()
    if "delta" in found:
        bits = np.cumsum(bits, dtype=bits.dtype)
    if "xor" in found:
        bits = bits ^ base_bits(like, dtype)
    return bits.view(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32, np.uint8])
def test_what_goes_in_comes_out_to_the_bit(dtype):
    numbers = np.random.default_rng(4).normal(0.0, 40.0, (300, 3))
    values = numbers.astype(dtype) if dtype != np.uint8 else np.abs(numbers).astype(dtype)
    assert unpacked(packed(values)).tobytes() == np.ascontiguousarray(values.T).tobytes()


def test_bits_are_taken_off_the_reference_and_put_back():
    with np.errstate(over="ignore"):
        reference = np.array(ODD, np.float64).astype(np.float32)
    ours = np.array([*ODD[3:], *ODD[:3]], np.float64)
    for mine, theirs in ((ours, reference), (ours, reference.astype(np.float64)), (rounded(ours), reference)):
        assert unpacked(packed(mine, theirs), theirs).tobytes() == mine.tobytes()


def test_numbers_that_are_nearly_equal_take_little_room():
    reference = np.random.default_rng(4).uniform(1.0, 2.0, 10_000).astype(np.float32)
    ours = reference.astype(np.float64)
    assert len(packed(ours, reference)["z"]) < len(packed(ours)["z"]) / 50


def test_float32_only_where_nothing_is_lost():
    assert narrowest(np.array([1.5, np.nan, np.inf])).dtype == np.float32
    assert narrowest(np.array([1.5, 0.1])).dtype == np.float64


def test_shares_are_never_reported_smaller_than_they_are():
    numbers = 10.0 ** np.random.default_rng(4).uniform(-50.0, 50.0, 5000)
    told = coarse(numbers).astype(np.float64)
    assert np.all(told >= numbers)
    normal = (numbers > 2e-38) & (numbers < 3e38)
    assert np.all(told[normal] <= numbers[normal] * (1.0 + 2.0**-11 + 2.0**-22))


def test_the_bound_itself_stays_what_decides():
    edge = np.array([0.0, 1.0, np.nextafter(1.0, 2.0), np.nextafter(1.0, 0.0), np.inf, np.nan])
    told = coarse(edge)
    assert told[0] == 0.0 and told[1] == 1.0 and told[2] > 1.0 and told[3] == 1.0
    assert np.all(np.isposinf(told[4:]))

"""Arrays as text: bytes of equal weight together, deflated, in base64. What goes in comes out to the bit.

mitsuba_ref/report/page/arrays.js is the way back.
"""

import base64
import zlib
from typing import Any

import numpy as np

Packed = dict[str, Any]  # {"type": "f4", "z": text}, and "delta" or "xor" where that was done before

LEVEL = 4  # of zlib: takes 0.6 of the time of its usual 6, and 1.02 of the room
DIGITS = 12  # bits of a float32 that `coarse` drops: what is left tells one part in 2^11


def packed(values: np.ndarray, like: np.ndarray | None = None) -> Packed:
    """(n,) numbers or (n, c), whose channels follow one another.

    like: values of the same shape which these are nearly equal to, as floats. Their bits are taken off.
    """
    values = _in_a_row(values)
    bits = values.view(f"<u{values.itemsize}")
    if like is not None:
        return {
            "type": _type(values),
            "xor": 1,
            "z": _deflated(bits ^ base_bits(_in_a_row(like), values.dtype)),
        }
    plain, delta = _deflated(bits), _deflated(np.diff(bits, prepend=bits.dtype.type(0)))
    if len(delta) < len(plain):
        return {"type": _type(values), "delta": 1, "z": delta}
    return {"type": _type(values), "z": plain}


def base_bits(like: np.ndarray, dtype: np.dtype[Any]) -> np.ndarray:
    """Bits of the same numbers in this type; 0 for NaN, whose bits a conversion may change."""
    numbers = np.where(np.isnan(like), 0.0, like).astype(dtype)
    return numbers.view(f"<u{dtype.itemsize}")


def narrowest(values: np.ndarray) -> np.ndarray:
    """The same numbers as float32, if each is one, else as they are."""
    single = rounded(values)
    return single if np.array_equal(single, values, equal_nan=True) else values


def rounded(values: np.ndarray) -> np.ndarray:
    """As float32, inf where it holds no such number."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def coarse(values: np.ndarray) -> np.ndarray:
    """Shares and bounds, >= 0, as float32 of a few digits: up to 2^-11 more than they are, never less; NaN as inf.

    1 stays 1, and what is more than 1 stays more.
    """
    single = rounded(np.where(np.isnan(values), np.inf, values))
    single = np.where(single < values, np.nextafter(single, np.float32(np.inf)), single)
    step = np.uint32((1 << DIGITS) - 1)
    return ((single.view(np.uint32) + step) & ~step).view(np.float32)


def _in_a_row(values: np.ndarray) -> np.ndarray:
    """Channel after channel, little-endian."""
    return np.ascontiguousarray(values.T, values.dtype.newbyteorder("<")).ravel()


def _type(values: np.ndarray) -> str:
    return f"{values.dtype.kind}{values.itemsize}"


def _deflated(bits: np.ndarray) -> str:
    planes = np.ascontiguousarray(bits).view(np.uint8).reshape(-1, bits.itemsize).T
    return base64.b64encode(zlib.compress(planes.tobytes(), LEVEL)).decode("ascii")

"""Bitwise comparison of arrays; an error names the first difference."""

from collections.abc import Mapping

import numpy as np

Arrays = Mapping[str, np.ndarray]


def bits(a: np.ndarray) -> np.ndarray:
    """The array's bits as integers, so that NaN equals itself and -0.0 differs from 0.0."""
    return np.ascontiguousarray(a).view({8: np.uint64, 4: np.uint32, 1: np.uint8}[a.dtype.itemsize])


def assert_same_bits(expected: Arrays, got: Arrays, what: str) -> None:
    """Fail with the array, the number of entries that differ, and the first one."""
    assert expected.keys() == got.keys(), f"{what}: {sorted(expected)} against {sorted(got)}"
    for name, a in expected.items():
        b = got[name]
        assert (a.shape, a.dtype) == (b.shape, b.dtype), f"{what}: {name}: {a.shape} {a.dtype}, {b.shape} {b.dtype}"
        differ = np.argwhere(bits(a) != bits(b))
        if len(differ):
            at = tuple(int(i) for i in differ[0])
            raise AssertionError(
                f"{what}: {name}: {len(differ)} of {a.size} differ, first at {at}: {a[at]!r}, {b[at]!r}"
            )


def without_signed_zeros(arrays: Arrays) -> dict[str, np.ndarray]:
    """Replace -0.0 by 0.0: a mirror may turn one into the other, and they are equal numbers."""
    return {name: a + 0.0 if a.dtype.kind == "f" else a for name, a in arrays.items()}

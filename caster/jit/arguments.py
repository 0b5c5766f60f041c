"""The arguments of a kernel as machine code takes them: a block of words; an array is passed by its address."""

import struct
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

# Flags of an array for which Numba compiles different code. An array in both orders counts as C-ordered.
C_ORDER, FORTRAN_ORDER, ALIGNED, WRITABLE = 0x1, 0x2, 0x100, 0x400

INTEGER, REAL, BOOLEAN, NONE = "i", "d", "b", "n"

# Exactly these: for Numba, a subclass may be another type.
SCALARS: dict[type, str] = {
    int: INTEGER,
    np.int64: INTEGER,
    float: REAL,
    np.float64: REAL,
    bool: BOOLEAN,
    np.bool: BOOLEAN,
    type(None): NONE,
}


class Described(NamedTuple):
    """The arguments of a call."""

    key: tuple[Any, ...]  # decides which machine code fits: the form of each argument, classes and lengths of tuples
    words: list[int]  # a block: room for the answer, then the arguments


def describe(args: tuple[Any, ...]) -> Described | None:
    """Key and words of arguments; None if they are not arrays, numbers, None, or tuples of these."""
    key: list[Any] = []
    words = [0]
    return Described(tuple(key), words) if _describe(args, key, words) else None


def _describe(args: Iterable[Any], key: list[Any], words: list[int]) -> bool:
    for arg in args:
        kind: Any = type(arg)
        if kind is np.ndarray:
            flags = arg.flags.num
            order = C_ORDER if flags & C_ORDER else C_ORDER | FORTRAN_ORDER
            key.append((arg.dtype.str, arg.ndim, flags & (ALIGNED | WRITABLE | order)))
            words.append(id(arg))
        elif kind in SCALARS:
            form = SCALARS[kind]
            key.append(form)
            if form != NONE:
                words.append(WORD.unpack(REAL_NUMBER.pack(arg))[0] if form == REAL else int(arg))
        elif isinstance(arg, tuple):
            key.append((kind, len(arg)))
            if not _describe(arg, key, words):
                return False
        else:
            return False
    return True


REAL_NUMBER, WORD = struct.Struct("d"), struct.Struct("q")


def key_text(key: tuple[Any, ...]) -> str:
    """A key as text that is the same in every process."""
    return " ".join(
        f"{each[0].__module__}.{each[0].__qualname__}/{each[1]}" if is_tuple(each) else str(each) for each in key
    )


def tuple_classes(key: tuple[Any, ...]) -> tuple[type, ...]:
    """The classes of all tuples among the arguments, in order."""
    return tuple(each[0] for each in key if is_tuple(each))


def is_tuple(form: Any) -> bool:
    """Whether a part of a key is that of a tuple, whose members are the parts that follow."""
    return isinstance(form, tuple) and isinstance(form[0], type)

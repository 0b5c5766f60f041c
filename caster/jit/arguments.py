"""Arguments of a kernel as machine code takes them: an array by its address, a tuple by its members."""

import ctypes
import struct
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

# Of an array's flags, what Numba compiles a kernel of its own for. An array that is in both orders is in C's.
C_ORDER, FORTRAN_ORDER, ALIGNED, WRITABLE = 0x1, 0x2, 0x100, 0x400

ARRAY, INTEGER, REAL, BOOLEAN, NONE = "a", "i", "d", "b", "n"
Form = tuple[str, int, int]  # one of these; dimensions and bytes of an element, of an array

# Only these exactly: a class derived from one of them may be another type for Numba.
SCALARS: dict[type, str] = {
    int: INTEGER,
    np.int64: INTEGER,
    float: REAL,
    np.float64: REAL,
    bool: BOOLEAN,
    np.bool: BOOLEAN,
}
CLASSES = {form: tuple(kind for kind, its in SCALARS.items() if its == form) for form in (INTEGER, REAL, BOOLEAN)}

C: dict[str, Any] = {ARRAY: ctypes.c_int64, INTEGER: ctypes.c_int64, REAL: ctypes.c_double, BOOLEAN: ctypes.c_uint8}

MISMATCH = object()
"""Returned by a call that was made for other classes of arguments."""

# What an entry answers when all went well; None as an answer has a number of its own in Numba's calling convention.
DONE = (0, -2)


def significant_flags(flags: int) -> int:
    """Mask of the flags by which arrays with these flags differ for a kernel."""
    return ALIGNED | WRITABLE | C_ORDER | (0 if flags & C_ORDER else FORTRAN_ORDER)


def signature_key(args: tuple[Any, ...]) -> str | None:
    """What decides which machine code is right, the same in every process; None: there is none for such arguments."""
    words: list[str] = []
    return " ".join(words) if _describe(args, words) else None


def _describe(args: tuple[Any, ...], words: list[str]) -> bool:
    for arg in args:
        kind: Any = type(arg)
        if kind is np.ndarray:
            words.append(_array_word(arg.dtype, arg.ndim, arg.flags.num))
        elif kind in SCALARS or arg is None:
            words.append(NONE if arg is None else SCALARS[kind])
        elif isinstance(arg, tuple):
            words.append(_tuple_word(kind, len(arg)))
            if not _describe(arg, words):
                return False
        else:
            return False
    return True


# Written once for each combination, of which there are few: a film describes some hundred arguments a thread.


@cache
def _array_word(dtype: Any, ndim: int, flags: int) -> str:
    return f"{dtype.str}/{ndim}/{flags & significant_flags(flags)}"


@cache
def _tuple_word(kind: Any, length: int) -> str:
    return f"{kind.__module__}.{kind.__qualname__}/{length}"


def tuple_classes(args: tuple[Any, ...]) -> tuple[type, ...]:
    """The classes of all tuples among some arguments, in order."""
    found: list[type] = []
    for arg in args:
        if isinstance(arg, tuple):
            found += [type(arg), *tuple_classes(arg)]
    return tuple(found)


def argument_forms(args: tuple[Any, ...]) -> list[Form]:
    """The form of each argument, members of tuples one by one; of arguments that have a key."""
    found: list[Form] = []
    for arg in args:
        if isinstance(arg, tuple):
            found += argument_forms(arg)
        elif isinstance(arg, np.ndarray):
            found.append((ARRAY, arg.ndim, arg.itemsize))
        else:
            found.append((NONE if arg is None else SCALARS[type(arg)], 0, 0))
    return found


def checked_call(args: tuple[Any, ...], entry: Callable[..., int], gives: str) -> Callable[..., Any]:
    """A function of such arguments that calls `entry`; for any others it returns MISMATCH.

    It is written out for their classes, as what happens here comes on top of every call of a kernel. gives: the form
    of the answer, "" for none; `entry` takes the address for it first.
    """
    names = [f"a{n}" for n in range(len(args))]
    known: dict[str, Any] = {"entry": entry, "DONE": DONE, "OTHER": MISMATCH, "failed": fail}
    tests: list[str] = []
    flat: list[str] = []
    for name, arg in zip(names, args, strict=True):
        _unfold(name, name, arg, known, tests, flat)
    lines = [f"def call({', '.join(names)}):", f" if not ({' and '.join(tests)}): return OTHER"]
    if gives:
        known |= {"box": C[gives], "address": ctypes.addressof}
        lines += [" answer = box()", f" status = entry({', '.join(['address(answer)', *flat])})"]
    else:
        lines += [f" status = entry({', '.join(['0', *flat])})"]
    lines += [" if status not in DONE: failed()", " return answer.value" if gives else " return None"]
    exec("\n".join(lines), known)
    made: Callable[..., Any] = known["call"]
    return made


def _unfold(name: str, value: str, arg: Any, known: dict[str, Any], tests: list[str], flat: list[str]) -> None:
    """Tests for one argument, and what is handed over; `value` is the expression that gives it its name."""
    kind, this = type(arg), f"({name} := {value})" if name != value else name
    known[f"k_{name}"] = kind
    if arg is None:
        tests.append(f"{value} is None")
    elif kind in SCALARS:
        known[f"k_{name}"] = CLASSES[SCALARS[kind]]
        tests.append(f"type({this}) in k_{name}")
        flat.append(name)
    elif isinstance(arg, tuple):
        tests.append(f"type({this}) is k_{name} and len({name}) == {len(arg)}")
        for n, member in enumerate(arg):
            _unfold(f"{name}_{n}", f"{name}[{n}]", member, known, tests, flat)
    else:
        known[f"d_{name}"] = arg.dtype
        tests.append(f"type({this}) is k_{name} and {name}.ndim == {arg.ndim}")
        tests.append(f"({name}.dtype is d_{name} or {name}.dtype == d_{name})")
        mask = significant_flags(arg.flags.num)
        tests.append(f"{name}.flags.num & {mask} == {arg.flags.num & mask}")
        flat.append(f"id({name})")


def add_words(args: tuple[Any, ...], words: list[int]) -> None:
    """Arguments as eight bytes each for what an entry takes of them."""
    for arg in args:
        kind = type(arg)
        if kind is np.ndarray:
            words.append(id(arg))
        elif kind in SCALARS:
            words.append(BITS(REAL_NUMBER(arg))[0] if SCALARS[kind] == REAL else int(arg))
        elif arg is not None:
            add_words(arg, words)


REAL_NUMBER, BITS = struct.Struct("d").pack, struct.Struct("q").unpack


def fail() -> None:
    raise RuntimeError("a kernel failed: it counted with a number beyond its range")


def named_tuple_names(args: tuple[Any, ...]) -> list[str]:
    """Names of the NamedTuples among the arguments, for people."""
    return [type(arg).__name__ for arg in args if isinstance(arg, tuple) and type(arg) is not tuple]

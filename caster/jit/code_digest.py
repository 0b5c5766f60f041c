"""A digest of all code that a kernel can reach: its machine code is compiled anew only if some of that has changed.

Numba compiles globals as constants. So the digest of a function covers its byte code, its constants and the values of
the globals that it names. Functions among these are followed, and so are the bodies of protocol functions (`generic`)
for all classes in reach. Comments, line numbers and docstrings are left out.
"""

import hashlib
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np

# Packages that are known by name: their versions are part of the target.
WITHOUT_SOURCE = {*sys.stdlib_module_names, "numpy", "numba", "llvmlite"}


class OwnCode(NamedTuple):
    """The code of one function without that of others, and the names in it that can be followed."""

    text: str
    functions: set[FunctionType]
    generics: set[Any]  # decorators.Generic
    classes: set[type]


def code_digest(function: Callable[..., Any], classes: Iterable[type], generics: dict[Any, Any]) -> str:
    """Hexadecimal digest of the code that a function reaches with arguments of some classes.

    generics: protocol functions (decorators.Generic) by the function that stands for them in code.
    """
    known_classes: set[type] = {object, *classes}
    known_generics: set[Any] = set()
    texts = {_class_text(kind) for kind in known_classes}
    reached: set[Any] = set()
    waiting: set[Any] = {function}
    while waiting:
        while waiting:
            each = waiting.pop()
            reached.add(each)
            own = _OWN_CODES.get(each) or _OWN_CODES.setdefault(each, _read(each, generics))
            texts.add(own.text)
            waiting |= own.functions - reached
            known_classes |= own.classes
            known_generics |= own.generics
        pairs = [(g, c) for g in known_generics for c in g.bodies.keys() & known_classes]
        waiting = {_plain(g.bodies[c]) for g, c in pairs} - reached
    texts |= {f"{_name(g.stub)} for {_name(c)}: {_name(_plain(g.bodies[c]))}" for g, c in pairs}
    return hashlib.sha256("\0".join(sorted(texts)).encode()).hexdigest()


@cache
def compiler_digest() -> str:
    """Digest of the sources of caster/jit, which make machine code."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


_OWN_CODES: dict[Any, OwnCode] = {}  # by function


def _read(function: FunctionType, generics: dict[Any, Any]) -> OwnCode:
    functions, named_generics, classes = set[FunctionType](), set[Any](), set[type]()

    def label(value: Any) -> str:
        """A value as text; one that can be followed is noted."""
        if isinstance(value, type):
            classes.add(value)
            return _class_text(value)
        if isinstance(value, ModuleType):
            return f"module {value.__name__} {_source_digest(value)}"
        if isinstance(value, BuiltinFunctionType | np.ufunc):
            return f"{type(value).__name__} {_name(value)}"
        if isinstance(plain := _plain(value), FunctionType):
            package = plain.__module__.partition(".")[0]
            if value in generics:
                named_generics.add(generics[value])
            elif package not in WITHOUT_SOURCE and not plain.__module__.startswith(__package__):
                functions.add(plain)
            return f"function {_name(plain)} {getattr(value, 'options', '')}"
        if isinstance(value, tuple):
            return f"({', '.join(map(label, value))})"
        if isinstance(value, np.ndarray):
            return f"array {value.dtype.str} {value.shape} {value.tobytes().hex()}"
        if isinstance(value, frozenset):
            return f"set {sorted(map(label, value))}"
        if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
            return f"{type(value).__name__} {value!r}"
        return f"some {type(value).__module__}.{type(value).__qualname__}"  # Numba takes no such value

    words = [_name(function), label(function.__defaults__)]
    for code in _codes(function.__code__):
        # the first constant is the docstring, if there is one
        constants = code.co_consts[1:] if code.co_consts[:1] == (function.__doc__,) else code.co_consts
        words += [code.co_code.hex(), str((code.co_argcount, code.co_kwonlyargcount, code.co_flags))]
        words += [str((code.co_varnames, code.co_freevars, code.co_cellvars))]
        words += [label(constant) for constant in constants if not isinstance(constant, CodeType)]
        known = function.__globals__
        words += [f"{name} = {label(known[name])}" if name in known else name for name in code.co_names]
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        words.append(f"{name} = {label(cell.cell_contents)}")
    return OwnCode("\n".join(words), functions, named_generics, classes)


def _class_text(kind: type) -> str:
    return f"class {_name(kind)} {getattr(kind, '_fields', '')}"


def _codes(code: CodeType) -> Iterator[CodeType]:
    """A code object and those of nested functions."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


@cache
def _source_digest(module: ModuleType) -> str:
    """Digest of the source of a module whose attributes a kernel uses; "" for a package that is known by name."""
    path = getattr(module, "__file__", None)
    if module.__name__.partition(".")[0] in WITHOUT_SOURCE or path is None:
        return ""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _plain(value: Any) -> Any:
    """The Python function of a kernel."""
    return getattr(value, "function", value)


def _name(thing: Any) -> str:
    return f"{getattr(thing, '__module__', '')}.{getattr(thing, '__qualname__', getattr(thing, '__name__', ''))}"

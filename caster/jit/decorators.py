"""Decorators of kernels; without Numba they return functions unchanged.

`CASTER_JIT=0` switches the compiler off, so that pdb can step through the kernels. Numba is loaded when a kernel is
first compiled; kernels that have been compiled before run without it (caster/jit/machine_code.py).
"""

import contextlib
import gc
import hashlib
import importlib
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from functools import cache, cached_property, update_wrapper, wraps
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from caster.jit import machine_code
from caster.jit.arguments import INTEGER, REAL, describe, key_text, tuple_classes
from caster.jit.code_digest import code_digest, compiler_digest
from caster.jit.kernel_cache import COMPILED, INSTALLED, PACKAGE, cache_folder, claim, write_sealed

Function = TypeVar("Function", bound=Callable[..., Any])

# No fast-math, IEEE division, no GIL. Numba inlines what an inlined function calls first, unless told not to.
OPTIONS = {"nogil": True, "error_model": "numpy", "forceinline": False}

Key = tuple[tuple[Any, ...], int]  # key of the arguments, and the number of bodies registered

GIVES = {"none": "", "int64": INTEGER, "float64": REAL}  # forms of answers, by the names of Numba's types

_LOCK = machine_code.LLVM_LOCK  # also for the tables below


class CompilationLog:
    """The kernels of this process by name; `compiling` is called before one is compiled."""

    def __init__(self) -> None:
        self.compiled: list[str] = []
        self.loaded: list[str] = []  # from the cache
        self.compiling: Callable[[str], None] = lambda name: None


COMPILATION_LOG = CompilationLog()


@cache
def _compiler() -> Any:
    """The module caster.jit.compiler, which loads Numba."""
    compiler: Any = importlib.import_module("caster.jit.compiler")
    for entry in _GENERICS.values():
        entry.overload(compiler)
    return compiler


class Kernel:
    """A function and its machine code for each key of arguments."""

    __name__: str
    __qualname__: str

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self.function = function
        self.options = {**OPTIONS, **options}
        self._codes: dict[Key, machine_code.ObjectCode | None] = {}  # None: only Numba can call it

    def __call__(self, *args: Any) -> Any:
        described = describe(args)
        if described is None:
            return self._interpreted(*args)
        code = self._codes.get((described.key, len(_IMPLEMENTED)))
        return code(described.words) if code is not None else self._prepared(described.key, args)(*args)

    def __reduce__(self) -> str:
        return self.__qualname__

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's dispatcher for calls from kernels."""
        return _compiler().dispatcher_of(self.function, self.options)

    @cached_property
    def _python_dispatcher(self) -> Any:
        """Numba's dispatcher for calls from Python, where only Numba can pass the arguments or the answer."""
        return _compiler().dispatcher_of(self.function, self.options, from_python=True)

    @property
    def _numba_type_(self) -> Any:
        """The Numba type of a kernel that another one calls."""
        return _compiler().types.Dispatcher(self.dispatcher)

    def _prepared(self, key: tuple[Any, ...], args: tuple[Any, ...]) -> Callable[..., Any]:
        """Find or compile the machine code for these arguments; returns the function to call."""
        if _THREAD.interprets or self.function.__annotations__.get("return") not in (None, int, float):
            return self._interpreted  # Python calls kernels that answer anything else as plain Python
        with _LOCK:
            known = key, len(_IMPLEMENTED)
            if known not in self._codes and machine_code.is_supported():
                path = cache_folder() / self._file(key, machine_code.target_description())
                code = self._found(path, key)
                if code is None:
                    _SHARED.begin()
                    with claim(path, wait=_SHARED.work is None) as mine:
                        if not mine:
                            return self._interpreted
                        # another process may have compiled it meanwhile
                        code = self._found(path, key) or self._made(path, key, args)
                self._codes[known] = code
            return self if self._codes.get(known) is not None else self._python_dispatcher

    def _interpreted(self, *args: Any) -> Any:
        """Call the function as plain Python, with all that it calls."""
        if _THREAD.interprets:
            return self.function(*args)
        _THREAD.interprets = True
        try:
            with np.errstate(all="ignore"):  # as in machine code
                return self.function(*args)
        finally:
            _THREAD.interprets = False

    def code(self, args: tuple[Any, ...]) -> machine_code.ObjectCode | None:
        """Machine code for such arguments; None if only Numba can call this kernel, or another process compiles it."""
        described = describe(args)
        if described is None:
            return None
        known = described.key, len(_IMPLEMENTED)
        if known not in self._codes:
            self._prepared(described.key, args)
        return self._codes.get(known)

    def _file(self, key: tuple[Any, ...], target: str) -> str:
        """The file name of the machine code, from a digest of all that it depends on."""
        digest = code_digest(self.function, tuple_classes(key), _GENERICS)
        names = self.__module__, self.__qualname__, str(self.options)
        text = "\n".join([*names, key_text(key), digest, compiler_digest(), target])
        return f"{self.__name__}-caster_{hashlib.sha256(text.encode()).hexdigest()[:32]}.o"

    def _found(self, path: Path, key: tuple[Any, ...]) -> machine_code.ObjectCode | None:
        """Load machine code from the cache or else from the wheel; None if neither has it."""
        code = machine_code.read(path)
        if code is None and INSTALLED.is_dir() and machine_code.runs_portable_code():
            code = machine_code.read(INSTALLED / self._file(key, machine_code.PORTABLE_DESCRIPTION))
        if code is not None:
            COMPILATION_LOG.loaded.append(self._named(tuple_classes(key)))
        return code

    def _made(self, path: Path, key: tuple[Any, ...], args: tuple[Any, ...]) -> machine_code.ObjectCode | None:
        """Compile the kernel and keep its machine code; None if only Numba can call it."""
        name = self._named(tuple_classes(key))
        COMPILATION_LOG.compiling(name)
        types = tuple(map(_compiler().typeof, args))
        with _no_garbage_collection():
            self.dispatcher.compile(types)
            result = self.dispatcher.overloads[types]
            gives = GIVES.get(str(result.signature.return_type))
            if gives is None:
                raise TypeError(f"{name} answers {result.signature.return_type}: its annotation has to say so")
            data = _compiler().object_code(result, path, key, gives)
        COMPILATION_LOG.compiled.append(name)
        if data is None:
            return None
        write_sealed(path, gives.encode() + b"\n" + data)
        return machine_code.ObjectCode(path, gives, data)

    def _named(self, classes: Iterable[type]) -> str:
        """The name that users see: with the NamedTuples among the arguments."""
        kinds = ", ".join(kind.__name__ for kind in classes if kind is not tuple)
        return f"{self.__name__}({kinds})" if kinds else self.__name__


# ---- compilation by several processes ----

MAX_PROCESSES = 4  # each compiles the functions that many kernels share once more


class _Thread(threading.local):
    interprets = False  # whether kernels run as plain Python


_THREAD = _Thread()


class SharedCompilation:
    """Work whose kernels are compiled by several processes, started when the first kernel is missing."""

    def __init__(self) -> None:
        self.work: Callable[[], None] | None = None
        self.children: list[int] = []  # process numbers, the last one 0 in a child

    def run(self, work: Callable[[], None]) -> None:
        self.work, self.children = work, []
        try:
            work()
        except BaseException:
            for number in self.children:
                os.kill(number, signal.SIGKILL)
            raise
        finally:
            self.work = None
            for number in self.children:
                os.waitpid(number, 0)

    def begin(self) -> None:
        """Start processes that do the same work and leave out kernels that others have claimed."""
        if self.work is None or self.children:
            return
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
        for _ in range(min(cores, MAX_PROCESSES) - 1):
            self.children.append(os.fork())
            if self.children[-1] == 0:
                try:
                    nowhere = os.open(os.devnull, os.O_RDWR)
                    for stream in range(3):
                        os.dup2(nowhere, stream)
                    COMPILATION_LOG.compiling = lambda name: None
                    self.work()
                finally:
                    os._exit(0)


_SHARED = SharedCompilation()


def compile_ahead(about: str, work: Callable[[], None]) -> None:
    """Run `work` once for these sources, so that its kernels need not be compiled later.

    Several processes share the compilation: each compiles kernels that no other has claimed, and runs the others as
    plain Python. So `work` should use few primitives and pixels. about: a text that determines the kernels it needs.
    """
    if not COMPILED or not machine_code.is_supported() or _SHARED.work is not None:
        return
    words = [about, compiler_digest(), machine_code.target_description()]
    for path in sorted(PACKAGE.rglob("*.py")):  # an edit changes size or time, which are read sooner than the text
        status = path.stat()
        words.append(f"{path} {status.st_size} {status.st_mtime_ns}")
    done = cache_folder() / f"{hashlib.sha256('|'.join(words).encode()).hexdigest()[:32]}.done"
    if not done.exists():
        _SHARED.run(work)
        write_sealed(done, about.encode())


@contextlib.contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Without garbage collection the compiler is a tenth faster: nearly all of its many objects are freed at once."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def jit(function: Function) -> Function:
    """Compile a kernel: no fast-math, IEEE division, no GIL, cached on disk."""
    return Kernel(function, {}) if COMPILED else function  # type: ignore[return-value]  # called like the function


def inlined(function: Function) -> Function:
    """The same for a function that LLVM is to inline although it is large."""
    return Kernel(function, {"forceinline": True}) if COMPILED else function  # type: ignore[return-value]  # likewise


class Generic:
    """A function whose body is chosen by the class of its first argument, a NamedTuple of arrays."""

    def __init__(self, stub: Callable[..., Any], options: dict[str, Any]):
        bodies: dict[type, Callable[..., Any]] = {}
        self.bodies, self.stub, self.options = bodies, stub, options

        @wraps(stub)
        def dispatch(*args: Any) -> Any:
            kind = type(args[0])
            return bodies[kind if kind in bodies else object](*args)

        self.call = dispatch

    def overload(self, compiler: Any) -> None:
        """Tell Numba how to choose the body."""
        bodies = self.bodies

        @wraps(self.stub)  # whose signature Numba reads
        def choose(*args: Any) -> Any:
            kind: Any = getattr(args[0], "instance_class", None)  # of a Numba type
            return bodies.get(kind, bodies.get(object))

        compiler.overload(self.call, jit_options=self.options, strict=False)(choose)


_GENERICS: dict[Callable[..., Any], Generic] = {}
_IMPLEMENTED: list[Any] = []  # all bodies; a new one may change what a kernel reaches


def generic(stub: Function, *, forceinline: bool = False) -> Function:
    """Declare a protocol function; `implement(function, Kind)` gives it a body for one kind."""
    entry = Generic(stub, {"forceinline": forceinline})
    with _LOCK:
        _GENERICS[entry.call] = entry
        if _compiler.cache_info().currsize:  # a mesh reader may compile before the kernels of rendering are imported
            entry.overload(_compiler())
    return entry.call  # type: ignore[return-value]  # called like the stub


def generic_inlined(stub: Function) -> Function:
    """The same for a function of innermost loops, which is inlined."""
    return generic(stub, forceinline=True)


def optional(declare: Callable[[Function], Function]) -> Callable[[Function], Function]:
    """Declare a protocol function by `generic` or `generic_inlined`, with its own body for classes without another."""

    def keep(stub: Function) -> Function:
        function = declare(stub)
        implement(function, object)(stub)
        return function

    return keep


def implement(function: Callable[..., Any], *kinds: type) -> Callable[[Function], Function]:
    """Register the decorated body of `function` for some classes; object: for classes without their own."""

    def keep(body: Function) -> Function:
        _GENERICS[function].bodies |= dict.fromkeys(kinds, body)
        _IMPLEMENTED.append(body)
        return body

    return keep


def implements(function: Callable[..., Any], kind: type) -> bool:
    """Whether `function` has a body for `kind`."""
    return kind in _GENERICS[function].bodies

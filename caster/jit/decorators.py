"""The only module that names a Numba decorator; without Numba every function is handed back unchanged.

`CASTER_JIT=0` switches the compiler off, so that pdb steps through the very code that runs compiled. Numba itself is
loaded when a kernel is first compiled: what has been compiled before runs without it (caster/jit/machine_code.py).
"""

import contextlib
import gc
import hashlib
import importlib
import inspect
import os
import signal
import threading
from collections.abc import Callable, Iterator
from functools import cache, cached_property, update_wrapper
from typing import Any, TypeVar

import numpy as np

from caster.jit import machine_code
from caster.jit.arguments import (
    INTEGER,
    MISMATCH,
    REAL,
    argument_forms,
    checked_call,
    named_tuple_names,
    signature_key,
    tuple_classes,
)
from caster.jit.code_digest import code_digest, compiler_digest
from caster.jit.command_list import BoundCall
from caster.jit.kernel_cache import COMPILED, cache_folder, claim, sources_stamp, write_atomically

Function = TypeVar("Function", bound=Callable[..., Any])

OPTIONS = {"nogil": True, "error_model": "numpy"}  # no fast-math, IEEE division, no GIL

GIVES = {"none": "", "int64": INTEGER, "float64": REAL}  # what machine code can answer, by Numba's names

_LOCK = machine_code.LLVM_LOCK  # of the lists below as well


class CompilationLog:
    """What this process did to have its kernels, by their names; `compiling` is called before one is compiled."""

    def __init__(self) -> None:
        self.compiled: list[str] = []
        self.loaded: list[str] = []  # from the cache
        self.slowly: list[str] = []  # of these, what only Numba can call: loading it takes long, and so does each call
        self.compiling: Callable[[str], None] = lambda name: None


COMPILATION_LOG = CompilationLog()


@cache
def _numba() -> Any:
    numba: Any = importlib.import_module("numba")
    importlib.import_module("numba.extending")
    for entry in _GENERICS.values():
        entry.overload(numba)
    for stub, definition in importlib.import_module("caster.jit.vector_intrinsics").intrinsics():
        _compiler().register_intrinsic(stub, definition)
    return numba


def _compiler() -> Any:
    """The module caster.jit.compiler, which loads Numba."""
    return importlib.import_module("caster.jit.compiler")


class Kernel:
    """A function and its machine code for each combination of classes that its arguments may have."""

    __name__: str
    __qualname__: str

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self.function = function
        self.options = {**OPTIONS, **options}
        self._symbols: dict[Any, str] = {}  # by `_key` of the arguments
        self._codes: dict[str, machine_code.ObjectCode] = {}  # by symbol
        self._calls: dict[str | None, Callable[..., Any]] = {}  # by symbol; None: whatever has none
        self._latest: dict[type, Callable[..., Any]] = {}  # by the class of the first argument

    def __call__(self, *args: Any) -> Any:
        call = self._latest.get(type(args[0])) if args else None
        if call is not None:
            answer = call(*args)
            if answer is not MISMATCH:
                return answer
        answer = self._prepared(args)(*args)
        assert answer is not MISMATCH, f"{self.__name__}: machine code of other classes of arguments"
        return answer

    def __reduce__(self) -> str:
        return self.__qualname__

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's object for this function where kernels call it."""
        _numba()
        return _compiler().dispatcher_of(self.function, self.options)

    @cached_property
    def _python_dispatcher(self) -> Any:
        """Numba's object for this function where only Numba can pass its arguments or its answer."""
        _numba()
        return _compiler().dispatcher_of(self.function, self.options, from_python=True)

    @property
    def _numba_type_(self) -> Any:
        """Numba type of a kernel that is called in another one."""
        return _compiler().types.Dispatcher(self.dispatcher)

    def _prepared(self, args: tuple[Any, ...]) -> Callable[..., Any]:
        """What to call with such arguments: machine code from the cache or just compiled, else Numba."""
        if _THREAD.interprets:
            return self.function
        with _LOCK:
            symbol = self._symbol(args)
            call = self._calls.get(symbol)
            if call is None and symbol is not None:
                call = self._found(symbol, args)
                if call is None:
                    _SHARED.begin()
                with claim(cache_folder() / self._file(symbol), wait=_SHARED.work is None) as mine:
                    if not mine:
                        return self._interpreted
                    # another process may have compiled it meanwhile
                    call = call or self._found(symbol, args) or self._made(symbol, args)
            if call is None:
                COMPILATION_LOG.slowly.append(_named(self.__name__, args))
                call = self._python_dispatcher  # which compiles, and serves all arguments
                self._calls[symbol] = call
                return call
            self._calls[symbol] = call
        self._latest[type(args[0])] = call
        return call

    def _interpreted(self, *args: Any) -> Any:
        """The function as plain Python, with all that it calls."""
        _THREAD.interprets = True
        try:
            with np.errstate(all="ignore"):  # as in machine code
                return self.function(*args)
        finally:
            _THREAD.interprets = False

    def code(self, args: tuple[Any, ...]) -> machine_code.ObjectCode | None:
        """Machine code for such arguments, with its entries; None where only Numba can call this kernel."""
        symbol = self._symbol(args)
        if symbol is None:
            return None
        if symbol not in self._codes:
            self._prepared(args)
        with _LOCK:
            code = self._codes.get(symbol)
            if code is not None:
                _ = code.block_address  # found by LLVM when it is first wanted
            return code

    def _symbol(self, args: tuple[Any, ...]) -> str | None:
        """Name of the machine code for such arguments; None where there can be none."""
        signature = signature_key(args) if machine_code.is_supported() else None
        if signature is None:
            return None
        key = signature, tuple_classes(args), len(_IMPLEMENTED)
        symbol = self._symbols.get(key)
        if symbol is None:
            symbol = self._symbols[key] = self._named_after(args, signature, machine_code.target_description())
        return symbol

    def _named_after(self, args: tuple[Any, ...], signature: str, target: str) -> str:
        """A name made of all that the machine code depends on."""
        digest = code_digest(self.function, tuple_classes(args), _GENERICS)
        words = [self.__module__, self.__qualname__, str(self.options), signature, digest, compiler_digest(), target]
        return "caster_" + hashlib.sha256("\n".join(words).encode()).hexdigest()[:32]

    def _file(self, symbol: str) -> str:
        return f"{self.__name__}-{symbol}.o"

    def _found(self, symbol: str, args: tuple[Any, ...]) -> Callable[..., Any] | None:
        """Machine code from the cache, or else of the wheel; None if there is none that can be loaded."""
        call = self._loaded(symbol, machine_code.read(cache_folder() / self._file(symbol)), symbol, args)
        installed = machine_code.installed_code() if call is None else None
        if installed is not None:
            folder, target = installed
            shipped = self._named_after(args, signature_key(args) or "", target)
            code = machine_code.read(folder / self._file(shipped), installed=True)
            call = self._loaded(symbol, code, shipped, args)
        if call is not None:
            COMPILATION_LOG.loaded.append(_named(self.__name__, args))
        return call

    def _made(self, symbol: str, args: tuple[Any, ...]) -> Callable[..., Any] | None:
        """Compiled, and kept; None if it needs Numba to run."""
        name = _named(self.__name__, args)
        COMPILATION_LOG.compiling(name)
        types = tuple(_numba().typeof(arg) for arg in args)
        with _no_garbage_collection():
            self.dispatcher.compile(types)
            result = self.dispatcher.overloads[types]
            gives = GIVES.get(str(result.signature.return_type))
            if gives is None:
                return None
            function = result.fndesc.llvm_func_name
            code = machine_code.extract_object_code(result.library, function, symbol, argument_forms(args), gives)
        COMPILATION_LOG.compiled.append(name)
        if code is not None:
            code.write(cache_folder() / self._file(symbol))
        return self._loaded(symbol, code, symbol, args)

    def _loaded(
        self, key: str, code: machine_code.ObjectCode | None, symbol: str, args: tuple[Any, ...]
    ) -> Callable[..., Any] | None:
        """Machine code in this process, kept for bound calls."""
        call = _loaded(code, symbol, args)
        if call is not None and code is not None:
            self._codes[key] = code
        return call


# ---- compilation by several processes ----

MAX_PROCESSES = 4  # of them; each compiles the functions that many kernels call once more


class _Thread(threading.local):
    interprets = False  # every kernel is plain Python


_THREAD = _Thread()


class SharedCompilation:
    """Work whose kernels several processes compile; they are started when the first kernel is missing."""

    def __init__(self) -> None:
        self.work: Callable[[], None] | None = None
        self.begun = False
        self.children: list[int] = []  # process numbers

    def run(self, work: Callable[[], None]) -> None:
        self.work, self.begun, self.children = work, False, []
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
        """Have other processes do the same work, each of which passes over what is claimed."""
        if self.work is None or self.begun:
            return
        self.begun = True
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
        for _ in range(min(cores, MAX_PROCESSES) - 1):
            child = os.fork()
            if child == 0:
                self._run_in_child(self.work)
            self.children.append(child)

    def _run_in_child(self, work: Callable[[], None]) -> None:
        try:
            nowhere = os.open(os.devnull, os.O_RDWR)
            for stream in range(3):
                os.dup2(nowhere, stream)
            COMPILATION_LOG.compiling = lambda name: None
            work()
        finally:
            os._exit(0)


_SHARED = SharedCompilation()


def compile_ahead(about: str, work: Callable[[], None]) -> None:
    """Run `work` once for these sources, so that no kernel it needs has to be compiled later.

    Several processes share the compilation: each compiles what no other has claimed and interprets what another is
    compiling. So `work` is done on a few primitives and pixels. about: what decides which kernels it needs.
    """
    if not COMPILED or not machine_code.is_supported() or _SHARED.work is not None:
        return
    words = [about, compiler_digest(), sources_stamp(), machine_code.target_description()]
    done = cache_folder() / f"{hashlib.sha256('|'.join(words).encode()).hexdigest()[:32]}.done"
    if not done.exists():
        _SHARED.run(work)
        write_atomically(done, about.encode())


@contextlib.contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """The compiler makes a great many objects, nearly all of which go by themselves: a tenth of its time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _loaded(code: machine_code.ObjectCode | None, symbol: str, args: tuple[Any, ...]) -> Callable[..., Any] | None:
    """Machine code in this process, to be called with such arguments; None where it is none that LLVM can load."""
    if code is None or code.symbol != symbol:
        return None
    try:
        return checked_call(args, code.entry(), code.gives)
    except (RuntimeError, OSError, KeyError):
        return None


def _named(name: str, args: tuple[Any, ...]) -> str:
    kinds = ", ".join(named_tuple_names(args))
    return f"{name}({kinds})" if kinds else name


def jit(function: Function) -> Function:
    """Compile a kernel: no fast-math, IEEE division, no GIL, cached on disk."""
    return Kernel(function, {}) if COMPILED else function  # type: ignore[return-value]  # called like the function


def inlined(function: Function) -> Function:
    """The same for a function that is too large for LLVM to put it in the place of its call unasked."""
    return Kernel(function, {"forceinline": True}) if COMPILED else function  # type: ignore[return-value]  # likewise


def bind(function: Callable[..., Any], *args: Any, given: tuple[int, ...]) -> BoundCall:
    """A kernel with these arguments, but for those at the places `given`, integers or tuples of integers.

    A call takes a tenth of the time of others, and is one thread's at a time.
    """
    return BoundCall(function, args, given, function.code(args) if isinstance(function, Kernel) else None)


class Generic:
    """A function whose body is chosen by the class of its first argument, a NamedTuple of arrays."""

    def __init__(self, stub: Callable[..., Any], options: dict[str, Any]):
        self.bodies: dict[type, Callable[..., Any]] = {}
        self.__name__, self.__doc__ = stub.__name__, stub.__doc__
        self.stub, self.options = stub, options
        self.call = self._dispatch()

    def _dispatch(self) -> Callable[..., Any]:
        bodies = self.bodies

        def dispatch(*args: Any) -> Any:
            kind = type(args[0])
            return bodies[kind if kind in bodies else object](*args)

        self._dress(dispatch)
        return dispatch

    def overload(self, numba: Any) -> None:
        """Tell Numba how to choose the body."""
        bodies = self.bodies

        def choose(*args: Any) -> Any:
            kind: Any = getattr(args[0], "instance_class", None)  # of a Numba type
            body = bodies.get(kind, bodies.get(object))
            return body.dispatcher if isinstance(body, Kernel) else body

        self._dress(choose)
        numba.extending.overload(self.call, jit_options=self.options, strict=False)(choose)

    def _dress(self, function: Any) -> None:
        function.__name__, function.__doc__ = self.stub.__name__, self.stub.__doc__
        function.__signature__ = inspect.signature(self.stub)  # Numba reads it


_GENERICS: dict[Callable[..., Any], Generic] = {}
_IMPLEMENTED: list[Any] = []  # all bodies; what a kernel reaches may change with each


def generic(stub: Function) -> Function:
    """Declare a function of the protocol; `implement(function, Kind)` gives it a body for one kind."""
    return _declared(stub, {})


def generic_inlined(stub: Function) -> Function:
    """The same for a function of the innermost loops, where a call would cost as much as what it does."""
    return _declared(stub, {"forceinline": True})


def _declared(stub: Function, options: dict[str, Any]) -> Function:
    entry = Generic(stub, options)
    with _LOCK:
        _GENERICS[entry.call] = entry
        if _numba.cache_info().currsize:  # reading a mesh compiles kernels before those of rendering are imported
            entry.overload(_numba())
    return entry.call  # type: ignore[return-value]  # called like the stub


def implement(function: Callable[..., Any], kind: type) -> Callable[[Function], Function]:
    """Register the decorated body of `function` for arguments of class `kind`; object: for all without their own."""

    def keep(body: Function) -> Function:
        _GENERICS[function].bodies[kind] = body
        _IMPLEMENTED.append(body)
        return body

    return keep


def implements(function: Callable[..., Any], kind: type) -> bool:
    """Whether `function` has a body for `kind`."""
    return kind in _GENERICS[function].bodies

"""The only module that names a Numba decorator; without Numba every function is handed back unchanged.

`CASTER_JIT=0` switches the compiler off, so that pdb steps through the very code that runs compiled. Numba itself is
loaded when a kernel is first compiled: what has been compiled before runs without it (caster/jit/machine_code.py).
"""

import contextlib
import hashlib
import importlib
import inspect
from collections.abc import Callable, Iterator
from functools import cache, update_wrapper
from typing import Any, TypeVar

from caster.jit import machine_code
from caster.jit.arguments import INTEGER, MISMATCH, REAL, argument_forms, checked_call, named_tuple_names, signature_key
from caster.jit.command_list import BoundCall
from caster.jit.kernel_cache import COMPILED, CompileResultCache, cache_folder
from caster.jit.simd import (
    CHILDREN,
    FAN_FIELDS,
    FAR_PADDING,
    LANES,
    LARGEST_T,
    PLANE_ATOL,
    any_sum_reaches,
    boxes_below,
    boxes_reach_lines,
    gather_corners,
    intersect_boxes,
    intersect_boxes_packet,
    lane_max,
    lane_max_of_sums,
    lane_min,
    lanes_in_range,
    lanes_not_above,
    lanes_within_lines,
    lowest_bit,
    numbers_in_range,
    prefetch,
)

Function = TypeVar("Function", bound=Callable[..., Any])

OPTIONS = {"nogil": True, "error_model": "numpy"}  # no fast-math, IEEE division, no GIL

GIVES = {"none": "", "int64": INTEGER, "float64": REAL}  # what machine code can answer, by Numba's names

_LOCK = machine_code.LLVM_LOCK  # of the lists below as well


_PACKAGE = __name__.partition(".")[0]
_EXTENDED: set[type] = set()  # classes of this package for which some other module has given a body


def is_cacheable(kind: type) -> bool:
    """Whether what is compiled for arguments of a class may be kept on disk.

    The cache folder is named after the sources of this package (kernel_cache.py). A class from elsewhere, or one that
    has bodies from elsewhere, has kernels that may change without a change of these: they are compiled anew in each
    process.
    """
    return kind not in _EXTENDED and (_is_own(kind.__module__) or kind.__module__ == "builtins")


def _is_own(module: str) -> bool:
    return module.partition(".")[0] == _PACKAGE


def _all_cacheable(args: Any) -> bool:
    """Whether that holds for the classes of all tuples among some arguments."""
    return all(is_cacheable(type(arg)) and _all_cacheable(arg) for arg in args if isinstance(arg, tuple))


def _class_ids(args: Any) -> list[Any]:
    """The identity of all tuples' classes among some arguments; all of them stay as long as the process."""
    return [(id(type(arg)), _class_ids(arg)) for arg in args if isinstance(arg, tuple)]


def _cacheable_signature(types: Any) -> bool:
    """Whether that holds for the classes of all tuples in a signature of Numba, or among some of its types."""
    return all(
        is_cacheable(getattr(each, "instance_class", int)) and _cacheable_signature(getattr(each, "types", ()))
        for each in getattr(types, "args", types)
    )


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
    importlib.import_module("numba.core.event")
    for entry in _GENERICS.values():
        entry.overload(numba)
    _overload_lanes(numba)
    return numba


class Kernel:
    """A function and its machine code for each combination of classes that its arguments may have."""

    __name__: str
    __qualname__: str

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self.function = function
        self.options = {**OPTIONS, **options}
        self._codes: dict[str | None, machine_code.ObjectCode] = {}  # by `signature_key` the arguments
        self._calls: dict[str | None, Callable[..., Any]] = {}  # by `signature_key` the arguments
        self._latest: dict[type, Callable[..., Any]] = {}  # by the class of the first argument
        # by `signature_key`: `_kept`, as long as no class has a body from elsewhere
        self._keeps: dict[str, bool] = {}
        self._dispatcher: Any = None

    def __call__(self, *args: Any) -> Any:
        call = self._latest.get(type(args[0]))
        if call is not None:
            answer = call(*args)
            if answer is not MISMATCH:
                return answer
        answer = self._prepared(args)(*args)
        assert answer is not MISMATCH, f"{self.__name__}: machine code of other classes of arguments"
        return answer

    def __reduce__(self) -> str:
        return self.__qualname__

    @property
    def dispatcher(self) -> Any:
        """Numba's own object for this function."""
        with _LOCK:
            if self._dispatcher is None:
                self._dispatcher = _numba().njit(**self.options)(self.function)
                if _is_own(self.function.__module__):
                    name = f"{self.function.__module__}.{self.function.__qualname__}"
                    self._dispatcher._cache = CompileResultCache(name, _cacheable_signature, _numba())
            return self._dispatcher

    @property
    def _numba_type_(self) -> Any:
        """Numba type of a kernel that is called in another one."""
        return _numba().types.Dispatcher(self.dispatcher)

    def _prepared(self, args: tuple[Any, ...]) -> Callable[..., Any]:
        """What to call with such arguments: machine code from the cache or just compiled, else Numba."""
        key = self._key(args) if machine_code.is_supported() else None
        with _LOCK:
            call = self._calls.get(key) if key is not None else None
            if call is None:
                call = None if key is None else self._found(key, args) or self._made(key, args)
                if call is None:
                    self._compiled(args)
                    COMPILATION_LOG.slowly.append(_named(self.__name__, args))
                    call = self.dispatcher
                self._calls[key] = call
        if call is not self._dispatcher:  # which serves all arguments
            self._latest[type(args[0])] = call
        return call

    def code(self, args: tuple[Any, ...]) -> machine_code.ObjectCode | None:
        """Machine code for such arguments, with its entries; None where only Numba can call this kernel."""
        key = self._key(args)
        if key not in self._codes:
            self._prepared(args)
        with _LOCK:
            code = self._codes.get(key)
            if code is not None:
                _ = code.block_address  # found by LLVM when it is first wanted
            return code

    def _key(self, args: tuple[Any, ...]) -> str | None:
        """Key of machine code: in all processes, or, with classes from elsewhere, in this one."""
        key = signature_key(args)
        if key is None:
            return None
        kept = self._keeps.get(key) if not _EXTENDED else None
        if kept is None:
            kept = self._keeps[key] = self._kept(args)
        return key if kept else f"{key} {_class_ids(args)}"

    def _place(self, key: str, target: str) -> tuple[str, str]:
        """Name of the entry, and of the file it is kept in."""
        words = "\n".join([self.__module__, self.__qualname__, key, target])
        symbol = f"caster_{hashlib.sha256(words.encode()).hexdigest()[:32]}"
        return symbol, f"{self.__name__}-{symbol}.o"

    def _kept(self, args: tuple[Any, ...]) -> bool:
        return _is_own(self.function.__module__) and _all_cacheable(args)

    def _found(self, key: str, args: tuple[Any, ...]) -> Callable[..., Any] | None:
        """Machine code from the cache, or else of the wheel; None if there is none that can be loaded."""
        if not self._kept(args):
            return None
        symbol, file = self._place(key, machine_code.target_description())
        call = self._loaded(key, machine_code.read(cache_folder() / file), symbol, args)
        installed = machine_code.installed_code() if call is None else None
        if installed is not None:
            folder, target = installed
            symbol, file = self._place(key, target)
            call = self._loaded(key, machine_code.read(folder / file, installed=True), symbol, args)
        if call is not None:
            COMPILATION_LOG.loaded.append(_named(self.__name__, args))
        return call

    def _made(self, key: str, args: tuple[Any, ...]) -> Callable[..., Any] | None:
        """Compiled, and kept; None if it needs Numba to run."""
        result = self._compiled(args)
        gives = GIVES.get(str(result.signature.return_type))
        if gives is None:
            return None
        symbol, file = self._place(key, machine_code.target_description())
        function = result.fndesc.llvm_func_name
        code = machine_code.extract_object_code(result.library, function, symbol, argument_forms(args), gives)
        if code is not None and self._kept(args):
            code.write(cache_folder() / file)
        return self._loaded(key, code, symbol, args)

    def _loaded(
        self, key: str, code: machine_code.ObjectCode | None, symbol: str, args: tuple[Any, ...]
    ) -> Callable[..., Any] | None:
        """Machine code in this process, kept for bound calls."""
        call = _loaded(code, symbol, args)
        if call is not None and code is not None:
            self._codes[key] = code
        return call

    def _compiled(self, args: tuple[Any, ...]) -> Any:
        """Numba's result for such arguments, counted once."""
        numba, dispatcher = _numba(), self.dispatcher
        types = tuple(numba.typeof(arg) for arg in args)
        if types not in dispatcher.overloads:
            name = _named(self.__name__, args)
            with _announcing(numba, name):
                dispatcher.compile(types)
            (COMPILATION_LOG.loaded if dispatcher.stats.cache_hits.get(types) else COMPILATION_LOG.compiled).append(
                name
            )
        return dispatcher.overloads[types]


@contextlib.contextmanager
def _announcing(numba: Any, name: str) -> Iterator[None]:
    """Say that a kernel is being compiled, once Numba has not found it in its own cache."""
    reported = False

    class Listener(numba.core.event.Listener):  # type: ignore[misc]  # Numba has no types
        def on_start(self, event: Any) -> None:
            nonlocal reported
            if not reported:
                reported = True
                COMPILATION_LOG.compiling(name)

        def on_end(self, event: Any) -> None:
            pass

    with numba.core.event.install_listener("numba:compile", Listener()):
        yield


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


def _overload_lanes(numba: Any) -> None:
    """What LLVM is to make of the functions of caster/jit/simd.py."""
    vectors, types = importlib.import_module("caster.jit.vector_intrinsics"), numba.types
    reaches, least, most, sums, one, several, lowest = map(
        numba.extending.intrinsic,
        (
            vectors.any_sum_reaches(LANES, types),
            vectors.lane_min(LANES, types),
            vectors.lane_max(LANES, types),
            vectors.lane_max_of_sums(LANES, types),
            vectors.intersect_boxes(CHILDREN, types, FAR_PADDING, LARGEST_T),
            vectors.intersect_boxes_packet(CHILDREN, types, FAR_PADDING, LARGEST_T),
            vectors.lowest_bit(types),
        ),
    )
    below, reaching, within, not_above, gather, in_range, counted, fetch = map(
        numba.extending.intrinsic,
        (
            vectors.boxes_below(CHILDREN, types, FAN_FIELDS),
            vectors.boxes_reach_lines(CHILDREN, types, FAN_FIELDS),
            vectors.lanes_within_lines(LANES, types),
            vectors.lanes_not_above(LANES, types, PLANE_ATOL),
            vectors.gather_corners(LANES, types),
            vectors.lanes_in_range(LANES, types),
            vectors.numbers_in_range(LANES, types),
            vectors.prefetch(types),
        ),
    )
    made = {
        any_sum_reaches: lambda a, i, j, limit: lambda a, i, j, limit: reaches(a, i, j, limit),
        lane_min: lambda a, i: lambda a, i: least(a, i),
        lane_max: lambda a, i: lambda a, i: most(a, i),
        lane_max_of_sums: lambda a, i, j: lambda a, i, j: sums(a, i, j),
        intersect_boxes: lambda boxes, node, view, t_min, t_max, near: (
            lambda boxes, node, view, t_min, t_max, near: one(boxes, node, view, t_min, t_max, near)
        ),
        intersect_boxes_packet: lambda boxes, node, view, t_min, t_max, near: (
            lambda boxes, node, view, t_min, t_max, near: several(boxes, node, view, t_min, t_max, near)
        ),
        lowest_bit: lambda mask: lambda mask: lowest(mask),
        boxes_below: lambda boxes, node, limits: lambda boxes, node, limits: below(boxes, node, limits),
        boxes_reach_lines: lambda boxes, node, lines: lambda boxes, node, lines: reaching(boxes, node, lines),
        lanes_within_lines: lambda xy, i, j, lines: lambda xy, i, j, lines: within(xy, i, j, lines),
        lanes_not_above: lambda tile, x, y, z, plane: lambda tile, x, y, z, plane: not_above(tile, x, y, z, plane),
        lanes_in_range: lambda a, i, least, end: lambda a, i, least, end: in_range(a, i, least, end),
        prefetch: lambda rows, k: lambda rows, k: fetch(rows, k),
        numbers_in_range: lambda a, i, least, end, lanes, into: (
            lambda a, i, least, end, lanes, into: counted(a, i, least, end, lanes, into)
        ),
        gather_corners: lambda rows, faces, lanes, numbers, into, step: (
            lambda rows, faces, lanes, numbers, into, step: gather(rows, faces, lanes, numbers, into, step)
        ),
    }
    for stub, choose in made.items():
        numba.extending.overload(stub, jit_options={"forceinline": True}, strict=False)(choose)


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
        if not _is_own(body.__module__):
            _EXTENDED.add(kind)
        return body

    return keep


def implements(function: Callable[..., Any], kind: type) -> bool:
    """Whether `function` has a body for `kind`."""
    return kind in _GENERICS[function].bodies

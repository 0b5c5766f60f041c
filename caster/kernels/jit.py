"""The only module that names a Numba decorator; without Numba every function is handed back unchanged.

`CASTER_JIT=0` switches the compiler off, so that pdb steps through the very code that runs compiled.
"""

import atexit
import contextlib
import hashlib
import inspect
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

PACKAGE = Path(__file__).resolve().parents[1]
KEPT_CACHES = 4  # one for each of a few checkouts that are worked on in turn


def _compiler() -> Any:
    if os.environ.get("CASTER_JIT", "1") == "0":
        return None
    try:
        import numba
        import numba.extending
    except ImportError:
        return None
    return numba


def source_hash(version: str) -> str:
    """A name for this source and this compiler.

    Numba does not see an edit in a file that a cached kernel calls into, and a stale kernel is a wrong
    answer: the cache folder changes its name with every source file of the package instead.
    """
    digest = hashlib.sha256(version.encode())
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _cache_folder(version: str) -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    folder = Path(home) / "caster" / "kernels" / source_hash(version)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except OSError:  # a home that cannot be written: compile anew in every process
        folder = Path(tempfile.mkdtemp(prefix="caster-kernels-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        return folder
    _drop_old_caches(folder.parent)
    return folder


def _drop_old_caches(parent: Path) -> None:
    with contextlib.suppress(OSError):  # another process drops the same ones
        folders = sorted(parent.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
        for old in folders[KEPT_CACHES:]:
            shutil.rmtree(old, ignore_errors=True)


NUMBA = _compiler()
COMPILED = NUMBA is not None
if COMPILED and not os.environ.get("NUMBA_CACHE_DIR"):
    NUMBA.config.CACHE_DIR = str(_cache_folder(NUMBA.__version__))


def jit(function: Function) -> Function:
    """Compile a kernel: no fast-math, IEEE division, no GIL, cached on disk."""
    if not COMPILED:
        return function
    compiled: Function = NUMBA.njit(cache=True, nogil=True, error_model="numpy")(function)
    return compiled


def inlined(function: Function) -> Function:
    """The same for a function that is too large for LLVM to put it in the place of its call unasked."""
    if not COMPILED:
        return function
    compiled: Function = NUMBA.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(function)
    return compiled


LANES = 8 if COMPILED else 1
"""So many float64 AVX-512 takes at once. Uncompiled, taking several together would be in vain."""


def _any_reaches() -> Callable[..., bool]:
    def one(a: Any, i: Any, j: Any, limit: float) -> bool:
        return bool(a[i] + a[j] >= limit)

    if not COMPILED:
        return one
    from llvmlite import ir  # what Numba itself writes in
    from numba.core import types

    def vector(typing: Any, a: Any, i: Any, j: Any, limit: Any) -> Any:
        """As one comparison of vectors: LLVM does not make one of a short loop by itself."""
        if not isinstance(a, types.Array):
            return None

        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array = context.make_array(a)(context, builder, arguments[0])
            lanes = ir.VectorType(ir.DoubleType(), LANES)

            def load(at: Any) -> Any:
                pointer = builder.gep(array.data, [at])
                return builder.load(builder.bitcast(pointer, lanes.as_pointer()), align=8)

            total = builder.fadd(load(arguments[1]), load(arguments[2]))
            one_lane = builder.insert_element(
                ir.Constant(lanes, ir.Undefined), arguments[3], ir.IntType(32)(0)
            )
            zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
            limits = builder.shuffle_vector(one_lane, ir.Constant(lanes, ir.Undefined), zeros)
            which = builder.bitcast(builder.fcmp_ordered(">=", total, limits), ir.IntType(LANES))
            return builder.icmp_unsigned("!=", which, ir.IntType(LANES)(0))

        return types.boolean(a, types.uint64, types.uint64, types.float64), build

    made: Callable[..., bool] = NUMBA.extending.intrinsic(vector)
    return made


any_reaches = _any_reaches()
"""any_reaches(a, i, j, limit): whether a[i + n] + a[j + n] >= limit for one of n = 0..LANES - 1."""


class Generic:
    """A function whose body is chosen by the class of its first argument, a NamedTuple of arrays."""

    def __init__(self, stub: Callable[..., Any], options: dict[str, Any]):
        self.bodies: dict[type, Callable[..., Any]] = {}
        self.__name__, self.__doc__ = stub.__name__, stub.__doc__
        self.call = self._dispatcher(stub, options)

    def _dispatcher(self, stub: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
        bodies = self.bodies

        def dispatch(*args: Any) -> Any:
            return bodies[type(args[0])](*args)

        def choose(*args: Any) -> Any:
            return bodies.get(getattr(args[0], "instance_class", None))  # type: ignore[arg-type]  # a Numba type

        for function in (dispatch, choose):
            function.__name__, function.__doc__ = stub.__name__, stub.__doc__
            function.__signature__ = inspect.signature(stub)  # type: ignore[attr-defined]  # Numba reads it
        if COMPILED:
            NUMBA.extending.overload(dispatch, jit_options=options, strict=False)(choose)
        return dispatch


_GENERICS: dict[Callable[..., Any], Generic] = {}


def generic(stub: Function) -> Function:
    """Declare a function of the protocol; `implement(function, Kind)` gives it a body for one kind."""
    return _declared(stub, {})


def generic_inlined(stub: Function) -> Function:
    """The same for a function of the innermost loops, where a call would cost as much as what it does."""
    return _declared(stub, {"forceinline": True})


def _declared(stub: Function, options: dict[str, Any]) -> Function:
    entry = Generic(stub, options)
    _GENERICS[entry.call] = entry
    return entry.call  # type: ignore[return-value]  # called like the stub


def implement(function: Callable[..., Any], kind: type) -> Callable[[Function], Function]:
    """Register the decorated body of `function` for arguments of class `kind`."""

    def keep(body: Function) -> Function:
        _GENERICS[function].bodies[kind] = body
        return body

    return keep


def implements(function: Callable[..., Any], kind: type) -> bool:
    """Whether `function` has a body for `kind`."""
    return kind in _GENERICS[function].bodies

"""A Numba target that makes object code: functions are lowered once, and only whole kernels are optimised and emitted.

Numba's own dispatchers make every function callable from Python: they optimise it, emit machine code, and wrap it for
CPython and C. Most functions here are called only by kernels, so this target stops at LLVM IR, in half the time. This
module loads Numba, so it is imported when the first kernel is compiled.
"""

from collections.abc import Callable
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba.core import codegen, compiler, cpu, dispatcher, registry, target_extension, types, typing
from numba.core.compiler_lock import require_global_compiler_lock
from numba.core.types.misc import unliteral
from numba.extending import overload
from numba.misc.special import typeof

from caster.jit import vector_intrinsics  # noqa: F401  # registers them
from caster.jit.arguments import BOOLEAN, INTEGER, NONE, REAL, is_tuple
from caster.jit.machine_code import DATA, PLACE_OF_ANSWER, SHAPE, STRIDES, symbol_in

__all__ = ["dispatcher_of", "object_code", "overload", "typeof", "types"]

TARGET = "caster"
WITHOUT_WRAPPERS = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class KernelLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]  # Numba has no types
    """The LLVM module of a function and all that it calls, optimised when machine code is needed."""

    _is_emitted = False

    def finalize(self) -> None:
        """Link the functions that this one calls."""
        require_global_compiler_lock()
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Address of a function's machine code, which Python can call; 0 if there is no such function."""
        self._ensure_finalized()
        if not self._is_emitted:
            self._is_emitted = True
            self._optimize_final_module()
            self._final_module.verify()
            self._finalize_final_module()
        return int(super().get_pointer_to_function(name))


class KernelCodegen(codegen.JITCPUCodegen):  # type: ignore[misc]  # likewise
    _library_class = KernelLibrary


class Entry:
    """Stands for a function without a wrapper where Numba has entry points, by which it tells functions apart."""


class KernelContext(cpu.CPUContext):  # type: ignore[misc]  # likewise
    def init(self) -> None:
        super().init()
        self._internal_codegen = KernelCodegen("caster.kernels")

    def get_executable(self, library: Any, fndesc: Any, env: Any) -> Any:
        library._ensure_finalized()
        try:
            library.get_function(fndesc.llvm_cpython_wrapper_name)
        except NameError:
            return Entry()
        return super().get_executable(library, fndesc, env)


class KernelTarget(registry.CPUTarget):  # type: ignore[misc]  # likewise
    @cached_property
    def typing_context(self) -> Any:
        return typing.Context()

    @cached_property
    def target_context(self) -> Any:
        return KernelContext(self.typing_context, TARGET)


class KernelDispatcher(dispatcher.Dispatcher):
    """A function and its compile results by argument types."""

    targetdescr = KernelTarget(TARGET)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """As in Numba, which would compile a function once more for each constant that it is called with."""
        named = {name: unliteral(kind) for name, kind in kws.items()}
        return super().get_call_template([unliteral(kind) for kind in args], named)

    def add_overload(self, result: Any) -> None:
        if isinstance(result.entry_point, Entry):
            self.overloads[tuple(result.signature.args)] = result
        else:
            super().add_overload(result)


class KernelClass(target_extension.CPU):  # type: ignore[misc]  # likewise
    """The class under which Numba finds the decorator for its own functions that kernels call."""


def dispatcher_of(function: Callable[..., Any], options: dict[str, Any], *, from_python: bool = False) -> Any:
    """A dispatcher for a function that kernels call; from_python: Python can call it, too."""
    every = {"nopython": True, **({} if from_python else WITHOUT_WRAPPERS), **options}
    return KernelDispatcher(function, targetoptions=every, pipeline_class=compiler.Compiler)


@cache
def dispatcher_of_body(function: Callable[..., Any], **options: Any) -> Any:
    """The dispatcher of a body of an overloaded function. Numba asks for it again for callers that are inlined."""
    return dispatcher_of(function, options)


target_extension.target_registry[TARGET] = KernelClass
target_extension.dispatcher_registry[KernelClass] = KernelDispatcher
target_extension.jit_registry[KernelClass] = lambda **options: partial(dispatcher_of_body, **options)


# ---- object code: the functions of Numba's runtime that kernels call are added to it as LLVM IR ----

# A memory record as Numba's code reads it: reference count, two unused fields, address and size of the data.
RECORD = 64  # bytes, of which it reads 40

ALLOCATE = f"""
define ptr @NRT_MemInfo_alloc_aligned(i64 %size, i32 %alignment) {{
  %step = zext i32 %alignment to i64
  %room = add i64 %size, {RECORD}
  %whole = add i64 %room, %step
  %record = call ptr @malloc(i64 %whole)
  %none = icmp eq ptr %record, null
  br i1 %none, label %done, label %fill
fill:
  %first = ptrtoint ptr %record to i64
  %behind = add i64 %first, {RECORD}
  %less = sub i64 %step, 1
  %beyond = add i64 %behind, %less
  %down = sub i64 0, %step
  %data = and i64 %beyond, %down
  store i64 1, ptr %record
  %record.1 = getelementptr i64, ptr %record, i64 1
  store i64 0, ptr %record.1
  %record.2 = getelementptr i64, ptr %record, i64 2
  store i64 0, ptr %record.2
  %record.3 = getelementptr i64, ptr %record, i64 3
  store i64 %data, ptr %record.3
  %record.4 = getelementptr i64, ptr %record, i64 4
  store i64 %size, ptr %record.4
  br label %done
done:
  ret ptr %record
}}
declare ptr @malloc(i64)
"""

FREE = """
define void @NRT_MemInfo_call_dtor(ptr %record) {
  call void @free(ptr %record)
  ret void
}
declare void @free(ptr)
"""

TIMES_POWER = """
define double @numba_ldexp(double %x, i32 %exponent) {
  %y = call double @ldexp(double %x, i32 %exponent)
  ret double %y
}
declare double @ldexp(double, i32)
"""

# The exponent of a number that is not finite is 0 in Numba, and unspecified in C.
EXPONENT = """
define double @numba_frexp(double %x, ptr %exponent) {
  %y = call double @frexp(double %x, ptr %exponent)
  %off = fsub double %x, %x
  %finite = fcmp oeq double %off, 0.0
  br i1 %finite, label %done, label %special
special:
  store i32 0, ptr %exponent
  br label %done
done:
  ret double %y
}
declare double @frexp(double, ptr)
"""

RUNTIME_SOURCE = {
    "NRT_MemInfo_alloc_aligned": ALLOCATE,
    "NRT_MemInfo_call_dtor": FREE,
    "numba_ldexp": TIMES_POWER,
    "numba_frexp": EXPONENT,
}

MATHEMATICS = "acos asin atan atan2 ceil cos exp fabs floor fma fmod frexp hypot ldexp log pow rint round sin sqrt tan"
C_LIBRARY_SYMBOLS = {*MATHEMATICS.split(" "), "trunc", "malloc", "free", "memcpy", "memmove", "memset"}
"""Functions of the C library that object code may call; any other is Numba's own."""

LLVM = {INTEGER: "i64", REAL: "double", BOOLEAN: "i8"}


def object_code(result: Any, path: Path, key: tuple[Any, ...], gives: str) -> bytes | None:
    """The object code of a compiled kernel with its entry, or None if it needs Numba to run.

    result: of Numba. path: the file to be. key: of the arguments. gives: the form of the answer, or "".
    """
    library, function, symbol = result.library, result.fndesc.llvm_func_name, symbol_in(path)
    module = llvm.parse_bitcode(library._get_module_for_linking().as_bitcode())
    target = library._codegen._tm
    body, passed = _entry(function, key, gives)
    types = [str(argument.type) for argument in module.get_function(function).arguments]
    if types != [each.partition(" ")[0] for each in passed]:
        return None
    source = [
        f'target datalayout = "{module.data_layout}"',
        f'target triple = "{module.triple}"',
        f'declare i32 @"{function}"({", ".join(types)})',
        f"define i32 @{symbol}(i64 %address) {{",
        *body,
        "}",
        *(RUNTIME_SOURCE[f.name] for f in module.functions if f.is_declaration and f.name in RUNTIME_SOURCE),
    ]
    module.link_in(llvm.parse_assembly("\n".join(source)))
    for thing in [*module.functions, *module.global_variables]:
        if not thing.is_declaration and thing.name != symbol:
            thing.linkage = "internal"
    passes = llvm.create_new_module_pass_manager()  # drops what the entry does not reach, such as Numba's wrappers
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()))
    for settings in ({"loop_vectorize": library._codegen._loopvect, "slp_vectorize": False, "cost": "cheap"}, {}):
        passes, builder = library._codegen._module_pass_manager(**settings)
        passes.run(module, builder)
    module.verify()
    data: bytes = target.emit_object(module)
    unknown = {f.name for f in module.functions if f.is_declaration} - C_LIBRARY_SYMBOLS
    return data if all(name.startswith("llvm.") for name in unknown) else None


def _entry(function: str, key: tuple[Any, ...], gives: str) -> tuple[list[str], list[str]]:
    """LLVM IR that calls a kernel with the block at %address and returns its status, and what it passes to the kernel.

    Its arguments are those of Numba's calling convention.
    """
    lines, passed, at = [], ["ptr %answer", "ptr %trouble"], PLACE_OF_ANSWER
    for n, form in enumerate(key):
        if is_tuple(form):
            continue
        if form == NONE:
            passed.append("ptr null")
            continue
        at += 1
        kind = LLVM.get(form, "i64")  # of an array, the address
        lines += [f"%at{n} = getelementptr i64, ptr %block, i64 {at}", f"%a{n} = load {kind}, ptr %at{n}"]
        if form in LLVM:
            passed.append(f"{kind} %a{n}")
        else:
            dtype, dimensions, _ = form
            lines += _read_array(n, dimensions)
            size = np.dtype(dtype).itemsize
            passed += ["ptr null", "ptr null", f"i64 %count{n}", f"i64 {size}", f"ptr %data{n}"]
            passed += [f"i64 %{what}{n}.{axis}" for what in ("shape", "step") for axis in range(dimensions)]
    return [
        "%block = inttoptr i64 %address to ptr",
        "%answer = alloca i64",
        "%trouble = alloca ptr",
        *lines,
        f'%status = call i32 @"{function}"({", ".join(passed)})',
        *(["%value = load i64, ptr %answer", "store i64 %value, ptr %block"] if gives else []),
        "ret i32 %status",
    ], passed


def _read_array(n: int, dimensions: int) -> list[str]:
    """Data, shape, strides and the count of elements of the array at address %a{n}."""
    lines = [f"%array{n} = inttoptr i64 %a{n} to ptr"]
    for what, place in (("data", DATA), ("shape", SHAPE), ("step", STRIDES)):
        lines.append(f"%{what}{n}.at = getelementptr i8, ptr %array{n}, i64 {place}")
        lines.append(f"%{what}{n} = load ptr, ptr %{what}{n}.at")
    lines.append(f"%count{n}.0 = add i64 0, 1")
    for axis in range(dimensions):
        for what in ("shape", "step"):
            lines.append(f"%{what}{n}.{axis}.at = getelementptr i64, ptr %{what}{n}, i64 {axis}")
            lines.append(f"%{what}{n}.{axis} = load i64, ptr %{what}{n}.{axis}.at")
        lines.append(f"%count{n}.{axis + 1} = mul i64 %count{n}.{axis}, %shape{n}.{axis}")
    return [*lines, f"%count{n} = add i64 %count{n}.{dimensions}, 0"]

"""Object code of compiled kernels: extracted, loaded and called without Numba.

The functions of Numba's runtime that kernels call are added to it as LLVM IR.

A kernel does not own its array arguments (their memory record is null), and it frees what it allocates before it
returns, so a record describes all of its memory.
"""

import ctypes
import os
import platform
import sys
import threading
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from caster.jit.arguments import ARRAY, BOOLEAN, INTEGER, NONE, REAL, Form, real_of_word
from caster.jit.kernel_cache import compiler_version, read_sealed

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


# The entry that is added to a kernel takes the address of a block of 8-byte words: its answer, then its arguments
# (caster/jit/arguments.py). It reads arrays where NumPy keeps their numbers.
PLACE_OF_ANSWER = 0

# Status of an entry without an error; in Numba's calling convention, None as an answer has a status of its own.
DONE = (0, -2)

# Where a NumPy array object (PyArrayObject_fields, part of its stable binary interface) keeps them.
DATA, SHAPE, STRIDES = 16, 32, 40

LLVM = {INTEGER: "i64", REAL: "double", BOOLEAN: "i8", ARRAY: "i64"}

ENTRY = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64)


def fail() -> NoReturn:
    raise RuntimeError("a kernel failed: it counted with a number beyond its range")


# Operations of command lists; compiled, each is one instruction (vector_intrinsics.py).


def load_word(address: int) -> int:
    """The eight bytes at an address."""
    return ctypes.c_int64.from_address(int(address)).value


def store_word(address: int, word: int) -> None:
    ctypes.c_int64.from_address(int(address)).value = int(word)


def call_entry(entry: int, block: int) -> int:
    """Call the entry at an address with the address of a block; its status."""
    return int(ENTRY(int(entry))(int(block)))


LLVM_LOCK = threading.RLock()  # LLVM is one thread's at a time


@cache
def is_supported() -> bool:
    """Whether this Python, NumPy and machine pass arguments as the entries take them."""
    if sys.platform != "linux" or platform.machine() not in ("x86_64", "aarch64"):
        return False
    probe = np.zeros((5, 7))[::2, ::3]
    at = [ctypes.c_uint64.from_address(id(probe) + place).value for place in (DATA, SHAPE, STRIDES)]
    found = [(ctypes.c_int64 * 2).from_address(place) for place in at[1:]] if at[1] and at[2] else []
    return at[0] == probe.ctypes.data and [tuple(f) for f in found] == [probe.shape, probe.strides]


# The processor features that object code in wheels may use, and that a processor needs to run it.
PORTABLE = "x86-64-v3"
PORTABLE_FEATURES = (
    "64bit avx avx2 bmi bmi2 cmov crc32 cx16 cx8 f16c fma fxsr lzcnt "
    "mmx movbe popcnt sahf sse sse2 sse3 sse4.1 sse4.2 ssse3 xsave"
)

# The target of object code in wheels. It calls neither Python nor NumPy, so their versions do not matter.
PORTABLE_DESCRIPTION = f"{platform.system()} {platform.machine()} {PORTABLE}"


def portable_settings() -> dict[str, str]:
    """Environment variables with which Numba compiles for PORTABLE, whatever processor this is."""
    features = ",".join(f"+{feature}" for feature in PORTABLE_FEATURES.split())
    return {"NUMBA_CPU_NAME": PORTABLE, "NUMBA_CPU_FEATURES": features}


@cache
def runs_portable_code() -> bool:
    """Whether this processor has all features of PORTABLE."""
    import llvmlite.binding as llvm

    found = llvm.get_host_cpu_features()
    return platform.machine() == "x86_64" and all(found.get(feature) for feature in PORTABLE_FEATURES.split())


@cache
def target_description() -> str:
    """The target of machine code: processor, versions and settings."""
    if portable_settings().items() <= os.environ.items():
        return PORTABLE_DESCRIPTION
    import llvmlite.binding as llvm

    versions = [platform.python_version(), np.__version__, compiler_version()]
    settings = [
        f"{name}={value}"
        for name, value in sorted(os.environ.items())
        if name.startswith("NUMBA_") and name != "NUMBA_CACHE_DIR"
    ]
    features = llvm.get_host_cpu_features().flatten()
    return "\n".join([*versions, llvm.get_host_cpu_name(), features, *settings])


class ObjectCode:
    """A kernel's object code, loaded into this process."""

    def __init__(self, symbol: str, gives: str, data: bytes) -> None:
        """gives: the form of its answer, "" for none. Raises RuntimeError if LLVM cannot load the data."""
        self._gives, self.address = gives, _load(symbol, data)
        self.entry = ENTRY(self.address)

    def __call__(self, words: list[int]) -> Any:
        """Call the kernel with a block of these words; return its answer."""
        block = (ctypes.c_int64 * len(words))(*words)
        if self.entry(ctypes.addressof(block)) not in DONE:
            fail()
        if self._gives == REAL:
            return real_of_word(block[PLACE_OF_ANSWER])
        return block[PLACE_OF_ANSWER] if self._gives else None


def read(path: Path, symbol: str) -> ObjectCode | None:
    """Load a file of object code; None if it is missing, damaged or unknown to LLVM."""
    try:
        gives, _, data = read_sealed(path).partition(b"\n")
        return ObjectCode(symbol, gives.decode(), data)
    except (OSError, ValueError, RuntimeError):
        return None


@cache
def _engine() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple().create_target_machine()
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), target)


def _load(symbol: str, data: bytes) -> int:
    import llvmlite.binding as llvm

    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(data))
    engine.finalize_object()
    address = int(engine.get_function_address(symbol))
    if not address:
        raise RuntimeError(f"no {symbol} in this object code")
    return address


def extract_object_code(library: Any, function: str, symbol: str, forms: list[Form], gives: str) -> bytes | None:
    """The object code of a kernel that Numba compiled, with an entry; None if it needs Numba to run.

    library, function: Numba's code library and the kernel's name in it. forms: those of its arguments.
    """
    import llvmlite.binding as llvm

    module = library.linked_copy()
    wanted = [str(argument.type) for argument in module.get_function(function).arguments]
    if wanted != ["ptr", "ptr", *(type_ for form in forms for type_ in _passed(form))]:
        return None
    module.link_in(llvm.parse_assembly(_entry(module, function, symbol, forms, gives)))
    for name in [f.name for f in module.functions if f.is_declaration and f.name in RUNTIME_SOURCE]:
        module.link_in(llvm.parse_assembly(_head(module) + RUNTIME_SOURCE[name]))
    _keep_only(module, symbol, library._codegen._tm)
    data: bytes = library.object_code(module)
    unknown = {f.name for f in module.functions if f.is_declaration} - C_LIBRARY_SYMBOLS
    return data if all(name.startswith("llvm.") for name in unknown) else None


def _keep_only(module: Any, symbol: str, target: Any) -> None:
    """Drop everything that the entry does not reach, such as Numba's wrappers."""
    import llvmlite.binding as llvm

    for thing in [*module.functions, *module.global_variables]:
        if not thing.is_declaration and thing.name != symbol:
            thing.linkage = "internal"
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()))


def _passed(form: Form) -> list[str]:
    """The LLVM types of one argument in Numba's calling convention."""
    kind, dimensions, _ = form
    if kind == ARRAY:
        return ["ptr", "ptr", "i64", "i64", "ptr", *["i64"] * (2 * dimensions)]
    return ["ptr"] if kind == NONE else [LLVM[kind]]


def _entry(module: Any, function: str, symbol: str, forms: list[Form], gives: str) -> str:
    """LLVM IR of a function that calls the kernel with the block at an address, and returns its status."""
    lines, passed, at = [], ["ptr %answer", "ptr %trouble"], PLACE_OF_ANSWER
    for n, (kind, dimensions, size) in enumerate(forms):
        if kind == NONE:
            passed.append("ptr null")
            continue
        at += 1
        lines += [f"%at{n} = getelementptr i64, ptr %block, i64 {at}", f"%a{n} = load {LLVM[kind]}, ptr %at{n}"]
        if kind == ARRAY:
            lines += _read_array(n, dimensions)
            passed += [f"ptr null, ptr null, i64 %count{n}, i64 {size}, ptr %data{n}"]
            passed += [f"i64 %{what}{n}.{axis}" for what in ("shape", "step") for axis in range(dimensions)]
        else:
            passed.append(f"{LLVM[kind]} %a{n}")
    types = ", ".join(str(argument.type) for argument in module.get_function(function).arguments)
    body = [
        "%block = inttoptr i64 %address to ptr",
        "%answer = alloca i64",
        "%trouble = alloca ptr",
        *lines,
        f'%status = call i32 @"{function}"({", ".join(passed)})',
        *(["%value = load i64, ptr %answer", "store i64 %value, ptr %block"] if gives else []),
        "ret i32 %status",
    ]
    declared = f'declare i32 @"{function}"({types})\n'
    return f"{_head(module)}{declared}define i32 @{symbol}(i64 %address) {{\n" + "\n".join(body) + "\n}\n"


def _head(module: Any) -> str:
    return f'target datalayout = "{module.data_layout}"\ntarget triple = "{module.triple}"\n'


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

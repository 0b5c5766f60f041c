"""Object code of compiled kernels: as files, loaded and called without Numba.

With it go the functions of Numba's runtime that kernels call, in LLVM's language.

Arrays that are handed to a kernel own no memory from its point of view (their record is null); what it allocates itself
it frees before it returns, so that a record is all of its memory.
"""

import ctypes
import json
import os
import platform
import sys
import threading
from collections.abc import Callable
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from caster.jit.arguments import ARRAY, BOOLEAN, DONE, INTEGER, NONE, REAL, C, Form
from caster.jit.kernel_cache import INSTALLED, compiler_version, distrust, distrust_installed, read_sealed, write_sealed

# A record as Numba's code reads it: count of references, two fields for others, address of the data, size of the data.
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

# What is not finite has the exponent 0 for Numba, and any in C.
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
"""What object code may call of the C library; anything else would be Numba's own."""


# Lists of calls (caster/jit/command_list.py). A command is the addresses of an entry that takes a block, of the block,
# and of a number that is not 0 where the command is to be carried out, or 0; then how many numbers of the row are to be
# copied into the block first, from and to an address each. PAUSE in place of an entry returns to Python.
END_OF_COMMANDS, PAUSE = 0, 1
COMMAND_STATE_SIZE = (
    7  # first command, next row, end of rows, numbers of a row, place of a row; where it paused, and at what
)
PAUSED, FAILED = 1, 2

_GO_ON = "\n".join(f"    i32 {status}, label %next" for status in DONE)

RUN_COMMANDS = f"""
define i32 @caster_run_commands(i64 %address) {{
  %state = inttoptr i64 %address to ptr
  %rows.at = getelementptr i64, ptr %state, i64 1
  %end.at = getelementptr i64, ptr %state, i64 2
  %width.at = getelementptr i64, ptr %state, i64 3
  %place.at = getelementptr i64, ptr %state, i64 4
  %paused.at = getelementptr i64, ptr %state, i64 5
  %what.at = getelementptr i64, ptr %state, i64 6
  %program = load ptr, ptr %state
  %end = load i64, ptr %end.at
  %width = load i64, ptr %width.at
  %place = load ptr, ptr %place.at
  %paused = load ptr, ptr %paused.at
  %begins = icmp eq ptr %paused, null
  br i1 %begins, label %row, label %command
row:
  %at = load i64, ptr %rows.at
  %over = icmp eq i64 %at, %end
  br i1 %over, label %done, label %take
done:
  ret i32 0
take:
  %from = inttoptr i64 %at to ptr
  br label %number
number:
  %n = phi i64 [ 0, %take ], [ %n.next, %number ]
  %from.n = getelementptr i64, ptr %from, i64 %n
  %place.n = getelementptr i64, ptr %place, i64 %n
  %value = load i64, ptr %from.n
  store i64 %value, ptr %place.n
  %n.next = add i64 %n, 1
  %more = icmp ult i64 %n.next, %width
  br i1 %more, label %number, label %taken
taken:
  %bytes = mul i64 %width, 8
  %following = add i64 %at, %bytes
  store i64 %following, ptr %rows.at
  br label %command
command:
  %c = phi ptr [ %paused, %0 ], [ %program, %taken ], [ %c.next, %next ]
  %entry = load i64, ptr %c
  %last = icmp eq i64 %entry, {END_OF_COMMANDS}
  br i1 %last, label %row, label %read
read:
  %block.at = getelementptr i64, ptr %c, i64 1
  %when.at = getelementptr i64, ptr %c, i64 2
  %count.at = getelementptr i64, ptr %c, i64 3
  %copies = getelementptr i64, ptr %c, i64 4
  %block = load i64, ptr %block.at
  %when = load ptr, ptr %when.at
  %count = load i64, ptr %count.at
  %words = mul i64 %count, 2
  %c.next = getelementptr i64, ptr %copies, i64 %words
  %always = icmp eq ptr %when, null
  br i1 %always, label %act, label %ask
ask:
  %flag = load i64, ptr %when
  %skipped = icmp eq i64 %flag, 0
  br i1 %skipped, label %next, label %act
act:
  %pauses = icmp eq i64 %entry, {PAUSE}
  br i1 %pauses, label %pause, label %copy
pause:
  store ptr %c.next, ptr %paused.at
  store i64 %block, ptr %what.at
  ret i32 {PAUSED}
copy:
  %k = phi i64 [ 0, %act ], [ %k.next, %one ]
  %copied = icmp eq i64 %k, %words
  br i1 %copied, label %call, label %one
one:
  %source.at = getelementptr i64, ptr %copies, i64 %k
  %target.at = getelementptr i64, ptr %source.at, i64 1
  %source = load ptr, ptr %source.at
  %target = load ptr, ptr %target.at
  %word = load i64, ptr %source
  store i64 %word, ptr %target
  %k.next = add i64 %k, 2
  br label %copy
call:
  %function = inttoptr i64 %entry to ptr
  %status = call i32 %function(i64 %block)
  switch i32 %status, label %failed [
{_GO_ON}
  ]
failed:
  ret i32 {FAILED}
next:
  br label %command
}}
"""


# Compiled kernels without Numba: the object code it made is kept, and loaded and called by llvmlite alone.
#
# Loading Numba and what it keeps of a kernel takes longer than most films. The entry that is added to a kernel reads
# arrays where NumPy keeps their numbers, so that a call costs no more than Numba's own.


# Where a NumPy array object (PyArrayObject_fields, part of its stable binary interface) keeps them.
DATA, SHAPE, STRIDES = 16, 32, 40

BLOCK = "_block"  # at the end of the symbol of an entry that takes a block

LLVM = {INTEGER: "i64", REAL: "double", BOOLEAN: "i8", ARRAY: "i64"}


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


# Levels of x86-64 that wheels bring object code for, the best first, by what LLVM is to use of each
# (NUMBA_CPU_FEATURES), all of which a processor must have. Vectors of 512 bits are eight numbers, as the kernels are
# written; LLVM would rather take 256 of them for this level.
_V3 = [
    "64bit",
    "avx",
    "avx2",
    "bmi",
    "bmi2",
    "cmov",
    "crc32",
    "cx16",
    "cx8",
    "f16c",
    "fma",
    "fxsr",
    "lzcnt",
    "mmx",
    "movbe",
    "popcnt",
    "sahf",
    "sse",
    "sse2",
    "sse3",
    "sse4.1",
    "sse4.2",
    "ssse3",
    "xsave",
]
LEVELS = {"x86-64-v4": [*_V3, "avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl"], "x86-64-v3": _V3}
TUNING = {"x86-64-v4": ",-prefer-256-bit"}


def level_settings(level: str) -> dict[str, str]:
    """Environment variables with which Numba compiles for a level, whatever processor this is."""
    features = ",".join(f"+{feature}" for feature in LEVELS[level]) + TUNING.get(level, "")
    return {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": features}


def level_description(level: str) -> str:
    """What object code of a wheel is made for: Python and NumPy, which it calls nothing of, are of no account."""
    return f"{platform.system()} {platform.machine()} {level}"


@cache
def best_level() -> str:
    """The best level of LEVELS that this processor has all features of; "" for none."""
    import llvmlite.binding as llvm

    found = llvm.get_host_cpu_features()
    fitting = (level for level, needed in LEVELS.items() if all(found.get(feature) for feature in needed))
    return next(fitting, "") if platform.machine() == "x86_64" else ""


@cache
def target_description() -> str:
    """What machine code is made for: another processor in the same home needs its own."""
    level = os.environ.get("NUMBA_CPU_NAME", "")
    if level in LEVELS and level_settings(level).items() <= os.environ.items():
        return level_description(level)
    import llvmlite.binding as llvm

    versions = [platform.python_version(), np.__version__, compiler_version()]
    settings = [
        f"{name}={value}"
        for name, value in sorted(os.environ.items())
        if name.startswith("NUMBA_") and name != "NUMBA_CACHE_DIR"  # a place, which code does not depend on
    ]
    features = llvm.get_host_cpu_features().flatten()
    return "\n".join([*versions, llvm.get_host_cpu_name(), features, *settings])


class ObjectCode:
    """A kernel's object code and how it is called."""

    def __init__(self, symbol: str, taken: str, gives: str, data: bytes) -> None:
        self.symbol, self.taken, self.gives, self.data = symbol, taken, gives, data

    def entry(self) -> Callable[..., int]:
        """Loaded into this process; what it takes first is the address for its answer."""
        types = [C[form] for form in self.taken]
        prototype = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64, *types)
        return prototype(_load(self.symbol, self.data))

    @cached_property
    def block_address(self) -> int:
        """Of an entry that takes the address of a block of these, eight bytes each; once `entry` has loaded it."""
        return int(_engine().get_function_address(self.symbol + BLOCK))

    @cached_property
    def block_entry(self) -> Callable[[int], int]:
        """The same, to be called from Python."""
        return ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64)(self.block_address)

    def write(self, path: Path) -> None:
        head = json.dumps({"symbol": self.symbol, "taken": self.taken, "gives": self.gives})
        write_sealed(path, head.encode() + b"\n" + self.data)


def installed_code() -> tuple[Path, str] | None:
    """Folder and description of the wheel's object code for this processor; None where it brought none that fits."""
    level = best_level() if INSTALLED.is_dir() and not distrust_installed(INSTALLED.stat()) else ""
    return (INSTALLED / level, level_description(level)) if level else None


def read(path: Path, *, installed: bool = False) -> ObjectCode | None:
    """What was written; None if it is not there, not what was written, or may be by another user."""
    try:
        content = read_sealed(path, distrust_installed if installed else distrust)
        head, _, data = content.partition(b"\n")
        return ObjectCode(**json.loads(head), data=data)
    except (OSError, ValueError, TypeError):
        return None


@cache
def _engine() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple().create_target_machine()
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), target)


def command_runner() -> Callable[[int], int]:
    """Carries out commands; takes the address of COMMAND_STATE_SIZE int64."""
    with LLVM_LOCK:
        return _made_runner()


@cache
def _made_runner() -> Callable[[int], int]:
    import llvmlite.binding as llvm

    _engine()  # LLVM is initialised
    # 2 ms in place of 6, for a function whose time does not count
    target = llvm.Target.from_default_triple().create_target_machine(opt=0)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(RUN_COMMANDS), target)
    engine.finalize_object()
    run: Any = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64)(int(engine.get_function_address("caster_run_commands")))
    run.engine = engine  # which owns the code
    return run


def _load(symbol: str, data: bytes) -> int:
    import llvmlite.binding as llvm

    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(data))
    engine.finalize_object()
    address = int(engine.get_function_address(symbol))
    if not (address and engine.get_function_address(symbol + BLOCK)):
        raise RuntimeError(f"no {symbol} in this object code")
    return address


def extract_object_code(library: Any, function: str, symbol: str, taken: list[Form], gives: str) -> ObjectCode | None:
    """The object code of what Numba compiled, with an entry; None if it needs Numba to run.

    library, function: Numba's code library and the name of the kernel in it. taken: `arguments.forms`.
    """
    import llvmlite.binding as llvm

    module = library.linked_copy()
    wanted = [str(argument.type) for argument in module.get_function(function).arguments]
    given = ["ptr", "ptr", *(type_ for form in taken for type_ in _passed(form))]
    if given != wanted:
        return None
    entry = _entry(module, function, symbol, taken, gives)
    module.link_in(llvm.parse_assembly(entry))
    for name in [f.name for f in module.functions if f.is_declaration and f.name in RUNTIME_SOURCE]:
        module.link_in(llvm.parse_assembly(_head(module) + RUNTIME_SOURCE[name]))
    _keep_only(module, symbol, library._codegen._tm)
    data = library.object_code(module)
    if any(f.is_declaration and not _known(f.name) for f in module.functions):
        return None
    forms = "".join(form for form, _, _ in taken if form != NONE)
    return ObjectCode(symbol, forms, gives, data)


def _known(name: str) -> bool:
    return name.startswith("llvm.") or name in C_LIBRARY_SYMBOLS


def _keep_only(module: Any, symbol: str, target: Any) -> None:
    """Drop what the entry does not reach: Numba's own wrappers."""
    import llvmlite.binding as llvm

    for thing in [*module.functions, *module.global_variables]:
        if not thing.is_declaration and thing.name not in (symbol, symbol + BLOCK):
            thing.linkage = "internal"
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()))


def _passed(form: Form) -> list[str]:
    """What Numba's calling convention makes of one argument."""
    kind, dimensions, _ = form
    if kind == ARRAY:
        return ["ptr", "ptr", "i64", "i64", "ptr", *["i64"] * (2 * dimensions)]
    return ["ptr"] if kind == NONE else [LLVM[kind]]


def _entry(module: Any, function: str, symbol: str, taken: list[Form], gives: str) -> str:
    """LLVM's language for a function of whole and real numbers that calls the kernel; it returns its status."""
    lines, passed, parameters = [], ["ptr %answer", "ptr %trouble"], ["i64 %out"]
    for n, (kind, dimensions, size) in enumerate(taken):
        if kind != NONE:
            parameters.append(f"{LLVM[kind]} %a{n}")
        if kind == ARRAY:
            lines += _read_array(n, dimensions)
            passed += [f"ptr null, ptr null, i64 %count{n}, i64 {size}, ptr %data{n}"]
            passed += [f"i64 %{what}{n}.{axis}" for what in ("shape", "step") for axis in range(dimensions)]
        else:
            passed.append("ptr null" if kind == NONE else f"{LLVM[kind]} %a{n}")
    types = ", ".join(str(argument.type) for argument in module.get_function(function).arguments)
    if gives:
        lines_after = ["%value = load i64, ptr %answer", "%to = inttoptr i64 %out to ptr", "store i64 %value, ptr %to"]
    else:
        lines_after = []
    body = [
        "%answer = alloca i64",
        "%trouble = alloca ptr",
        *lines,
        f'%status = call i32 @"{function}"({", ".join(passed)})',
        *lines_after,
        "ret i32 %status",
    ]
    declared = f'declare i32 @"{function}"({types})\n'
    return (
        f"{_head(module)}{declared}define i32 @{symbol}({', '.join(parameters)}) {{\n"
        + "\n".join(body)
        + "\n}\n"
        + _block_entry(symbol, [LLVM[kind] for kind, _, _ in taken if kind != NONE])
    )


def _block_entry(symbol: str, types: list[str]) -> str:
    """LLVM's language for an entry whose arguments, the address for its answer first, lie in a block."""
    lines, passed = [], []
    for n, type_ in enumerate(["i64", *types]):
        lines += [f"%at{n} = getelementptr i64, ptr %block, i64 {n}", f"%v{n} = load {type_}, ptr %at{n}"]
        passed.append(f"{type_} %v{n}")
    call = f"%status = call i32 @{symbol}({', '.join(passed)})"
    body = ["%block = inttoptr i64 %address to ptr", *lines, call, "ret i32 %status"]
    return f"define i32 @{symbol}{BLOCK}(i64 %address) {{\n" + "\n".join(body) + "\n}\n"


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

"""Object code of compiled kernels (caster/jit/compiler.py), loaded and called without Numba.

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

from caster.jit.arguments import REAL
from caster.jit.kernel_cache import compiler_version, read_sealed

# The entry that is added to a kernel takes the address of a block of 8-byte words: its answer, then its arguments
# (caster/jit/arguments.py). It reads arrays where NumPy keeps their numbers.
PLACE_OF_ANSWER = 0

# Status of an entry without an error; in Numba's calling convention, None as an answer has a status of its own.
DONE = (0, -2)

# Where a NumPy array object (PyArrayObject_fields, part of its stable binary interface) keeps them.
DATA, SHAPE, STRIDES = 16, 32, 40

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
    settings = [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith("NUMBA_")]
    features = llvm.get_host_cpu_features().flatten()
    return "\n".join([*versions, llvm.get_host_cpu_name(), features, *settings])


class ObjectCode:
    """A kernel's object code, loaded into this process."""

    def __init__(self, path: Path, gives: str, data: bytes) -> None:
        """path: its file. gives: the form of its answer, or "". Raises RuntimeError if LLVM cannot load the data."""
        import llvmlite.binding as llvm

        engine = _engine()
        engine.add_object_file(llvm.ObjectFileRef.from_data(data))
        engine.finalize_object()
        self._gives, self.address = gives, int(engine.get_function_address(symbol_in(path)))
        if not self.address:
            raise RuntimeError(f"{path}: no entry in this object code")
        self.entry = ENTRY(self.address)

    def __call__(self, words: list[int]) -> Any:
        """Call the kernel with a block of these words; return its answer."""
        block = (ctypes.c_int64 * len(words))(*words)
        if self.entry(ctypes.addressof(block)) not in DONE:
            fail()
        if self._gives == REAL:
            return ctypes.c_double.from_buffer(block).value
        return block[PLACE_OF_ANSWER] if self._gives else None


def symbol_in(path: Path) -> str:
    """The symbol of the entry in a file."""
    return path.stem.partition("-")[2]


def read(path: Path) -> ObjectCode | None:
    """Load a file of object code; None if it is missing, damaged or unknown to LLVM."""
    try:
        gives, _, data = read_sealed(path).partition(b"\n")
        return ObjectCode(path, gives.decode(), data)
    except (OSError, ValueError, RuntimeError):
        return None


@cache
def _engine() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple().create_target_machine()
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), target)

"""Mitsuba's variants. Those that work on this machine are found by tracing a small scene in a child process."""

import glob
import os
import platform
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from caster.description.errors import SceneError, suggestion
from caster.system.atomic_files import ScratchFolder
from caster.system.terminal import folded
from mitsuba_ref.reference import messages
from mitsuba_ref.reference.interpreter import VARIANT_VARIABLE, file_stamp, installation
from mitsuba_ref.reference.messages import Crash, TraceRequest
from mitsuba_ref.reference.store import REFERENCE_SETTINGS, environment_settings, key_of, machine, user_store

SMOKE_TEST_TIMEOUT_SECONDS = 60.0  # it takes one or two

# Relative errors of Mitsuba where all values are small integers or half of one, and so exact except for the final
# reciprocal, whose bits differ between CPUs. In units of U = 2^-24, to first order:
#   t = rcp(den) * T in Embree: x86 starts from rcpps with an error of at most 1.5 * 2^-12, and one Newton step leaves
#   its square, 2.25; the last two roundings of the step add 2 (1 with fma), the product 1. On aarch64, two steps from
#   2^-8 leave less.
#   z * rsqrt(z z) in Dr.Jit: one step from rsqrtps, with an error of 1.5 * 2^-12, leaves 1.5 times its square, 3.375;
#   half of the roundings of z z, two products and a difference count, two more products count in full: 4.
U = 2.0**-24
EXACT_T_ERROR, EXACT_NORMAL_ERROR = 5.25 * U, 8.0 * U

SMOKE_TEST_T = 8.0

# The file has no normals: Mitsuba computes them with an instruction that makes an old libLLVM abort.
SMOKE_TEST_PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
-4 -4 0
4 -4 0
4 4 0
-4 4 0
3 0 1 2
3 0 2 3
"""
SMOKE_TEST_XML = """<scene version="3.0.0">
    <emitter type="point"><point name="position" value="0 0 2"/></emitter>
    <shape type="ply" id="square"><string name="filename" value="square.ply"/><bsdf type="diffuse"/></shape>
</scene>
"""


def smoke_test(variant: str, settings: Mapping[str, str]) -> str:
    """Trace a small scene with one variant; "" if the result is right, else what happened. settings: environment."""
    with ScratchFolder() as name:
        folder = Path(name)
        (folder / "square.ply").write_text(SMOKE_TEST_PLY)
        (folder / "scene.xml").write_text(SMOKE_TEST_XML)
        fresh = {**settings, "DRJIT_CACHE_DIR": name}  # a cached kernel would hide an abort
        o, d = np.array([[1, 0.5, 8], [9, 0.5, 8]], np.float32), np.array([[0, 0, -1]] * 2, np.float32)
        request = TraceRequest(folder / "scene.xml", variant, o, d, np.full(2, np.inf, np.float32))
        response = messages.run_request(request, SMOKE_TEST_TIMEOUT_SECONDS, fresh)
    if isinstance(response, Crash):
        return response.brief
    (t, miss), normals = response.t.tolist(), response.sh_n.astype(np.float64)
    right = (
        abs(t - SMOKE_TEST_T) <= EXACT_T_ERROR * SMOKE_TEST_T
        and miss == np.inf
        and np.max(np.abs(normals - [[0, 0, 1], [0, 0, 0]])) <= EXACT_NORMAL_ERROR
    )
    return "" if right else f"wrong answer: t {response.t.tolist()}, normals {response.sh_n.tolist()}"


NO_LIBLLVM = "no libLLVM found"
WAY_OUT = "`mitsuba-ref doctor` names a way out"
# The versions whose arithmetic the bounds were derived for; Dr.Jit has to be the one Mitsuba was built with.
PINNED = {"mitsuba": "3.9.1", "drjit": "1.5.0"}
INSTALL_COMMAND = "pip install " + " ".join(f"{name}=={version}" for name, version in PINNED.items())
SCALAR, LLVM = VARIANT_NAMES = ("scalar_rgb", "llvm_ad_rgb")
LIBLLVM_ENVIRONMENT_VARIABLE = "DRJIT_LIBLLVM_PATH"  # environment variable of Dr.Jit

# Dr.Jit takes the first it finds, whose code generator may abort; here the newest comes first.
LIBLLVM_PATTERNS = (
    f"{sys.prefix}/lib/libLLVM*.so*",
    "/usr/lib/*-linux-gnu*/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
)


class VariantError(SceneError, messages.MitsubaError):
    """A chosen variant does not exist or does not work here."""


@dataclass(frozen=True)
class Variants:
    """The variants that work. libllvm: the library with which the LLVM variant does; why: why others do not work.

    why: one line; details: the same in full.
    """

    scalar: bool
    libllvm: str | None
    why: str
    details: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for name, works in zip(VARIANT_NAMES, (self.scalar, self.libllvm), strict=True) if works)


def usable_variants() -> Variants:
    """The variants that work on this machine: scalar, and LLVM with the first of the libraries that it works with."""
    candidates, scalar, library = _candidates(), _problem(SCALAR), None
    problems = [f"{SCALAR}: {scalar}"] if scalar else []
    absent = "No module named" in scalar
    for path in () if absent else candidates:
        problem = _problem(LLVM, path)
        if not problem:
            library = path
            break
        problems.append(f"{path}: {problem}")
    if not candidates and not absent:
        problems.append(NO_LIBLLVM)
    return Variants(not scalar, library, _brief(problems), "; ".join(problems))


_outcomes: dict[str, str] = {}  # of this process


def _problem(variant: str, library: str | None = None) -> str:
    """What happened when a variant was tried; "" if it works. Tried once, then stored in the user's cache folder.

    Loading a library runs its code: one is loaded only where it is a candidate, whatever the store names.
    """
    parts = [Path(__file__).read_text(encoding="utf-8"), platform.node(), repr(machine()), variant]
    settings = {LIBLLVM_ENVIRONMENT_VARIABLE: library} if library else {}
    key = key_of([*parts, environment_settings(*REFERENCE_SETTINGS), file_stamp(library or "")])
    if key not in _outcomes:
        stored = user_store().get(key)
        problem = smoke_test(variant, settings) if stored is None else stored.decode()
        # A Mitsuba that cannot be imported may be half installed, a GPU may come; after the other two, a machine was
        # busy or out of memory.
        for_now = problem.startswith("exit code") and variant != LLVM
        if not for_now and not any(word in problem for word in ("killed", "SIGKILL")):
            user_store().put(key, problem.encode(errors="replace"))
        _outcomes[key] = problem
    return _outcomes[key]


def variant_for(has_quadrics: bool) -> str:
    """The variant for a scene. With spheres, cylinders or disks, the scalar one, which computes them in float64.

    Raises VariantError if it does not work here or MITSUBA_REF_VARIANT (--variant) names an unknown one, SceneError
    for an interpreter (--mitsuba) that cannot be used.
    """
    found, chosen = usable_variants(), os.environ.get(VARIANT_VARIABLE)
    if chosen:
        if chosen not in VARIANT_NAMES and chosen not in (known := rgb_variants()):
            rule = f"whose light is in rgb, as it is compared{suggestion(chosen, known)}"
            raise VariantError(f"--variant {chosen!r}: expected {' or '.join(known)}, {rule}")
        if why := why_not(chosen):
            raise VariantError(f"--variant {chosen!r}: it does not work here: {why}")
        return chosen
    variant = LLVM if found.libllvm and not has_quadrics else SCALAR
    if variant in found.names:
        return variant
    if re.search("No module named '(mitsuba|drjit)'", found.why):
        raise VariantError(f"Mitsuba is not installed: {INSTALL_COMMAND}")
    raise VariantError(f"Mitsuba's {SCALAR} does not work here: {found.why}; {WAY_OUT}")


def rgb_variants() -> list[str]:
    """The variants of the chosen Mitsuba, in float32 or float64, whose light is comparable: not spectra or luminance.

    Raises SceneError.
    """
    return [name for name in installation().variants if re.fullmatch(r"\w+_rgb(_double)?", name)]


def why_not(variant: str) -> str:
    """Why a variant does not work here, in one line; "" if it does."""
    found = usable_variants()
    if variant in VARIANT_NAMES:
        return "" if variant in found.names else found.why
    problem = _problem(variant, environment_for(variant).get(LIBLLVM_ENVIRONMENT_VARIABLE))
    return "no CUDA device was found" if NO_CUDA in problem else _brief([problem])


NO_CUDA = "the CUDA backend hasn't been initialized"  # in Dr.Jit's message


_said: set[str] = set()  # lines that this process has printed


def require_variants() -> None:
    """Raise VariantError where spheres have no variant; print a line where no libLLVM works, once a process.

    Called before any work.
    """
    chosen, found = variant_for(has_quadrics=True), usable_variants()
    broken = not found.libllvm and not found.why.endswith(NO_LIBLLVM)
    line = f"{LLVM} does not work here, {chosen} traces all scenes ({WAY_OUT}): {found.why}"
    if broken and not os.environ.get(VARIANT_VARIABLE) and line not in _said:
        _said.add(line)
        print(folded(line), file=sys.stderr)


def environment_for(variant: str) -> dict[str, str]:
    """The environment variables with which a child process finds the libLLVM that works."""
    library = usable_variants().libllvm if variant.startswith("llvm") else None
    return {LIBLLVM_ENVIRONMENT_VARIABLE: library} if library else {}


def _candidates() -> list[str]:
    """Paths of libLLVM to try: the user's choice alone, if there is one, else all, the newest first."""
    if os.environ.get(LIBLLVM_ENVIRONMENT_VARIABLE):
        return [os.environ[LIBLLVM_ENVIRONMENT_VARIABLE]]
    own = filter(None, os.environ.get("LD_LIBRARY_PATH", "").split(":"))
    patterns = [*LIBLLVM_PATTERNS, *(f"{folder}/libLLVM*.so*" for folder in own)]
    found = {os.path.realpath(path) for pattern in patterns for path in glob.glob(pattern)}
    whole = [path for path in found if WHOLE_LLVM.search(path) and os.path.isfile(path)]
    return sorted(whole, key=lambda path: ([*map(int, re.findall(r"\d+", Path(path).name))], path), reverse=True)


# A path of the whole LLVM library, not of a part or a fork of it.
WHOLE_LLVM = re.compile(r"/libLLVM([-.][\d.]+)?\.(so|dylib)[\d.]*$")


MAX_PROBLEM_CHARACTERS, MAX_PROBLEMS = 110, 2  # in one line


def _brief(problems: list[str]) -> str:
    """The first problems, each cut to one line."""
    lines = (problem.partition("\n")[0] for problem in problems[:MAX_PROBLEMS])
    shown = [line if len(line) <= MAX_PROBLEM_CHARACTERS else f"{line[:MAX_PROBLEM_CHARACTERS]} ..." for line in lines]
    more = len(problems) - len(shown)
    return "; ".join([*shown, *([f"and {more} more libraries"] if more else [])])

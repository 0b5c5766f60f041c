"""A kernel's file name depends on everything its machine code depends on: reachable code, types and target."""

import os
from typing import Any

import pytest
from marks import compiled_only

from caster.jit import code_digest as digests
from caster.jit import decorators, kernel_cache, machine_code
from caster.jit.arguments import describe
from caster.jit.kernel_cache import compiler_version

# Two kinds with a body each for one function of the protocol, and a kernel that reaches it for the class it is given.
SOURCE = '''
from typing import Any, NamedTuple
import math
import numpy as np
from caster.jit.decorators import generic, implement, jit, inlined

SCALE, SHIFTS, TABLE = 2.0, (1, 2.5), np.array([1.0, 2.0])
UNUSED = 1

@jit
def helper(x: float) -> float:
    """What it does."""
    return x * SCALE + SHIFTS[1]  # a comment

def made(step):
    @jit
    def inner(x):
        return x + step
    return inner

stepped = made(3)

@generic
def area(prims: Any, k: int) -> Any:
    """The area of primitive k."""

class Squares(NamedTuple):
    sides: np.ndarray

class Circles(NamedTuple):
    radii: np.ndarray

class Result(NamedTuple):
    value: float

@implement(area, Squares)
@jit
def _square(prims, k):
    return prims.sides[k] * prims.sides[k]

@implement(area, Circles)
@jit
def _circle(prims, k):
    return math.pi * prims.radii[k] ** 2

@implement(area, Result)
@jit
def _result(prims, k):
    return prims.value

@jit
def total(prims, count):
    found = Result(helper(area(prims, 0)) + stepped(1.0) + TABLE[1])
    return sum([area(prims, k) for k in range(count)]) + found.value
'''


def digest(source: str, kind: str = "Squares") -> str:
    """Of `total` for one kind, in a module with this source."""
    module: dict[str, Any] = {"__name__": "made_up_module"}
    kept = decorators.jit
    try:
        decorators.jit = lambda function: decorators.Kernel(function, {})  # also where nothing is compiled
        exec(compile(source, "made_up_module.py", "exec"), module)
    finally:
        decorators.jit = kept
    return digests.code_digest(module["total"].function, (module[kind],), decorators._GENERICS)


CHANGES = {
    "a constant": ("SCALE, SHIFTS, TABLE = 2.0", "SCALE, SHIFTS, TABLE = 2.0000000000000004"),
    "a member of a constant": ("(1, 2.5)", "(1, 3.5)"),
    "an array": ("np.array([1.0, 2.0])", "np.array([1.0, 4.0])"),
    "the type of an array": ("np.array([1.0, 2.0])", "np.array([1.0, 2.0]).view(np.int64)"),
    "an operator of a function that is called": ("return x * SCALE", "return x / SCALE"),
    "a literal": ("stepped(1.0)", "stepped(1.5)"),
    "what a closure holds": ("made(3)", "made(4)"),
    "the body for the class of an argument": ("prims.sides[k] * prims.sides[k]", "prims.sides[k] * 1.0"),
    "the body for a class made within": ("return prims.value", "return -prims.value"),
    "the fields of a class": ("sides: np.ndarray", "sides: np.ndarray\n    more: np.ndarray"),
    "which function is called": ("TABLE[1])", "TABLE[1] + helper(0.0))"),
    "how a function is compiled": ("@jit\ndef helper", "@inlined\ndef helper"),
    "code within code": ("sum([area(prims, k)", "sum([-area(prims, k)"),
    "what a name stands for": ("stepped = made(3)", "stepped = helper"),
}
NO_CHANGES = {
    "a comment": ("# a comment", "# another"),
    "a docstring": ("What it does.", "What it does, in other words."),
    "lines between": ("\n@jit\ndef total", "\n\n\n\n@jit\ndef total"),
    "a constant that nothing names": ("UNUSED = 1", "UNUSED = 2"),
    "the body for another class": ("math.pi * prims.radii[k] ** 2", "3.0 * prims.radii[k] ** 2"),
    "a type hint": ("def helper(x: float) -> float", "def helper(x: Any) -> Any"),
}


def edited(change: tuple[str, str]) -> str:
    assert SOURCE.count(change[0]) == 1, change
    return SOURCE.replace(*change)


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_what_a_kernel_can_reach_is_part_of_its_name(change):
    assert digest(edited(change)) != digest(SOURCE)


@pytest.mark.parametrize("change", NO_CHANGES.values(), ids=NO_CHANGES)
def test_what_it_cannot_reach_is_not(change):
    assert digest(edited(change)) == digest(SOURCE)


def test_another_class_is_another_name():
    assert digest(SOURCE, "Circles") != digest(SOURCE, "Squares")


@compiled_only
def test_signature_options_target_and_this_package_are_part_of_the_name(monkeypatch):
    """Each alone gives the file another name."""
    from caster.kernels.raster.tile import clear_rays, new_tile

    def name(*args):
        return clear_rays._file(describe(args).key, machine_code.target_description())

    args = (new_tile(), 0, 4)
    found = {name(*args), name(args[0], 0, 4.0)}
    for place, attribute, value in (
        (machine_code, "target_description", lambda: "another"),
        (decorators, "compiler_digest", lambda: "another"),
        (clear_rays, "options", {"forceinline": True}),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, attribute, value)
            found.add(name(*args))
    assert len(found) == 5 and name(*args) in found


def test_every_source_of_this_package_is_part_of_its_digest(tmp_path, monkeypatch):
    """An edit of any module by which functions become machine code."""
    monkeypatch.setattr(digests, "__file__", str(tmp_path / "code_digest.py"))
    found = set()
    for name, text in (("a.py", "x"), ("a.py", "y"), ("b.py", "z"), ("a.py", "yb.py\0z")):
        (tmp_path / name).write_text(text)
        found.add(digests.compiler_digest.__wrapped__())
    assert len(found) == 4


@compiled_only
@pytest.mark.parametrize("library", kernel_cache.COMPILERS)
def test_another_version_of_the_compiler_is_another_target(library, tmp_path, monkeypatch):
    describe, find = machine_code.target_description.__wrapped__, kernel_cache.find_spec
    before = describe()
    (tmp_path / "_version.py").write_text("version = 'another'")

    class Spec:
        origin = str(tmp_path / "__init__.py")

    monkeypatch.setattr(kernel_cache, "find_spec", lambda name: Spec if name == library else find(name))
    assert "another" in compiler_version() and describe() != before


@compiled_only
def test_processor_versions_and_settings_are_part_of_the_target(monkeypatch):
    """Each alone gives another description of the target, which the name of every kernel's file is made of."""
    import llvmlite.binding as llvm

    describe = machine_code.target_description.__wrapped__
    found = [describe()]
    for place, name, value in (
        (llvm, "get_host_cpu_name", lambda: "another"),
        (llvm, "get_host_cpu_features", lambda: type("Features", (), {"flatten": lambda self: "+another"})()),
        (machine_code.np, "__version__", "another"),
        (machine_code.platform, "python_version", lambda: "another"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, value)
            found.append(describe())
    for name in ("NUMBA_OPT", "NUMBA_CPU_NAME", "NUMBA_BOUNDSCHECK"):
        with monkeypatch.context() as patch:
            patch.setenv(name, "0" if os.environ.get(name) != "0" else "1")
            found.append(describe())
    assert len(set(found)) == len(found) == 8

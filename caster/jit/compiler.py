"""A Numba target that makes object code: functions are lowered once, and only whole kernels are optimised and emitted.

Numba's own dispatchers make every function callable from Python: they optimise it, emit machine code, and wrap it for
CPython and C. Most functions here are called only by kernels, so this target stops at LLVM IR, in half the time. This
module loads Numba, so it is imported when the first kernel is compiled.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import llvmlite.binding as llvm
from numba.core import codegen, compiler, cpu, dispatcher, registry, target_extension, types, typing
from numba.core.compiler_lock import require_global_compiler_lock
from numba.core.types.misc import unliteral
from numba.core.typing import templates

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

    def linked_copy(self) -> Any:
        """A copy of the LLVM module, not optimised."""
        return llvm.parse_bitcode(self._get_module_for_linking().as_bitcode())

    def object_code(self, module: Any) -> bytes:
        """Optimise and emit a module made from `linked_copy`."""
        for settings in ({"loop_vectorize": self._codegen._loopvect, "slp_vectorize": False, "cost": "cheap"}, {}):
            passes, builder = self._codegen._module_pass_manager(**settings)
            passes.run(module, builder)
        module.verify()
        emitted: bytes = self._codegen._tm.emit_object(module)
        return emitted


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


_DISPATCHERS: dict[tuple[Callable[..., Any], frozenset[tuple[str, Any]]], Any] = {}


def decorator_of_bodies(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """The decorator by which Numba makes dispatchers of bodies of overloaded functions.

    It makes another one for each caller that is inlined or not. Those that state whether they are inlined themselves
    are the same for all callers.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        if "forceinline" not in options:
            return dispatcher_of(function, options)
        key = function, frozenset(options.items())
        return _DISPATCHERS.get(key) or _DISPATCHERS.setdefault(key, dispatcher_of(function, options))

    return decorate


target_extension.target_registry[TARGET] = KernelClass
target_extension.dispatcher_registry[KernelClass] = KernelDispatcher
target_extension.jit_registry[KernelClass] = decorator_of_bodies


def register_intrinsic(stub: Callable[..., Any], definition: Callable[..., Any]) -> None:
    """Replace calls of a Python function by LLVM code; definition: as for numba.extending.intrinsic."""
    template = templates.make_intrinsic_template(stub, definition, stub.__name__)
    templates.infer(template)
    templates.infer_global(stub, types.Function(template))

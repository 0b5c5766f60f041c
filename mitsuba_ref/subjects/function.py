"""A candidate that is a Python function: function(scene, o, d) -> (t, n), or with limits and ids."""

import contextlib
import faulthandler
import importlib
import inspect
import os
import re
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from caster.description.errors import SceneError, error_prefix, suggestion
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.subjects.ray_files import answer_of_numbered_hits
from mitsuba_ref.subjects.subject import PRECISIONS, Answer, CastRequest, NoAnswer, Subject, Unsupported, exception_text

Function = Callable[..., Any]  # (scene, o, d) -> (t, n), or with more
# package.module:function
FUNCTION_PATTERN = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")
HIDDEN_FRAMES = (
    str(Path(__file__).parent),
    "<frozen importlib",
    str(Path(importlib.__file__).parent),
)  # files of frames that are not the candidate's
MAX_TRACEBACK_FRAMES = 4

# Scenes are judged several at a time, but a candidate need not be thread-safe.
_one_at_a_time = threading.Lock()


def import_function(text: str, precision: str | None) -> "FunctionSubject":
    """The candidate MODULE:NAME. Raises SceneError."""
    return function_subject(imported(text), text, precision)


def imported(text: str) -> Function:
    """The function MODULE:NAME; the current folder comes first, as for `python -m`. Raises SceneError."""
    module, _, path = text.partition(":")
    module, here = module.removesuffix(".py"), str(Path.cwd())
    faulthandler.enable(2)  # says where the function is when machine code ends the process
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        with _isolated():
            found: Any = importlib.import_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # also SystemExit, which would end the program with its own exit code
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):  # not one it imports
            where = f"{here}, then among the installed packages and in PYTHONPATH"
            raise SceneError(f"there is no module {module}: looked in {where}") from error
        raise SceneError(f"cannot import {module}: {_exception_with_calls(error)}") from error
    for name in path.split("."):
        if not hasattr(found, name):
            raise SceneError(f"{module} has no '{path}'{suggestion(name, dir(found))}")
        found = getattr(found, name)
    if not callable(found):
        raise SceneError(f"expected a function, got {type(found).__name__}")
    return found


def spawn_rule(text: str) -> Callable[[Array, Array, Array], Array]:
    """The function(points, normals, directions) that gives the origins of a candidate's secondary rays.

    Its arguments and its result are (n, 3) float64; normals point outwards and have length 1. It raises NoAnswer.
    Raises SceneError for a text that names no function.
    """
    with error_prefix(f"--spawn {text}"):
        call = imported(text)

    def spawn(points: Array, normals: Array, directions: Array) -> Array:
        with _one_at_a_time, _isolated():
            try:
                origins = np.asarray(call(points, normals, directions), np.float64)
            except Exception as error:
                raise NoAnswer(f"{text} raised {_exception_with_calls(error)}") from error
        if origins.shape != points.shape:
            raise NoAnswer(f"{text}: expected origins of shape {points.shape}, got {origins.shape}")
        return origins

    return spawn


def function_subject(call: Function, name: str = "", precision: str | None = None) -> "FunctionSubject":
    """A function as a candidate, with its attribute `precision` unless one is given. Raises SceneError."""
    name = name or getattr(call, "__name__", type(call).__name__)
    declared = precision or getattr(call, "precision", None)
    if declared is not None and not (isinstance(declared, str) and declared in PRECISIONS):
        raise SceneError(f"{name}.precision: expected {' or '.join(PRECISIONS)}, got {declared!r}")
    return FunctionSubject(name, call, declared)


CALLED = "it is called as function(scene, o, d), with o and d (n, 3) float64, and returns (t, n)"


@dataclass(frozen=True)
class FunctionSubject(Subject):
    """A candidate that is a Python function."""

    call: Function
    precision: str | None = None  # None: that of the arrays it returns
    takes_rays: ClassVar[bool] = True

    def __reduce__(self) -> tuple[Function, tuple[Any, ...]]:
        """A pickle names the function; the process that reads it imports the module."""
        return import_function, (self.name, self.precision)

    @property
    def takes_limits(self) -> bool:
        """Whether it has parameters t_min and t_max."""
        try:
            return {"t_min", "t_max"} <= inspect.signature(self.call).parameters.keys()
        except (TypeError, ValueError):  # of a built-in function
            return False

    def answer(self, request: CastRequest) -> Answer:
        """Call it with the rays of all pixels that have one, as float64. Raises NoAnswer."""
        rays, traced = request.rays, request.traced
        there = rays.t_max >= 0.0
        named = {"t_min": np.broadcast_to(rays.t_min, there.shape), "t_max": rays.t_max} if self.takes_limits else {}
        o, d, *limits = (a[there].astype(np.float64) for a in (rays.o, rays.d, *named.values()))
        with _one_at_a_time, _isolated():
            try:
                returned = self.call(traced, o, d, **dict(zip(named, limits, strict=True)))
            except KeyboardInterrupt:
                raise
            except NotImplementedError as error:
                raise Unsupported(f"{self.name} raised {_exception_with_calls(error)}") from error
            except BaseException as error:
                hint = f"\n  {CALLED}" if isinstance(error, TypeError) else ""
                raise NoAnswer(f"{self.name} raised {_exception_with_calls(error)}{hint}") from error
            try:
                hits, packed = _hits(returned), request.model.packed
                return answer_of_numbered_hits(hits, rays, packed, self.precision, limits=self.takes_limits)
            except NoAnswer as error:
                raise NoAnswer(f"{self.name}: {error}") from error


@contextlib.contextmanager
def _isolated() -> Iterator[None]:
    """Run foreign code: its output goes to stderr; working folder and NumPy's error state are restored afterwards."""
    here = Path.cwd()
    with contextlib.redirect_stdout(sys.stderr), np.errstate():
        try:
            yield
        finally:
            os.chdir(here)


def _hits(returned: Any) -> dict[str, Any]:
    """Arrays by name, from (t, n) or (t, n, prim_id). Raises NoAnswer."""
    if not isinstance(returned, tuple | list) or len(returned) not in (2, 3):
        got = f"{len(returned)} of them" if isinstance(returned, tuple | list) else type(returned).__name__
        got = f"one array of shape {returned.shape}" if isinstance(returned, np.ndarray) else got
        raise NoAnswer(f"expected two arrays (t, n), got {got}; {CALLED}")
    t, n, *ids = returned
    return {"t": t, "n": n} | ({"prim_id": np.asarray(ids[0])} if ids and ids[0] is not None else {})


def _exception_with_calls(error: BaseException) -> str:
    """The exception with the last calls that led to it."""
    calls = [call for call in traceback.extract_tb(error.__traceback__) if not call.filename.startswith(HIDDEN_FRAMES)]
    where = "".join(
        f"\n  {call.filename}:{call.lineno}, in {call.name}: {call.line}" for call in calls[-MAX_TRACEBACK_FRAMES:]
    )
    return f"{type(error).__name__}: {exception_text(error)}{where}"

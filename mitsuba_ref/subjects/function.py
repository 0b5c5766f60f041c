"""A candidate that is a Python function: function(scene, o, d) -> (t, n)."""

import contextlib
import importlib
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

from caster.description.errors import SceneError
from mitsuba_ref.subjects.subject import (
    PRECISIONS,
    Answer,
    CastRequest,
    NoAnswer,
    Subject,
    Unsupported,
    checked_answer,
    exception_text,
    without_hits_beyond,
)

# package.module:function
FUNCTION_PATTERN = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")
HIDDEN_FRAMES = (str(Path(__file__).parent), "<frozen importlib")  # files of frames that are not the candidate's
MAX_TRACEBACK_FRAMES = 4

# Scenes are judged several at a time, but a candidate need not be thread-safe.
_one_at_a_time = threading.Lock()


def import_function(text: str, precision: str | None = None) -> "FunctionSubject":
    """Import a function; the current folder comes first, as for `python -m`. Raises SceneError."""
    module, _, path = text.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        with _isolated():
            found: Any = importlib.import_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # also SystemExit, which would end the program with its own exit code
        raise SceneError(f"--candidate {text}: cannot import {module}: {_exception_with_calls(error)}") from error
    for name in path.split("."):
        if not hasattr(found, name):
            raise SceneError(f"--candidate {text}: {module} has no '{path}'")
        found = getattr(found, name)
    if not callable(found):
        raise SceneError(f"--candidate {text}: expected a function, got {type(found).__name__}")
    return function_subject(found, text, precision)


def function_subject(call: Callable[..., Any], name: str = "", precision: str | None = None) -> "FunctionSubject":
    """A function as a candidate, with its attribute `precision` unless one is given. Raises SceneError."""
    name = name or getattr(call, "__name__", type(call).__name__)
    declared = precision or getattr(call, "precision", None)
    if declared is not None and not (isinstance(declared, str) and declared in PRECISIONS):
        raise SceneError(f"{name}.precision: expected {' or '.join(PRECISIONS)}, got {declared!r}")
    return FunctionSubject(name, call, declared)


@dataclass(frozen=True)
class FunctionSubject(Subject):
    """A candidate that is a Python function."""

    call: Callable[[Any, np.ndarray, np.ndarray], Any]
    precision: str | None = None  # None: that of the arrays it returns
    takes_rays: ClassVar[bool] = True

    def answer(self, request: CastRequest) -> Answer:
        """Call it with the rays of all pixels that have one, as float64; a hit beyond t_max counts as a miss.

        Raises NoAnswer.
        """
        rays = request.rays
        there = rays.t_max >= 0.0
        o, d = (a[there].astype(np.float64) for a in (rays.o, rays.d))
        with _one_at_a_time, _isolated():
            returned = self._called(request, o, d)
            try:
                found = checked_answer(*_pair(returned), there, precision=self.precision)
            except NoAnswer as error:
                raise NoAnswer(f"{self.name}: {error}") from error
        return without_hits_beyond(found, rays.t_max.astype(np.float64))

    def _called(self, request: CastRequest, o: np.ndarray, d: np.ndarray) -> Any:
        try:
            return self.call(request.traced, o, d)
        except KeyboardInterrupt:
            raise
        except NotImplementedError as error:
            raise Unsupported(f"{self.name} raised {_exception_with_calls(error)}") from error
        except BaseException as error:
            raise NoAnswer(f"{self.name} raised {_exception_with_calls(error)}") from error


@contextlib.contextmanager
def _isolated() -> Iterator[None]:
    """Run foreign code: its output goes to stderr; working folder and NumPy's error state are restored afterwards."""
    here = Path.cwd()
    with contextlib.redirect_stdout(sys.stderr), np.errstate():
        try:
            yield
        finally:
            os.chdir(here)


def _pair(returned: Any) -> tuple[Any, Any]:
    """(t, n). Raises NoAnswer."""
    if isinstance(returned, tuple | list):
        if len(returned) == 2:
            return returned[0], returned[1]
        got = f"{len(returned)} of them"
    else:
        got = f"one array of shape {returned.shape}" if isinstance(returned, np.ndarray) else type(returned).__name__
    raise NoAnswer(f"expected two arrays (t, n), got {got}")


def _exception_with_calls(error: BaseException) -> str:
    """The exception with the last calls that led to it."""
    calls = [call for call in traceback.extract_tb(error.__traceback__) if not call.filename.startswith(HIDDEN_FRAMES)]
    where = "".join(
        f"\n  {call.filename}:{call.lineno}, in {call.name}: {call.line}" for call in calls[-MAX_TRACEBACK_FRAMES:]
    )
    return f"{type(error).__name__}: {exception_text(error)}{where}"

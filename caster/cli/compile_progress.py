"""What users are told while kernels are compiled."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, TextIO

from caster.cli.progress_bar import StatusLine
from caster.jit.decorators import COMPILATION_LOG
from caster.jit.kernel_cache import cache_folder, refusals
from caster.scene.files import Scene

COMPILE_TIME_HINT = "once, some 5 to 30 s"


def type_names(scene: Scene) -> str:
    """sphere, mesh, pinhole"""
    things: list[Any] = [*scene.shapes, scene.camera]
    return ", ".join(dict.fromkeys(thing.type for thing in things))


@contextmanager
def announce_compilation(what: str) -> Iterator[None]:
    """One line on standard error before the first kernel for this is compiled; none if all of them are there."""

    def say(name: str) -> None:
        COMPILATION_LOG.compiling = _silent
        text = f"compiling the kernels for {what}: {COMPILE_TIME_HINT}; `caster doctor --warm` does it ahead"
        print(text, file=sys.stderr, flush=True)
        say_if_not_kept()

    COMPILATION_LOG.compiling = say
    try:
        yield
    finally:
        COMPILATION_LOG.compiling = _silent


@cache
def say_if_not_kept() -> None:
    """One line on standard error, once, where kernels are not kept as others could replace them."""
    cache_folder()
    hint = "remove it, or name a folder of your own as XDG_CACHE_HOME"
    for refusal in refusals:
        print(f"compiled kernels are not kept: {refusal}; {hint}", file=sys.stderr, flush=True)


def _silent(name: str) -> None:
    pass


class CompileProgress:
    """Which scene is begun, and how many kernels have been compiled: one line on a terminal, else a line a scene."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.line = StatusLine(stream)
        self.scene, self.count = "", 0

    def begin(self, scene: str) -> None:
        self.scene = scene
        if self.line.live:
            self.line.show(scene)
        else:
            self.line.write(f"kernels for {scene}\n")

    def compiling(self, kernel: str) -> None:
        self.count += 1
        self.line.show(f"{self.scene}: compiling {kernel} ({self.count})")

    def end(self) -> None:
        self.line.erase()

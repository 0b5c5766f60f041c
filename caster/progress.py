"""What users are told while kernels are compiled."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, TextIO

from caster.kernels.compiling.kernel_cache import cache_folder, refusals
from caster.kernels.jit import WORK
from caster.scene import Scene
from caster.terminal_line import Line

HOW_LONG = "once, some 5 to 30 s"


def kinds_in(scene: Scene) -> str:
    """sphere, mesh, pinhole"""
    things: list[Any] = [*scene.shapes, scene.camera]
    return ", ".join(dict.fromkeys(thing.type for thing in things))


@contextmanager
def announced(what: str) -> Iterator[None]:
    """One line on standard error before the first kernel for this is compiled; none if all of them are there."""

    def say(name: str) -> None:
        WORK.compiling = _silent
        text = f"compiling the kernels for {what}: {HOW_LONG}; `caster doctor --warm` does it ahead"
        print(text, file=sys.stderr, flush=True)
        say_if_not_kept()

    WORK.compiling = say
    try:
        yield
    finally:
        WORK.compiling = _silent


@cache
def say_if_not_kept() -> None:
    """One line on standard error, once, where kernels are not kept as others could replace them."""
    cache_folder()
    way_out = "remove it, or name a folder of your own as XDG_CACHE_HOME"
    for refusal in refusals:
        print(f"compiled kernels are not kept: {refusal}; {way_out}", file=sys.stderr, flush=True)


def _silent(name: str) -> None:
    pass


class Progress:
    """Which scene is begun, and how many kernels have been compiled: one line on a terminal, else a line a scene."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.line = Line(stream)
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

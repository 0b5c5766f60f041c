"""Replay commands: they show a scene or a pixel again, with the options of the run."""

import shlex
from collections.abc import Iterator
from dataclasses import replace as with_fields

from mitsuba_ref.judge.verdict import Failure, SceneVerdict


def with_replay(scene: SceneVerdict) -> SceneVerdict:
    """The verdict with the commands that show the scene and each of its failures again."""

    def shown(failure: Failure) -> Failure:
        return with_fields(failure, replay=replay(scene, (failure.x, failure.y)))

    return with_fields(
        scene,
        failures=tuple(map(shown, scene.failures)),
        worst_by={check: shown(failure) for check, failure in scene.worst_by.items()},
        replay=replay(scene),
    )


def replay(scene: SceneVerdict, pixel: tuple[int, int] | None = None) -> str:
    """The command that shows one pixel, or else the scene, again."""
    if pixel is None:
        return f"mitsuba-ref validate {shlex.quote(scene.path or 'SCENE')}{repeated_options(scene)}"
    before, after = replay_around(scene)
    return f"{before}{pixel[0]} {pixel[1]}{after}"


def replay_around(scene: SceneVerdict) -> tuple[str, str]:
    """The command that shows a pixel again: what comes before its column and row, and what comes after."""
    return f"mitsuba-ref probe {shlex.quote(scene.path or 'SCENE')} ", repeated_options(scene)


def repeated_options(scene: SceneVerdict) -> str:
    """Options that a command has to repeat to see the same."""
    size = ["--size", *map(str, scene.size)] if scene.resized else []
    return "".join(f" {shlex.quote(word)}" for word in (*size, *scene.options, *_named_candidate(scene)))


def _named_candidate(scene: SceneVerdict) -> Iterator[str]:
    """A candidate given in Python, not on the command line; of a function, only the name is known."""
    if not scene.candidate or "--candidate" in scene.options:
        return
    as_typed = ":" in scene.candidate or "{" in scene.candidate
    yield from ("--candidate", scene.candidate if as_typed else f"MODULE:{scene.candidate}")
    if scene.precision:
        yield from ("--candidate-precision", scene.precision)

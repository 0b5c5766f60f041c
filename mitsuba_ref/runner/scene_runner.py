"""Validation of many scenes, several at a time; verdicts that are done survive an interruption."""

import os
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from caster.cli.progress import ProgressBar
from caster.cli.scene_arguments import error_prefix
from caster.description.errors import SceneError
from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref.judge.aggregate import scene_statistics
from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.report.reproducers import with_replay
from mitsuba_ref.runner.validation import validate_scene

Result = TypeVar("Result")


@dataclass(frozen=True)
class SceneEntry:
    """A scene to validate."""

    scene: Scene
    name: str
    path: str
    resized: bool = False  # by --size, which a replay has to repeat
    options: tuple[str, ...] = ()  # others that a replay has to repeat


JudgeScene = Callable[[SceneEntry, Path | None], SceneVerdict]
"""Judges one scene; the folder, if any, receives the images of subject and reference."""


def load_entry(
    path: str,
    name: str,
    *,
    size: Sequence[int] | None = None,
    mesh_dirs: Sequence[str] = (),
    options: tuple[str, ...] = (),
) -> SceneEntry:
    """Read a scene file. size: width and height of the film instead of the scene's own; options: of its replay.

    Raises SceneError, FileMissing.
    """
    scene = load_scene(path, mesh_dirs)
    if size:
        with error_prefix("--size", *size):
            scene = scene.with_film(width=size[0], height=size[1])
    mesh_options = tuple(word for folder in mesh_dirs for word in ("--mesh-dir", folder))
    return SceneEntry(scene, name, path, resized=bool(size), options=(*mesh_options, *options))


def default_workers() -> int:
    """Half the work of a scene is another process's, so one worker for each core."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def map_in_order(
    work: Callable[[SceneEntry], Result], entries: Sequence[SceneEntry], workers: int | None = None
) -> Generator[Result, None, None]:
    """work(entry) for each, several at a time, in order; after an interruption no further one is started."""
    stop = threading.Event()

    def unless_stopped(entry: SceneEntry) -> Result | None:
        return None if stop.is_set() else work(entry)

    pool = ThreadPoolExecutor(workers or default_workers())
    try:
        for future in [pool.submit(unless_stopped, entry) for entry in entries]:
            result = future.result()
            assert result is not None  # only after a stop, and then no result is read
            yield result
    finally:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)
        subprocess_runner.kill_subprocesses()
        pool.shutdown(wait=True)
        subprocess_runner.allow_subprocesses()


def run(
    entries: Sequence[SceneEntry],
    workers: int,
    maxfail: int | None = None,
    folder: Path | None = None,
    judge: JudgeScene | None = None,
    record: Callable[[SceneVerdict], SceneVerdict] | None = None,
) -> Generator[SceneVerdict, None, None]:
    """Verdicts in the order of the entries; at most maxfail that fail. folder: for images of subject and reference.

    record: called by the worker with verdict and evidence; returns it without the evidence, to keep memory small.
    """
    judge = judge or partial(judge_entry, keep=record is not None)

    def work(entry: SceneEntry) -> SceneVerdict:
        verdict = judge(entry, folder)
        return record(verdict) if record else verdict

    failed = 0
    with closing(map_in_order(work, entries, workers)) as verdicts:
        for verdict in verdicts:
            yield verdict
            failed += not verdict.ok
            if maxfail is not None and failed >= maxfail:
                return


def judge_entry(
    entry: SceneEntry,
    folder: Path | None,
    *,
    validate: Callable[..., SceneVerdict] = validate_scene,
    keep: bool = False,
) -> SceneVerdict:
    """The verdict of one scene; one that cannot be judged has its `problem` set.

    validate: a function with the parameters of validate_scene; keep: with the evidence of the verdict.
    """
    try:
        verdict = validate(entry.scene, entry.name, entry.path, folder=folder, keep=keep)
    except SceneError as error:  # no reference for a shape, or numbers beyond float32
        verdict = SceneVerdict(entry.name, entry.path, problem=f"cannot be judged: {error}")
    found = replace(
        verdict, resized=entry.resized, options=entry.options, composition=scene_statistics(entry.scene)
    )
    return with_replay(found)


def progress_bar(entries: Sequence[SceneEntry]) -> ProgressBar:
    """A bar over all rays: scenes differ too much in size to count scenes."""
    return ProgressBar("validating", sum(map(ray_count, entries)), "rays")


def count_scene(bar: ProgressBar, entries: Sequence[SceneEntry], done: int) -> None:
    """Advance the bar by scene number `done`, counted from 1."""
    bar.add(ray_count(entries[done - 1]), f"{done} of {len(entries)} scenes")


def ray_count(entry: SceneEntry) -> int:
    """Rays of the film window."""
    x0, y0, x1, y1 = entry.scene.film.window
    return (x1 - x0) * (y1 - y0)

"""Many scenes, several at a time; what is done is kept when somebody stops it."""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from caster.description.errors import SceneError
from caster.scene.model import Scene
from mitsuba_ref.judge.aggregate import scene_statistics
from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.report.replay import with_replay
from mitsuba_ref.runner.validation import validate_scene


@dataclass(frozen=True)
class SceneEntry:
    """A scene that is about to be validated."""

    scene: Scene
    name: str
    path: str
    resized: bool = False  # by --size, which a replay has to repeat
    options: tuple[str, ...] = ()  # others that a replay has to repeat


JudgeScene = Callable[[SceneEntry, Path | None], SceneVerdict]
"""How to come to the verdict of a scene; the folder is where pictures of both sides go, if anywhere."""


def default_workers() -> int:
    """Half the work of a scene is another process's, so one worker for each core."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run(
    entries: Sequence[SceneEntry],
    workers: int,
    maxfail: int | None = None,
    folder: Path | None = None,
    judge: JudgeScene | None = None,
    record: Callable[[SceneVerdict], SceneVerdict] | None = None,
) -> Iterator[SceneVerdict]:
    """Verdicts in the order of the entries; at most maxfail that fail. folder: where pictures of both sides go.

    record: called by the worker with what the verdict rests on; gives it back without, so that memory stays small.
    """
    judge = judge or partial(judge_entry, keep=record is not None)
    stop = threading.Event()

    def work(entry: SceneEntry) -> SceneVerdict | None:
        if stop.is_set():
            return None
        verdict = judge(entry, folder)
        return record(verdict) if record else verdict

    pool = ThreadPoolExecutor(max(1, workers))
    failed = 0
    try:
        futures: list[Future[SceneVerdict | None]] = [pool.submit(work, entry) for entry in entries]
        for future in futures:
            verdict = future.result()
            assert verdict is not None  # only after a stop, and then nobody asks
            yield verdict
            failed += not verdict.ok
            if maxfail is not None and failed >= maxfail:
                return
    finally:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)
        subprocess_runner.kill_subprocesses()
        pool.shutdown(wait=True)
        subprocess_runner.allow_subprocesses()


def judge_entry(
    entry: SceneEntry,
    folder: Path | None,
    *,
    validate: Callable[..., SceneVerdict] = validate_scene,
    keep: bool = False,
) -> SceneVerdict:
    """The verdict of one scene; one that cannot be judged has a problem.

    validate: as validate_scene is called; keep: with what the verdict rests on.
    """
    try:
        verdict = validate(entry.scene, entry.name, entry.path, folder=folder, keep=keep)
    except SceneError as error:  # no reference for a shape, or numbers beyond float32
        verdict = SceneVerdict(entry.name, entry.path, problem=f"cannot be judged: {error}")
    found = replace(
        verdict, resized=entry.resized, options=entry.options, made_of=scene_statistics(entry.scene)
    )
    return with_replay(found)

"""Validation of many scenes, several at a time; verdicts that are done survive an interruption."""

import re
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from caster.cameras import CAMERAS
from caster.description.errors import SceneError, error_prefix, suggestion
from caster.description.registry import type_name
from caster.rendering.threads import core_count, set_default_threads
from caster.scene.files import film_pixels, load_scene
from caster.scene.model import Scene
from caster.shapes import SHAPES
from caster.system import process
from caster.system.atomic_files import OutputError
from caster.system.terminal import ProgressBar
from mitsuba_ref.judge.aggregate import scene_statistics
from mitsuba_ref.judge.scene_checks import wrongly_resized
from mitsuba_ref.judge.verdict import SceneCheck, SceneVerdict
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, send_request
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.report.reproducers import with_replay
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.runner.isolation import Isolated, WorkerEnded
from mitsuba_ref.subjects.subject import Subject

Result = TypeVar("Result")

INTERRUPTED_SECONDS = 1.5  # for scenes that are being judged to end after an interruption


@dataclass(frozen=True)
class SceneEntry:
    """A loaded scene to validate."""

    scene: Scene
    name: str
    path: str
    resized: bool = False  # by --size, which a replay has to repeat
    wrong_film: str = ""  # what is wrong with the film that --size has made of the scene's own; "": nothing
    options: tuple[str, ...] = ()  # others that a replay has to repeat
    subject: Subject | None = None  # of this entry alone: answers that were given beforehand
    rays: SharedRays | None = None  # of a list, which the film is filled with
    ray_range: tuple[int, int] = (0, 0)  # first and end of them in their list
    command: str = "validate"  # that judges it

    @property
    def pixels(self) -> int:
        """Rays of the film window."""
        x0, y0, x1, y1 = self.scene.film.window
        return (x1 - x0) * (y1 - y0)

    @property
    def cost(self) -> int:
        """Work to be expected, about, in pixels."""
        return self.pixels

    def load(self) -> "SceneEntry":
        """Itself."""
        return self


@dataclass(frozen=True)
class SceneSource:
    """A scene file to validate, loaded when its turn comes, by the process that judges it, and released after it."""

    name: str
    path: str
    pixels: int  # of the film window, for progress and shards
    size: tuple[int, int] | None = None  # of the film instead of the scene's own
    mesh_dirs: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    size_bytes: int = 0  # of the file

    @property
    def cost(self) -> int:
        """Work to be expected, about, in pixels: what is checked of a shape takes as long for each of its bytes."""
        return self.pixels + self.size_bytes

    def load(self) -> SceneEntry:
        """Read the file. Raises SceneError, FileMissing."""
        return load_entry(self.path, self.name, size=self.size, mesh_dirs=self.mesh_dirs, options=self.options)


Entry = SceneEntry | SceneSource

JudgeScene = Callable[..., SceneVerdict]
"""judge(entry, folder, **options): one scene; the folder, if any, receives the images of subject and reference.

options: those of `judge_here` from `inputs_of` on."""


def source_of(
    path: str,
    name: str,
    *,
    size: Sequence[int] | None = None,
    mesh_dirs: Sequence[str] = (),
    options: tuple[str, ...] = (),
) -> SceneSource:
    """A scene file of which only the film is read yet; parameters as of `load_entry`."""
    film = (size[0], size[1]) if size else None
    try:
        size_bytes = Path(path).stat().st_size
    except OSError:  # whoever loads it says so
        size_bytes = 0
    return SceneSource(name, path, film_pixels(path, film), film, tuple(mesh_dirs), options, size_bytes)


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
    wrong: list[str] = []
    if size:
        with error_prefix("--size", *size):
            resized = scene.with_film(width=size[0], height=size[1])
        wrong, scene = wrongly_resized(scene, [(size[0], size[1])]), resized
    mesh_options = tuple(word for folder in mesh_dirs for word in ("--mesh-dir", folder))
    again = (*mesh_options, *options)
    return SceneEntry(scene, name, path, resized=bool(size), wrong_film="; ".join(wrong), options=again)


def default_workers() -> int:
    """One for each core."""
    return core_count()


def threads_per_worker(workers: int, scenes: int) -> int:
    """So many that each core has one: more would wait for each other, a twentieth of the time."""
    return max(1, core_count() // max(1, min(workers, scenes)))


# Of the last scenes, so many for each worker are begun in the order of their costs: a long one at the very end would
# leave the other workers idle. Rows before them are not held up.
REORDERED_PER_WORKER = 4


def start_order(costs: Sequence[int], workers: int) -> list[int]:
    """The order in which entries are begun."""
    every = list(range(len(costs)))
    tail = max(0, len(every) - REORDERED_PER_WORKER * workers)
    return every[:tail] + sorted(every[tail:], key=lambda place: -costs[place])


def map_in_order(
    work: Callable[[Entry], Result], entries: Sequence[Entry], workers: int | None = None
) -> Generator[Result, None, None]:
    """work(entry) for each, several at a time; results in order. After an interruption no further one is started."""
    stop = threading.Event()

    def unless_stopped(entry: Entry) -> Result | None:
        return None if stop.is_set() else work(entry)

    workers = workers or default_workers()
    pool = ThreadPoolExecutor(workers)
    begun = {
        place: pool.submit(unless_stopped, entries[place])
        for place in start_order([each.cost for each in entries], workers)
    }
    futures = [begun[place] for place in range(len(entries))]
    del begun
    try:
        for place, future in enumerate(futures):
            result = future.result()
            assert result is not None  # only after a stop, and then no result is read
            futures[place] = Future()  # whoever has the result may release it
            yield result
    finally:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)
        subprocess_runner.kill_subprocesses()
        ISOLATED.stop()
        if process.interrupted.is_set():  # work in compiled code ends with the process
            wait([each for each in futures if each.running()], timeout=INTERRUPTED_SECONDS)
        else:
            pool.shutdown(wait=True)
        subprocess_runner.allow_subprocesses()


def run(
    entries: Sequence[Entry],
    workers: int,
    maxfail: int | None = None,
    folder: Path | None = None,
    judge: JudgeScene | None = None,
    record: Callable[[SceneVerdict], SceneVerdict] | None = None,
    on_error: Callable[[Exception], None] = lambda error: None,
) -> Generator[SceneVerdict, None, None]:
    """Verdicts in the order of the entries; at most maxfail that fail. folder: for images of subject and reference.

    record: called by the worker with the verdict and its page; returns it without, to keep memory small.
    A scene that cannot be loaded, judged or written has a verdict with that problem; on_error gets the exception.
    """
    judge = judge or judge_entry

    def work(entry: Entry) -> SceneVerdict:
        try:
            verdict = judge(entry, folder)
            return record(verdict) if record else verdict
        except Exception as error:
            on_error(error)
            return with_replay(SceneVerdict(entry.name, entry.path, entry.pixels, problem=problem_of(error)))

    failed = 0
    with ISOLATED.kept(), closing(map_in_order(work, entries, workers)) as verdicts:
        for verdict in verdicts:
            yield verdict
            failed += not (verdict.ok or verdict.waived)
            if maxfail is not None and failed >= maxfail:
                return


def problem_of(error: Exception) -> str:
    """Why a scene has no verdict."""
    if isinstance(error, OutputError):
        return f"cannot be written: {error}"
    if isinstance(error, SceneError):
        return f"cannot be judged: {error}"
    if isinstance(error, MemoryError):
        return f"cannot be judged: not enough memory{f': {error}' if str(error) else ''}"
    if isinstance(error, OSError):
        return f"cannot be judged: {error.filename or 'a file'}: {error.strerror or error}"
    return f"internal error, please report it: {type(error).__name__}: {error}"


def judge_here(
    entry: Entry,
    folder: Path | None,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    store: bool = True,
    thorough: bool = False,
    subject: Subject | None = None,
    inputs_of: Callable[[SceneEntry], str] | None = None,
    known: str = "",
    page_of: Callable[[SceneVerdict], Any] | None = None,
) -> SceneVerdict:
    """Load and judge one scene in this process. Raises what loading and judging raise.

    timeout: seconds for Mitsuba; store: take its answer to the very same request in an earlier run; thorough: make
    every check of our caster; subject: in place of our caster, where the entry has none of its own; inputs_of: a hash
    of all that the verdict depends on, recorded as its `inputs`; known: such a hash for which nothing is judged, and
    the verdict says nothing else; page_of: what of the verdict and its evidence the report needs, which takes the place
    of the evidence.
    """
    loaded = entry.load()
    inputs = inputs_of(loaded) if inputs_of else ""
    if inputs and inputs == known:
        return SceneVerdict(entry.name, entry.path, entry.pixels, inputs=inputs)
    given: dict[str, Any] = {"timeout": timeout, "keep": page_of is not None, "thorough": thorough}
    if not store:
        given["send"] = send_request
    if loaded.rays is not None:
        given |= {"rays": loaded.rays, "first_ray": loaded.ray_range[0]}
    if loaded.subject or subject:
        given["subject"] = loaded.subject or subject
    try:
        verdict = validate_scene(loaded.scene, loaded.name, loaded.path, folder=folder, **given)
    except OutputError:
        raise
    except SceneError as error:  # no reference for a shape, or numbers beyond float32
        verdict = SceneVerdict(entry.name, entry.path, entry.pixels, problem=problem_of(error), thorough=thorough)
    if loaded.wrong_film:
        others = (check for check in verdict.checks if check.name != "camera")
        verdict = replace(verdict, checks=(SceneCheck("camera", float("inf"), loaded.wrong_film), *others))
    about: dict[str, Any] = {"resized": loaded.resized, "options": loaded.options, "command": loaded.command}
    composition = scene_statistics(loaded.scene)
    found = replace(verdict, **about, rays=loaded.ray_range, composition=composition, inputs=inputs)
    return with_replay(replace(found, seen=page_of(found) if page_of and found.seen else None))


def judge_in_fork(entry: Entry, folder: Path | None, threads: int | None, **options: Any) -> SceneVerdict:
    """`judge_here` in a process that does nothing else, on so many threads where it requests no number."""
    set_default_threads(threads)
    return judge_here(entry, folder, **options)


# Our kernels are machine code, which may end the process that it runs in.
ISOLATED = Isolated(judge_in_fork)


def judge_entry(entry: Entry, folder: Path | None, *, threads: int | None = None, **options: Any) -> SceneVerdict:
    """`judge_here` in a fork, whose end is a `problem` of the verdict; in this process for other subjects than ours.

    threads: of the fork.
    """
    if options.get("subject") or (isinstance(entry, SceneEntry) and entry.subject):
        return judge_here(entry, folder, **options)
    try:
        with ISOLATED.kept():
            return ISOLATED(entry, folder, threads, **options)
    except WorkerEnded as ended:
        problem = f"the process that casts and judges ended: {ended}"
        thorough = bool(options.get("thorough"))
        return with_replay(SceneVerdict(entry.name, entry.path, entry.pixels, problem=problem, thorough=thorough))


def progress_bar(entries: Sequence[Entry]) -> ProgressBar:
    """A bar over all rays: scenes differ too much in size to count scenes."""
    return ProgressBar("validating", sum(entry.pixels for entry in entries), "rays")


def count_scene(bar: ProgressBar, entries: Sequence[Entry], done: int) -> None:
    """Advance the bar by scene number `done`, counted from 1."""
    bar.add(entries[done - 1].pixels, f"{done} of {len(entries)} scenes")


# ---- selection by an expression over the names of scenes ----

TOKENS = re.compile(r"\s*([()]|[^\s()]+)")
TYPE_PREFIX = "type:"  # of a word about the shapes and the camera of a scene, not about its name

MAX_DEPTH = 50  # nested parentheses
MAX_SHOWN = 200  # characters of an expression in its error

Predicate = Callable[[str], bool]


def matching(expression: str | None, types_of: Callable[[str], frozenset[str]] | None = None) -> Predicate:
    """A predicate on names by an expression of parts of names, `and`, `or`, `not` and parentheses.

    types_of: of scene files; then the predicate takes their paths, the stem is the name, and `type:mesh` is true of
    a scene with such a shape or camera. Raises SceneError for a malformed expression.
    """
    if expression is None:
        return lambda name: True
    return _Reader(expression, types_of).read()


def known_types() -> tuple[str, ...]:
    """What `type:` may be followed by."""
    kinds = [type_name(each) for registry in (SHAPES, CAMERAS) for each in registry]
    return (*kinds, "triangles")


class _Reader:
    """Recursive descent: or of ands of nots of words."""

    def __init__(self, expression: str, types_of: Callable[[str], frozenset[str]] | None = None):
        self.expression, self.types_of = expression, types_of
        self.tokens: Sequence[str] = TOKENS.findall(expression)
        self.place, self.depth = 0, 0

    def read(self) -> Predicate:
        predicate = self._any()
        if self.place < len(self.tokens):
            raise self._error(f"'{self.tokens[self.place]}' is one too many")
        return predicate

    def _any(self) -> Predicate:
        choices = [self._all()]
        while self._take("or"):
            choices.append(self._all())
        return lambda name: any(choice(name) for choice in choices)

    def _all(self) -> Predicate:
        parts = [self._one()]
        while self._take("and"):
            parts.append(self._one())
        return lambda name: all(part(name) for part in parts)

    def _one(self) -> Predicate:
        negated = False
        while self._take("not"):
            negated = not negated
        inner = self._atom()
        return (lambda name: not inner(name)) if negated else inner

    def _atom(self) -> Predicate:
        if self._take("("):
            self.depth += 1
            if self.depth > MAX_DEPTH:
                raise self._error(f"more than {MAX_DEPTH} parentheses are nested")
            inner = self._any()
            self.depth -= 1
            if not self._take(")"):
                raise self._error("a ')' is missing")
            return inner
        if self.place >= len(self.tokens) or self.tokens[self.place] in ("and", "or", ")"):
            raise self._error("a part of a name is missing")
        word = self.tokens[self.place]
        self.place += 1
        types_of = self.types_of
        if types_of is None:
            return lambda name: word in name
        if not word.startswith(TYPE_PREFIX):
            return lambda path: word in Path(path).stem
        wanted, known = word.removeprefix(TYPE_PREFIX), known_types()
        if wanted not in known:
            raise SceneError(f"-k {word}: unknown type{suggestion(wanted, known)} (known: {', '.join(known)})")
        return lambda path: wanted in types_of(path)

    def _take(self, token: str) -> bool:
        taken = self.place < len(self.tokens) and self.tokens[self.place] == token
        self.place += taken
        return taken

    def _error(self, what: str) -> SceneError:
        return SceneError(
            f"-k {self.expression[:MAX_SHOWN]!r}: expected parts of names with and, or, not and parentheses; {what}"
        )

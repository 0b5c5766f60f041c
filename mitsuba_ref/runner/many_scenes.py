"""Validation of many scenes, several at a time; verdicts that are done survive an interruption."""

import ast
import json
import re
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

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
from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, send_request
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.reference.store import Store, local_store
from mitsuba_ref.report.out_folder import file_records, files_of
from mitsuba_ref.report.reproducers import with_replay
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.runner.verdict_files import scene_of, verdict_key
from mitsuba_ref.runner.workers import CALL_TIMEOUTS, WorkerEnded, Workers
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
        scene = load_scene(self.path, self.mesh_dirs)
        if self.size:
            width, height = self.size
            with error_prefix("--size", width, height):
                scene = scene.with_film(width=width, height=height)
        again = (*(word for folder in self.mesh_dirs for word in ("--mesh-dir", folder)), *self.options)
        return SceneEntry(scene, self.name, self.path, resized=bool(self.size), options=again)


Entry = SceneEntry | SceneSource


def source_of(
    path: str,
    name: str,
    *,
    size: Sequence[int] | None = None,
    mesh_dirs: Sequence[str] = (),
    options: tuple[str, ...] = (),
) -> SceneSource:
    """A scene file of which only the film is read yet.

    size: width and height of the film instead of the scene's own; options: of its replay.
    """
    film = (size[0], size[1]) if size else None
    try:
        size_bytes = Path(path).stat().st_size
    except OSError:  # whoever loads it says so
        size_bytes = 0
    return SceneSource(name, path, film_pixels(path, film), film, tuple(mesh_dirs), options, size_bytes)


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
    work: Callable[[Entry], Result],
    entries: Sequence[Entry],
    workers: int | None = None,
    end_work: Callable[[], None] = lambda: None,
) -> Generator[Result, None, None]:
    """work(entry) for each, several at a time; results in order. After an interruption no further one is started.

    end_work: called then, to end what is being worked on.
    """
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
        end_work()
        if process.interrupted.is_set():  # work in compiled code ends with the process
            wait([each for each in futures if each.running()], timeout=INTERRUPTED_SECONDS)
        else:
            pool.shutdown(wait=True)
        subprocess_runner.allow_subprocesses()


def run(
    entries: Sequence[Entry],
    options: "JudgeOptions",
    workers: int,
    maxfail: int | None = None,
    record: Callable[[SceneVerdict], SceneVerdict] = lambda verdict: verdict,
    on_error: Callable[[Exception], None] = lambda error: None,
) -> Generator[SceneVerdict, None, None]:
    """Verdicts in the order of the entries; at most maxfail that fail.

    record: called by the thread that has the verdict and its page; returns it without, to keep memory small. A scene
    that cannot be loaded, judged or written has a verdict with that problem; on_error gets the exception.
    """
    pool = Workers(CALL_TIMEOUTS * max(options.timeout, DEFAULT_TIMEOUT))

    def work(entry: Entry) -> SceneVerdict:
        try:
            if options.subject or (isinstance(entry, SceneEntry) and entry.subject):
                return record(judge_entry(entry, options))
            return record(pool.call(judge_entry, entry, options))  # machine code may end the process that it runs in
        except WorkerEnded as ended:
            problem = f"the process that casts and judges ended: {ended}"
        except Exception as error:
            on_error(error)
            problem = problem_of(error)
        failed = SceneVerdict(entry.name, entry.path, entry.pixels, problem=problem)
        return with_replay(failed)

    failed = 0
    with pool, closing(map_in_order(work, entries, workers, pool.stop)) as verdicts:
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


class JudgeOptions(NamedTuple):
    """How scenes are judged."""

    folder: Path | None = None  # of the images of both sides
    timeout: float = DEFAULT_TIMEOUT  # seconds for Mitsuba
    store: bool = True  # take verdicts and Mitsuba's responses that earlier runs stored for the very same inputs
    subject: Subject | None = None  # in place of our caster, where an entry has none of its own
    page_of: Callable[[SceneVerdict], Any] | None = None  # what the report needs of a verdict and its evidence
    threads: int | None = None  # that a worker casts on


def judge_entry(entry: Entry, options: JudgeOptions) -> SceneVerdict:
    """Load and judge one scene in this process, or find its verdict. Raises what loading and judging raise."""
    set_default_threads(options.threads)
    loaded = entry.load()
    subject, folder = loaded.subject or options.subject, options.folder
    store = local_store() if options.store and options.page_of is None and subject is None else None
    key = ""
    if store:
        about = {"resized": loaded.resized, "options": loaded.options, "out": bool(folder)}
        key = verdict_key(loaded.scene, loaded.path, **about)
        if key and (found := _stored_verdict(store, key, folder)):
            return found
    verdict = _judge_loaded(loaded, options, subject)
    if folder:
        verdict = replace(verdict, files=file_records(folder, verdict))
    if store and key and not verdict.problem:
        store.put(key, json.dumps(verdict.to_dict(), allow_nan=False).encode())
    return verdict


def _stored_verdict(store: Store, key: str, folder: Path | None) -> SceneVerdict | None:
    """The verdict of the very same inputs, marked as kept, if its files in the folder are what was written."""
    content = store.get(key)
    try:
        found = scene_of(content) if content else None
    except ValueError:
        return None
    if found is None or (
        folder and (set(files_of(found)) != set(found.files) or file_records(folder, found) != found.files)
    ):
        return None
    return replace(found, kept=True)


def _judge_loaded(loaded: SceneEntry, options: JudgeOptions, subject: Subject | None) -> SceneVerdict:
    given: dict[str, Any] = {"timeout": options.timeout, "keep": options.page_of is not None}
    if not options.store:
        given["send"] = send_request
    if loaded.rays is not None:
        given |= {"rays": loaded.rays, "first_ray": loaded.ray_range[0]}
    if subject:
        given["subject"] = subject
    try:
        verdict = validate_scene(loaded.scene, loaded.name, loaded.path, folder=options.folder, **given)
    except OutputError:
        raise
    except SceneError as error:  # no reference for a shape, or numbers beyond float32
        problem = problem_of(error)
        verdict = SceneVerdict(loaded.name, loaded.path, loaded.pixels, problem=problem)
    found = replace(
        verdict,
        candidate=verdict.candidate or (subject.name if subject else ""),
        resized=loaded.resized,
        options=loaded.options,
        command=loaded.command,
        rays=loaded.ray_range,
        composition=scene_statistics(loaded.scene),
    )
    return with_replay(replace(found, seen=options.page_of(found) if options.page_of and found.seen else None))


def progress_bar(entries: Sequence[Entry]) -> ProgressBar:
    """A bar over all rays: scenes differ too much in size to count scenes."""
    return ProgressBar("validating", sum(entry.pixels for entry in entries), "rays")


def count_scene(bar: ProgressBar, entries: Sequence[Entry], done: int) -> None:
    """Advance the bar by scene number `done`, counted from 1."""
    bar.add(entries[done - 1].pixels, f"{done} of {len(entries)} scenes")


# ---- selection by an expression over the names of scenes ----

TOKENS = re.compile(r"[()]|[^\s()]+")
TYPE_PREFIX = "type:"  # of a word about the shapes and the camera of a scene, not about its name
MAX_SHOWN = 200  # characters of an expression in its error
OPERATORS = ("and", "or", "not", "(", ")")
EXPRESSIONS = (
    *(ast.Expression, ast.BoolOp, ast.boolop, ast.UnaryOp, ast.Not),
    *(ast.Call, ast.Name, ast.Load, ast.Constant),
)

Predicate = Callable[[str], bool]


def matching(expression: str | None, types_of: Callable[[str], frozenset[str]] | None = None) -> Predicate:
    """A predicate on names by an expression of parts of names, `and`, `or`, `not` and parentheses.

    types_of: of scene files; then the predicate takes their paths, the stem is the name, and `type:mesh` is true of
    a scene with such a shape or camera. Raises SceneError for a malformed expression.
    """
    if expression is None:
        return lambda name: True
    tokens = TOKENS.findall(expression)
    known = (*(type_name(each) for registry in (SHAPES, CAMERAS) for each in registry), "triangles")
    for wanted in (token.removeprefix(TYPE_PREFIX) for token in tokens if types_of and token.startswith(TYPE_PREFIX)):
        if wanted not in known:
            word = f"{TYPE_PREFIX}{wanted}"
            raise SceneError(f"-k {word}: unknown type{suggestion(wanted, known)} (known: {', '.join(known)})")
    # Every word becomes a call with a quoted argument, so that nothing but `has` and operators is run.
    source = " ".join(token if token in OPERATORS else f"has({token!r})" for token in tokens)
    try:
        tree = ast.parse(source, "-k", "eval")
        if not all(isinstance(node, EXPRESSIONS) for node in ast.walk(tree)) or ") (" in source:
            raise SyntaxError
        code = compile(tree, "-k", "eval")
    except (SyntaxError, MemoryError, RecursionError, ValueError):
        raise SceneError(
            f"-k {expression[:MAX_SHOWN]!r}: expected parts of names with and, or, not and parentheses"
        ) from None

    def fits(name: str) -> bool:
        def has(word: str) -> bool:
            if types_of and word.startswith(TYPE_PREFIX):
                return word.removeprefix(TYPE_PREFIX) in types_of(name)
            return word in (Path(name).stem if types_of else name)

        return bool(eval(code, {"__builtins__": {}, "has": has}))

    return fits

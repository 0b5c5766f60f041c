"""Verdicts of one run of pytest: each scene is judged once, whichever of xdist's workers runs its tests."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from caster.description.errors import SceneError

if TYPE_CHECKING:
    from mitsuba_ref.judge.verdict import SceneVerdict


class VerdictStore:
    """folder: of this run alone, that other processes share; None where there are none."""

    def __init__(self, judge: Callable[[Path, str], SceneVerdict], folder: Path | None) -> None:
        self.judge, self.folder = judge, folder
        self.known: dict[Path, SceneVerdict | str] = {}

    def verdict_of(self, path: Path) -> SceneVerdict | str:
        """The verdict, or what is wrong with the scene file."""
        if path not in self.known:
            self.known[path] = self._judged(path) if self.folder is None else self._shared(path, self.folder)
        return self.known[path]

    def _judged(self, path: Path) -> SceneVerdict | str:
        try:
            return self.judge(path, path.stem)
        except SceneError as error:
            return str(error)

    def _shared(self, path: Path, folder: Path) -> SceneVerdict | str:
        """From the file that another process wrote, or judged and written while others wait."""
        from caster.image.atomic_files import write_text
        from mitsuba_ref.runner.verdict_file import scene_of

        place = folder / hashlib.sha256(str(path).encode(errors="surrogateescape")).hexdigest()
        with exclusive_lock(place.with_suffix(".lock")):
            if place.exists():
                record = json.loads(place.read_text(encoding="utf-8"))
                return record if isinstance(record, str) else scene_of(record)
            found = self._judged(path)
            write_text(place, json.dumps(found if isinstance(found, str) else found.to_dict()))
            return found


@contextlib.contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """Held by one process at a time; where the system has no such locks, everybody goes on and may judge twice."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


# The tests of `pytest --mitsuba-ref`, collected without Mitsuba or Numba; the first of a scene has it judged.


if TYPE_CHECKING:
    from mitsuba_ref.judge.verdict import SceneVerdict

# The checks of a pixel, then those of a scene, by the names that a verdict has. Named here as well, since loading the
# judge loads the kernels (tests/reference/test_pytest_plugin.py compares).
PIXEL_CHECKS = (
    "mask",
    "shape_id",
    "on_surface",
    "depth",
    "position",
    "normal",
    "shading_normal",
    "diffuse",
    "exact",
)
SCENE_CHECKS = ("placement", "geometry", "materials", "camera", "render", "culling", "sensor", "bias")
VERDICT = "verdict"  # the scene as a whole: it loads, Mitsuba answers, and there is evidence
SUFFIXES = (".toml", ".json")
SCENE_MARKERS = (
    "[camera]",
    "[[shape]]",
    '"camera"',
    '"shape"',
)  # a file of a folder that has none of them is no scene

MARKERS = (
    "xdist_group(name): of pytest-xdist, for --dist loadgroup",
    "mitsuba_ref: a check of a scene, by --mitsuba-ref",
)

WORKER_INPUT_KEY = "mitsuba_ref_store"  # key of what xdist's controller tells its workers


class CheckFailed(Exception):  # noqa: N818 - what pytest shows is its text alone
    """A check of a scene failed; str() is what the terminal shows."""


class ScenePlugin:
    """What pytest asks of this plug-in."""

    def __init__(self, config: pytest.Config) -> None:
        for line in MARKERS:
            config.addinivalue_line("markers", line)
        self.start = config.invocation_params.dir
        self.size = size_of(config)
        self.mesh_dirs = [str(path) for path in config.getini("mitsuba_ref_mesh_dirs")]
        given = getattr(config, "workerinput", {}).get(WORKER_INPUT_KEY)
        self.shared: Path | None = Path(given) if given else None
        self.store = VerdictStore(self._judge, self.shared)
        self.owned: Path | None = None
        self.named = {Path(self.start, arg.split("::")[0]).resolve() for arg in config.args}

    def pytest_collect_file(self, file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
        if file_path.suffix.lower() not in SUFFIXES:
            return None
        if file_path.resolve() in self.named or is_scene(file_path):
            collector: pytest.Collector = SceneFile.from_parent(parent, path=file_path)
            return collector
        return None

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Any) -> None:
        """Of xdist: a folder that its workers share, so that each scene is judged once, whoever has its tests."""
        if self.owned is None:
            self.owned = Path(tempfile.mkdtemp(prefix="mitsuba-ref-pytest-"))
        node.workerinput[WORKER_INPUT_KEY] = str(self.owned)

    def pytest_sessionfinish(self) -> None:
        if self.owned is not None:
            shutil.rmtree(self.owned, ignore_errors=True)

    def pytest_report_header(self) -> str:
        film = f"films of {self.size[0]} x {self.size[1]}" if self.size else "the scenes' own films"
        return f"mitsuba-ref: {film}"

    def _judge(self, path: Path, name: str) -> SceneVerdict:
        """Raises SceneError for a scene that cannot be used."""
        from caster.scene.files import load_scene
        from mitsuba_ref.runner.scene_runner import SceneEntry, run

        named = str(path.relative_to(self.start)) if path.is_relative_to(self.start) else str(path)
        scene = load_scene(named, self.mesh_dirs)
        if self.size:
            scene = scene.with_film(width=self.size[0], height=self.size[1])
        options = tuple(word for folder in self.mesh_dirs for word in ("--mesh-dir", str(folder)))
        (verdict,) = run(
            [SceneEntry(scene, name, named, resized=bool(self.size), options=options)], workers=1
        )
        return verdict


def size_of(config: pytest.Config) -> tuple[int, int] | None:
    """By the option, or else the ini file. Raises pytest.UsageError."""
    given = config.getoption("mitsuba_ref_size") or config.getini("mitsuba_ref_size")
    if not given:
        return None
    try:
        width, height = (int(number) for number in given)
    except ValueError:
        raise pytest.UsageError(f"mitsuba_ref_size: expected two whole numbers, W H, got {given}") from None
    if width < 1 or height < 1:
        raise pytest.UsageError(f"mitsuba_ref_size: expected numbers >= 1, got {width} {height}")
    return width, height


def is_scene(path: Path) -> bool:
    """Whether it looks like one: pyproject.toml and package.json lie in the same folders."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return any(mark in text for mark in SCENE_MARKERS)


class SceneFile(pytest.File):
    """One scene."""

    def collect(self) -> Iterator[CheckItem]:
        for name in (VERDICT, *PIXEL_CHECKS, *SCENE_CHECKS):
            yield CheckItem.from_parent(self, name=name)


class CheckItem(pytest.Item):
    """One check of a scene."""

    def __init__(self, **about: Any) -> None:
        super().__init__(**about)
        self.add_marker("mitsuba_ref")
        self.add_marker(
            pytest.mark.xdist_group(str(self.path))
        )  # --dist loadgroup keeps a scene's tests together

    def runtest(self) -> None:
        scenes = self.config.pluginmanager.get_plugin("mitsuba-ref-scenes")
        assert isinstance(scenes, ScenePlugin)  # who collected this item
        words = check_problem(scenes.store.verdict_of(self.path), self.name)
        if words:
            raise CheckFailed(words)

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """The text alone, and its first line in the summary; a traceback only for what nobody foresaw."""
        from caster.description.errors import SceneError

        if not isinstance(excinfo.value, (CheckFailed, SceneError)):
            return super().repr_failure(excinfo, style)
        shown: Any = excinfo.getrepr(style="value")
        if shown.reprcrash is not None:
            # the line of pytest's summary, which is not cut where CI is set
            shown.reprcrash.message = str(excinfo.value).partition("\n")[0]
        return shown

    def reportinfo(self) -> tuple[Path, None, str]:
        return self.path, None, f"{self.path.stem}: {self.name}"


def check_problem(found: SceneVerdict | str, check: str) -> str:
    """Why a check of a scene fails, as the table of `validate` words it; nothing where it passes.

    found: the verdict, or why there is none.
    """
    if isinstance(found, str):
        return found if check == VERDICT else no_verdict(found)
    if found.problem and check != VERDICT:
        return no_verdict(f"FAIL  {found.name}  {found.problem}")
    from mitsuba_ref.report.terminal import check_failure, failure_text, pixel_failure

    if check == VERDICT:
        return "" if found.ok else failure_text(found)
    if not found.has_evidence and not found.failing:
        return no_verdict(failure_text(found))
    if check in PIXEL_CHECKS:
        return pixel_failure(found, check) if found.failing_by.get(check) else ""
    return "\n".join(
        check_failure(found, each) for each in found.checks if each.name == check and not each.ok
    )


def no_verdict(why: str) -> str:
    """A check without a verdict fails: a run of -k depth would pass, else."""
    return (
        f"{why.splitlines()[0]}\nThere is no verdict, so nothing was checked; the test {VERDICT} says more."
    )

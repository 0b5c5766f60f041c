"""What many tests start with: Mitsuba in one process a variant, which stays, and a copy of both packages."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from edited_tree import ROOT, Forks, copy_tree
from forked_runs import ask_once

from caster.scene.model import Scene
from mitsuba_ref.judge.classification import Judge, scene_judge
from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import ResidentSession, SendRequest
from mitsuba_ref.report.validation import validate_scene


@pytest.fixture(scope="session")
def send() -> Iterator[SendRequest]:
    """The way to Mitsuba, for tests that ask it about small scenes: to start it takes ten times as long."""
    with ResidentSession() as resident:
        yield resident.send


@pytest.fixture(scope="session")
def judged(send: SendRequest) -> Callable[[Scene], SceneVerdict]:
    """What `mitsuba_ref.validate` finds about a scene."""
    return lambda scene: validate_scene(scene, "scene", send=send)


@pytest.fixture(scope="session")
def brought(send: SendRequest) -> Callable[[Scene], Judge]:
    """A scene before the judge."""

    def bring(scene: Scene) -> Judge:
        judge = scene_judge(scene, send=send)
        assert not isinstance(judge, Crash), judge
        return judge

    return bring


@pytest.fixture(scope="session")
def unedited(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of both packages."""
    return copy_tree(tmp_path_factory.mktemp("unedited"))


@pytest.fixture(scope="session")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for what Mitsuba answered in this session, which its processes share."""
    base = tmp_path_factory.getbasetemp()
    memory = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "answers"
    memory.mkdir(exist_ok=True)
    return memory


@pytest.fixture(scope="module")
def remembered(answers: Path) -> Iterator[None]:
    """Commands of this process and its forks ask Mitsuba once about the same rays through the same scene."""
    put = ResidentSession.send
    ask_once(answers)
    yield
    ResidentSession.send = put  # type: ignore[method-assign]


@pytest.fixture(scope="session")
def forks(tmp_path_factory: pytest.TempPathFactory, unedited: Path, answers: Path) -> Iterator[Forks]:
    """Runs commands; the processes of one session share what Mitsuba answered."""
    forks = Forks(tmp_path_factory.mktemp("words"), answers, home=unedited)
    yield forks
    forks.close()


# Some thousand triangles each, which plain Python takes seconds to sort; and what each has instead.
COARSE = {"torus": "segments = 9\nsides = 5", "heightfield": "resolution = 5", "teapot": "subdivisions = 2"}


@pytest.fixture(scope="session")
def coarse_scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the shipped scenes, where shapes of a default resolution are coarser."""
    folder = shutil.copytree(ROOT / "scenes", tmp_path_factory.mktemp("coarse") / "scenes")
    for file in folder.glob("*.toml"):
        text = file.read_text(encoding="utf-8")
        for kind, options in COARSE.items():
            if options.split()[0] not in text:
                text = text.replace(f'type = "{kind}"\n', f'type = "{kind}"\n{options}\n')
        file.write_text(text, encoding="utf-8")
    return folder

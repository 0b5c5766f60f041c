"""Shared fixtures: a resident Mitsuba process for each variant, and a copy of both packages."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from edited_tree import ROOT, Forks, copy_tree
from mitsuba_scenes import scene_judge

from caster.scene.model import Scene
from mitsuba_ref.judge.classification import Judge
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import SendRequest, send_request
from mitsuba_ref.reference.store import STORE_VARIABLE
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.runner import many_scenes


@pytest.fixture(scope="session")
def send() -> SendRequest:
    """Send requests to a resident Mitsuba: starting one takes ten times as long as a small scene."""
    return send_request


@pytest.fixture(scope="session")
def judged(send: SendRequest) -> Callable[[Scene], SceneVerdict]:
    """Judge a scene, as `mitsuba_ref.validate` does."""
    return lambda scene: validate_scene(Task(scene, "scene", send=send))


@pytest.fixture(scope="session")
def brought(send: SendRequest) -> Callable[[Scene], Judge]:
    """Make the judge of a scene, with Mitsuba's answer."""

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
    """A folder for Mitsuba's answers of this session, shared by its processes."""
    base = tmp_path_factory.getbasetemp()
    memory = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "answers"
    memory.mkdir(mode=0o700, exist_ok=True)
    return memory


@pytest.fixture(scope="module")
def remembered(answers: Path) -> Iterator[None]:
    """Commands of this process and its forks ask Mitsuba once about the same rays through the same scene."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(STORE_VARIABLE, str(answers))
        patch.setattr(many_scenes, "local_store", lambda: None)  # verdicts are not stored
        yield


@pytest.fixture(scope="session")
def forks(tmp_path_factory: pytest.TempPathFactory, unedited: Path, answers: Path) -> Iterator[Forks]:
    """Runs commands; the processes of one session share Mitsuba's answers."""
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

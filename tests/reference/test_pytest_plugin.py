"""The pytest plug-in, run by pytest on small scenes: collection, number of judgements, and output."""

import json
import math
import re
import tempfile
from importlib import import_module
from pathlib import Path

import pytest
from places import PYPROJECT, ROOT

from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.reference.messages import Crash

pytest_plugins = "pytester"

SCENE = """# A ball.
[film]
width = 60
height = 50
[camera]
type = "pinhole"
eye = [0.1, 0.2, 5.3]
look_at = [0, 0, 0]
{more}
[[shape]]
type = "sphere"
name = "ball"
radius = 1.3
"""
STRICT = "[check.depth]\nratio = 1e-6\n"
HEAVY = ("numba", "mitsuba", "numpy", "pydantic", "caster.scene", "mitsuba_ref.runner.many_scenes")


@pytest.fixture
def keep_modules(monkeypatch):
    """Keep imported modules, which pytester would remove: llvmlite cannot be imported twice in a process."""

    class Nothing:
        def __init__(self, preserve=None):
            pass

        def restore(self):
            pass

    monkeypatch.setattr("_pytest.pytester.SysModulesSnapshot", Nothing)


@pytest.fixture
def folder(keep_modules, pytester, monkeypatch):
    """good and strict scenes; another file of the kind that is no scene. This plug-in is the only one."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makeini("[pytest]\n")  # so that no ini file of a folder above counts
    scenes = pytester.mkdir("scenes")
    (scenes / "good.toml").write_text(SCENE.format(more=""))
    (scenes / "strict.toml").write_text(SCENE.format(more=STRICT))
    (scenes / "settings.toml").write_text("[tool]\nx = 1\n")
    return pytester


def run(folder, *words, inside=True):
    words = ("-p", "no:cacheprovider", *words)
    if not inside:
        return folder.runpytest_subprocess("-p", "mitsuba_ref.runner.pytest_plugin", *words)
    plugin = import_module("mitsuba_ref.runner.pytest_plugin")  # -p would warn that it is imported already
    return folder.runpytest_inprocess(*words, plugins=[plugin])


def test_the_entry_point_is_this_plug_in():
    named = PYPROJECT["project"]["entry-points"]["pytest11"]
    assert named == {"mitsuba-ref": "mitsuba_ref.runner.pytest_plugin"}
    assert import_module("mitsuba_ref.runner.pytest_plugin").OPTION == "--mitsuba-ref"


def test_nothing_is_loaded_without_the_option(folder):
    folder.makeconftest(
        f"""
        import sys
        def pytest_unconfigure():
            print("loaded:", [name for name in {HEAVY!r} if name in sys.modules])
        """
    )
    folder.makepyfile("def test_other(): pass")
    found = run(folder, inside=False)
    found.assert_outcomes(passed=1)
    assert "loaded: []" in found.stdout.str()


def test_each_scene_is_a_test(folder):
    found = run(folder, "--mitsuba-ref", "--collect-only", "-q")
    ids = [line for line in found.outlines if ".toml::" in line]
    assert ids == ["scenes/good.toml::verdict", "scenes/strict.toml::verdict"]


def test_a_scene_that_fails_is_shown_with_its_replay(folder):
    folder.makeini("[pytest]\naddopts = --mitsuba-ref-size 20 16\n")
    found = run(folder, "--mitsuba-ref", "scenes")
    found.assert_outcomes(passed=1, failed=1)
    text = found.stdout.str()
    assert "FAIL  strict  " in text and re.search(r"depth: \d+.* hit pixels, ", text)
    assert "replay:    mitsuba-ref probe scenes/strict.toml " in text and " --size 20 16" in text
    assert "FAILED scenes/strict.toml::verdict - " in text and "Traceback" not in text


@pytest.fixture
def crashing(monkeypatch, tmp_path_factory):
    """Mitsuba ends without an answer; gives the files of its requests, which come from forks of this process."""
    requests = tmp_path_factory.mktemp("requests")

    def put(job, timeout):
        tempfile.mkstemp(dir=requests)
        return Crash(-6, "last words", 0.1)

    monkeypatch.setattr("mitsuba_ref.reference.mitsuba_process.ask_resident", put)
    monkeypatch.setattr(
        "mitsuba_ref.reference.rendering.variant_for", lambda has_quadrics: "scalar_rgb"
    )  # nor asked for this
    return lambda: list(requests.iterdir())


def test_a_crash_fails_the_scene(folder, crashing):
    found = run(folder, "--mitsuba-ref", "scenes", "-k", "good", "--mitsuba-ref-size", "8", "6")
    found.assert_outcomes(failed=1, deselected=1)
    text = found.stdout.str()
    assert "FAIL  good  Mitsuba ended without an answer (SIGABRT)" in text and "last words" in text
    assert len(crashing()) == 1


def test_a_scene_file_that_is_not_valid_is_reported_with_its_place(folder, crashing):
    Path("scenes/bad.toml").write_text(SCENE.format(more="foov = 3"))
    found = run(folder, "--mitsuba-ref", "scenes/bad.toml")
    found.assert_outcomes(failed=1)
    text = found.stdout.str()
    assert "scenes/bad.toml:9:1: " in text and "foov is an unknown key" in text and "Traceback" not in text
    assert not crashing()


def scenes_of_page():
    """The names of the scenes on the page of the folder page."""
    index = re.search(r'id="index">(.*?)</script>', Path("page/index.html").read_text(encoding="utf-8"))[1]
    return sorted(scene["name"] for scene in json.loads(index)["scenes"])


MADE_UP = """
import os, sys
sys.path.insert(0, {tests!r})
import verdict_factory
def fake(path, **options):
    from mitsuba_ref.report.validation import Validation
    name = os.path.basename(path).removesuffix(".toml")
    with open({log!r}, "a") as file:
        file.write(name + chr(10))
    return Validation((verdict_factory.scene(name, ok=name != "strict"),), 1, (name,))
def pytest_configure():
    import mitsuba_ref
    mitsuba_ref.validate = fake
"""


@pytest.mark.slow("starts several processes")
def test_with_several_workers_each_scene_is_judged_once(folder, tmp_path):
    """The judge is replaced: the test counts its calls."""
    log = tmp_path / "judged"
    folder.makeconftest(MADE_UP.format(tests=str(ROOT / "tests/unit"), log=str(log)))
    words = ("-p", "xdist.plugin", "-n", "2", "--dist", "load", "--mitsuba-ref", "scenes")
    found = run(folder, *words, "--mitsuba-ref-html", "page", inside=False)
    assert scenes_of_page() == ["scenes/good.toml good", "scenes/strict.toml strict"]
    found.assert_outcomes(failed=1, passed=1)
    assert sorted(log.read_text().split()) == ["good", "strict"]
    assert "FAIL  strict  depth: 1 wrong" in found.stdout.str()


# ---- a candidate in place of ours ----

CASTERS = """
import caster


def right(scene, o, d):
    hits = caster.cast(scene, o, d)
    return hits.t, hits.normal


def turned(scene, o, d):
    hits = caster.cast(scene, o, d)
    return hits.t, -hits.normal


def declines(scene, o, d):
    raise NotImplementedError("no spheres")
"""


def run_candidate(folder, candidate):
    folder.makepyfile(somebodys=CASTERS)
    words = ("--mitsuba-ref", "scenes/good.toml", "--mitsuba-ref-size", "8", "6")
    return run(folder, *words, "--mitsuba-ref-candidate", candidate)


@pytest.mark.parametrize(
    ("candidate", "outcome", "says"),
    [
        ("somebodys:right", {"passed": 1}, []),
        ("somebodys:turned", {"failed": 1}, ["the normal is turned round", "--candidate somebodys:turned"]),
        ("somebodys:declines", {"failed": 1}, ["no spheres"]),
        ("nobodys:caster", {"failed": 1}, ["there is no module nobodys"]),
    ],
)
def test_a_candidate_is_judged(folder, candidate, outcome, says):
    found = run_candidate(folder, candidate)
    found.assert_outcomes(**outcome)
    assert all(words in found.stdout.str() for words in says)


def test_a_check_of_the_run_fails_every_scene(folder, monkeypatch):
    """Scenes may pass with a caster that ignores the limits of rays."""
    wrong = SceneCheck("ray_conventions", math.inf, "it ignores t_max")
    monkeypatch.setattr("mitsuba_ref.python_api.run_checks", lambda subject: (wrong,))
    found = run_candidate(folder, "somebodys:right")
    found.assert_outcomes(failed=1)
    assert "FAIL  ray_conventions: it ignores t_max" in found.stdout.str()


SCENES_IN_TEST = ("good", "touching-spheres")
IN_TESTS = """
import pytest
from somebodys import right, turned


@pytest.mark.parametrize("trace", [right, turned])
def test_mine(judge_caster, trace):
    assert judge_caster(trace, ["scenes/good.toml", "builtin:touching-spheres"], size=(8, 6)).ok
"""


def test_a_caster_is_judged_in_any_test_and_the_message_has_ten_readable_lines(folder):
    folder.makepyfile(somebodys=CASTERS, test_it=IN_TESTS)
    found = run(folder, "test_it.py", "--mitsuba-ref-html", "page")
    found.assert_outcomes(passed=1, failed=1)
    told = found.stdout.str()
    shown = told[told.index("test_mine[turned]") :].partition("short test summary")[0].splitlines()[1:-1]
    assert "2 scenes: 0 pass, 2 fail: good, touching-spheres" in shown[0] and "the normal is turned round" in told
    assert any("replay:    mitsuba-ref probe " in line for line in shown) and len(shown) <= 12, shown
    assert "Traceback" not in told and "judge_caster(" not in told
    assert scenes_of_page() == [
        f"test_mine[{name}] {scene}" for name in ("right", "turned") for scene in SCENES_IN_TEST
    ]
    assert f"mitsuba-ref report: {Path('page/index.html').absolute().as_uri()}" in told


def test_the_test_of_the_documentation_passes_as_written(folder):
    page = (ROOT / "docs/ci.md").read_text(encoding="utf-8")
    (test,) = re.findall(r"```python\n((?:(?!```).)*judge_caster.*?)```", page, re.DOTALL)
    folder.makepyfile(mine=CASTERS.replace("def right", "def trace"), test_page=test.replace("(48, 48)", "(6, 5)"))
    run(folder, "test_page.py").assert_outcomes(passed=1)


def test_the_page_of_another_program_is_not_replaced(folder):
    folder.mkdir("page").joinpath("index.html").write_text("<title>mine</title>")
    found = run(folder, "--mitsuba-ref", "scenes", "--mitsuba-ref-html", "page")
    assert "--mitsuba-ref-html: " in found.stderr.str() and "Traceback" not in found.stderr.str()
    assert Path("page/index.html").read_text() == "<title>mine</title>"

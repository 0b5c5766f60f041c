"""What earlier runs left in --out and --html goes, and is counted; what anybody else put there stays."""

import json
import re
from pathlib import Path

import pytest
from verdict_factory import scene as made

from caster.system.terminal import ProgressBar
from mitsuba_ref.__main__ import main
from mitsuba_ref.report.html_report import HtmlReport
from mitsuba_ref.report.scene_record import SceneRecord
from mitsuba_ref.runner import many_scenes, validation_run

SCENE = '[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n[[shape]]\ntype = "sphere"\n'
IMAGES = ("ours", "reference", "verdict")
REMOVED = "of an earlier run, now obsolete"


@pytest.fixture
def judged(tmp_path, monkeypatch):
    """Scenes a, b and c, and a judge that is made up; run(...) gives the exit code."""
    monkeypatch.chdir(tmp_path)
    Path("scenes").mkdir()
    for name in "abc":
        Path(f"scenes/{name}.toml").write_text(SCENE)
    settings = {"reproducers": (), "problem": (), "stop": 0}

    def validate(scene, name, path, *, folder, **options):
        if name in settings["problem"]:
            return made(name, ok=False, problem="crash")
        assert not Path("out/verdict.json").exists()  # of an earlier run, while this one goes on
        reproducers = tuple(f"{name}.{each}.toml" for each in settings["reproducers"])
        files = (*(f"{name}.{which}.exr" for which in IMAGES), *reproducers)
        for file in files:
            (folder / file).write_bytes(f"{file}\n".encode())
        return made(name, reproducers=reproducers, files=files)

    class Bar(ProgressBar):
        def add(self, count, extra=""):
            if extra.startswith(f"{settings['stop']} of "):
                raise KeyboardInterrupt

    monkeypatch.setattr(many_scenes, "validate_scene", validate)
    monkeypatch.setattr(validation_run, "ProgressBar", Bar)

    def run(*words, places=("scenes",), **changed):
        settings.update({"reproducers": (), "problem": (), "stop": 0} | changed)
        return main(["validate", *places, "--out", "out", "-j", "1", *words])

    return run


def names(suffix=""):
    return sorted(path.name for path in Path("out").iterdir() if path.name.endswith(suffix))


def test_files_that_this_tool_did_not_write_stay(judged, capsys):
    Path("out").mkdir()
    for file in ("a.mine.exr", "notes.txt"):
        Path("out", file).write_text("mine")
    judged()
    assert judged(problem=("a",)) == 1 and f"removed 3 files {REMOVED}" in capsys.readouterr().err
    assert {"a.mine.exr", "notes.txt"} < set(names()) and not any(f"a.{which}.exr" in names() for which in IMAGES)


def test_a_reproducer_or_image_that_is_no_longer_true_goes_with_the_verdict_it_came_with(judged, capsys):
    judged(reproducers=("case-1.3-4",))
    assert judged() == 0 and names(".toml") == []
    assert judged(problem=("b",)) == 1
    assert f"removed 3 files {REMOVED}" in capsys.readouterr().err and not any(n.startswith("b.") for n in names())


def test_an_interrupted_run_spares_what_it_did_not_come_to(judged):
    judged()
    assert judged(stop=1) == 130
    assert {f"{name}.ours.exr" for name in "abc"} <= set(names(".exr"))
    written = json.loads(Path("out/verdict.json").read_text())
    assert [scene["name"] for scene in written["scenes"]] == ["a"] and written["not_judged"] == ["b", "c"]


@pytest.mark.parametrize(
    ("words", "places"), [(("-k", "a"), ("scenes",)), ((), ("scenes/a.toml",))], ids=["-k", "named"]
)
def test_a_run_of_some_scenes_removes_only_what_is_theirs(judged, capsys, words, places):
    judged(reproducers=("case-1.3-4",))
    assert judged(*words, places=places) == 0
    assert f"removed 1 file {REMOVED}" in capsys.readouterr().err
    assert names(".toml") == [f"{name}.case-1.3-4.toml" for name in "bc"] and len(names(".exr")) == 9


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"scenes": [{"name": "a", "files": ["../notes.txt", "notes.txt", 7]}]}', "[" * 10**5]
)
def test_a_list_of_files_that_is_garbled_removes_nothing(judged, text):
    Path("out").mkdir()
    Path("notes.txt").write_text("mine")
    Path("out/verdict.json").write_text(text)
    assert judged() == 0 and Path("notes.txt").exists()


def test_a_listed_file_that_is_not_the_scenes_or_not_in_the_folder_stays(judged):
    judged()
    record = json.loads(Path("out/verdict.json").read_text())
    others = "notes.txt", "../a.notes.txt", "b.ours.exr"
    for name in others[:2]:
        Path("out", name).write_text("mine")
    record["scenes"][0]["files"] += others
    Path("out/verdict.json").write_text(json.dumps(record))
    assert judged() == 0 and all(Path("out", name).exists() for name in others)


# ---- --html


def recorded(name: str, **more):
    return made(name, seen=SceneRecord({"window": []}, {}, "data:thumbnail"), **more)


def report(path: Path, *verdicts) -> HtmlReport:
    html = HtmlReport(path, len(verdicts))
    for verdict in verdicts:
        html.add(html.keep(verdict))
    html.write()
    return html


def rows_of(html: HtmlReport):
    """The scenes of a written page."""
    (text,) = re.findall(r'<script type="application/json" id="index">(.*)</script>', html.index.read_text())
    return json.loads(text)["scenes"]


def test_a_report_leads_to_the_scenes_of_its_own_run(tmp_path):
    report(tmp_path, recorded("a"), recorded("b"))
    html = report(tmp_path, recorded("a"))
    assert [row["file"] for row in rows_of(html)] == ["a.js"] and rows_of(html)[0]["thumbnail"] == "data:thumbnail"


def test_a_scene_without_a_record_has_a_row_and_no_pixels(tmp_path):
    assert rows_of(report(tmp_path, made("a")))[0]["file"] == ""


def test_a_candidate_that_cannot_be_loaded_leaves_no_verdict_of_an_earlier_run(tmp_path):
    """Loading it may end the process, and nobody would notice that the verdict is an old one."""
    old = [tmp_path / name for name in ("verdict.json", "all.json", "all.xml")]
    for path in old:
        path.write_text("{}")
    files = ["--out", str(tmp_path), "--json", str(old[1]), "--junit", str(old[2])]
    assert main(["validate", "scenes/one-sphere.toml", "--candidate", "no_such_module:trace", *files]) == 2
    assert not any(path.exists() for path in old)

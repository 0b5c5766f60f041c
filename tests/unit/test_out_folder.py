"""What earlier runs left in --out and --html is not taken for results of this one."""

import json
import re
from pathlib import Path

from outputs import json_of
from verdict_factory import scene as made

from caster.system.terminal import ProgressBar
from mitsuba_ref.__main__ import main
from mitsuba_ref.report.html_report import HtmlReport
from mitsuba_ref.report.scene_record import SceneRecord
from mitsuba_ref.runner import many_scenes, validation_run

SCENE = '[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n[[shape]]\ntype = "sphere"\n'


def test_an_interrupted_run_has_its_own_verdict_and_spares_what_others_wrote(here, monkeypatch):
    for folder in ("scenes", "out"):
        Path(folder).mkdir()
    for name in "ab":
        Path(f"scenes/{name}.toml").write_text(SCENE)
    for file in ("verdict.json", "b.ours.exr", "notes.txt"):
        Path("out", file).write_text("of an earlier run")

    def validate(task, *, folder, **options):
        assert not Path("out/verdict.json").exists()  # while this run goes on
        (folder / f"{task.name}.ours.exr").write_text("of this run")
        return made(task.name, files=(f"{task.name}.ours.exr",))

    class Bar(ProgressBar):
        def add(self, count, extra=""):
            raise KeyboardInterrupt

    monkeypatch.setattr(many_scenes, "validate_scene", validate)
    monkeypatch.setattr(validation_run, "ProgressBar", Bar)
    assert main(["validate", "scenes", "--out", "out", "-j", "1"]) == 130
    written = json_of("out/verdict.json")
    assert [scene["name"] for scene in written["scenes"]] == ["a"] and written["not_judged"] == ["b"]
    assert Path("out/b.ours.exr").exists() and Path("out/notes.txt").exists()


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

"""What earlier runs left in --out and --html goes, and is counted; what anybody else put there stays."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from verdict_factory import judging
from verdict_factory import scene as made

from caster.system.atomic_files import OutputError
from mitsuba_ref.__main__ import main
from mitsuba_ref.report.html_report import MAX_PIXELS_WITH_IMAGES, HtmlReport
from mitsuba_ref.report.output_manifest import IMAGES, MANIFEST, OutputManifest, files_of
from mitsuba_ref.runner import many_scenes

SCENE = '# {name}\n[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n[[shape]]\ntype = "sphere"\n'
REMOVED = "files that an earlier run wrote and this one did not"


@pytest.fixture
def judged(tmp_path, monkeypatch):
    """Scenes a, b and c, and a judge that is made up; run(...) gives (exit code, standard error's last line)."""
    monkeypatch.chdir(tmp_path)
    Path("scenes").mkdir()
    for name in "abc":
        Path(f"scenes/{name}.toml").write_text(SCENE.format(name=name))
    settings = {"reproducers": (), "problem": (), "stop": ()}

    def judge(entry, folder):
        if entry.name in settings["stop"]:
            raise KeyboardInterrupt
        if entry.name in settings["problem"]:
            return made(entry.name, ok=False, problem="crash")
        files = tuple(f"{entry.name}.{each}.toml" for each in settings["reproducers"])
        for file in (*files, *(f"{entry.name}.{which}.exr" for which in IMAGES)):
            (folder / file).write_bytes(f"{file}\n".encode())
        return made(entry.name, reproducers=files)

    monkeypatch.setattr(many_scenes, "judge_entry", judging(judge))

    def run(*words, places=("scenes",), **changed):
        settings.update(reproducers=(), problem=(), stop=())
        settings.update(changed)
        return main(["validate", *places, "--out", "out", "-j", "1", *words])

    return run


def names(suffix=""):
    return sorted(path.name for path in Path("out").iterdir() if path.name.endswith(suffix))


@pytest.mark.parametrize("words", [(), ("--resume",)])
def test_files_of_a_scene_that_is_renamed_or_gone_are_removed_and_counted(judged, capsys, words):
    judged()
    Path("scenes/a.toml").rename("scenes/z.toml")
    Path("scenes/b.toml").unlink()
    capsys.readouterr()
    assert judged(*words) == 0
    assert f"out: removed 6 {REMOVED}" in capsys.readouterr().err
    assert names(".exr") == sorted(f"{name}.{which}.exr" for name in "cz" for which in IMAGES)
    assert judged() == 0 and "removed" not in capsys.readouterr().err  # once


def test_files_that_this_tool_did_not_write_or_that_were_altered_stay(judged, capsys):
    Path("out").mkdir()
    for file in ("a.mine.exr", "notes.txt"):
        Path("out", file).write_text("mine")
    judged()
    Path("out/a.ours.exr").write_text("improved by hand")
    Path("scenes/a.toml").unlink()
    assert judged() == 0
    told = capsys.readouterr().err
    assert f"removed 2 {REMOVED}; left 1 that were altered since: a.ours.exr" in told
    assert {"a.mine.exr", "notes.txt", "a.ours.exr"} < set(names()) and "a.verdict.exr" not in names()


def test_a_reproducer_or_image_that_is_no_longer_true_goes_with_the_verdict_it_came_with(judged, capsys):
    judged(reproducers=("case-1.3-4",))
    assert judged("--resume") == 0 and names(".toml") == [f"{name}.case-1.3-4.toml" for name in "abc"]  # kept
    assert judged() == 0 and names(".toml") == []
    assert judged(problem=("b",)) == 1
    assert f"removed 3 {REMOVED}" in capsys.readouterr().err and not any(n.startswith("b.") for n in names())


def test_an_interrupted_run_spares_what_it_did_not_come_to(judged, capsys):
    judged()
    Path("scenes/a.toml").rename("scenes/0.toml")
    assert judged(stop=("b",)) == 130
    assert f"removed 3 {REMOVED}" in capsys.readouterr().err  # of a, which is no scene any more
    assert len(names(".exr")) == 9
    assert judged("-k", "0") == 0 and len(names(".exr")) == 9  # some scenes say nothing of the others


@pytest.mark.parametrize(
    ("words", "places"), [(("-k", "a"), ("scenes",)), ((), ("scenes/a.toml",))], ids=["-k", "named"]
)
def test_a_run_of_some_scenes_removes_only_what_is_theirs(judged, capsys, words, places):
    judged(reproducers=("case-1.3-4",))
    assert judged(*words, places=places) == 0
    assert "removed 1 file that an earlier run wrote" in capsys.readouterr().err
    assert names(".toml") == [f"{name}.case-1.3-4.toml" for name in "bc"] and len(names(".exr")) == 9


def test_no_verdict_of_an_earlier_run_is_there_while_one_goes_on(judged, monkeypatch):
    """Who is killed leaves none, and --resume has the journal."""
    judged()
    judge, seen = many_scenes.judge_entry, []

    def looking(entry, folder, **options):
        verdict = judge(entry, folder, **options)
        if verdict.hit_pixels:  # judged anew
            seen.append(Path("out/verdict.json").exists())
        return verdict

    monkeypatch.setattr(many_scenes, "judge_entry", looking)
    Path("scenes/a.toml").write_text(SCENE.format(name="another"))
    assert judged("--resume") == 0 and seen == [False]
    assert judged() == 0 and seen == [False] * 4 and Path("out/verdict.json").exists()


def test_shards_in_one_folder_spare_each_other(judged, capsys):
    for part in (1, 2, 3):
        assert judged("--shard", f"{part}/3") == 0
    assert len(names(".exr")) == 9 and "removed" not in capsys.readouterr().err


def test_a_candidates_images_are_listed_too():
    one = made("a")
    assert files_of(one)[0] == "a.ours.exr"
    assert files_of(replace(one, candidate="x:y"))[0] == "a.candidate.exr"


def test_a_run_that_was_killed_leaves_a_list_that_is_read_as_far_as_it_goes(tmp_path):
    """The list has a line cut short, one that leads out of the folder, one of another shape."""
    folder = tmp_path / "out"
    folder.mkdir()
    for path in (folder / "a.exr", folder / "b.exr", tmp_path / "outside.exr"):
        path.write_bytes(b"x")
    first = OutputManifest(folder)
    first.add("a", ["a.exr", "missing.exr"])
    line = json.loads((folder / MANIFEST).read_text())
    others = [json.dumps(line | {"file": "../outside.exr"}), "[1]", json.dumps(line | {"file": "b.exr"})[:-9]]
    with (folder / MANIFEST).open("a") as file:
        file.write("\n".join(others))
    second = OutputManifest(folder)
    second.add("c", ["b.exr"])
    assert second.sweep().removed == ("a.exr",)
    assert (tmp_path / "outside.exr").exists() and (folder / "b.exr").exists()
    assert [json.loads(each)["file"] for each in (folder / MANIFEST).read_text().splitlines()] == ["b.exr"]


def test_what_another_run_writes_meanwhile_is_not_removed(tmp_path):
    """Not even where it writes the same bytes that an earlier run wrote."""
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.exr").write_bytes(b"x")
    OutputManifest(tmp_path).add("a", ["a.exr", "b.exr"])
    one, other = OutputManifest(tmp_path), OutputManifest(tmp_path)
    other.add("b", ["b.exr", "c.exr"])
    assert one.sweep().removed == ("a.exr",)
    assert other.sweep().removed == () and set(other.now) == {"b.exr", "c.exr"}
    assert OutputManifest(tmp_path).sweep().removed == ("b.exr", "c.exr")


def test_a_file_that_cannot_be_removed_is_an_output_error(judged, monkeypatch, capsys):
    judged()
    Path("scenes/a.toml").unlink()
    healthy = Path.unlink

    def unlink(path, *, missing_ok=False):
        if path.suffix == ".exr":
            raise PermissionError(13, "Permission denied")
        healthy(path, missing_ok=missing_ok)

    monkeypatch.setattr(Path, "unlink", unlink)
    assert judged() == OutputError.exit_code
    assert "out/a.ours.exr: cannot remove what an earlier run wrote: Permission denied" in capsys.readouterr().err


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np, OpenEXR
from caster.image.exr import write_exr
write = OpenEXR.File.write
def half(file, path):
    Path(path).write_bytes(b"half a picture")
    os.kill(os.getpid(), signal.SIGKILL)
OpenEXR.File.write = half
write_exr(Path(sys.argv[1]) / "a.ours.exr", {"A": np.ones((4, 4))})
"""


def test_a_run_that_is_killed_while_it_writes_leaves_no_half_image_under_its_name(tmp_path):
    killed = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], capture_output=True)
    assert killed.returncode == -9, killed.stderr
    assert [path.suffix for path in tmp_path.iterdir()] == [".part"]


def test_a_folder_whose_list_cannot_be_written_is_stated_before_any_work(judged, capsys):
    Path(f"out/{MANIFEST}").mkdir(parents=True)
    assert judged() == OutputError.exit_code and f"out/{MANIFEST}: expected a file to write" in capsys.readouterr().err


# ---- --html ----


@pytest.fixture
def report(tmp_path, monkeypatch):
    """report(scene, ...): a report on them in tmp_path, swept. What goes into its pages is made up."""
    monkeypatch.setattr("mitsuba_ref.report.html_report.page", lambda *_: ["<title>ray-reference"])

    def made_from(*scenes, spared=()):
        one = HtmlReport(tmp_path, len(scenes))
        for each in scenes:
            one.add(one.keep(each))
        one.write()
        return one, one.sweep(spared)

    return made_from


class Recorded:
    about, layers, thumbnail = {"name": "x"}, {}, "data:a picture"


def judged_now(name, inputs="same"):
    return made(name, seen=Recorded(), inputs=inputs)


def pages(tmp_path):
    return sorted(path.name for path in (tmp_path / "data").iterdir())


def test_a_report_keeps_no_scene_that_its_page_does_not_lead_to(tmp_path, report):
    (tmp_path / "data").mkdir()
    (tmp_path / "data/mine.js").write_text("mine")
    report(judged_now("a"), judged_now("b c"))
    assert report(judged_now("b c"), judged_now("d"))[1].removed == ("a.js",)
    assert pages(tmp_path) == ["b c.js", "d.js", "mine.js", MANIFEST]
    assert report(judged_now("d"), spared=["b c"])[1].removed == ()


def test_the_page_of_a_kept_scene_is_kept_and_states_it(tmp_path, report):
    """Its picture and its data come from the report of the run that judged it."""
    before, _ = report(judged_now("a"))
    kept = replace(made("a", inputs="same"), kept=True)
    for _ in range(2):  # also of a report that had kept it
        assert HtmlReport(tmp_path, 1).holds(kept)
        after, swept = report(kept)
        assert swept.removed == () and pages(tmp_path) == ["a.js", MANIFEST]
        assert after.rows[0] == before.rows[0] | {"kept": True}
    assert after.rows[0]["file"] == "a.js" and after.rows[0]["thumbnail"] == Recorded.thumbnail


@pytest.mark.parametrize("what", ["other inputs", "no inputs", "altered", "gone", "never written"])
def test_data_of_another_verdict_are_not_those_of_a_kept_scene(tmp_path, report, what):
    report(judged_now("b" if what == "never written" else "a", "" if what == "no inputs" else "same"))
    if what == "altered":
        (tmp_path / "data/a.js").write_text("altered")
    if what == "gone":
        (tmp_path / "data/a.js").unlink()
    inputs = {"other inputs": "other", "no inputs": ""}.get(what, "same")
    kept = replace(made("a", inputs=inputs), kept=True)
    assert not HtmlReport(tmp_path, 1).holds(kept)
    assert report(kept)[0].rows[0]["file"] == ""


def test_one_file_has_no_data_to_keep_and_huge_films_have_none_at_all(tmp_path):
    kept = replace(made("a", inputs="same"), kept=True)
    one = HtmlReport(tmp_path / "r.html", 1)
    assert one.holds(kept) and HtmlReport(tmp_path / "page", 1).holds(replace(kept, pixels=MAX_PIXELS_WITH_IMAGES + 1))
    one.close()


def test_resume_judges_a_scene_anew_whose_page_is_not_there(judged, tmp_path, capsys):
    judged()
    assert judged("--resume", "--html", "page") == 0 and "kept" not in capsys.readouterr().out
    assert judged("--resume", "--html", "page.html") == 0 and "3 scenes were not judged" in capsys.readouterr().out

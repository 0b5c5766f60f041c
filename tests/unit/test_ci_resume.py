"""--resume takes over what was judged of the very same inputs, says so, and judges everything else anew."""

import json
from pathlib import Path

import pytest
from verdict_factory import judging
from verdict_factory import scene as made

from mitsuba_ref.__main__ import main
from mitsuba_ref.report import output_manifest
from mitsuba_ref.runner import many_scenes, resume

CAMERA = '[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n'
SCENE = "# {name}\n" + CAMERA + '[[shape]]\ntype = "{shape}"\n{more}'
TILE = "v -1 -1 0\nv 1 -1 {z}\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture
def judged(tmp_path, monkeypatch):
    """Three scenes, and a judge that is made up: the names of those it was asked about, since last looked at."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenes").mkdir()
    for name in ("a", "b"):
        (tmp_path / f"scenes/{name}.toml").write_text(SCENE.format(name=name, shape="sphere", more=""))
    (tmp_path / "scenes/m.toml").write_text(SCENE.format(name="m", shape="mesh", more='file = "tile.obj"\n'))
    (tmp_path / "scenes/tile.obj").write_text(TILE.format(z=0))
    asked = []

    def judge(entry, folder):
        if entry.name in asked_to_fail:
            raise KeyboardInterrupt
        asked.append(entry.name)
        for which in output_manifest.IMAGES:
            (folder / f"{entry.name}.{which}.exr").write_bytes(f"{entry.name} {which}".encode())
        return made(entry.name, ok=entry.name != "b")

    asked_to_fail = judge.stops = set()
    monkeypatch.setattr(many_scenes, "judge_entry", judging(judge))

    def run(*words, stop=()):
        asked_to_fail.clear()
        asked_to_fail.update(stop)
        asked.clear()
        code = main(["validate", "scenes", "--out", "out", "-j", "1", *words])
        return code, sorted(asked)

    return run


def kept():
    return [scene["name"] for scene in written()["scenes"] if scene["kept"]]


def written():
    return json.loads(Path("out/verdict.json").read_text(encoding="utf-8"))


def test_the_same_inputs_are_taken_over_and_shown_as_such(judged, capsys):
    assert judged() == (1, ["a", "b", "m"]) and kept() == []
    capsys.readouterr()
    assert judged("--resume") == (1, []) and kept() == ["a", "b", "m"]
    said = capsys.readouterr().out
    assert said.count("  kept") == 3 and "kept:       3 scenes were not judged now" in said
    assert "FAIL  b  depth: 1 wrong" in said  # a failure that is kept fails
    assert judged("--resume")[1] == [] and judged() == (1, ["a", "b", "m"]) and kept() == []  # without it: anew


@pytest.mark.parametrize(
    ("change", "anew"),
    [
        (("scenes/a.toml", "# a", "# A comment counts as a byte"), ["a"]),
        (("scenes/tile.obj", "v 1 -1 0", "v 1 -1 0.5"), ["m"]),
        (("out/b.reference.exr", None, None), ["b"]),
        (("out/verdict.json", '"kept"', '"skept"'), ["a", "b", "m"]),
        (("out/verdict.json", '"format": 3', '"format": 1'), ["a", "b", "m"]),
        (("out/verdict.json", '"inputs": "', '"inputs": "0'), ["a", "b", "m"]),
    ],
)
def test_what_has_changed_is_judged_anew(judged, change, anew, tmp_path):
    judged()
    file, old, new = change
    if old is None:
        (tmp_path / file).unlink()
    else:
        text = (tmp_path / file).read_text()
        assert old in text
        (tmp_path / file).write_text(text.replace(old, new))
    assert judged("--resume")[1] == anew
    assert kept() == [name for name in ("a", "b", "m") if name not in anew]


@pytest.mark.parametrize("which", output_manifest.IMAGES)
@pytest.mark.parametrize("content", [b"", b"m ", b"m anything", b"M reference"], ids=str)
def test_an_image_that_is_not_what_was_written_is_judged_anew(judged, which, content):
    """Cut short, replaced, or of the same size and other bytes; a reproducer as well."""
    judged()
    Path(f"out/m.{which}.exr").write_bytes(content)
    assert judged("--resume")[1] == ["m"] and kept() == ["a", "b"]
    assert Path(f"out/m.{which}.exr").read_bytes() == f"m {which}".encode()


def test_a_verdict_that_does_not_say_what_was_written_is_judged_anew(judged, tmp_path):
    judged()
    text = json.loads((tmp_path / "out/verdict.json").read_text())
    del text["scenes"][0]["files"], text["scenes"][1]["files"]["b.verdict.exr"]
    text["scenes"][2]["files"]["m.ours.exr"] = "of another shape"
    (tmp_path / "out/verdict.json").write_text(json.dumps(text))
    assert judged("--resume")[1] == ["a", "b", "m"] and kept() == []


@pytest.mark.parametrize(
    "other", [{"code": "another"}, {"mitsuba": "3.9.0"}, {"numpy": "1.0"}, {"processor": "another"}], ids=str
)
def test_other_code_or_versions_judge_all_anew(judged, monkeypatch, other):
    judged()
    now = resume.environment() | other
    monkeypatch.setattr(resume, "environment", lambda: now)
    assert judged("--resume")[1] == ["a", "b", "m"]


@pytest.mark.parametrize("words", [("--size", "20", "10"), ("--mesh-dir", "scenes")], ids=" ".join)
def test_another_option_judges_all_anew(judged, words):
    judged()
    assert judged("--resume", *words)[1] == ["a", "b", "m"]
    assert judged("--resume", *words)[1] == []


@pytest.mark.parametrize("other", ["variant", "settings"])
def test_another_variant_or_another_setting_of_it_judges_all_anew(judged, monkeypatch, other):
    """Each alone, the other one being what it is."""
    known = {"variant": "scalar_rgb", "settings": {"DRJIT_LIBLLVM_PATH": "/libLLVM.so.19"}}
    monkeypatch.setattr(resume, "variant_of", lambda scene: known["variant"])
    monkeypatch.setattr(resume.variants, "environment_for", lambda variant: known["settings"])
    judged()
    assert judged("--resume")[1] == []
    known |= {other: {"variant": "llvm_ad_rgb", "settings": {"DRJIT_LIBLLVM_PATH": "/libLLVM.so.99"}}[other]}
    assert judged("--resume")[1] == ["a", "b", "m"]


def test_every_source_file_counts(tmp_path, monkeypatch):
    for name in ("caster/deep/x.py", "mitsuba_ref/runner/resume.py"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text("x = 1\n")
    monkeypatch.setattr(resume, "__file__", str(tmp_path / "mitsuba_ref/runner/resume.py"))
    first = resume.code_hash.__wrapped__()
    (tmp_path / "caster/deep/x.py").write_text("x = 2\n")
    second = resume.code_hash.__wrapped__()
    (tmp_path / "caster/deep/x.py").rename(tmp_path / "caster/deep/y.py")
    assert len({first, second, resume.code_hash.__wrapped__()}) == 3


def test_an_interrupted_run_goes_on_where_it_ended(judged, tmp_path):
    assert judged(stop=["b", "m"]) == (130, ["a"])
    assert written()["not_judged"] == ["b", "m"] and (tmp_path / "out/judged.jsonl").exists()
    assert judged("--resume") == (1, ["b", "m"]) and kept() == ["a"]
    assert not (tmp_path / "out/judged.jsonl").exists()


def test_a_run_that_was_killed_goes_on_too_and_half_a_line_counts_for_nothing(judged, tmp_path):
    judged(stop=["m"])
    (tmp_path / "out/verdict.json").unlink()  # nobody wrote it
    journal = tmp_path / "out/judged.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    assert len(lines) == 2
    journal.write_text(lines[0] + lines[1][:-40])
    assert judged("--resume") == (1, ["b", "m"]) and kept() == ["a"]


def test_what_is_kept_outlives_an_interruption_of_the_run_that_goes_on(judged, tmp_path):
    judged()
    text = (tmp_path / "scenes/a.toml").read_text()
    (tmp_path / "scenes/a.toml").write_text(text + "# another byte\n")
    assert judged("--resume", stop=["a"]) == (130, []) and written()["scenes"] == []
    with (tmp_path / "out/judged.jsonl").open("a") as file:
        file.write('{"cut": "sho')
    assert judged("--resume", stop=["a"]) == (130, [])
    assert judged("--resume") == (1, ["a"]) and kept() == ["b", "m"]


def test_a_crash_of_mitsuba_is_not_kept(judged, monkeypatch):
    healthy = many_scenes.judge_entry
    monkeypatch.setattr(
        many_scenes, "judge_entry", judging(lambda entry, folder: made(entry.name, ok=False, problem="crash"))
    )
    assert judged() == (1, []) and written()["scenes"][0]["problem"] == "crash"
    monkeypatch.setattr(many_scenes, "judge_entry", healthy)
    assert judged("--resume") == (1, ["a", "b", "m"]) and kept() == []


def test_resume_needs_a_folder(judged, capsys):
    assert main(["validate", "scenes", "--resume"]) == 2
    assert "--resume: expected --out DIR beside it" in capsys.readouterr().err

"""Scenes are loaded when they are judged, and an error of one is its row."""

import pytest
from outputs import json_of

import mitsuba_ref.__main__
from caster.description.errors import SceneError
from caster.rendering.threads import core_count, thread_count
from caster.system.atomic_files import OutputError
from mitsuba_ref.judge.verdict import CLASSES, SceneVerdict
from mitsuba_ref.runner import many_scenes, validation_run
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry
from mitsuba_ref.runner.validation_run import ValidationRun

SCENE = """[film]
width = 8
height = 4
[camera]
type = "pinhole"
eye = [0, 0, 3]
look_at = [0, 0, 0]
[[shape]]
type = "sphere"
"""


@pytest.fixture
def folder(tmp_path):
    """Thirty scenes, of which the third cannot be parsed."""
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    for i in range(30):
        (scenes / f"s{i:02}.toml").write_text(SCENE if i != 2 else "[film\n")
    return scenes


def passed(entry: SceneEntry) -> SceneVerdict:
    counts = {name: 32 * (name == "agree") for name in CLASSES}
    return SceneVerdict(entry.name, entry.path, 32, hit_pixels=32, counts=counts)


def test_the_process_that_hands_out_scenes_loads_none(folder, monkeypatch):
    """Scenes are loaded where they are judged, when their turn comes."""

    def judge(entry, options):
        assert entry.given is None
        return passed(entry)

    monkeypatch.setattr(validation_run, "judge_entry", judge)
    sources = [SceneEntry(path.stem, str(path)) for path in sorted(folder.iterdir())]
    found = ValidationRun(sources, JudgeOptions(), workers=2).verdicts()
    assert [verdict.name for verdict in found] == [f"s{i:02}" for i in range(30)]


ERRORS = {
    "s04": (MemoryError("Unable to allocate 64. GiB"), "cannot be judged: not enough memory: Unable to allocate"),
    "s05": (OutputError("s05.ours.exr: cannot write: full"), "cannot be written: s05.ours.exr"),
    "s06": (OSError(5, "Input/output error", "mesh.ply"), "cannot be judged: mesh.ply: Input/output error"),
    "s07": (ZeroDivisionError("division by zero"), "internal error, please report it: ZeroDivisionError"),
    "s08": (SceneError("no reference"), "cannot be judged: no reference"),
}


@pytest.mark.parametrize(
    ("failing", "code"), [((), 2), (("s04",), 2), (("s06",), 2), (("s04", "s05"), 4), (tuple(ERRORS), 70)]
)
def test_any_error_is_a_row_and_the_verdict_is_written(folder, tmp_path, monkeypatch, capsys, failing, code):
    def judge(entry, scene, options):
        if entry.name in failing:
            raise ERRORS[entry.name][0]
        return passed(entry)

    monkeypatch.setattr(many_scenes, "judge_loaded", judge)
    monkeypatch.setattr("mitsuba_ref.reference.variants.variant_for", lambda **_: "scalar_rgb")
    monkeypatch.setattr(validation_run, "run_identity", lambda *_: {"judged_with": {}})
    out = tmp_path / "verdict.json"
    assert mitsuba_ref.__main__.main(["validate", str(folder), "-j", "2", "--json", str(out)]) == code
    rows = {row["name"]: row for row in json_of(out)["scenes"]}
    assert len(rows) == 30 and {name for name, row in rows.items() if not row["ok"]} == {"s02", *failing}
    assert "s02.toml:1:6: not valid TOML" in rows["s02"]["problem"]
    assert all(rows[name]["problem"].startswith(ERRORS[name][1]) for name in failing)
    assert ("Traceback" in capsys.readouterr().err) == (code == 70)


def test_a_worker_casts_on_its_share_of_threads(folder, monkeypatch):
    """The number that a worker is given is its default; this process keeps its own."""
    monkeypatch.setattr(many_scenes, "judge_loaded", lambda *_: SceneVerdict("threads", str(thread_count(None))))
    source = SceneEntry("s00", str(folder / "s00.toml"))
    before = thread_count(None)
    for entries in ([source], 2 * [source]):
        run = ValidationRun(entries, JudgeOptions(), workers=2)
        assert {found.path for found in run.verdicts()} == {str(max(1, core_count() // len(entries)))}
    assert thread_count(None) == before

"""Scenes are loaded when their turn comes, and what fails about one of them is its row."""

import json
import time

import numpy as np
import pytest

import mitsuba_ref.__main__
from caster.description.errors import SceneError
from caster.rendering.threads import core_count, thread_count
from caster.system.atomic_files import OutputError
from mitsuba_ref.judge.verdict import CLASSES, SceneVerdict
from mitsuba_ref.runner import many_scenes, validation_run
from mitsuba_ref.runner.many_scenes import Entry, JudgeOptions, SceneSource, matching, run, source_of, start_order
from mitsuba_ref.runner.shards import Shard, _missing, scenes_of_shard

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


def passed(entry: Entry) -> SceneVerdict:
    counts = {name: 32 * (name == "agree") for name in CLASSES}
    return SceneVerdict(entry.name, entry.path, entry.pixels, hit_pixels=32, counts=counts)


def test_the_process_that_hands_out_scenes_loads_none(folder, monkeypatch):
    """Scenes are loaded where they are judged, when their turn comes."""

    def judge(entry, options):
        assert isinstance(entry, SceneSource)
        return passed(entry)

    monkeypatch.setattr(many_scenes, "judge_entry", judge)

    sources = [source_of(str(path), path.stem) for path in sorted(folder.iterdir())]
    assert [source.pixels for source in sources[:4]] == [32, 32, 1, 32]
    found = list(run(sources, JudgeOptions(), 2))
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
    def judge(loaded, options, subject):
        if loaded.name in failing:
            raise ERRORS[loaded.name][0]
        return passed(loaded)

    monkeypatch.setattr(many_scenes, "_judge_loaded", judge)
    monkeypatch.setattr("mitsuba_ref.reference.variants.variant_for", lambda **_: "scalar_rgb")
    monkeypatch.setattr(validation_run, "run_identity", lambda *_: {})
    out = tmp_path / "verdict.json"
    assert mitsuba_ref.__main__.main(["validate", str(folder), "-j", "2", "--json", str(out)]) == code
    rows = {row["name"]: row for row in json.loads(out.read_text())["scenes"]}
    assert len(rows) == 30 and {name for name, row in rows.items() if not row["ok"]} == {"s02", *failing}
    assert "s02.toml:1:6: not valid TOML" in rows["s02"]["problem"]
    assert all(rows[name]["problem"].startswith(ERRORS[name][1]) for name in failing)
    assert ("Traceback" in capsys.readouterr().err) == (code == 70)


def test_work_is_in_proportion_to_scenes_and_words(folder):
    begin = time.process_time()
    sources = [source_of(str(path), path.stem) for path in sorted(folder.iterdir())]
    parts = [scenes_of_shard(sources, Shard(part, 10**8)) for part in (1, 30, 31, 10**8)]
    assert [len(part) for part in parts] == [1, 1, 0, 0]
    lines = _missing(10**8, {1})
    assert (len(lines), lines[-1]) == (51, "99999949 more shards are missing")
    assert matching("(" * 50 + "a" + ")" * 50)("a")
    with pytest.raises(SceneError, match="expected parts of names"):
        matching("(" * 100_000)
    assert time.process_time() - begin < 2.0


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_of_the_last_scenes_alone_the_long_ones_are_begun_first(workers):
    costs = np.random.default_rng(workers).integers(1, 9, 30).tolist()
    order, tail = start_order(costs, workers), 30 - 4 * workers
    assert sorted(order) == list(range(30)) and order[:tail] == list(range(tail))
    assert [costs[place] for place in order[tail:]] == sorted(costs[tail:], reverse=True)
    assert start_order([5, 5, 5], 2) == [0, 1, 2] and start_order([1, 2], 8) == [1, 0] and start_order([], 1) == []


def test_a_long_description_counts_as_work(tmp_path):
    for name, text in (("short", SCENE), ("long", SCENE + "#" * 10_000)):
        (tmp_path / f"{name}.toml").write_text(text)
    short, long = (source_of(str(tmp_path / f"{name}.toml"), name) for name in ("short", "long"))
    assert long.cost - short.cost == 10_000 and short.cost == short.pixels + len(SCENE)


@pytest.mark.parametrize(
    ("cores", "workers", "scenes", "threads"), [(8, 8, 40, 1), (8, 2, 40, 4), (8, 8, 1, 8), (2, 6, 9, 1)]
)
def test_all_cores_have_work_and_no_core_two_threads(monkeypatch, cores, workers, scenes, threads):
    monkeypatch.setattr(many_scenes, "core_count", lambda: cores)
    assert many_scenes.threads_per_worker(workers, scenes) == threads


def test_a_worker_casts_on_its_share_of_threads(folder, monkeypatch):
    """The number that a worker is given is its default; this process keeps its own."""
    monkeypatch.setattr(many_scenes, "_judge_loaded", lambda *_: SceneVerdict("threads", str(thread_count(None))))
    source = source_of(str(folder / "s00.toml"), "s00")
    for threads in (1, 2):
        assert [found.path for found in run([source], JudgeOptions(threads=threads), 1)] == [str(threads)]
    assert thread_count(None) == core_count()

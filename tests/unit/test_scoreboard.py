"""The scoreboard's runner: crashes, time-outs and missing packages are cells, and a planted leak is a red one."""

import argparse
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest
from scoreboard import __main__ as runner
from scoreboard import exact, judging, page, roster

from mitsuba_ref.oracle.oracle import Oracle

EDGES = ("watertight-edges", 10.0)
RAYS = 60

LEAKY = """
import caster, numpy as np

def trace(v, f, o, d, t_min, t_max):
    mesh = {"type": "mesh", "vertices": v.tolist(), "faces": f.tolist()}
    camera = {"type": "ray", "origin": [0, 0, 0], "direction": [0, 0, 1]}
    scene = caster.Scene.model_validate({"camera": camera, "shape": [mesh]})
    hits = caster.cast(scene, o, d)
    a, b, c = v[f[hits.prim_id]].astype(float).swapaxes(0, 1)
    p = o + hits.t[:, None] * d
    across = lambda x, y: np.linalg.norm(np.cross(y - x, p - x), axis=1) / np.linalg.norm(y - x, axis=1)
    near = np.minimum(np.minimum(across(a, b), across(b, c)), across(c, a))
    return np.where(near < LOST, np.inf, hits.t), None
"""


@pytest.fixture(autouse=True)
def few_settings(monkeypatch):
    monkeypatch.setattr(judging, "settings", lambda: iter([EDGES]))


def entry(path: Path, **more) -> roster.Entry:
    return roster.Entry("planted", "a planted one", str(path), "at once", "float64", "a test", rays=RAYS, **more)


def served(path: Path, text: str) -> roster.Entry:
    path.write_text(text)
    return entry(path)


def result_of(planted: roster.Entry, folder: Path, monkeypatch) -> dict:
    monkeypatch.setattr(judging, "speeds", lambda subjects: [(2.0, 1.0)] * 2)
    return runner.result_of(planted, None, folder)


def test_every_glue_is_listed_and_short():
    listed = {each.path for each in roster.entries()}
    there = {path for path in (roster.HERE / "casters").iterdir() if path.is_file()}
    assert listed == there and len(roster.entries()) >= 15
    long = {p.name: n for p in there if (n := sum(bool(line.strip()) for line in p.read_text().splitlines())) > 25}
    assert not long


def test_a_crash_is_a_cell(tmp_path, monkeypatch):
    found = result_of(served(tmp_path / "crash.py", "import os\ntrace = lambda *a: os.abort()"), tmp_path, monkeypatch)
    (cell,) = found["cells"]
    assert "SIGABRT" in cell["absent"] and "SIGABRT" in cell["reproducer"]


def test_a_time_out_is_a_cell(tmp_path, monkeypatch):
    monkeypatch.setattr(judging, "SECONDS", 1.0)
    slow = served(tmp_path / "slow.py", "import time\ntrace = lambda *a: time.sleep(60)")
    (cell,) = result_of(slow, tmp_path, monkeypatch)["cells"]
    assert cell["absent"].startswith("killed after 1 s")


@pytest.mark.parametrize(
    ("more", "words"),
    [({"debian": ["no-such-package"]}, "no-such-package"), ({"file": "none.c"}, "none.c")],
    ids=["package", "compiler"],
)
def test_what_is_missing_is_a_row(tmp_path, monkeypatch, more, words):
    missing = replace(served(tmp_path / "empty.py", "trace = None"), **more)
    found = result_of(missing, tmp_path, monkeypatch)
    assert found["absent"].startswith("not installed: ") and words in found["absent"] and found["cells"] == []


def test_a_planted_leak_is_red_and_its_ray_repeats(tmp_path, monkeypatch, capsys):
    leaky = served(tmp_path / "leaky.py", LEAKY.replace("LOST", "1e-6"))
    monkeypatch.setattr(roster, "entries", lambda: [leaky])
    monkeypatch.setattr(page, "entries", lambda: [leaky])
    found = result_of(leaky, tmp_path, monkeypatch)
    (cell,) = found["cells"]
    assert cell["false_misses"] > 0 and cell["false_hits"] == cell["off"] == 0
    file = tmp_path / "results.json"
    machine = {"processor": "P", "system": "S", "revision": "R"}
    file.write_text(json.dumps({"machine": machine, "casters": [found]}))
    page.write(file, tmp_path)
    text = (tmp_path / "findings" / "scoreboard.md").read_text()
    assert f"| [{cell['false_misses']} of {RAYS}](#planted) |" in text
    assert (tmp_path / "findings" / "scoreboard" / "wrong.svg").exists()
    command = next(line for line in text.splitlines() if "--replay" in line).split("--replay ")[1].split()
    replayed = argparse.Namespace(replay=[word.strip("'") for word in command], build=tmp_path)
    assert runner.replay(replayed) == 1
    printed = capsys.readouterr().out
    assert "caster: miss" in printed and "exact:  t " in printed


def test_without_the_leak_the_cell_is_right(tmp_path, monkeypatch):
    sound = served(tmp_path / "sound.py", LEAKY.replace("LOST", "-1"))
    (cell,) = result_of(sound, tmp_path, monkeypatch)["cells"]
    assert cell["false_misses"] == cell["false_hits"] == cell["off"] == 0 and cell["first"] is None


def test_the_fractions_agree_with_the_oracle():
    ready = judging.setting(*EDGES, RAYS)
    (part,) = ready.model.packed.parts
    corners = part.vertices[part.faces].tolist()
    oracle = Oracle(ready.model.packed)
    for o, d in zip(ready.o[:4].tolist(), ready.d[:4].tolist(), strict=True):
        t, prims = exact.first_hit(corners, o, d)
        answer = oracle.first_hit(o, d)
        assert abs(float(t) - float(answer.t)) == 0.0 and prims == answer.prims.tolist()
    assert exact.first_hit([[(0, 0, 0), (1, 0, 0), (0, 1, 0)]], (0.25, 0.5, 1), (0, 0, -3)) == (Fraction(1, 3), [0])
    assert exact.first_hit([[(0, 0, 0), (1, 0, 0), (0, 1, 0)]], (0.75, 0.5, 1), (0, 0, -3)) == (None, [])

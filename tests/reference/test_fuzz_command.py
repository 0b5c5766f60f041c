"""The command `mitsuba-ref fuzz`: coverage, stored findings and exit codes."""

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from edited_tree import NO_REMARKS
from outputs import json_of, unfolded
from places import ROOT

from caster.rendering import hits, images
from caster.rendering.casting import find_nearest
from caster.scene.files import load_scene
from mitsuba_ref.__main__ import main
from mitsuba_ref.cli import experiments as command
from mitsuba_ref.fuzz import checks
from mitsuba_ref.fuzz.cases import read_kept
from mitsuba_ref.fuzz.checks import compare_with_mitsuba, failure_mode
from mitsuba_ref.fuzz.findings import Tally
from mitsuba_ref.fuzz.fuzz_run import Drawing
from mitsuba_ref.hard import FAMILIES
from mitsuba_ref.judge.verdict import Failure
from mitsuba_ref.reference.messages import Crash

SCENE = ROOT / "scenes" / "one-sphere.toml"


@pytest.fixture
def fuzz(tmp_path, capsys, warm):
    """Run it; (exit code, stdout, stderr, JSON or None)."""

    def run(*argv, out=tmp_path / "kept"):
        told = tmp_path / "told.json"
        told.unlink(missing_ok=True)
        code = main(["fuzz", "--out", str(out), "--json", str(told), *argv])
        captured = capsys.readouterr()
        return code, captured.out, captured.err, json_of(told) if told.exists() else None

    return run


@pytest.fixture
def fault(monkeypatch):
    """Ours misses about every ninth ray, whatever the culling; undone by monkeypatch.undo()."""

    def forgetful(packed, rays, *more, **options):
        nearest = find_nearest(packed, rays, *more, **options)
        lost = np.frexp(np.abs(rays.o).sum(axis=1) + 1.0 / 3.0)[0] * 2.0**20 % 9.0 < 1.0
        nearest.t[lost], nearest.prim[lost] = np.inf, -1
        return nearest

    def plant():
        monkeypatch.setattr(images, "find_nearest", forgetful)
        monkeypatch.setattr(hits, "find_nearest", forgetful)

    return plant


@pytest.mark.slow("judges scenes of every family")
def test_all_families_pass_and_the_totals_say_what_was_looked_at(fuzz):
    code, out, err, told = fuzz("--examples", str(len(FAMILIES)), "--judge-every", "4")
    assert code == 0, out
    assert all(line.startswith(NO_REMARKS) for line in err.splitlines()), "progress is for terminals"
    assert told["ok"] and not told["interrupted"] and told["failures"] == []
    assert list(told["families"]) == [family.name for family in FAMILIES]
    total = told["total"]
    assert total["examples"] == len(FAMILIES) and total["rays"] > 1500 and total["judged"] >= 2 and total["pixels"] > 45
    assert total["rays"] == sum(each["rays"] for each in told["families"].values())
    assert f"{len(FAMILIES)} examples" in out and "nothing found" in out and f"{total['rays']} rays adjudicated" in out


def without_times(told):
    return {key: value for key, value in told.items() if key != "seconds"}


def test_the_same_seed_does_the_same_whatever_the_limits(fuzz):
    *_, first = fuzz("--seed", "5", "--examples", "6..9", "--judge-every", "0")
    *_, again = fuzz("--seed", "5", "--examples", "6..9", "--time", "5m", "--judge-every", "0")
    assert without_times(first) == without_times(again) and first["last_example"] == 9
    *_, other = fuzz("--seed", "6", "--examples", "6..9", "--judge-every", "0")
    assert first["total"] != other["total"]


@pytest.mark.slow("fuzzes for some seconds")
def test_time_is_kept(fuzz):
    start = time.monotonic()
    *_, told = fuzz("--time", "3s", "--judge-every", "0")
    assert 3.0 <= told["seconds"] <= time.monotonic() - start <= 9.0
    assert told["total"]["examples"] >= 1


def test_a_fault_is_found_made_small_kept_and_gone_when_it_is_fixed(fuzz, fault, monkeypatch, tmp_path):
    fault()
    code, out, _, told = fuzz("--examples", "8", "--family", "edges", "--keep", "1", "--judge-every", "0")
    assert code == 1
    (failure,) = (each for each in told["failures"] if each["kind"] == "missed")
    assert failure["family"] == "edges" and told["total"]["kinds"]["missed"] > 1
    assert f"FAIL missed: {failure['what']}" in unfolded(out)
    assert f"replay: mitsuba-ref fuzz --replay {failure['file']}" in out
    assert len(read_kept(Path(failure["file"]))[1]["shape"]) == 1
    assert load_scene(failure["file"]).camera.type == "ray"

    again = fuzz(*failure["example"].split(), "--judge-every", "0", out=tmp_path / "again")[3]["failures"]
    (same,) = (each for each in again if each["kind"] == "missed")
    assert Path(same["file"]).read_text() == Path(failure["file"]).read_text()

    code, out, *_ = fuzz("--replay", failure["file"])
    assert code == 1 and out.startswith(f"FAIL  {failure['file']}  missed\n      missed: ours misses")
    monkeypatch.undo()
    code, out, *_ = fuzz("--replay", failure["file"])
    assert code == 0 and out == f"PASS  {failure['file']}  missed\n1 kept scenes: 1 pass, 0 fail\n"


@pytest.mark.parametrize(
    ("argv", "code", "says"),
    [
        (["--family", "edge"], 2, "family 'edge': unknown, did you mean 'edges'? (known: any, edges"),
        (["--examples", "0"], 5, "nothing selected"),
        (["--examples", "9..3"], 2, "expected how many, such as 100, or from..to"),
        (["--time", "soon"], 2, "expected a time such as 60s, 5m or 1h, at most 500,000 s, got 'soon'"),
    ],
)
def test_bad_input_is_reported(argv, code, says, capsys):
    assert main(["fuzz", *argv]) == code
    told = capsys.readouterr()
    assert says in told.err and "Traceback" not in told.err and told.out == ""


def test_an_empty_folder_has_nothing_to_replay(tmp_path, capsys):
    assert main(["fuzz", "--replay", str(tmp_path)]) == 5
    assert f"no scene file in {tmp_path}" in capsys.readouterr().err


def test_what_was_found_before_an_interruption_is_kept_and_reported(fuzz, fault, monkeypatch):
    def impatient(line, text):
        if " 0 findings" not in text:
            raise KeyboardInterrupt

    fault()
    monkeypatch.setattr(command.StatusLine, "show", impatient)
    code, out, err, told = fuzz("--family", "edges", "--keep", "1", "--judge-every", "0")
    assert code == 130 and err == "interrupted\n" and told["interrupted"] and not told["ok"]
    assert told["failures"] and all(each["file"] in out for each in told["failures"])
    assert all(read_kept(Path(each["file"]))[0] == each["kind"] for each in told["failures"])


def test_a_crash_of_mitsuba_is_a_finding(monkeypatch):
    monkeypatch.setattr(checks, "send_request", lambda *_: Crash(-11, "", 0.1))
    (finding,) = compare_with_mitsuba(load_scene(SCENE).with_film(width=8, height=8), Tally())
    assert finding.kind == "crash" and "SIGSEGV" in finding.what


def test_a_pixel_that_the_judge_fails_is_a_finding(monkeypatch):
    usual = checks.validate_scene

    def with_a_failure(task):
        strict = task.scene.model_copy(update={"checks": {"depth": {"ratio": 1e-9}}})
        verdict = usual(task._replace(scene=strict))
        return replace(verdict, checks=())

    monkeypatch.setattr(checks, "validate_scene", with_a_failure)
    finding, *_ = compare_with_mitsuba(load_scene(SCENE).with_film(width=8, height=8), Tally())
    assert finding.kind == "judged" and finding.detail == "place"


# ---- a candidate in place of ours ----


def test_a_right_candidate_passes_on_films_and_on_aimed_rays(fuzz):
    code, out, _, told = fuzz("--examples", "16", "--candidate", "candidates:ours_rounded")
    assert code == 0, out
    assert told["candidate"] == "candidates:ours_rounded" and told["total"]["judged"] >= 16
    assert told["total"]["pixels"] >= 300 and "magnitudes" not in told["families"]


@pytest.mark.slow("judges some hundred scenes")
def test_a_wrong_candidate_is_shrunk_kept_and_replayed(fuzz, tmp_path, monkeypatch, capsys):
    """Our caster misses hits nearer than t = 1e-4, which only rays that start on a surface show."""
    (tmp_path / "epsilon_caster.py").write_text(
        "import caster\n\n\ndef cast(scene, o, d):\n    hits = caster.cast(scene, o, d, t_min=1e-4)\n"
        "    return hits.t, hits.normal\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    words = ["--candidate", "epsilon_caster:cast"]
    code, out, _, told = fuzz("--family", "surfaces", "--examples", "1..1", *words)
    assert code == 1 and told["total"]["kinds"] == {"judged": told["total"]["findings"]}
    first = told["failures"][0]
    assert "\n      candidate: " in first["what"] and f"replay: {first['replay']}" in out
    assert first["replay"] == f"mitsuba-ref fuzz --replay {first['file']} --candidate epsilon_caster:cast"
    text = Path(first["file"]).read_text()
    assert "--candidate epsilon_caster:cast\n" in text and text.count("[[shape]]") == 1
    assert "limits" in read_kept(Path(first["file"]))[1]
    assert f"\n      from:   mitsuba-ref fuzz {first['example']}\n" in out
    assert main(["fuzz", "--replay", first["file"], *words]) == 1
    assert main(["fuzz", "--replay", first["file"], "--candidate", "candidates:ours"]) == 0
    assert main(["fuzz", "--replay", first["file"]]) == 0
    capsys.readouterr()


def test_a_candidate_of_triangles_gets_scenes_of_triangles(fuzz, tmp_path, monkeypatch):
    (tmp_path / "meshes_alone.py").write_text(
        "import caster\n\n\ndef cast(scene, o, d):\n    if any(shape.type != 'mesh' for shape in scene.shapes):\n"
        "        raise NotImplementedError('triangles alone')\n    hits = caster.cast(scene, o, d)\n"
        "    return hits.t, hits.normal\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    code, out, _, told = fuzz("--examples", "12", "--candidate", "meshes_alone:cast")
    assert code == 0, out
    assert told["total"]["declined"] == 0 and told["total"]["judged"] >= 12
    assert {"sphere", "disk", "plane"} <= set(told["left_out"]) and "mesh" not in told["left_out"]
    assert "tangents" not in told["families"] and "without shapes that it declines: " in out


@pytest.mark.parametrize(
    ("check", "subject", "exact", "mode"),
    [
        ("mask", "miss, along o", "ball, prim 0", "missed"),
        ("exact", "miss, along o", "ball, prim 0", "missed"),  # by Mitsuba as well
        ("mask", "t 1.0 0x1p+0", "miss", "phantom"),
        ("exact", "t 1.0 0x1p+0", "ball, prim 0", "place"),
        ("depth", "ball at depth 1.0", "ball, prim 0", "place"),
        ("normal", "t 1.0 0x1p+0", "ball, prim 0", "normal"),
    ],
)
def test_the_way_in_which_a_pixel_fails_is_what_shrinking_preserves(check, subject, exact, mode):
    assert failure_mode(Failure(0, 0, "wrong", check, 2.0, subject, "", exact, "")) == mode


def test_an_example_that_ends_its_process_is_one_finding(fuzz, monkeypatch):
    honest = Drawing.tried

    def poisoned(drawing, number):
        if number == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return honest(drawing, number)

    monkeypatch.setattr(Drawing, "tried", poisoned)  # in the forks, too
    code, *_, told = fuzz("--examples", "6", "--judge-every", "0")
    assert code == 1 and told["total"]["examples"] == 6 and told["total"]["kinds"] == {"crash": 1}
    (failure,) = told["failures"]
    assert "--examples 2..2" in failure["example"] and "SIGKILL" in failure["what"]


def test_a_candidate_that_declines_or_cannot_answer_is_no_pass(fuzz, tmp_path, monkeypatch):
    (tmp_path / "no_caster.py").write_text(
        "def declines(scene, o, d):\n    raise NotImplementedError('no shape at all')\n\n\n"
        "def raises(scene, o, d):\n    return 1 / 0\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("mitsuba_ref.fuzz.fuzz_run.MITSUBA_SHRINK_ATTEMPTS", 2)
    code, out, _, told = fuzz("--examples", "2", "--candidate", "no_caster:declines")
    assert code == 1 and "FAIL  nothing was judged: no_caster:declines declined every scene" in out
    assert told["total"]["declined"] >= 3 and not told["ok"]
    code, out, _, told = fuzz("--examples", "1", "--candidate", "no_caster:raises")
    assert code == 1 and told["total"]["kinds"] == {"answer": 1} and "ZeroDivisionError" in out

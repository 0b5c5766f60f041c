"""`mitsuba-ref validate` from outside: exit codes, output, files, and interruptions."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import fields
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from edited_tree import DEADLINE, LONG_CHECKS, ROOT, copy_tree, edit
from outputs import unfolded
from programs import printed_by

from caster.image.exr import read_exr
from mitsuba_ref.__main__ import main
from mitsuba_ref.judge.verdict import CLASSES, Failure

SIZE, SMALL = ("--size", "12", "10"), ("--size", "7", "6")
CAMERA = '[film]\nwidth = 12\nheight = 10\n\n[camera]\ntype = "pinhole"\neye = [0.1, 0.2, 5.3]\nlook_at = [0, 0, 0]\n'
BALL = '\n[[shape]]\ntype = "sphere"\nname = "ball"\ncenter = [0.1, 0.2, {z}]\nradius = 1.3\n'
# mark, scene, hit, agree, and words about other pixels
ROW = re.compile(r"^(PASS|FAIL)  (\S+) +(\d+) +(\d+) +[\d.-]+ +(?:[\d.]+|kept)( .*)?$", re.MULTILINE)


@pytest.fixture
def ref(forks, unedited):
    """Run `mitsuba-ref` in a fork, which saves starting Python, and check that it prints no traceback."""

    def forked(*argv):
        return no_traceback(forks.run(unedited, *map(str, argv)))

    return forked


def no_traceback(found):
    assert "Traceback" not in found.stderr and found.returncode != 70, found.stderr
    return found


@pytest.fixture
def scenes(tmp_path):
    """ball and other pass, empty-1 and empty-2 show nothing."""
    folder = tmp_path / "scenes"
    folder.mkdir()
    for name, z in (("ball", 0.3), ("empty-1", 17.0), ("empty-2", 19.0), ("other", -0.7)):
        (folder / f"{name}.toml").write_text(CAMERA + BALL.format(z=z))
    return folder


def names_in(found):
    return [row[1] for row in ROW.findall(found.stdout)]


# ---- what is selected ----


def test_a_folder_is_judged_in_order_and_an_expression_chooses(ref, scenes):
    found = ref("validate", scenes)
    assert (found.returncode, names_in(found)) == (1, ["ball", "empty-1", "empty-2", "other"])
    assert "FAIL  empty-1  no pixel hits anything, so nothing was compared" in found.stdout
    found = ref("validate", scenes, "-k", "not empty")
    assert (found.returncode, names_in(found)) == (0, ["ball", "other"])
    assert "2 scenes: 2 pass, 0 fail, in " in found.stdout and "agree (100 %)" in found.stdout


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["-k", "nothing-like-it"], 5, "nothing selected: no scene file that fits -k 'nothing-like-it' in "),
        (["-j", "0"], 2, "-j: expected a whole number >= 1, got '0'"),
        (["--size", "0", "20"], 2, "--size 0 20: "),
        (["--thorough", "--candidate", "json:loads"], 2, "--thorough: not with a candidate"),
        (["--json", "{folder}/none/verdict.json"], 4, "none"),
        (["--out", "{folder}/ball.toml"], 2, "ball.toml"),
        (["--html", "{folder}/report.html"], 4, "a report is a folder"),
        (["{folder}/nowhere.toml"], 4, "nowhere.toml: expected a scene file or a folder of them, found nothing"),
    ],
)
def test_bad_usage_is_reported_before_any_work(ref, scenes, words, code, says):
    found = ref("validate", scenes, *(word.format(folder=scenes) for word in words))
    assert (found.returncode, found.stdout) == (code, "")
    assert says in unfolded(found.stderr)


def test_a_folder_without_scenes_is_no_pass(ref, tmp_path):
    assert ref("validate", tmp_path).returncode == 5


def test_scenes_that_cannot_be_used_are_rows_beside_the_others(ref, scenes):
    for failing in scenes.glob("empty-*.toml"):  # whose exit code, 1, would go before
        failing.unlink()
    (scenes / "bad-1.toml").write_text(CAMERA + "foov = 3\n")
    (scenes / "bad-2.toml").write_text(CAMERA + BALL.format(z=0.0) + "radios = 1\n")
    found = ref("validate", scenes)
    assert found.returncode == 2
    assert re.findall(r"^FAIL  (bad-\d)", found.stdout, re.MULTILINE)[:2] == ["bad-1", "bad-2"]
    assert "bad-1.toml:9:1:" in found.stdout and "radios is an unknown key" in unfolded(found.stdout)
    assert len(re.findall(r"^PASS", found.stdout, re.MULTILINE)) == len(list(scenes.glob("*.toml"))) - 2


# ---- what it says and writes ----


def test_maxfail_stops_and_states_what_was_left(ref, scenes):
    found = ref("validate", scenes, "-j", "1", "--maxfail", "1", "--json", scenes / "v.out")
    assert (found.returncode, names_in(found)) == (1, ["ball", "empty-1"])
    assert "4 scenes: 1 pass, 1 fail, 2 not judged" in found.stdout
    verdict = strict_json(scenes / "v.out")
    assert (verdict["ok"], verdict["scene_count"], len(verdict["scenes"])) == (False, 4, 2)


def test_thorough_makes_further_checks_and_a_plain_run_says_that_it_does_not(ref, scenes):
    """Also where the plain verdict of the same scene is stored."""
    made = {}
    for words in ((), ("--thorough",)):
        found = ref("validate", scenes / "ball.toml", "--json", "-", *words)
        assert found.returncode == 0 and ("left out:   tests of our caster" in found.stderr) is (not words)
        made[words] = {check["name"] for check in json.loads(found.stdout)["scenes"][0]["checks"]}
    assert not Path("-").exists()
    assert made["--thorough",] - made[()] == {"routes", "scaling"}


def strict_json(path: Path):
    def refuse(constant):
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def test_out_holds_the_verdict_and_the_images_that_a_row_and_probe_are_about(ref, tmp_path):
    out, size = tmp_path / "out", ("--size", "15", "15")
    found = ref("validate", "scenes/shared-edges-cube.toml", *size, "--out", out)
    assert found.returncode == 0 and re.search(r"reference:  mitsuba [\d.]+, drjit [\d.]+, variant \w+", found.stdout)
    files = {f"shared-edges-cube.{which}.exr" for which in ("ours", "reference", "verdict")}
    assert {path.name for path in out.iterdir()} == {"verdict.json", *files}
    (scene,) = strict_json(out / "verdict.json")["scenes"]
    codes = read_exr(out / "shared-edges-cube.verdict.exr").channels["class.I"]
    assert np.bincount(codes.ravel(), minlength=len(CLASSES)).tolist() == list(scene["counts"].values())
    assert set(scene["counts"]) == set(CLASSES) and scene["size"] == [15, 15] and scene["resized"] is True
    assert scene["ok"] is True and scene["failures"] == [] and scene["problem"] == ""
    assert set(scene["files"]) == files
    made = {check["name"] for check in scene["checks"]}
    assert made >= {"placement", "camera", "sensor", "render", "knife_edges", "geometry"}
    ((mark, name, hit, agree, others),) = ROW.findall(found.stdout)
    counts = dict(re.findall(r"(\d+) ([a-z ]+)", others))  # pixels -> class
    assert (mark, name, int(hit)) == ("PASS", "shared-edges-cube", 225)
    assert int(agree) + sum(map(int, counts)) == 225 and "tie" in counts.values()
    y, x = map(int, np.argwhere(codes == CLASSES.index("tie"))[-1])
    probed = json.loads(ref("probe", "scenes/shared-edges-cube.toml", x, y, *size, "--json").stdout)
    assert (probed["verdict"], probed["ok"]) == ("tie", True)


def test_a_failure_is_in_json_and_junit_with_where_and_why(forks, unedited, tmp_path):
    tree = copy_tree(tmp_path / "tree", unedited)
    edit(
        tree,
        "caster/kernels/math/quadric_roots.py",
        "roots.near_error, t_min, t_max",
        "roots.near_error, -math.inf, t_max",
    )
    words = ["--json", tmp_path / "v.json", "--junit", tmp_path / "v.xml", "--out", tmp_path / "out"]
    words += ["--html", tmp_path / "html", "-j", "1"]
    files = ("scenes/inside-sphere.toml", "scenes/shared-edges-cube.toml")
    found = no_traceback(forks.run(tree, "validate", *files, *SIZE, *map(str, words), without=LONG_CHECKS))
    assert found.returncode == 1
    bad, good = strict_json(tmp_path / "v.json")["scenes"]
    assert (bad["ok"], good["ok"]) == (False, True)
    assert strict_json(tmp_path / "out/verdict.json")["scenes"] == [bad, good]
    first = bad["failures"][0]
    assert set(first) == {*(field.name for field in fields(Failure)), "replay"} and float(first["ratio"]) > 1e6
    assert any(failure["ratio"] == "inf" for failure in (*bad["failures"], *bad["worst_by"].values()))
    assert first["replay"].startswith("mitsuba-ref probe scenes/inside-sphere.toml ")
    assert first["verdict"] == "wrong" and re.match(r"(shell|ball), prim 0 \(inside\) at t ", first["exact"])
    suite = ElementTree.parse(tmp_path / "v.xml").getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("2", "1", "0")
    cases = {case.get("name"): case.find("failure") for case in suite.iter("testcase")}
    assert cases["shared-edges-cube"] is None and cases["inside-sphere"] is not None
    assert "replay:    mitsuba-ref probe scenes/inside-sphere.toml" in cases["inside-sphere"].text
    x, y = first["x"], first["y"]
    assert f"look:      {tmp_path}/html/index.html#s=inside-sphere&x={x}&y={y}\n" in found.stdout
    assert {file.name for file in (tmp_path / "html/data").iterdir()} == {"inside-sphere.js", "shared-edges-cube.js"}
    assert "2 scenes: 1 pass, 1 fail" in (tmp_path / "html/index.html").read_text(encoding="utf-8")


# ---- what it survives ----


def test_an_interruption_keeps_what_is_done_and_leaves_no_child(tmp_path):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    mark = f"caster-test-{os.getpid()}-{time.monotonic_ns()}"
    words = [sys.executable, "-P", "-m", "mitsuba_ref", "validate", "scenes", *SIZE, "-j", "2"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "CASTER_JIT": "0", "MARK": mark, "TMPDIR": str(temporary)}
    child = subprocess.Popen(
        [*words, "--json", str(tmp_path / "v.json")],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    late = threading.Timer(DEADLINE, child.kill)
    late.start()
    try:
        lines = []
        while not any(line.startswith("PASS") for line in lines):
            lines.append(child.stdout.readline())
            assert lines[-1], child.stderr.read()
        child.send_signal(signal.SIGINT)
        out, err = child.communicate()
    finally:
        late.cancel()
    assert child.returncode == 130, err
    *progress, last = err.splitlines()
    assert last == "interrupted", err
    assert all(line.startswith(("validating: ", "mitsuba-ref validate: loading ")) for line in progress), err
    done = strict_json(tmp_path / "v.json")
    rows = ROW.findall("".join(lines) + out)
    kept = [scene["name"] for scene in done["scenes"]]
    assert kept[: len(rows)] == [row[1] for row in rows]
    assert len(kept) - len(rows) in (0, 1)  # the signal may come between keeping a verdict and printing its row
    assert 0 < len(rows) < done["scene_count"] and done["ok"] is False and " not judged, in " in out
    assert list(temporary.iterdir()) == []
    assert [pid for pid in running_with(mark) if pid != child.pid] == []


def running_with(mark: str) -> list[int]:
    """Our processes that have the mark in their environment."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (folder / "environ").read_bytes():
                found.append(int(folder.name))
        except OSError:  # gone, or somebody else's
            continue
    return found


# ---- the other commands ----


STRICT = """
import sys, mitsuba as mi
mi.set_variant("scalar_rgb")
mi.logger().set_error_level(mi.LogLevel.Warn)
for file in sys.argv[1:]:
    scene = mi.load_file(file, optimize=False)
    print(len(scene.shapes()), len(scene.sensors()))
"""
PLAIN = ("every-shape", "transforms", "ellipsoids", "crop-window", "orthographic-clip", "two-sided")


def test_what_export_writes_loads_in_plain_mitsuba_without_a_warning(tmp_path, capsys):
    """One process loads them all; a camera that Mitsuba lacks is left out."""
    scenes, said = [*PLAIN, "fisheye"], []
    for scene in scenes:
        assert main(["export", f"scenes/{scene}.toml", "-o", str(tmp_path / scene), *SIZE]) == 0
        said.append(capsys.readouterr().out)
    loaded = printed_by("-c", STRICT, *(tmp_path / scene / "scene.xml" for scene in scenes), cwd=tmp_path)
    for scene, exported, line in zip(scenes, said, loaded.splitlines(), strict=True):
        shapes, sensors = map(int, line.split())
        assert f"{shapes} shapes, " in exported and sensors == (scene in PLAIN), scene

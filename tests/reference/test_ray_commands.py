"""--candidate: programs of any language that read rays and write hits; right ones pass, planted faults fail."""

import shutil
import subprocess
import sys

import pytest
from outputs import json_of
from places import ROOT

from mitsuba_ref.__main__ import main

pytestmark = pytest.mark.usefixtures("remembered")
EXAMPLES = ROOT / "mitsuba_ref/starters"
SCENE = """
[film]
width = 20
height = 16
[camera]
type = "pinhole"
eye = [0.5, 0.75, 4]
look_at = [0, 0, 0]
[[shape]]
type = "icosphere"
face_normals = true
[[shape]]
type = "rectangle"
to_world = [{ scale = 3 }, { translate = [0, 0, -2] }]
"""


def validate(tmp_path, command, *more, door="--candidate"):
    (tmp_path / "scene.toml").write_text(SCENE)
    words = ["validate", str(tmp_path / "scene.toml"), door, command, "--json", str(tmp_path / "v.json")]
    code = main([*words, *more])
    return code, json_of(tmp_path / "v.json")["scenes"][0]


def compiled(tmp_path, source):
    cc = shutil.which("cc")
    if cc is None:
        pytest.skip("no C compiler: cc")
    (tmp_path / "caster.c").write_text(source)
    shutil.copy(EXAMPLES / "c/rays_and_hits.h", tmp_path)
    subprocess.run(
        [cc, *["-O2", "-std=c99", "-Wall", "-Werror", "-o", "caster", "caster.c", "-lm"]], cwd=tmp_path, check=True
    )
    return f"{tmp_path / 'caster'} {{mesh}} {{rays}} {{hits}}"


def test_the_caster_in_c_passes_with_normals_and_prim_ids(tmp_path):
    code, scene = validate(tmp_path, compiled(tmp_path, (EXAMPLES / "c/mine.c").read_text()))
    assert code == 0, scene
    assert scene["precision"] == "float32" and scene["counts"]["agree"] > 100 and "shape_id" not in scene["unjudged"]


FAULTS = {
    "far root": ("t < best)", "(t > best || best == INFINITY))"),
    "another primitive": ("(float)j;", "(float)(j + 1);"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_planted_faults_in_the_caster_in_c_fail(tmp_path, fault):
    source = (EXAMPLES / "c/mine.c").read_text()
    assert FAULTS[fault][0] in source
    code, scene = validate(tmp_path, compiled(tmp_path, source.replace(*FAULTS[fault])))
    assert code == 1 and scene["counts"]["wrong"] > 0


@pytest.mark.slow("starts another language")
def test_the_caster_in_javascript_passes(tmp_path):
    if shutil.which("node") is None:
        pytest.skip("no JavaScript: node")
    code, scene = validate(tmp_path, f"node {EXAMPLES / 'javascript/mine.js'} {{mesh}} {{rays}} {{hits}}")
    assert code == 0 and scene["counts"]["agree"] > 100


BROKEN = {
    "writes nothing": ("pass", "cannot be read"),
    "too few bytes": ("open(sys.argv[2], 'wb').write(b'12345')", "expected bytes of"),
}


@pytest.mark.parametrize("which", BROKEN)
def test_programs_that_give_no_hits_fail_with_the_reason(tmp_path, which):
    source, words = BROKEN[which]
    (tmp_path / "p.py").write_text(f"import sys\n{source}\n")
    code, scene = validate(tmp_path, f"{sys.executable} {tmp_path / 'p.py'} {{rays}} {{hits}}")
    assert code == 1 and words in scene["problem"]


# ---- a program that stays ----


def served(tmp_path, source):
    """A Python program around `source`, which has `mesh` and `rays` of a request and n of them."""
    lines = [
        "import os, struct, sys, time",
        "log = open(sys.argv[1], 'a'); log.write('started '); log.flush()",
        "stdin, stdout = sys.stdin.buffer, sys.stdout.buffer",
        "def respond(data): stdout.write(struct.pack('<q', len(data)) + data); stdout.flush()",
        "while head := stdin.read(8):",
        "    mesh = stdin.read(struct.unpack('<q', head)[0])",
        "    rays = stdin.read(struct.unpack('<q', stdin.read(8))[0])",
        "    n = len(rays) // 32",
        f"    {source}",
    ]
    (tmp_path / "served.py").write_text("\n".join(lines) + "\n")
    return f"{sys.executable} {tmp_path / 'served.py'} {tmp_path / 'log'}"


ENDLESS = """import sys
import numpy as np
from caster import cast, load_scene

rays = np.fromfile(sys.argv[2], "<f8").reshape(-1, 8)
hits = cast(load_scene(sys.argv[1]), rays[:, :3], rays[:, 3:6])
np.column_stack([hits.t, hits.normal]).tofile(sys.argv[3])
"""
MISSES = "respond(struct.pack('<f', float('inf')) * n)"
NO_RESPONSE = {
    "crash": ("print('last words', file=sys.stderr); os.abort()", "SIGABRT: last words"),
    "end": ("sys.exit(0)", "ended before its response was whole; it printed nothing to standard error"),
    "silence": ("time.sleep(60)", "killed after 2 s"),
    "words": ("print('12345678 rays read', flush=True)", "starts with the bytes b'12345678'"),
    "too few": ("respond(b'1234')", "as an int64 4; expected the length of"),
    "too many": (f"{MISSES}; {MISSES}; time.sleep(9)", None),
    "declined": ("stdout.write(struct.pack('<q', -1)); stdout.flush()", "declined the scene"),
    "misses": (MISSES, None),
}


@pytest.mark.parametrize("which", NO_RESPONSE)
@pytest.mark.slow("each waits for a program to end", keep=1)
def test_a_program_that_stays_and_gives_no_hits_fails_with_the_reason(tmp_path, which):
    source, words = NO_RESPONSE[which]
    more = ("--candidate-timeout", "2")
    code, scene = validate(tmp_path, served(tmp_path, source), *more, door="--candidate-serve")
    assert code == 1 and not scene["ok"]
    assert words is None or words in scene["problem"], scene["problem"]
    assert scene["unsupported"] == (which == "declined")
    assert scene["replay"].count("--candidate-serve") == 1 and "--candidate " not in scene["replay"]


def test_one_process_answers_all_scenes_and_a_crash_starts_another(tmp_path):
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.toml").write_text(SCENE)
    files = [str(tmp_path / f"{name}.toml") for name in ("a", "b", "c")]
    main(["validate", *files, "-j", "1", "--candidate-serve", served(tmp_path, MISSES)])
    assert (tmp_path / "log").read_text().split() == ["started"]
    (tmp_path / "log").unlink()
    main(["validate", *files, "-j", "1", "--candidate-serve", served(tmp_path, "os.abort()")])
    assert (tmp_path / "log").read_text().split() == ["started"] * 4  # for three scenes, and for its limits


def test_limits_that_a_program_does_not_have_are_one_finding_of_the_run_and_can_be_stated(tmp_path, capsys):
    """Its hits within the scenes' limits are right: the scenes pass, and so does the run once that is stated."""
    program = tmp_path / "endless.py"
    program.write_text(ENDLESS)
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text(SCENE)
    words = ["validate", str(tmp_path / "a.toml"), str(tmp_path / "b.toml"), "--json", str(tmp_path / "v.json")]
    words += [
        "--junit",
        str(tmp_path / "j.xml"),
        "--candidate",
        f"{sys.executable} {program} {{toml}} {{rays}} {{hits}}",
    ]
    assert main([*words, "--candidate-precision", "float64"]) == 1
    found, out = json_of(tmp_path / "v.json"), capsys.readouterr().out
    assert [scene["ok"] for scene in found["scenes"]] == [True, True] and not found["ok"]
    assert [(check["name"], check["ok"]) for check in found["checks"]] == [("ray_limits", False)]
    assert out.count("expected t = inf, got 2; --no-limits states that") == 1 and "2 scenes: 2 pass, 0 fail" in out
    assert (tmp_path / "j.xml").read_text().count("<failure") == 1
    words.remove(str(tmp_path / "b.toml"))
    assert main([*words, "--candidate-precision", "float64", "--no-limits"]) == 0
    found = json_of(tmp_path / "v.json")
    assert found["ok"] and found["checks"] == [] and "--no-limits" in found["scenes"][0]["replay"]


# ---- the pages' glue around other libraries, and findings in them

GLUE = sorted((ROOT / "benchmarks/scoreboard/casters").glob("*.mjs"))
FINDINGS = sorted((ROOT / "docs/findings").glob("*.toml"))


def test_glue_in_javascript_has_the_syntax():
    if shutil.which("node") is None:
        pytest.skip("no JavaScript: node")
    for path in GLUE:
        subprocess.run(["node", "--check", str(path)], check=True)


def test_the_page_shows_the_glue_around_three_js_as_it_is():
    assert (ROOT / "benchmarks/scoreboard/casters/three.mjs").read_text() in (ROOT / "docs/candidates.md").read_text()


def test_ours_is_right_on_the_scenes_of_the_findings():
    assert len(FINDINGS) >= 12
    assert main(["validate", *map(str, FINDINGS), "-j", "1"]) == 0

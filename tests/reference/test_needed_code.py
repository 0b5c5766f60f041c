"""The code that a stored verdict depends on: that of its scene's shapes and camera, and all that is not of a kind."""

import json
import os
import subprocess
import sys

import pytest
from places import ROOT

from caster.scene.files import load_scene
from mitsuba_ref.runner.verdict_files import OF_KINDS, code_hash, modules_for, sources, verdict_key

CAMERA = '[film]\nwidth = 6\nheight = 5\n[camera]\ntype = "{}"\n{}\n'
EYE = "eye = [0.1, 0.2, 5]\nlook_at = [0, 0, 0]\n"
SHAPES = {
    "sphere": "",
    "disk": "",
    "cylinder": "",
    "torus": "",
    "icosphere": "",
    "cube": "",
    "plane": "normal = [0, 1, 0]\noffset = -1\n",
    "linear_curve": "points = [[-1, 0, 0], [1, 0, 0]]\nradius = 0.3\n",
}
CAMERAS = {"pinhole": EYE, "orthographic": EYE, "fisheye": EYE, "panorama": EYE}


def write(folder, shape="sphere", camera="pinhole"):
    path = folder / f"{shape}-{camera}.toml"
    path.write_text(CAMERA.format(camera, CAMERAS[camera]) + f'[[shape]]\ntype = "{shape}"\n{SHAPES[shape]}')
    return path


# Judges scenes without compiled kernels, so that each function that runs is seen; prints the modules by scene.
TRACER = """\
import json, sys, threading
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry, judge_entry
options = JudgeOptions(store=False)
ran = {}
for path in sys.argv[1:]:
    seen = ran[path] = set()
    def note(frame, event, argument):
        if event == "call" and frame.f_code.co_name != "<module>":
            seen.add(frame.f_globals.get("__name__", ""))
    threading.setprofile(note)
    sys.setprofile(note)
    verdict = judge_entry(SceneEntry("s", path), options)
    sys.setprofile(None)
    assert not verdict.problem, verdict.problem
print(json.dumps({path: sorted(seen) for path, seen in ran.items()}))
"""


@pytest.mark.slow("judges eleven scenes by plain Python")
def test_all_code_that_runs_is_needed(tmp_path):
    files = [write(tmp_path, shape) for shape in SHAPES] + [write(tmp_path, camera=each) for each in CAMERAS]
    command = [sys.executable, "-c", TRACER, *map(str, files)]
    run = subprocess.run(command, cwd=ROOT, env={**os.environ, "CASTER_JIT": "0"}, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    for path, modules in json.loads(run.stdout.splitlines()[-1]).items():
        needed = modules_for(load_scene(path))
        ran = {name for name in modules if f"{name}.".startswith(OF_KINDS)}
        names = {f"{name}.__init__" if f"{name}.__init__" in sources() else name for name in ran}
        assert ran and names <= needed, (path, names - needed)


ROUND = {"sphere", "cylinder", "linear_curve"}
EDITS = {  # the shapes and cameras whose scenes a module reaches
    "caster.shapes.torus": {"torus"},
    "caster.shapes.disk": {"disk"},
    "mitsuba_ref.shapes.linear_curve": {"linear_curve"},
    "caster.cameras.panorama": {"panorama"},
    "caster.kernels.math.quadric_roots": ROUND,
    "caster.kernels.triangles": {*SHAPES, *CAMERAS},
    "mitsuba_ref.shapes.__init__": {*SHAPES, *CAMERAS},
    "caster.cameras.__init__": {*SHAPES, *CAMERAS},
    "mitsuba_ref.judge.classification": {*SHAPES, *CAMERAS},
}


@pytest.mark.parametrize("module", EDITS)
def test_an_edit_changes_the_keys_of_what_it_reaches(module, tmp_path, monkeypatch):
    files = [write(tmp_path, shape) for shape in SHAPES] + [write(tmp_path, camera=each) for each in CAMERAS]
    scenes = {path.stem: load_scene(path) for path in files}
    before = {name: verdict_key(scene, str(tmp_path / f"{name}.toml")) for name, scene in scenes.items()}
    whole = code_hash()
    monkeypatch.setitem(sources(), module, sources()[module]._replace(digest="edited"))
    after = {name: verdict_key(scene, str(tmp_path / f"{name}.toml")) for name, scene in scenes.items()}
    changed = {name for name in scenes if before[name] != after[name]}
    assert changed == {name for name in scenes if EDITS[module] & set(name.split("-"))}
    assert code_hash() != whole

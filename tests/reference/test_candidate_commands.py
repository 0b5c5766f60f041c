"""Candidates that are programs: their input, their output, and each way to fail."""

import os
import shlex
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from outputs import json_of, unfolded
from places import ROOT, SCENES, shipped

import caster
from caster.description.errors import SceneError
from caster.image.channels import aovs_to_channels
from caster.image.exr import Exr
from caster.scene.model import Scene
from mitsuba_ref.__main__ import main
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import OUT_OF_DOMAIN, WRONG, SceneVerdict
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.report.verdict_text import failure_text
from mitsuba_ref.subjects.command import ExrFile, Program, answer_from_exr
from mitsuba_ref.subjects.requests import parse_candidate
from mitsuba_ref.subjects.subject import Answer, CastRequest, NoAnswer

PYTHON = shlex.quote(sys.executable)
RENDER = f"{PYTHON} -m caster render {{toml}} -o {{exr}} --aov depth,normal"

# A renderer of Mitsuba's own: the sensor of the XML, the intersections, and depth from the eye.
MITSUBA = """
import sys
import numpy as np
import mitsuba as mi
mi.set_variant("scalar_rgb")
from caster.image.exr import write_exr
scene = mi.load_file(sys.argv[1], optimize=False)
sensor = scene.sensors()[0]
width, height = sensor.film().crop_size()
eye = np.array(sensor.world_transform().translation(), np.float64).ravel()
depth, normal = np.full((height, width), np.inf), np.zeros((height, width, 3))
for y, x in np.ndindex(height, width):
    ray, _ = sensor.sample_ray(0, 0.5, mi.Point2f((x + 0.5) / width, (y + 0.5) / height), 0.5)
    si = scene.ray_intersect(ray)
    if si.is_valid():
        start = (np.array(ray.o, np.float64) - eye) @ np.array(ray.d, np.float64)
        depth[y, x], normal[y, x] = si.t + start, si.n
channels = {"depth.Z": depth, "A": np.isfinite(depth)}
write_exr(sys.argv[2], channels | {f"normal.{axis}": normal[..., c] for c, axis in enumerate("XYZ")})
"""


def small(name: str) -> Scene:
    return shipped(name, 16, 12)


def judged(command: str, scene: Scene, seconds: float = 60.0) -> SceneVerdict:
    return validate_scene(Task(scene, "scene", subject=parse_candidate(command, None, seconds)))


def judged_program(tmp_path, source: str, scene: Scene, words: str, seconds: float = 60.0) -> SceneVerdict:
    """The verdict on a Python program that is called with these words."""
    (tmp_path / "program.py").write_text(source)
    return judged(f"{PYTHON} {tmp_path / 'program.py'} {words}", scene, seconds)


# ---- right ----


@pytest.mark.parametrize("name", ["near-far-clip", "fisheye"])
def test_our_own_command_passes(name):
    found = judged(RENDER, small(name))
    assert found.ok, failure_text(found)
    assert found.precision == "float32" and any("own camera" in note for note in found.notes)


@pytest.mark.parametrize("name", ["every-shape", "orthographic-clip"])
def test_a_program_that_reads_the_xml_passes(tmp_path, name):
    found = judged_program(tmp_path, MITSUBA, small(name), "{xml} {exr}")
    assert found.ok, failure_text(found)


class OwnCamera:
    """Our own rendering, which casts rays of its own camera, without a program."""

    name, reads_xml, takes_rays = "own camera", False, False

    def answer(self, question: CastRequest) -> Answer:
        aovs = caster.render(question.traced, aovs=("depth", "normal"))
        channels = {name: values.astype(np.float32) for name, values in aovs_to_channels(aovs).items()}
        window = question.scene.film.window
        image = Exr(channels, {}, window, window)
        return answer_from_exr(image, question, ExrFile("", image, None))


@pytest.mark.parametrize(("size", "lost"), [(1e-3, True), (1.0, False)])
def test_what_is_smaller_than_the_cameras_rounding_is_out_of_domain(size, lost):
    """At (-830, -535, 2156) an eye is known to 5e-4."""
    turned = {"rotate": {"axis": [1, 2, 3], "degrees": 40}}
    place = [{"scale": size}, turned, {"translate": [-830.0, -535.0, 2156.0]}]
    ball = caster.Icosphere(subdivisions=1, face_normals=True, to_world=place)
    eye, aim = (-830.0004, -535.0003, 2156 + 3 * size), (-830.0004, -535.0003, 2156)
    camera = caster.Orthographic(eye=eye, look_at=aim, width=3 * size)
    scene = Scene(film=caster.Film(width=24, height=18), camera=camera, shapes=[ball])
    found = validate_scene(Task(scene, "scene", subject=OwnCamera()))
    assert found.ok and found.counts[WRONG] == 0, failure_text(found)
    assert (found.counts[OUT_OF_DOMAIN] > 0) is lost


def test_a_camera_that_the_xml_cannot_have_is_stated():
    found = judged(f"{PYTHON} -c pass {{xml}} {{exr}}", small("fisheye"))
    assert not found.ok and "Mitsuba has no fisheye camera, so the XML has none; read {toml}" in found.problem


# ---- wrong ----

WRITE = """
import sys
import numpy as np
from caster.image.exr import write_exr
exr, width, height = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
depth, normal = np.full((height, width), np.inf), np.zeros((height, width))
channels = {"depth.Z": depth, "A": np.isfinite(depth)} | {f"normal.{axis}": normal for axis in "XYZ"}
"""
SAVE = "\nwrite_exr(exr, channels)\n"
WORDS = "{exr} {width} {height} {toml}"

FAILING = [
    ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "the program was ended by SIGSEGV; it printed nothing"),
    ("print('no licence'); raise SystemExit(3)", "ended with exit code 3: no licence"),
    ("import time; print('slow', flush=True); time.sleep(60)", "killed after 1 s: slow"),
    ("pass", "ended well, but wrote no {exr}"),
    (WRITE + SAVE + "open(exr, 'r+').truncate(400)", "a damaged or truncated EXR"),
    (WRITE + "del channels['depth.Z']" + SAVE, "the image has no channel depth.Z"),
    (WRITE + "del channels['normal.Y']" + SAVE, "has normal.X, normal.Z, but not all of"),
    (WRITE + "channels = {n: a[:-1] for n, a in channels.items()}" + SAVE, "expected (0, 0, 16, 12) of the film"),
    (WRITE + "channels['A'] = 0 * normal + 1" + SAVE, "A and depth.Z contradict each other at 192 pixels"),
    (WRITE + "depth[2, 3] = np.nan" + SAVE, "at 1 pixels, first (3, 2): A is 0, depth nan"),
    (
        WRITE + "depth[2, 3] = 1.0; channels['A'] = np.where(np.isfinite(depth), np.nan, 0.0)" + SAVE,
        "at 1 pixels, first (3, 2): A is nan, depth 1",
    ),
    (
        "import sys, numpy as np, OpenEXR; h = np.ones((12, 16), np.float16)\n"
        "OpenEXR.File({}, {'depth.Z': h}).write(sys.argv[1])",
        "channel depth.Z holds float16, expected float32",
    ),
]


@pytest.mark.parametrize(("program", "says"), FAILING, ids=[says for _, says in FAILING])
@pytest.mark.slow("each judges a film", keep=5)
def test_no_image_to_judge_is_a_problem_and_never_a_pass(tmp_path, program, says):
    found = judged_program(tmp_path, program, small("one-sphere"), WORDS, 1.0 if "sleep" in program else 60.0)
    assert not found.ok and says in found.problem and "FAIL" in failure_text(found)


def test_an_image_that_misses_everything_fails(tmp_path):
    found = judged_program(tmp_path, WRITE + SAVE, small("one-sphere"), WORDS)
    assert found.counts[WRONG] == found.hit_pixels > 50
    assert found.findings[0].what == "the candidate misses everything"


def test_an_image_whose_depth_is_off_by_a_hundred_thousandth_fails(tmp_path):
    """Rounding of its own camera excuses far less."""
    program = (
        "import sys\nfrom caster.__main__ import main\nfrom caster.image.exr import read_exr, write_exr\n"
        "assert main(['render', sys.argv[1], '-o', sys.argv[2], '--aov', 'depth,normal']) == 0\n"
        "exr = read_exr(sys.argv[2]); exr.channels['depth.Z'] *= 1.00001; write_exr(sys.argv[2], exr.channels)\n"
    )
    found = judged_program(tmp_path, program, small("cornell-box"), "{toml} {exr}")
    assert found.counts[WRONG] > 0.9 * found.hit_pixels, failure_text(found)


# ---- what cannot be asked ----

UNASKABLE = [
    ("nothing.py:trace", "there is no module nothing: looked in "),
    ("math:pi", "expected a function, got float"),
    ("true {xml}", "expected {exr}, the file to write"),
    ("true {xml} {exr} {samples}", "{samples} stands for nothing"),
    ("true '{xml} {exr}", "No closing quotation"),
    ("true {xml} {exr:d}", "expected {exr}, the file to write"),
    ("true {rays} {mesh}", "expected {rays}, the file to read, {hits}, that to write"),
    ("true {rays} {hits} {width}", "expected {rays}, the file to read, {hits}, that to write"),
    ("true {exr}", "{xml} or {toml}, the scene"),
]


@pytest.mark.parametrize(("text", "says"), UNASKABLE, ids=[text for text, _ in UNASKABLE])
def test_what_cannot_be_requested_is_stated_before_any_work(text, says):
    with pytest.raises(SceneError) as caught:
        parse_candidate(text)
    assert says in str(caught.value) and "--candidate" in str(caught.value)


@pytest.mark.parametrize("blanks", ["", " ", "\n \t"])
def test_a_served_program_of_blanks_is_refused(blanks):
    with pytest.raises(SceneError, match="got blanks alone"):
        parse_candidate(blanks, served=True)


def test_a_program_ends_with_the_run_that_started_it(tmp_path):
    """Ctrl-C reaches the judge alone, which then ends the program."""
    (tmp_path / "program.py").write_text(f"open({str(tmp_path / 'started')!r}, 'w')\nimport time; time.sleep(60)")
    command = f"{PYTHON} {tmp_path / 'program.py'} {{exr}} {{toml}}"
    found: list[SceneVerdict] = []
    work = threading.Thread(target=lambda: found.append(judged(command, small("one-sphere"))))
    work.start()
    try:
        while not (tmp_path / "started").exists() and work.is_alive():
            time.sleep(0.01)
        subprocess_runner.kill_subprocesses()
        work.join(10.0)
    finally:
        subprocess_runner.allow_subprocesses()
    assert not work.is_alive() and "ended by SIGKILL" in found[0].problem


def test_a_program_is_not_run_by_a_shell():
    scene = small("one-sphere")
    found = judged(f"{PYTHON} -c 'import sys; sys.exit(sys.argv[1])' '$HOME;' {{exr}} {{toml}}", scene)
    assert "exit code 1: $HOME;" in found.problem


ENDS = """
import atexit, ctypes, multiprocessing, os, time
import numpy as np
def exits_in_c(scene, o, d):
    ctypes.CDLL(None).exit(0)
def crashes(scene, o, d):
    ctypes.string_at(0)
def leaves_a_fork(scene, o, d):
    if os.fork():
        os._exit(3)
    time.sleep(600)
def exits_later(scene, o, d):
    atexit.register(os._exit, 0)
    return np.full(len(o), np.inf), o
def starts_processes(scene, o, d):
    os.write(1, b"printed in C")
    child = multiprocessing.Process(target=print)
    child.start()
    child.join()
    return np.full(len(o), np.inf), o
def never_ends(scene, o, d):
    print("sleeping", flush=True)
    while True:
        try:
            time.sleep(600)
        except BaseException:
            pass
"""


SUPERVISED = {  # function -> exit code, a part of standard error
    "exits_in_c": (1, "the candidate ended the process, and nothing is judged: exit code 0"),
    "crashes": (1, "with --engine dask -j 1 it ends one scene"),
    "leaves_a_fork": (1, "nothing is judged: exit code 3"),
    "exits_later": (1, ""),
    "starts_processes": (1, "printed in C"),
    "never_ends": (130, "interrupted"),
}


@pytest.mark.parametrize("function", SUPERVISED)
def test_however_a_function_ends_the_process_it_is_no_pass_and_leaves_no_earlier_verdict(tmp_path, function):
    (tmp_path / "ends.py").write_text(ENDS)
    earlier = tmp_path / "verdict.json"
    earlier.write_text('{"ok": true}')
    os.utime(earlier, (0, 0))
    words = ["validate", str(ROOT / "scenes/one-sphere.toml"), "--size", "8", "8", "--json", str(earlier)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])}
    started = subprocess.Popen(
        [sys.executable, "-m", "mitsuba_ref", *words, "--candidate", f"ends:{function}"],
        env=environment,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    if function == "never_ends":
        for line in started.stderr:
            if "sleeping" in line:
                break
        started.terminate()
    out, said = started.communicate(timeout=60)
    code, reason = SUPERVISED[function]
    assert started.returncode == code and reason in said and "printed in C" not in out
    assert not earlier.exists() or not json_of(earlier)["ok"]


def test_a_program_that_leaves_another_behind_is_not_waited_for(tmp_path):
    """The second program keeps the output file open."""
    (tmp_path / "leaves.sh").write_text("sleep 600 &\necho said\nexit 3\n")
    with pytest.raises(NoAnswer, match=r"(?s)exit code 3.*said"):
        Program("leaves", ("sh", str(tmp_path / "leaves.sh")), None, 60.0).run({})


# ---- an image in another program's names and conventions ----

BLENDER = """
import subprocess, sys
import numpy as np
import caster
from caster.image.exr import read_exr, write_exr
from caster.rendering.images import camera_rays
factor, words = float(sys.argv[3]), ["-o", sys.argv[2], "--aov", "depth,normal"]
subprocess.run([sys.executable, "-m", "caster", "render", sys.argv[1], *words], check=True)
exr, scene = read_exr(sys.argv[2]), caster.load_scene(sys.argv[1])
d = camera_rays(scene).d
axis = np.array(scene.camera.direction)
cosine = d @ axis / np.linalg.norm(axis) / np.linalg.norm(d, axis=1)
depth = exr.channels["depth.Z"]
z = np.where(np.isinf(depth), 1e10, factor * depth * cosine.reshape(depth.shape)).astype(np.float32)
channels = {"ViewLayer." + name.replace("normal", "Normal"): a for name, a in exr.channels.items() if "normal" in name}
write_exr(sys.argv[2], channels | {sys.argv[4]: z})
"""


def blender(tmp_path, capsys, *options, factor="1", depth="ViewLayer.Depth.Z", scene="cornell-box"):
    (tmp_path / "blender.py").write_text(BLENDER)
    command = f"{PYTHON} {tmp_path / 'blender.py'} {{toml}} {{exr}} {factor} {depth}"
    words = ["validate", str(SCENES / f"{scene}.toml"), "--size", "16", "12", "--candidate", command]
    code = main([*words, *options])
    found = capsys.readouterr()
    return code, found.out, found.err


@pytest.mark.slow("judges a film four times")
def test_depth_along_z_and_names_of_another_program_are_read_as_compare_reads_them(tmp_path, capsys):
    stated = ("--depth", "z", "--miss", "1e10")
    assert blender(tmp_path, capsys, *stated)[0] == 0
    code, out, _ = blender(tmp_path, capsys, "--miss", "1e10")
    assert code == 1 and "depth along z" in out and "--depth z" in out
    assert blender(tmp_path, capsys, "--depth", "z", scene="one-sphere")[0] == 1  # of a miss, 1e10 is a hit
    assert blender(tmp_path, capsys, *stated, "--map", "depth=somewhere.V", depth="somewhere.V")[0] == 0
    code, out, _ = blender(tmp_path, capsys, *stated, depth="somewhere.V")
    assert code == 1 and "has no channel depth.Z" in unfolded(out)


@pytest.mark.slow("judges a film several times")
def test_what_is_read_so_is_judged_all_the_same(tmp_path, capsys):
    """A depth off by a ten thousandth fails, and the replay reads its image in the same way."""
    code, out, _ = blender(tmp_path, capsys, "--depth", "z", "--miss", "1e10", factor="1.0001")
    assert code == 1 and " --depth z --miss 1e10" in next(line for line in out.splitlines() if "replay:" in line)


def test_options_about_images_need_a_command_that_writes_some(capsys):
    assert main(["validate", str(SCENES / "one-sphere.toml"), "--depth", "z"]) == 2
    assert "--depth: expected --candidate X beside it" in capsys.readouterr().err
    assert main(["validate", str(SCENES / "one-sphere.toml"), "--map", "a=b", "--candidate", "os:getcwd"]) == 2
    assert "--map: expected a --candidate with {exr} beside it" in capsys.readouterr().err

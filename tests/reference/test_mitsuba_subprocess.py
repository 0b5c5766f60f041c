"""Whatever becomes of Mitsuba's process is a result here, and nothing of it is left behind."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mitsuba_scenes import job, random_mesh, shape, write

from mitsuba_ref.reference import messages, mitsuba_process, subprocess_runner
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse

ROOT = Path(__file__).resolve().parents[2]
MESH = '<shape type="ply" id="strewn"><string name="filename" value="strewn.ply"/></shape>'
OLD_LLVM = Path("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1")  # aborts at an instruction it lacks
HANG = """
import os, subprocess, sys, time
print("grandchild", subprocess.Popen(["sleep", "600"]).pid, flush=True)
open({pids!r}, "w").write(str(os.getpid()))
time.sleep(600)
"""


@pytest.fixture
def ball(tmp_path) -> TraceRequest:
    return job(write(tmp_path, shape("sphere", "ball", 0)), "scalar_rgb", [[0, 0, 5]], [[0, 0, -1]])


@pytest.fixture(autouse=True)
def left_behind(tmp_path, monkeypatch):
    """No test may leave a temporary file or a child."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setattr(subprocess_runner, "_running", set())  # those of other tests stay
    yield
    assert list(folder.iterdir()) == [] and not subprocess_runner._running


@pytest.fixture
def in_place_of_mitsuba(tmp_path, monkeypatch) -> Callable[[str], None]:
    """A module mitsuba of our own, which the worker's child imports."""

    def plant(source: str) -> None:
        folder = tmp_path / "fake"
        folder.mkdir(exist_ok=True)
        (folder / "mitsuba.py").write_text(source)
        monkeypatch.setenv("PYTHONPATH", str(folder))

    return plant


def crash(ball: TraceRequest, timeout: float = 60) -> Crash:
    answer = mitsuba_process.send_alone(ball, timeout)
    assert isinstance(answer, Crash), answer
    return answer


def gone(pid: int) -> bool:
    """Whether the process is no more; one that is dead and not yet collected is gone, too."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def wait_for(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline, "it never came to that"
        time.sleep(0.01)


def test_a_scene_is_answered(ball):
    answer = mitsuba_process.send_alone(ball)
    assert isinstance(answer, TraceResponse)
    assert answer.t.tolist() == [4.0] and answer.names == ["ball"]


def test_an_abort_is_a_result_with_its_words(ball, in_place_of_mitsuba):
    in_place_of_mitsuba("import os; print('\\x1b[31mLLVM ERROR: Cannot\\x1b[0m', flush=True); os.abort()")
    found = crash(ball)
    assert (found.kind, found.exit, found.output) == ("abort", "SIGABRT", "LLVM ERROR: Cannot")


@pytest.mark.skipif(not OLD_LLVM.exists(), reason=f"{OLD_LLVM} is not installed; the planted abort stands in")
def test_a_real_abort_in_an_old_libllvm_is_a_result(tmp_path, monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(OLD_LLVM))
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path))  # a kernel from another libLLVM would hide it
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    random_mesh(tmp_path / "strewn.ply", np.random.default_rng(1))
    found = mitsuba_process.send_alone(job(write(tmp_path, MESH), "llvm_ad_rgb", [[0, 0, 5]], [[0, 0, -1]]), 60)
    assert isinstance(found, Crash), "it was to abort"
    assert (found.kind, found.exit) == ("abort", "SIGABRT")
    assert "fminimum" in found.headline and len(found.output) <= 4200


def test_a_worker_killed_in_the_middle_of_its_rays_is_a_result(tmp_path):
    """Killed once Mitsuba is loaded and the rays are under way: a million take two seconds and more."""
    random_mesh(tmp_path / "strewn.ply", np.random.default_rng(1))
    o, d = (np.tile([0, 0, z], (10**6, 1)) for z in (5, -1))
    question = job(write(tmp_path, MESH), "scalar_rgb", o, d)

    def kill() -> None:
        wait_for(lambda: subprocess_runner._running)
        (pid,) = subprocess_runner._running
        wait_for(lambda: "/ply.so" in Path(f"/proc/{pid}/maps").read_text())
        time.sleep(0.5)
        os.kill(pid, signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    found = mitsuba_process.send_alone(question, 60)
    thread.join()
    assert isinstance(found, Crash), found
    assert (found.kind, found.exit) == ("signal", "SIGKILL")


def test_a_segfault_is_a_result(ball, in_place_of_mitsuba):
    in_place_of_mitsuba("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    found = crash(ball)
    assert (found.kind, found.exit) == ("signal", "SIGSEGV")


def test_a_hang_ends_in_time_and_leaves_no_process(ball, in_place_of_mitsuba, tmp_path):
    in_place_of_mitsuba(HANG.format(pids=str(tmp_path / "pid")))
    start = time.monotonic()
    found = crash(ball, timeout=2)
    assert (found.kind, found.exit) == ("timeout", "killed after 2 s")
    assert time.monotonic() - start < 5
    wait_for(lambda: gone(int((tmp_path / "pid").read_text())))
    wait_for(lambda: gone(int(found.output.removeprefix("grandchild "))))


def test_a_waiting_request_gets_a_crash_when_all_are_stopped(ball, in_place_of_mitsuba, tmp_path):
    in_place_of_mitsuba(HANG.format(pids=str(tmp_path / "pid")))
    found: list[TraceResponse | Crash] = []
    threads = [threading.Thread(target=lambda: found.append(mitsuba_process.send_alone(ball, 60))) for _ in range(2)]
    for thread in threads:
        thread.start()
    wait_for(lambda: len(subprocess_runner._running) == 2)
    subprocess_runner.kill_subprocesses()
    try:
        for thread in threads:
            thread.join(10)
        assert [answer.exit for answer in found] == ["SIGKILL", "SIGKILL"]
        late = mitsuba_process.send_alone(ball, 60)
        assert isinstance(late, Crash) and "before it began" in late.output
    finally:
        subprocess_runner.allow_subprocesses()


ASK = """
import sys
from pathlib import Path
from mitsuba_ref.reference import mitsuba_process
from mitsuba_ref.reference.messages import TraceRequest
mitsuba_process.send_alone(TraceRequest.read(Path(sys.argv[1])), 60)
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_child_goes_with_the_one_that_requested(ball, in_place_of_mitsuba, tmp_path, how):
    in_place_of_mitsuba(HANG.format(pids=str(tmp_path / "pid")))
    ball.write(tmp_path)
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{os.environ['PYTHONPATH']}"}
    environment["TMPDIR"] = str(tmp_path / "asked")
    (tmp_path / "asked").mkdir()
    asking = subprocess.Popen([sys.executable, "-c", ASK, tmp_path], env=environment, stderr=subprocess.PIPE)
    wait_for(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
    pid = int((tmp_path / "pid").read_text())
    asking.send_signal(how)
    words = asking.communicate(timeout=30)[1]
    try:
        wait_for(lambda: gone(pid))
    finally:  # where nobody was left to do it
        subprocess_runner._kill_group(pid)
    if how == signal.SIGINT:
        assert b"KeyboardInterrupt" in words
        assert list((tmp_path / "asked").iterdir()) == []


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("<shape", "Error parsing start element"),
        ('<shape type="spere"/>', 'Plugin "spere" not found'),
        ('<shape type="sphere"><float name="radus" value="1"/></shape>', "radus"),
        ('<shape type="ply"><string name="filename" value="missing.ply"/></shape>', "missing.ply"),
    ],
)
def test_a_scene_that_mitsuba_refuses_gets_its_words(tmp_path, content, says):
    found = crash(job(write(tmp_path, content), "scalar_rgb", [[0, 0, 5]], [[0, 0, -1]]))
    assert (found.kind, found.exit) == ("error", "exit code 1")
    assert says in found.output and "Traceback" not in found.output


def test_a_warning_is_an_error(tmp_path):
    """Mitsuba would go on with a sphere of another size."""
    xml = write(tmp_path, shape("sphere", "egg", 0, stretch="2 1 1"))
    assert "non-uniform scaling" in crash(job(xml, "scalar_rgb", [[0, 0, 5]], [[0, 0, -1]])).headline


def test_a_missing_file_and_an_unknown_variant_are_refused(tmp_path, ball):
    assert "file does not exist" in crash(job(tmp_path / "nope.xml", "scalar_rgb", [[0, 0, 5]], [[0, 0, -1]])).output
    assert "unsupported variant" in crash(TraceRequest(ball.xml, "scalar_rgbx", ball.o, ball.d, ball.t_max)).output


@pytest.mark.parametrize(
    ("does", "says"),
    [
        ("pass", "No such file"),
        ("(folder / 'answer.json').write_text('{')", "JSONDecodeError"),
        ("(folder / 'answer.json').write_text('[]')", "TypeError"),
        ("(folder / 'answer.npz').unlink()", "No such file"),
        ("(folder / 'answer.npz').write_bytes((folder / 'answer.npz').read_bytes()[:-200])", "no whole answer"),
        ("(folder / 'answer.npz').write_bytes(b'')", "no whole answer"),
        ("change(t=whole['t'][:-1])", "t: expected float32[2], got float32[1]"),
        ("change(**{name: value[:1] for name, value in whole.items()})", "expected float32[2], got float32[1]"),
        ("change(n=whole['n'].astype(float))", "n: expected float32[2, 3], got float64[2, 3]"),
        ("change(light_visible=whole['light_visible'][:, :1])", "light_visible: expected bool[0, 2]"),
        ("change(shape=whole['shape'] + 1)", "shape: expected"),
        ("change(shape=whole['shape'] - 1)", "shape: expected"),
        ("change(surprise=whole['t'])", "surprise"),
        ("del whole['uv']; change()", "uv"),
        ("change(sensor_o=np.zeros((2, 3), np.float32))", "sensor_d: expected float32[2, 3], got NoneType"),
    ],
)
@pytest.mark.slow("each starts a process", keep=4)
def test_an_answer_that_is_not_whole_is_garbage(tmp_path, does, says):
    """The child ends well, with exit code 0."""
    program = f"""
import sys, numpy as np
from pathlib import Path
from mitsuba_ref.reference import mitsuba_process as worker
folder = Path(sys.argv[-1])
def change(**arrays):
    np.savez(folder / "answer.npz", **(whole | arrays))
if {does!r} != "pass":
    assert worker.main(folder) == 0
    with np.load(folder / "answer.npz") as arrays:
        whole = dict(arrays)
{does}
print("done")
"""
    xml = write(tmp_path, shape("sphere", "ball", 0))
    question = job(xml, "scalar_rgb", [[0, 0, 5], [0, 0, 5]], [[0, 0, -1], [0, 0, 1]])
    found = messages.run_request(question, 60, command=[sys.executable, "-c", program])
    assert isinstance(found, Crash), found
    assert (found.kind, found.exit) == ("garbage", "exit code 0"), found.output
    assert says in found.output and found.output.startswith("done")


def test_a_child_with_a_bug_is_an_error_with_its_traceback(ball, in_place_of_mitsuba):
    in_place_of_mitsuba("1 / 0")
    found = crash(ball)
    assert (found.kind, found.exit) == ("error", "exit code 1")
    assert found.output.splitlines()[-1] == "ZeroDivisionError: division by zero"


def test_a_flood_of_words_is_kept_at_both_ends(ball, in_place_of_mitsuba):
    in_place_of_mitsuba("print('Error: the first'); print('x' * 10**6); raise SystemExit('the last')")
    found = crash(ball)
    assert found.output.startswith("Error: the first") and found.output.endswith("the last")
    assert len(found.output) < 5000 and found.headline == "Error: the first"


@pytest.mark.parametrize("path", [None, "", ".", os.pathsep])
def test_a_users_own_mitsuba_py_in_the_current_folder_is_not_imported(ball, tmp_path, monkeypatch, path):
    (tmp_path / "mitsuba.py").write_text("raise SystemExit('the wrong one')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    if path is not None:
        monkeypatch.setenv("PYTHONPATH", path)
    answer = mitsuba_process.send_alone(TraceRequest(Path("scene.xml"), "scalar_rgb", ball.o, ball.d, ball.t_max))
    assert isinstance(answer, TraceResponse), answer


def test_asking_imports_no_mitsuba_and_the_child_nothing_slow():
    program = "import sys; from mitsuba_ref.reference import mitsuba_process; print(*sys.modules)"
    asking = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not {"mitsuba", "drjit", "numba", "pydantic"} & set(asking.stdout.split())
    program = "import sys; from mitsuba_ref.reference import mitsuba_calls, mitsuba_process; print(*sys.modules)"
    child_side = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not {"numba", "pydantic", "OpenEXR", "caster.scene", "caster.kernels"} & set(child_side.stdout.split())


def test_a_job_and_its_rays_survive_the_disk_bit_for_bit(tmp_path):
    rng = np.random.default_rng(7)
    bits = rng.integers(0, 2**32, (100, 7), np.uint32).view(np.float32)
    question = TraceRequest(tmp_path / "a.xml", "scalar_rgb", bits[:, :3], bits[:, 3:6], bits[:, 6])
    question.write(tmp_path)
    again = TraceRequest.read(tmp_path)
    assert json.loads((tmp_path / "job.json").read_text())["xml"] == str(tmp_path / "a.xml") == str(again.xml)
    for name in TraceRequest.ROWS:
        assert getattr(question, name).tobytes() == getattr(again, name).tobytes()


def test_rays_that_are_not_float32_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"d: expected float32\[1, 3\], got float64\[1, 3\]"):
        TraceRequest(tmp_path, "scalar_rgb", np.zeros((1, 3), np.float32), np.zeros((1, 3)), np.zeros(1, np.float32))

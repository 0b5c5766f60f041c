"""Every end of a Mitsuba process is a result, every request is answered, and nothing is left behind."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from mitsuba_scenes import job, shape, write
from places import ROOT

from mitsuba_ref.reference import messages, mitsuba_process, subprocess_runner
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse

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
    mitsuba_process.close_residents()
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setattr(subprocess_runner, "_running", set())  # those of other tests stay
    yield
    mitsuba_process.close_residents()
    assert list(folder.iterdir()) == [] and not subprocess_runner._running


@pytest.fixture
def in_place_of_mitsuba(tmp_path, monkeypatch) -> Callable[[str], None]:
    """A module mitsuba of our own, which the child imports."""

    def plant(source: str) -> None:
        folder = tmp_path / "fake"
        folder.mkdir(exist_ok=True)
        (folder / "mitsuba.py").write_text(source)
        monkeypatch.setenv("PYTHONPATH", str(folder))

    return plant


def crash(ball: TraceRequest, timeout: float = 60) -> Crash:
    answer = messages.run_request(ball, timeout, {})
    assert isinstance(answer, Crash), answer
    return answer


def gone(pid: int) -> bool:
    """Whether a process has ended; a zombie has, too."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def wait_for(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline, "it never came to that"
        time.sleep(0.01)


# ---- one request, one process


@pytest.mark.parametrize(
    ("source", "exit_", "output"),
    [
        ("import os; print('\\x1b[31mLLVM ERROR\\x1b[0m', flush=True); os.abort()", "SIGABRT", "LLVM ERROR"),
        ("import os; os._exit(0)", "exit code 0", ""),
        ("raise ImportError('no such variant')", "exit code 1", "no such variant"),
    ],
)
def test_each_end_is_a_result_with_its_output(ball, in_place_of_mitsuba, source, exit_, output):
    in_place_of_mitsuba(source)
    found = crash(ball)
    assert found.exit == exit_
    assert found.output.splitlines()[-1:] == ([output] if output else [])


def test_a_hang_ends_in_time_and_leaves_no_process(ball, in_place_of_mitsuba, tmp_path):
    in_place_of_mitsuba(HANG.format(pids=str(tmp_path / "pid")))
    start = time.monotonic()
    found = crash(ball, timeout=1)
    assert found.exit.startswith("killed after 1")
    assert time.monotonic() - start < 4
    wait_for(lambda: gone(int((tmp_path / "pid").read_text())))
    wait_for(lambda: gone(int(found.output.removeprefix("grandchild "))))


def test_a_waiting_request_gets_a_crash_when_all_are_stopped(ball, in_place_of_mitsuba, tmp_path):
    in_place_of_mitsuba(HANG.format(pids=str(tmp_path / "pid")))
    found: list[Crash] = []
    threads = [threading.Thread(target=lambda: found.append(crash(ball))) for _ in range(2)]
    for thread in threads:
        thread.start()
    wait_for(lambda: len(subprocess_runner._running) == 2)
    subprocess_runner.kill_subprocesses()
    try:
        for thread in threads:
            thread.join(10)
        assert [answer.exit for answer in found] == ["SIGKILL", "SIGKILL"]
        assert "before it began" in crash(ball).output
    finally:
        subprocess_runner.allow_subprocesses()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("<shape", "Error parsing start element"),
        (shape("sphere", "egg", 0, stretch="2 1 1"), "non-uniform scaling"),  # Mitsuba alone would only warn
    ],
)
def test_a_scene_that_mitsuba_refuses_gets_its_words(tmp_path, content, says):
    found = crash(job(write(tmp_path, content), "scalar_rgb", [[0, 0, 5]], [[0, 0, -1]]))
    assert found.exit == "exit code 1"
    assert says in found.output and "Traceback" not in found.output


def test_a_flood_of_output_is_kept_at_both_ends(ball, in_place_of_mitsuba):
    in_place_of_mitsuba("print('Error: the first'); print('x' * 10**6); raise SystemExit('the last')")
    found = crash(ball)
    assert found.output.startswith("Error: the first") and found.output.endswith("the last")
    assert len(found.output) < 5000 and found.headline == "Error: the first"


def test_a_users_own_mitsuba_py_in_the_current_folder_is_not_imported(ball, here, monkeypatch):
    (here / "mitsuba.py").write_text("raise SystemExit('the wrong one')")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    for path in ("", ".", os.pathsep):
        monkeypatch.setenv("PYTHONPATH", path)
        assert subprocess_runner.import_path() == "", path
    answer = messages.run_request(ball, 60, {})
    assert isinstance(answer, TraceResponse), answer


# ---- requests and responses as bytes


def test_a_request_and_its_rays_come_back_bit_for_bit(tmp_path):
    bits = np.random.default_rng(7).integers(0, 2**32, (100, 7), np.uint32).view(np.float32)
    named = {"array": {"array": "any name"}}
    request = TraceRequest(tmp_path / "a.xml", "scalar_rgb", bits[:, :3], bits[:, 3:6], bits[:, 6], original=named)
    again = messages.message_of(request.to_bytes())
    assert again.xml == str(request.xml) and again.original == named
    for name in ("o", "d", "t_max"):
        assert getattr(request, name).tobytes() == getattr(again, name).tobytes()


def test_a_response_that_is_not_whole_is_refused(ball, tmp_path):
    response = mitsuba_process.send_request(ball)
    whole = response.to_bytes()
    (tmp_path / "arrays.npz").write_bytes(whole)
    arrays = dict(np.load(tmp_path / "arrays.npz"))
    fields = json.loads(arrays["record"].tobytes())

    def changed(**changes: object) -> bytes:
        np.savez(tmp_path / "changed.npz", **{name: a for name, a in (arrays | changes).items() if a is not None})
        return (tmp_path / "changed.npz").read_bytes()

    records = (np.frombuffer(text, np.uint8) for text in (b"", b"null", b"{}"))
    for content in (
        b"",
        whole[:-200],
        changed(**{fields["t"][messages.ARRAY]: None}),
        *(changed(record=each) for each in (None, *records)),
    ):
        with pytest.raises(ValueError, match="no whole answer"):
            messages.message_of(content)
    with pytest.raises(ValueError, match="no whole answer: ValueError: shape: expected one of the named"):
        messages.message_of(changed(**{fields["shape"][messages.ARRAY]: np.array([1], np.int32)}))


# ---- a process that stays


FAULTY = """
import os, signal, sys, time
from mitsuba_ref.reference import mitsuba_process
from mitsuba_ref.reference.subprocess_runner import serve
pipe, count = os.dup(1), 0
def faulty(request):
    global count
    count += 1
    if count == {at}:
        {fault}
    return mitsuba_process.respond(request)
serve(faulty, 60)
"""
FAULTS = {
    "abort": "print('LLVM ERROR', flush=True); os.abort()",
    "killed": "os.kill(os.getpid(), signal.SIGKILL)",
    "quiet end": "os._exit(0)",
    "a length without end": "os.write(pipe, b'\\xff' * 9)",
    "noise": "os.write(pipe, b'noise\\n' + bytes(100))",
    "half a response": "return mitsuba_process.respond(request)[:-200]",
    "hang": "time.sleep(600)",
}


@pytest.fixture
def plant(monkeypatch):
    """Have each resident process do something else when it gets its request number `at`, from 1."""

    def planted(fault: str, at: int = 2) -> None:
        program = (sys.executable, "-c", FAULTY.format(fault=fault, at=at))
        place = {"PYTHONPATH": subprocess_runner.import_path()}
        begin = subprocess_runner.ResidentProcess
        monkeypatch.setattr(mitsuba_process, "start", lambda settings: begin(program, settings | place))

    return planted


@pytest.fixture
def alone(monkeypatch) -> list[TraceRequest]:
    """Requests that got a process of their own."""
    sent: list[TraceRequest] = []
    run = messages.run_request

    def noted(request, timeout, environment):
        sent.append(request)
        return run(request, timeout, environment)

    monkeypatch.setattr(messages, "run_request", noted)
    return sent


def balls(tmp_path: Path, count: int) -> list[TraceRequest]:
    """Requests whose responses differ: spheres farther and farther away."""
    requests = []
    for i in range(count):
        folder = tmp_path / str(i)
        folder.mkdir()
        xml = write(folder, shape("sphere", f"ball{i}", 0))
        requests.append(job(xml, "scalar_rgb", [[0, 0, 5 + i], [9, 0, 5]], [[0, 0, -1], [0, 0, -1]]))
    return requests


def check_right(responses) -> None:
    for i, response in enumerate(responses):
        assert isinstance(response, TraceResponse), response
        assert response.t.tolist() == [4.0 + i, np.inf] and response.names == [f"ball{i}"]


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.slow("each starts Mitsuba three times", keep=1)
def test_a_fault_amid_many_requests_loses_nothing(tmp_path, plant, alone, fault):
    plant(FAULTS[fault])
    requests = balls(tmp_path, 3)
    timeouts = (60, 6 if fault in ("hang", "noise", "a length without end") else 60, 60)
    check_right([mitsuba_process.send_request(*each) for each in zip(requests, timeouts, strict=True)])
    assert alone == requests[1:2]


def test_what_a_scene_makes_of_every_process_is_its_result(tmp_path, in_place_of_mitsuba, monkeypatch):
    """A crash caused by the scene is reported from the second process; a later scene is answered."""
    first, second = balls(tmp_path, 2)
    in_place_of_mitsuba("import os; print('LLVM ERROR: Cannot', flush=True); os.abort()")
    found = mitsuba_process.send_request(first, 60)
    monkeypatch.delenv("PYTHONPATH")
    assert isinstance(found, Crash) and (found.exit, found.output) == ("SIGABRT", "LLVM ERROR: Cannot")
    assert mitsuba_process.send_request(second, 60).t.tolist() == [5.0, np.inf]


def test_one_process_serves_all_scenes_of_a_variant_in_the_same_environment(tmp_path, monkeypatch, alone):
    """The settings of Mitsuba's libraries, such as libLLVM's path, are those of the time of the request."""
    request = balls(tmp_path, 1)[0]
    for name, value, processes in (("DRJIT_X", "a", 1), ("OTHER", "b", 1), ("DRJIT_X", "b", 2)):
        monkeypatch.setenv(name, value)
        check_right([mitsuba_process.send_request(request)])
        assert len(subprocess_runner._running) == processes
    assert not alone


def test_a_process_that_has_grown_or_has_no_requests_ends_and_is_replaced(tmp_path, plant, alone):
    plant("serve.__defaults__ = None; mitsuba_process.RESIDENT_BYTES = 1", at=1)
    check_right([mitsuba_process.send_request(each) for each in balls(tmp_path, 2)])
    program = "from mitsuba_ref.reference.subprocess_runner import serve; serve(bytes.upper, 0.2)"
    with closing(subprocess_runner.ResidentProcess([sys.executable, "-c", program])) as process:
        assert process.ask(b"hello", 30) == b"HELLO"
        assert process.process.wait(30) == 0 and not process.alive
    assert not alone


def test_output_beside_the_replies_stays_out(tmp_path, plant, alone, capfd):
    plant("print('noise ' * 100000); os.system('echo more noise')", at=1)
    check_right([mitsuba_process.send_request(each, 60) for each in balls(tmp_path, 2)])
    assert capfd.readouterr() == ("", "") and not alone


def test_a_fork_has_residents_of_its_own(tmp_path):
    """It neither uses nor ends those of its parent."""
    requests = balls(tmp_path, 2)
    check_right([mitsuba_process.send_request(requests[0], 60)])
    (pid,) = subprocess_runner._running
    child = os.fork()
    if child == 0:
        code = 1
        try:
            own = mitsuba_process.send_request(requests[0], 60).t.tolist() == [4.0, np.inf]
            code = 0 if own and pid not in subprocess_runner._running else 2
            subprocess_runner.kill_subprocesses()
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert mitsuba_process.send_request(requests[1], 60).t[0] == 5.0
    assert subprocess_runner._running == {pid}


ASK = """
import sys, time
from pathlib import Path
from mitsuba_ref.reference import messages, mitsuba_process, subprocess_runner
mitsuba_process.send_request(messages.message_of(Path(sys.argv[1]).read_bytes()), 60)
print(*subprocess_runner._running, flush=True)
time.sleep(float(sys.argv[2]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere it ends once it has nothing to do")
@pytest.mark.parametrize("how", [None, signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.slow("each starts Mitsuba, and ends it", keep=1)
def test_a_resident_goes_with_its_parent(tmp_path, how):
    (tmp_path / "request").write_bytes(balls(tmp_path, 1)[0].to_bytes())
    words = [sys.executable, "-c", ASK, tmp_path / "request", "600" if how else "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=ROOT) as parent:
        pid = int(parent.stdout.readline())
        if how:
            parent.send_signal(how)
    wait_for(lambda: gone(pid))

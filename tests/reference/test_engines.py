"""Dask as the engine: results equal to the local ones; lost workers, schedulers and calls."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

import pytest
from outputs import json_of
from places import ROOT

import caster
from caster.__main__ import main as caster_main
from caster.cli.distributed_render import render_band, scene_of
from caster.system.cluster import CallEnded, Cluster, ClusterError
from mitsuba_ref.__main__ import main
from mitsuba_ref.bench.machine import CORES, LOAD
from mitsuba_ref.bench.result import SceneResult
from mitsuba_ref.cli import experiments
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry, judge_entry, with_inputs_hash
from mitsuba_ref.runner.verdict_files import worker_identity

pytest.importorskip("distributed", reason="the extra [cluster] is not installed")

# Functions that workers import from a module beside the test.
WORK = """\
import ctypes, os, signal, time
from pathlib import Path

def what():
    return {"same": os.environ.get("SAME", "1"), "processor": "test"}

def work(folder, number):
    Path(folder, f"{number}-{os.getpid()}-{time.monotonic_ns()}").touch()
    if number == 3:
        ctypes.string_at(0)
    if number == 5:
        time.sleep(60)
    if number == 7:
        raise ValueError("seven")
    time.sleep(0.02)
    return number * number
"""


@pytest.fixture
def jobs(here, monkeypatch):
    """The module that workers import, a folder for what they touch, and the working folder."""
    (here / "cluster_jobs.py").write_text(WORK)
    (here / "touched").mkdir()
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(here), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.syspath_prepend(str(here))
    yield __import__("cluster_jobs")
    del sys.modules["cluster_jobs"]


def touched(number=None):
    return [path.name for path in Path("touched").iterdir() if number is None or path.name.startswith(f"{number}-")]


def outcomes_of(cluster, jobs, numbers, seconds=None):
    with closing(cluster.map(jobs.work, (("touched", number) for number in numbers), seconds)) as outcomes:
        yield from outcomes


def test_each_call_ends_by_itself_and_outcomes_are_in_order(jobs):
    with Cluster("dask", 2, jobs.what, "same") as cluster:
        found = list(outcomes_of(cluster, jobs, range(40), seconds=2.0))
    errors = {number: found[number].error for number in (3, 5, 7)}
    assert isinstance(errors[3], CallEnded) and isinstance(errors[5], CallEnded)  # a crash, and a hang
    assert "a crash or the time limit, each time it was tried" in str(errors[5])
    assert isinstance(errors[7], ValueError) and "cluster_jobs.py" in errors[7].__notes__[0]
    assert [each.result for i, each in enumerate(found) if i not in errors] == [
        i * i for i in range(40) if i not in errors
    ]
    assert len(touched(3)) == len(touched(5)) == 2  # bounded retries
    # Four workers ended, each with at most the last two results, not fetched yet; these calls run again.
    assert sum(len(touched(i)) - 1 for i in range(40) if i not in (3, 5)) <= 4 * 2


def listening(pid):
    """Addresses on which a process and its descendants listen, as /proc tells: hexadecimal IPv4 and IPv6."""
    import psutil

    family = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    return {each.laddr.ip for one in family for each in one.net_connections("inet") if each.status == "LISTEN"}


@pytest.mark.slow("starts clusters")
def test_a_killed_worker_is_replaced_and_nothing_listens_beyond_loopback(jobs):
    with Cluster("dask", 2, jobs.what, "same") as cluster:
        assert listening(os.getpid()) == {"127.0.0.1"}
        found, calls = [], outcomes_of(cluster, jobs, [10 + i for i in range(60)])
        for outcome in calls:
            found.append(outcome.result)
            if len(found) == 10:
                os.kill(int(touched(19)[0].split("-")[1]), signal.SIGKILL)
    assert found == [(10 + i) ** 2 for i in range(60)]


@contextmanager
def scheduler(*, workers=1, threads=1, **environment):
    """A scheduler and its workers as processes of their own."""
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    file = Path("scheduler.json").resolve()
    processes = [subprocess.Popen([*command, "--no-dashboard", "--scheduler-file", str(file)], stderr=-3)]
    try:
        while not file.exists():
            time.sleep(0.05)
        command = [
            sys.executable,
            "-m",
            "distributed.cli.dask_worker",
            "--scheduler-file",
            str(file),
            "--nthreads",
            str(threads),
            "--no-dashboard",
        ]
        for _ in range(workers):
            processes.append(subprocess.Popen(command, stderr=subprocess.DEVNULL, env={**os.environ, **environment}))
        yield json_of(file)["address"], processes[0]
    finally:
        for process in reversed(processes):
            process.send_signal(signal.SIGCONT)
            process.terminate()
            process.wait()


@pytest.mark.slow("starts clusters")
def test_a_killed_scheduler_ends_the_run_with_what_is_finished(jobs, monkeypatch):
    monkeypatch.setattr("caster.system.cluster.CONNECT_SECONDS", 2.0)
    with scheduler() as (address, process), Cluster(f"dask:{address}", 1, jobs.what, "same") as cluster:
        found = []
        with pytest.raises(ClusterError, match=r"the scheduler is gone; what is finished is kept"):
            for outcome in outcomes_of(cluster, jobs, [10 + i for i in range(500)]):
                found.append(outcome.result)
                if len(found) == 20:
                    process.kill()
    assert found == [(10 + i) ** 2 for i in range(len(found))] and 20 <= len(found) < 500


@pytest.mark.parametrize(
    ("workers", "says"),
    [
        ({"SAME": "2"}, "its same is 2, expected 1"),
        ({"threads": 2}, "a worker has 2 threads, expected one: --nthreads 1"),
    ],
)
def test_a_worker_that_differs_is_refused(jobs, workers, says):
    with (
        scheduler(**workers) as (address, _),
        Cluster(f"dask:{address}", 1, jobs.what, "same") as cluster,
        pytest.raises(ClusterError, match=says),
    ):
        list(outcomes_of(cluster, jobs, [1]))
    assert touched() == []


@pytest.mark.slow("starts clusters")
def test_a_scheduler_without_workers_is_named(jobs, monkeypatch):
    monkeypatch.setattr("caster.system.cluster.CONNECT_SECONDS", 3.0)
    with scheduler(workers=0) as (address, _), pytest.raises(ClusterError, match="no scheduler with workers answers"):
        Cluster(f"dask:{address}", 1, jobs.what)


NO_ENGINE = "expected local, dask or dask:tcp://HOST:PORT"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("dask:tcp://127.0.0.1:9", "--engine dask:tcp://127.0.0.1:9: no scheduler with workers answers there"),
        ("dask:tls://127.0.0.1:9", "expected Dask's settings of TLS"),
        *((name, NO_ENGINE) for name in ("ray", "dask:", "dask:127.0.0.1", "dask:http://h:1")),
    ],
)
def test_a_name_that_is_no_engine_or_does_not_answer(monkeypatch, capsys, name, says):
    monkeypatch.setattr("caster.system.cluster.CONNECT_SECONDS", 0.5)
    assert main(["validate", "--builtin", "spheres", "--engine", name]) == 2
    assert says in capsys.readouterr().err


def living_processes_of(group: int) -> list[list[str]]:
    said = subprocess.run(["ps", "-A", "-o", "pgid=,stat="], capture_output=True, text=True, check=True).stdout
    return [words for words in map(str.split, said.splitlines()) if words[0] == str(group) and words[1][0] != "Z"]


@pytest.mark.slow("starts clusters")
def test_ctrl_c_in_a_terminal_ends_the_run_and_its_workers_quietly(tmp_path):
    """The signal reaches the whole process group."""
    command = [sys.executable, "-P", "-m", "mitsuba_ref", "fuzz", "--time", "60s", "--engine", "dask", "--json", "told"]
    scratch = {"TMPDIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    run = subprocess.Popen([*command, "--judge-every", "0"], cwd=tmp_path, env=os.environ | scratch, **pipes)
    end = time.monotonic() + 60.0
    while not [*tmp_path.glob("*/dask-scratch-space/worker-*")] and time.monotonic() < end:
        time.sleep(0.1)
    time.sleep(6.0)  # for the first examples
    os.killpg(run.pid, signal.SIGINT)
    out, err = run.communicate(timeout=30)
    assert run.returncode == 130 and err.splitlines()[-1] == "interrupted", err
    assert "Traceback" not in err and "leaked" not in err and "adjudicated by exact arithmetic" in out
    assert json_of(tmp_path / "told")["interrupted"]
    end = time.monotonic() + 5.0  # the system may still be ending a worker
    while living_processes_of(run.pid) and time.monotonic() < end:
        time.sleep(0.1)
    assert living_processes_of(run.pid) == []
    assert [path.name for path in tmp_path.iterdir() if path.name not in ("told", "fuzz-failures")] == []


def test_without_the_package(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["validate", "--builtin", "spheres", "--engine", "dask"]) == 2
    assert "pip install 'ray-reference[cluster]'" in capsys.readouterr().err


def without_times(record):
    """A result without what differs from run to run."""
    if isinstance(record, dict):
        return {key: without_times(value) for key, value in record.items() if "seconds" not in key}
    return [without_times(each) for each in record] if isinstance(record, list) else record


HEAD = '[film]\nwidth = 24\nheight = 16\n[camera]\ntype = "pinhole"\neye = [0, 1, 5]\nlook_at = [0, 0, 0]\n'
SPHERE = '[[shape]]\ntype = "sphere"\n'
COUNTS = ("camera_rays", "decided_exactly", "shadow_rays", "aovs")


def test_a_worker_with_another_scene_renders_and_judges_nothing(tmp_path):
    file = tmp_path / "one.toml"
    file.write_text(HEAD + SPHERE)
    sha256 = caster.load_scene(file).sha256()
    (entry,) = map(with_inputs_hash, [SceneEntry("one", str(file))])
    render = partial(render_band, str(file), (), sha256, (24, 16), (0, 0, 24, 4), ("depth",))
    judge = partial(judge_entry, entry, JudgeOptions(store=False))
    assert render().hits and judge().ok
    file.write_text(HEAD + SPHERE + "radius = 2\n")
    scene_of.cache_clear()
    for call in (render, judge):
        with pytest.raises(caster.SceneError, match=r"one\.toml: the worker on .* has another version"):
            call()


@pytest.mark.slow("starts clusters")
def test_bands_of_a_film_on_dask_are_the_same_bytes(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("caster.rendering.images.BAND_PIXELS", 64 * 70)
    words = ["render", str(ROOT / "scenes/every-shape.toml"), "--size", "70", "300", "--crop", "3", "5", "69", "290"]
    told = {}
    for engine in ("local", "dask"):
        assert caster_main([*words, "--engine", engine, "-o", f"{tmp_path}/{engine}.exr", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        told[engine] = [found[name] for name in COUNTS]
    assert told["local"] == told["dask"]
    assert (tmp_path / "local.exr").read_bytes() == (tmp_path / "dask.exr").read_bytes()


CANDIDATE = """\
import os, signal
import numpy as np
from caster import cast

def trace(scene, o, d):
    if len(scene.shapes) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    hits = cast(scene, o, d)
    return hits.t, hits.normal
"""


@pytest.mark.slow("starts clusters")
def test_a_cluster_that_goes_on_judges_the_candidate_of_today(here):
    Path("one.toml").write_text(HEAD + SPHERE)
    right = "from caster import cast\n\ndef trace(*rays):\n    hits = cast(*rays)\n    return hits.t{}, hits.normal\n"
    with scheduler() as (address, _):
        for change, code in (("", 0), (" * 1.5", 1), ("", 0)):
            Path("mine.py").write_text(right.format(change))
            words = ["validate", "one.toml", "--candidate", "mine:trace", "--engine", f"dask:{address}"]
            assert main(words) == code


@pytest.mark.slow("starts clusters")
def test_bench_times_on_one_worker_a_machine(here, capsys):
    words = ["bench", "one-sphere", "overdraw-256", "--size", "8", "--alternations", "1"]
    assert main([*words, "--engine", "dask", "--json", "run.json"]) == 0
    record = json_of("run.json")
    assert [scene["name"] for scene in record["scenes"]] == ["one-sphere", "overdraw-256"]
    assert all(row["seconds"] for scene in record["scenes"] for row in scene["rows"] if row["key"] == "ours")
    assert record["machine"]["mitsuba"] and not capsys.readouterr().err.count("Traceback")
    with scheduler(workers=2) as (address, _), Cluster(f"dask:{address}", 1, worker_identity) as cluster:
        cluster.client.wait_for_workers(2)
        with pytest.raises(ClusterError, match=r"expected one worker a machine, got 2 on 127\.0\.0\.1"):
            cluster.check_one_worker_a_machine()


def test_bench_refuses_times_of_different_machines(tmp_path, monkeypatch, capsys):
    fast, slow = ({"processor": name, LOAD: name, CORES: "2 of 4"} for name in ("fast", "slow"))
    result = SceneResult("one-sphere", "", "film", 1, ())
    for second, code in (({**fast, LOAD: "9"}, 0), (slow, 2)):
        found = iter([(fast, result), (second, result)])
        monkeypatch.setattr(experiments, "time_on_worker", lambda *_, found=found: next(found))
        file = tmp_path / f"{code}.json"
        assert main(["bench", "one-sphere", "mesh-70k", "--json", str(file)]) == code
        record = json_of(file)
        assert len(record["scenes"]) == 2 - (code > 0) and record["machine"][CORES] == "2 of 4"
    assert "expected equal machines, got two of another processor" in capsys.readouterr().err


@pytest.mark.slow("starts clusters")
def test_dask_and_local_give_the_same_and_a_poisoned_scene_is_one_row(here, monkeypatch, capsys):
    monkeypatch.setenv("MITSUBA_REF_STORE", "off")
    before = threading.active_count()
    Path("scenes").mkdir()
    for name, shapes in {"a": 1, "b": 3, "poison": 2, "z": 1}.items():
        Path(f"scenes/{name}.toml").write_text(HEAD + SPHERE + "center = [1, 0, 0]\n" + SPHERE * (shapes - 1))
    for engine in ("local", "dask"):
        assert main(["validate", "scenes", "-j", "2", "--engine", engine, "--json", f"{engine}.json"]) == 0
        assert (
            main(["fuzz", "--examples", "6", "--judge-every", "0", "--engine", engine, "--json", f"f-{engine}.json"])
            == 0
        )
        assert main(["stress", "tangency", "--rays", "9", "--engine", engine, "--json", f"s-{engine}.json"]) == 0
    for prefix in ("", "f-", "s-"):
        local, dask = (without_times(json_of(f"{prefix}{name}.json")) for name in ("local", "dask"))
        assert local == dask
    Path("mine.py").write_text(CANDIDATE)
    words = ["validate", "scenes", "--candidate", "mine:trace", "--engine", "dask", "-j", "1", "--json", "c.json"]
    assert main(words) == 1
    found = {scene["name"]: scene for scene in json_of("c.json")["scenes"]}
    assert [name for name, scene in found.items() if scene["problem"]] == ["poison"]
    assert found["poison"]["problem"].startswith("the process that casts and judges ended: a crash")
    assert found["poison"]["replay"] and all(found[name]["ok"] for name in "abz")
    assert threading.active_count() < before + 4 and not capsys.readouterr().err.count("Traceback")

"""`mitsuba-ref bench` counts right, finds every planted fault and reports all of it. No Mitsuba, no timing."""

import json
import pickle
import signal
import sys
from dataclasses import replace
from typing import ClassVar

import jsonschema
import numpy as np
import performance_page
import pytest
from outputs import json_of
from pages import read_result

from mitsuba_ref.__main__ import main
from mitsuba_ref.bench import measuring
from mitsuba_ref.bench.casters import BY_KEY
from mitsuba_ref.bench.drivers import AOVS, FILM, CannotRun
from mitsuba_ref.bench.measuring import CasterRun, score, time_scene, write_scene
from mitsuba_ref.bench.result import COLUMNS, Row, Run, SceneResult, Score, as_text, overview, rows
from mitsuba_ref.bench.scenes import SCENES, scene_of_file
from mitsuba_ref.cli.doctor import result_schema
from mitsuba_ref.judge.adjudication import ExactHits
from mitsuba_ref.judge.verdict import as_json
from mitsuba_ref.reference.subprocess_runner import ProcessEnd, ProcessEnded, ResidentProcess
from mitsuba_ref.report.output import write_result


def test_every_scene_can_be_sent_to_a_worker(tmp_path):
    (tmp_path / "ball.toml").write_text('[camera]\ntype = "ray"\norigin = [0, 0, 5]\ndirection = [0, 0, -1]\n')
    for scene in (*SCENES, scene_of_file(str(tmp_path / "ball.toml"))):
        assert pickle.loads(pickle.dumps(scene)).name == scene.name


BY_NAME = {scene.name: scene for scene in SCENES}


def row(key: str, seconds: tuple[float, ...], rays: int = 100, **more: object) -> Row:
    return Row(key, BY_KEY[key].title, rays, 10, 0.5, seconds, **more)


def result(*rows: Row) -> SceneResult:
    return SceneResult("mesh-70k", "a closed mesh", FILM, 70224, rows, aovs=AOVS)


@pytest.mark.parametrize(
    ("other", "ratio"),
    [
        (row("raw-default", (2.0, 18.0, 2.0, 18.0, 18.0)), 2.0),  # of the same moment, not of medians
        (row("raw-default", (1.0, 9.0), rays=25), 4.0),  # of rays, not of images
        (row("raw-default", (2.0,)), 2.0),  # died half way
        (row("raw-default", ()), None),
    ],
)
def test_a_ratio_is_of_rays_at_the_same_moment(other, ratio):
    ours = row("ours", (1.0, 9.0, 1.0, 9.0, 1.0))
    assert result(ours, other).ratio("raw-default") == ratio and result(ours, other).ratio("ours") == 1.0
    assert row("ours", (3e-6, 1e-6, 2e-6)).ns == pytest.approx(20.0)  # 2 us for 100 rays


# --- who is wrong


@pytest.fixture(scope="module", params=["grazing-plane", "one-sphere"])
def exact(request, tmp_path_factory) -> ExactHits:
    ready = write_scene(BY_NAME[request.param], tmp_path_factory.mktemp("scene"), 16)
    return ExactHits(ready.model, ready.o[::3], ready.d[::3])


def test_exact_answers_are_right_and_errors_are_counted_as_what_they_are(exact):
    hit, right = exact.hit, score(exact, exact.t, "float64")
    assert right.rays == len(hit) > 80 and right.masks == right.beyond == 0
    assert score(exact, np.full(len(hit), np.inf), "float64").masks == hit.sum() > 0
    assert right.ulps < 1e-8 and 0.0 < right.bounds < 1.0  # half a unit of float64 is 2^-30 of one of float32
    off = np.nextafter(exact.t.astype(np.float32), np.float32(np.inf)).astype(np.float64)
    rounded = score(exact, off, "float32", reference=True)
    assert 0.4 <= rounded.ulps <= 1.5 and rounded.beyond == 0
    assert score(exact, off, "float64").beyond == hit.sum()  # which float64 has no excuse for
    assert score(exact, off, "float32").beyond == 0, "a candidate is held to its own precision"
    nan = score(exact, np.where(np.arange(len(hit)) == np.argmax(hit), np.nan, exact.t), "float64")
    assert (nan.masks, nan.beyond) == (0, 1)
    assert score(exact, np.where(hit, exact.t, 1.0), "float64").masks == (~hit).sum()


# --- turns


class Fake:
    """A caster in this process; dies_at: the number of its casts."""

    log: ClassVar[list[str]] = []

    def __init__(self, key: str, dies_at: int = 1000) -> None:
        self.key, self.left, self.closed = key, dies_at, False

    def ask(self, data, timeout):
        return json.dumps(self.reply(json.loads(data))).encode()

    def reply(self, request):
        if request["do"] == "cast":
            Fake.log.append(self.key)
            self.left -= 1
            if self.left < 0:
                raise ProcessEnded(ProcessEnd(-signal.SIGSEGV, "", 0.0))
            return {"seconds": 2.0 if self.key == "raw-default" else 1.0, "rays": 256}
        if request["do"] == "answer":
            return {"t": [np.inf] * len(request["rows"]), "precision": "float64"}
        return {"seconds": 0.25}

    def close(self) -> None:
        self.closed = True


KEYS = ("ours", "raw-robust", "raw-default")


def timed(monkeypatch, dying: dict[str, int]) -> tuple[SceneResult, dict[str, Fake]]:
    Fake.log = []
    fakes = {key: Fake(key, dying.get(key, 1000)) for key in KEYS}
    casters = [replace(BY_KEY[key], options={}, first=0) for key in KEYS]
    monkeypatch.setattr(measuring, "start_process", lambda caster, *rest: fakes[caster.key])
    return time_scene(BY_NAME["grazing-plane"], casters, 16, 3), fakes


def test_casters_take_turns_and_none_is_always_first(monkeypatch):
    found, fakes = timed(monkeypatch, {})
    warm = len(KEYS) * (measuring.WARM_UP_CASTS + 1)
    assert Fake.log[warm:] == [*KEYS, "raw-robust", "raw-default", "ours", "raw-default", "ours", "raw-robust"]
    assert found.ratio("raw-default") == 2.0
    assert [one.build for one in found.rows] == [0.25] * 3
    assert found.row("ours").score.masks > 0  # it says that all rays miss
    assert all(fake.closed for fake in fakes.values())


def test_a_crash_of_one_caster_leaves_the_others_running(monkeypatch):
    found, fakes = timed(monkeypatch, {"raw-robust": measuring.WARM_UP_CASTS + 2, "raw-default": 0})
    ours, raw, default = found.rows
    assert len(ours.seconds) == 3 and ours.why == ""
    assert len(raw.seconds) == 1 and raw.why == "died: SIGSEGV" and raw.score is None
    assert default.seconds == () and default.why == "died: SIGSEGV"
    assert "died: SIGSEGV" in as_text(found) and all(fake.closed for fake in fakes.values())


# --- processes

READ = "import os, sys; sys.stdin.buffer.read(8); "
REPLY = READ + "sys.stdout.buffer.write(len({0}).to_bytes(8, 'little') + {0}); sys.stdout.flush(); sys.stdin.read()"
ENDS = {
    "import time; time.sleep(60)": "died: killed after 0.5",
    READ + "print('last words', file=sys.stderr, flush=True); os.abort()": "died: SIGABRT: last words",
    "import sys; sys.exit(3)": "died: exit code 3",
    REPLY.format('b\'{"why": "no such sensor"}\''): "no such sensor",
}


@pytest.mark.parametrize("script", ENDS)
def test_every_end_of_a_process_is_a_reason(script, monkeypatch):
    monkeypatch.setattr(measuring, "REQUEST_TIMEOUT_S", 0.5 if "sleep" in script else 30.0)
    monkeypatch.setattr(measuring, "run_module", lambda *_, **__: ResidentProcess([sys.executable, "-c", script]))
    process = measuring.start_process(BY_KEY["ours"], "/nowhere", BY_NAME["one-sphere"])
    with pytest.raises(CannotRun) as end:
        CasterRun(BY_KEY["ours"], 4, process).request(do="build", size=4)
    assert str(end.value).startswith(ENDS[script]) and str(end.value).count(":") == ENDS[script].count(":")
    process.close()  # again does nothing
    assert not process.alive


# --- results

SCORE = Score(2000, 5.25, 0.25, 0, 1)
FIXED = Run(
    settings={"size": 1024, "alternations": 3, "candidate": ""},
    machine={"processor": "an abacus", "processors used": "2 of 4"},
    requested=("one-sphere", "mesh-70k"),
    scenes=(
        result(
            row("ours", (1e-6, 1e-6, 2e-6), score=SCORE),
            row("aov-robust", (6e-6, 6e-6, 12e-6), score=SCORE),
            row("raw-robust", (1.2e-6, 1.2e-6, 2.4e-6)),
            Row("raw-default", "Mitsuba LLVM, default, ray_intersect", why="died: SIGSEGV"),
        ),
    ),
)


def test_json_brings_the_run_back_and_satisfies_its_schema(tmp_path):
    file = tmp_path / "run.json"
    write_result(FIXED, str(file))
    data = json_of(file)
    assert read_result(Run, str(file), "mitsuba-ref bench") == FIXED and data == as_json(FIXED)
    jsonschema.validate(data, result_schema("bench"))
    rows = {one["key"]: one for one in data["scenes"][0]["rows"]}
    assert rows["aov-robust"]["ratio"] == pytest.approx(6.0) and rows["ours"]["ns"] == pytest.approx(10.0)
    assert rows["raw-default"]["ratio"] is None


def test_a_candidate_is_a_row_and_a_column_beside_the_others():
    base = result(row("ours", (1e-6,)), row("aov-robust", (6e-6,)))
    candidate = Row("candidate", "mine:trace", 25, 5, 0.5, (1e-6,))  # 4e-8 s a ray, ours 1e-8
    found = replace(base, rows=(*base.rows, candidate))
    shown = {line[0]: line[COLUMNS.index("times as fast")] for line in rows(found)[1:]}
    assert shown == {BY_KEY["ours"].title: "1.00", BY_KEY["aov-robust"].title: "6.00", "mine:trace (5^2)": "4.00"}
    head, cells = overview(replace(FIXED, scenes=(found,)))
    assert head == ["scene", "AOVs", "ours, ms", "AOV integrator", "candidate"] and cells[3:] == ["6.00", "4.00"]


def test_the_pareto_front_is_of_those_that_none_beats_in_both():
    points = [(9.0, 1.0), (1.0, 5.0), (3.0, 5.0), (2.0, 3.0), (10.0, 4.0)]
    assert performance_page.front(points) == [(1, 5), (2, 3), (9, 1)]
    assert set(performance_page.STYLE) == set(BY_KEY)


def test_the_page_has_the_conditions_every_row_and_the_plot(tmp_path):
    performance_page.write_report(FIXED, tmp_path)
    text = (tmp_path / performance_page.PAGE).read_text()
    assert "medians of 3 alternations" in text and "an abacus" in text and "Not timed: one-sphere." in text
    assert "| Mitsuba LLVM, default, ray_intersect | died: SIGSEGV |" in text
    line = "| Mitsuba LLVM, robust, AOV integrator | 500.0 | 60.00 | 6.00 | 5.25 | 0.25 | 0+1 |"
    assert line in text and "| mesh-70k | depth, normal | 1.0e-03 | 1.20 | 6.00 |" in text
    assert (tmp_path / "performance/pareto.png").is_file() and "(performance/pareto.png)" in text


# --- the command


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ("mesh-70", 2, "scene 'mesh-70': unknown, did you mean 'mesh-70k'?"),
        ("rays --aov depth", 5, "nothing selected"),
        ("nothing.obj", 4, "nothing.obj"),
    ],
)
def test_wrong_usage_is_reported(words, code, says, capsys):
    assert main(["bench", *words.split()]) == code
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "names"),
    [("rays", "rays-coherent rays-incoherent"), ("one-sphere --aov depth,normal,uv", "one-sphere:depth,normal,uv")],
)
def test_scenes_are_listed(words, names, capsys):
    assert main(["bench", *words.split(), "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == names.split()

"""`mitsuba-ref bench` counts right, finds every planted fault and reports all of it. No Mitsuba, no timing."""

import ast
import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import jsonschema
import numpy as np
import performance_page
import performance_plots
import performance_targets
import pytest

import mitsuba_ref.bench.entries
from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32, as_given
from mitsuba_ref.__main__ import main
from mitsuba_ref.bench import measuring, run, scenes
from mitsuba_ref.bench.contestants import ALL_TASKS, BY_KEY, CONTESTANTS, Contestant, contestants_for
from mitsuba_ref.bench.entries import ANY, AOVS, FILM, NEAREST, PROCESS, SHADING, VALIDATION, Work
from mitsuba_ref.bench.measuring import ContestantEnded, ContestantProcess, Settings, time_scene
from mitsuba_ref.bench.result import Row, Run, SceneResult, Score, Series, Sweep, as_text, fitted_slope, ratio
from mitsuba_ref.bench.scoring import ExactAnswers, write_scene
from mitsuba_ref.bench.worker import peak_memory
from mitsuba_ref.cli.doctor import result_schema
from mitsuba_ref.report import results
from mitsuba_ref.report.results import as_json, read_result, write_result

SCENES = {scene.name: scene for scene in scenes.SCENES}


def row(key: str, seconds: tuple[float, ...], rays: int = 100, **more: object) -> Row:
    return Row(key, BY_KEY[key].title, BY_KEY[key].side, rays, 10, 0.5, seconds, 2**20, **more)


# --- arithmetic


def test_medians_and_rates_are_of_one_ray():
    one = row("ours", (3e-6, 1e-6, 2e-6))
    assert one.ns == pytest.approx(20.0)  # 2 us for 100 rays
    assert one.mrays == pytest.approx(50.0)
    assert row("ours", ()).ns is None and not row("ours", ()).ran


def test_a_ratio_is_of_the_same_moment():
    """In the second alternation the machine did something else; half of the median of one is no ratio."""
    ours, other = row("ours", (1.0, 9.0, 1.0, 9.0, 1.0)), row("open3d", (2.0, 18.0, 2.0, 18.0, 18.0))
    assert ratio(other, ours) == 2.0
    assert other.ns / ours.ns == 18.0


def test_ratios_are_of_rays_and_not_of_images():
    """A quarter of the pixels in the same time is four times as long."""
    assert ratio(row("scalar-aov", (1.0,), rays=25), row("ours", (1.0,))) == 4.0


def test_who_died_half_way_is_set_against_the_turns_it_took():
    assert ratio(row("open3d", (2.0,)), row("ours", (1.0, 4.0, 4.0))) == 2.0
    assert ratio(row("open3d", ()), row("ours", (1.0,))) is None


@pytest.mark.parametrize("slope", [0.0, 0.5, 1.0, 2.0])
def test_a_power_law_gives_its_slope(slope):
    x = (1e3, 1e4, 1e5, 1e6)
    assert fitted_slope(x, [3e-4 * a**slope for a in x]) == pytest.approx(slope, abs=1e-12)


def test_no_slope_goes_through_one_point():
    assert fitted_slope((), ()) is None and fitted_slope((5.0,), (1.0,)) is None


def test_a_slow_image_is_made_smaller_until_it_fits():
    assert measuring.fitting_size(32, measuring.MAX_CAST_S / 1025.0, 1024) == 1024
    assert measuring.fitting_size(32, measuring.MAX_CAST_S / 16.5, 1024) == 128
    assert measuring.fitting_size(32, 60.0, 1024) == 32
    assert measuring.fitting_size(32, 1e-6, 16) == 16


# --- who is wrong


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> ExactAnswers:
    return truth_of("cornell-box", tmp_path_factory.mktemp("cornell"))


def truth_of(name: str, folder: Path) -> ExactAnswers:
    scene = SCENES[name]
    return ExactAnswers(write_scene(scene, folder, 16), scene.workload, 0, sample=80)


def test_the_exact_answer_is_not_wrong(truth):
    score = truth.score(truth.t, ours=True)
    assert (score.rays, score.edge_rays) == (80, 80)
    assert score.masks == score.beyond == score.edge_masks == score.edge_beyond == 0
    assert score.ulps < 1e-8  # half a unit of float64 is 2^-30 of one of float32
    assert 0.0 < score.bounds < 1.0


def test_one_unit_in_the_last_place_is_one_unit(truth):
    off = np.nextafter(truth.t.astype(np.float32), np.float32(np.inf)).astype(np.float64)
    assert 0.5 <= truth.score(off, ours=False).ulps <= 1.5
    assert truth.score(off, ours=False).beyond == 0
    assert truth.score(off, ours=True).beyond == truth.score(off, ours=True).rays  # which float64 has no excuse for


def test_a_missed_edge_is_detected(truth):
    t = truth.t.copy()
    t[truth.film_rays + int(np.argmax(truth.hit[truth.film_rays :]))] = np.inf
    score = truth.score(t, ours=True)
    assert (score.masks, score.edge_masks) == (0, 1)


def test_a_caster_that_hits_nothing_is_detected(tmp_path):
    truth = truth_of("one-sphere", tmp_path)
    t = np.where(np.isinf(truth.t) & (np.arange(len(truth.t)) < truth.film_rays), 1.0, truth.t)
    assert truth.score(t, ours=True).masks == int((~truth.hit[: truth.film_rays]).sum()) > 0


def test_a_nan_is_no_hit_and_no_miss(truth):
    t = truth.t.copy()
    t[0] = np.nan
    assert truth.hit[0]
    assert (truth.score(t, ours=True).masks, truth.score(t, ours=True).beyond) == (0, 1)


def test_another_surface_is_detected(truth):
    t = truth.t.copy()
    t[truth.film_rays + 3] *= 1.5
    assert truth.score(t, ours=False).edge_beyond == 1


def test_shadow_rays_have_masks_alone(tmp_path):
    truth = truth_of("rays-shadow", tmp_path)
    t = np.where(truth.hit, 0.0, np.inf)
    assert truth.score(t, ours=True) == Score(80, None, None, 0, 0, 80, 0, 0)
    assert truth.score(np.full(len(t), np.inf), ours=True).masks == int(truth.hit[:80].sum()) > 0


@pytest.mark.parametrize("name", ["cornell-box", "one-sphere"])
def test_edges_and_silhouettes_are_aimed_at(name, tmp_path):
    """A hundred-thousandth of the way beside, no more; rays of the picture are elsewhere."""
    ready = write_scene(SCENES[name], tmp_path, 16)
    truth = ExactAnswers(ready, FILM, 0, sample=40)
    o, d = truth.o.astype(np.float64), truth.d.astype(np.float64)
    beside = np.array([distance_beside(ready.packed.parts[0], *line) for line in zip(o, d, strict=True)])
    assert (beside[truth.film_rays :] < 1e-5).all()
    assert np.median(beside[: truth.film_rays]) > 1e-3


def distance_beside(part, o, d) -> float:
    """Between the line and the nearest edge or silhouette, over how far away that is."""
    if hasattr(part, "radius"):
        away = part.center[0] - o
        return abs(np.linalg.norm(np.cross(away, d)) - part.radius[0]) / np.linalg.norm(away)
    ends = part.vertices[part.faces]
    a, b = ends.reshape(-1, 3), np.roll(ends, -1, axis=1).reshape(-1, 3)
    n = np.cross(b - a, d)
    length = np.linalg.norm(n, axis=1)
    apart = np.abs(((a - o) * n).sum(axis=1)) / length  # of two lines
    s = (np.cross(o - a, d) * n).sum(axis=1) / length**2  # where on the edge
    return float(np.min(np.where((s > -1e-3) & (s < 1.0 + 1e-3), apart, np.inf)) / np.linalg.norm(a[0] - o))


# --- turns


class Fake:
    """A contestant in this process; `faults`: how many casts it takes until something happens."""

    log: ClassVar[list[str]] = []

    def __init__(self, key: str, dies_at: int | None = None) -> None:
        self.key, self.left, self.closed = key, dies_at, False

    def request(self, timeout: float, **request):
        if request["do"] == "cast":
            Fake.log.append(self.key)
            if self.left is not None:
                self.left -= 1
                if self.left < 0:
                    raise ContestantEnded("died: SIGSEGV")
            return {"seconds": 2.0 if self.key == "open3d" else 1.0, "casts": 1, "rays": 256}
        if request["do"] == "answer":
            with np.load(request["rays"]) as rays:
                np.save(request["out"], np.full(len(rays["o"]), np.inf))
            return {}
        return {"seconds": 0.25} if request["do"] == "build" else {"bytes": 4096}

    def close(self) -> None:
        self.closed = True


def timed(keys: list[str], dying: dict[str, int], alternations: int = 3) -> tuple[SceneResult, dict[str, Fake]]:
    Fake.log = []
    fakes = {key: Fake(key, dying.get(key)) for key in keys}
    timed = [replace(BY_KEY[key], variant="", package="", first=0) for key in keys]
    settings = Settings(16, alternations)
    start = lambda contestant, *rest: fakes[contestant.key]  # noqa: E731
    return time_scene(SCENES["cornell-box"], timed, settings, start=start), fakes


def test_contestants_take_turns_and_none_is_always_first():
    keys = ["ours", "raw-robust", "open3d"]
    found, fakes = timed(keys, {})
    warm = len(keys) * (measuring.WARM_UP_CASTS + 1)
    assert Fake.log[warm:] == [*keys, "raw-robust", "open3d", "ours", "open3d", "ours", "raw-robust"]
    assert found.ratio("open3d") == 2.0 and found.ratio("ours") == 1.0
    assert [one.memory for one in found.rows] == [4096] * 3
    assert [one.build for one in found.rows] == [0.25] * 3
    assert found.row("ours").score.masks > 0  # it says that all rays miss
    assert all(fake.closed for fake in fakes.values())


def test_a_crash_of_one_peer_leaves_the_others_running():
    found, fakes = timed(["ours", "raw-robust", "open3d"], {"raw-robust": measuring.WARM_UP_CASTS + 2, "open3d": 0})
    ours, raw, open3d = found.rows
    assert len(ours.seconds) == 3 and ours.why == ""
    assert len(raw.seconds) == 1 and raw.why == "died: SIGSEGV" and raw.score is None
    assert open3d.seconds == () and open3d.why == "died: SIGSEGV"
    assert "died: SIGSEGV" in as_text(found) and found.ratio("raw-robust") == 1.0
    assert all(fake.closed for fake in fakes.values())


def test_who_cannot_run_states_why(monkeypatch):
    absent = Contestant("open3d", "nobody", "peer", "none:None", (FILM,), package="no_such_package_here")
    crowd = replace(BY_KEY["ours-python"], most=3)
    found = time_scene(SCENES["cornell-box"], [absent, crowd], Settings(16, 1), start=None)
    assert found.rows[0].why == "no_such_package_here is not installed: pip install 'ray-reference[peers]'"
    assert found.rows[1].why == "not timed with more than 3 primitives"


# --- processes


WORK = Work("/nowhere", FILM, 1, "entries:Ours")
ENDS = {
    "hangs": ("import time; time.sleep(60)", "no answer within 0.5 s"),
    "dies": ("import os, sys; sys.stdin.readline(); print('last words'); sys.stdout.flush(); os.abort()",
             "died: SIGABRT: last words"),
    "leaves": ("import sys; sys.exit(3)", "died: exit code 3"),
    "babbles": ("import os, sys; sys.stdin.readline(); os.write(int(sys.argv[1]), b'what?\\n'); sys.stdin.read()",
                "unexpected reply: 'what?'"),
    "cannot": ("import os, sys; sys.stdin.readline();"
               "os.write(int(sys.argv[1]), b'{\"status\": \"cannot\", \"why\": \"no such sensor\"}\\n')",
               "no such sensor"),
}  # fmt: skip


@pytest.mark.parametrize("name", ENDS)
def test_every_end_of_a_process_is_a_reason(name):
    script, why = ENDS[name]
    process = ContestantProcess(WORK, command=(sys.executable, "-c", script))
    with pytest.raises(ContestantEnded) as end:
        process.request(0.5 if name == "hangs" else 30.0, do="build", size=4)
    assert str(end.value) == why
    process.close()  # again does nothing
    assert not process.process.alive


def test_a_worker_states_what_is_missing_and_lives_in_few_bytes():
    process = ContestantProcess(replace(WORK, entry="no_such_entry:Nobody"))
    with pytest.raises(ContestantEnded, match=r"No module named .*no_such_entry"):
        process.request(30.0, do="build", size=4)
    assert 2**20 < peak_memory() < 2**40


def test_no_contestant_pays_for_another():
    """What a worker loads before its entry is light: no caster, no compiler, no Mitsuba."""
    heavy = {"numba", "mitsuba", "pydantic", "open3d"}
    code = f"import sys, mitsuba_ref.bench.worker; print(*({heavy} & set(sys.modules)))"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == ""


# --- registries


def test_every_contestant_has_an_entry_that_can_do_all_that_is_requested():
    folder = Path(mitsuba_ref.bench.entries.__file__).parent
    for contestant in CONTESTANTS:
        module, _, name = contestant.entry.partition(":")
        tree = ast.parse((folder / f"{module}.py").read_text())
        (found,) = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name)
        methods = {node.name for node in found.body if isinstance(node, ast.FunctionDef)}
        assert {"build", "take_rays", "cast", "answer"} <= methods, contestant.key
        drawn = set(contestant.workloads) & {FILM, NEAREST, ANY}
        assert contestant.key in performance_plots.STYLE or not drawn, contestant.key


def test_what_the_contract_names_is_there():
    timed = {each.key for each in contestants_for(FILM, peers=True)}
    assert {"ours", "ours-bvh", "ours-1-thread", "ours-python", "scalar-aov", "scalar-loop"} <= timed
    assert {"raw-robust", "raw-default", "aov-robust", "aov-default", "open3d", "trimesh", "copy"} <= timed
    assert not {"open3d", "embreex", "trimesh"} & {each.key for each in contestants_for(FILM, peers=False)}
    assert {scene.workload for scene in scenes.SCENES} == {FILM, NEAREST, ANY, SHADING, PROCESS, VALIDATION}
    assert len(scenes.SCENES) >= 12
    assert run.TRIANGLE_COUNTS[-1] == 10_000_000 and (run.FILM_SIDES[0], run.FILM_SIDES[-1]) == (64, 4096)


CAST = [each.name for each in SCENES.values() if each.workload in ALL_TASKS]


@pytest.mark.parametrize("name", [name for name in CAST if name not in ("mesh-1m", "spheres-10k")])
def test_all_peers_are_given_the_very_same_numbers(name, tmp_path):
    """All but normals of corners, which a file has in float32, and which whoever reads it makes of unit length."""
    made = SCENES[name].make(tmp_path)
    for given, rounded in zip(pack(made, as_given).parts, pack(made, as_float32).parts, strict=True):
        fields = [field for field in given._fields if field != "normals"]
        assert all(np.array_equal(getattr(given, field), getattr(rounded, field)) for field in fields)


def test_a_file_and_a_mesh_are_images_in_each_set(tmp_path):
    (tmp_path / "box.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    (tmp_path / "box.ply").write_text("the same name")
    found = list(scenes.scenes_of_meshes(str(tmp_path)))
    assert [(each.name, each.aovs[2:]) for each in found] == [
        ("box", ()), ("box-smooth", ("shading_normal",)), ("box-lit", ("diffuse",)),
    ]  # fmt: skip
    lit = scenes.with_aovs(found[0], ["depth", "diffuse"])
    assert (lit.name, lit.aovs) == ("box:depth,diffuse", ("depth", "diffuse"))
    keys = {each.key for each in contestants_for(FILM, peers=True, aovs=lit.aovs)}
    assert "aov-robust" in keys and not keys & {"open3d", "trimesh", "copy", "ours-python"}


def test_aovs_and_folders_that_are_none_are_errors(tmp_path, capsys):
    assert main(["bench", "one-sphere", "--aov", "depht"]) == 2
    assert "--aov depht: unknown, did you mean 'depth'?" in capsys.readouterr().err
    assert main(["bench", "--meshes", str(tmp_path / "none"), "--list"]) == 4
    assert main(["bench", "rays", "--aov", "depth"]) == 5


def test_aovs_are_sets_of_each_image(capsys):
    words = ["bench", "one-sphere", "kinds", "--aov", "depth,normal,uv", "--aov", "position", "--list"]
    assert main(words) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        f"{name}:{aovs}" for name in ("one-sphere", "kinds") for aovs in ("depth,normal,uv", "position")
    ]


def test_threads_are_swept_up_to_all():
    settings = Settings(threads=6)
    assert [x for x, _, _ in run.over_threads(settings)] == [1.0, 2.0, 4.0, 6.0]
    assert [here.threads for _, _, here in run.over_threads(settings)] == [1, 2, 4, 6]
    assert [x for x, _, _ in run.over_threads(Settings(threads=1))] == [1.0]


# --- what is told

SCORE = Score(2000, 5.25, 0.25, 0, 1, 2000, 3, 4)
FIXED = Run(
    settings={"size": 1024, "alternations": 3, "threads": 2, "seed": 0, "peers": True},
    machine={"processor": "an abacus"},
    requested=("one-sphere", "mesh-70k", "lit-mesh"),
    scenes=(
        SceneResult(
            "mesh-70k",
            "a closed mesh",
            FILM,
            70224,
            (
                row("ours", (1e-6, 1e-6, 2e-6), score=SCORE),
                row("aov-robust", (6e-6, 6e-6, 12e-6), score=SCORE),
                row("raw-robust", (1.2e-6, 1.2e-6, 2.4e-6)),
                row("raw-robust-incoherent", (2.4e-6, 2.4e-6, 4.8e-6)),
                Row("open3d", "Open3D", "peer", why="died: SIGSEGV"),
                row("copy", (1e-7, 1e-7, 2e-7)),
            ),
        ),
        SceneResult(
            "lit-mesh",
            "a lit mesh",
            SHADING,
            70224,
            (
                row("shade-normal", (1.0,)),
                row("shade-smooth", (1.25,)),
                row("shade-unshadowed", (2.0,)),
                row("shade-shadowed", (4.5,)),
            ),
        ),
        SceneResult(
            "process",
            "a teapot",
            PROCESS,
            6320,
            (row("ours-process", (0.5,)), row("llvm-process", (1.0,)), row("scalar-process", (0.4,))),
        ),
    ),
    sweeps=(Sweep("triangles", "triangles of hills", (Series("ours", "ours", (1e2, 1e3, 1e4), (1e-3, 2e-3, 2e-2)),)),),
    bytes_of_pixel=16,
)


def test_json_brings_the_run_back_and_what_follows_from_it(tmp_path):
    file = tmp_path / "run.json"
    write_result(FIXED, str(file))
    data = json.loads(file.read_text())
    assert read_result(Run, str(file), "mitsuba-ref bench") == FIXED and data == as_json(FIXED)
    jsonschema.validate(data, result_schema("bench"))
    told = {one["key"]: one for one in data["scenes"][0]["rows"]}
    assert told["aov-robust"]["ratio"] == pytest.approx(6.0) and told["ours"]["ns"] == pytest.approx(10.0)
    assert told["open3d"]["ratio"] is None
    slopes = data["sweeps"][0]["series"][0]
    assert slopes["slope"] == pytest.approx(math.log10(20.0) / 2.0) and slopes["end_slope"] == pytest.approx(1.0)


def test_targets_are_reached_missed_or_not_measured():
    marks = {it.what: it.ok for it in performance_targets.outcomes(FIXED)}
    assert marks["AOV integrator: other scenes, geometric mean"] is False  # 6 < 8
    assert marks["`ray_intersect`: each other scene"] is False  # 1.2 < 1.5
    assert marks["`ray_intersect`: one sphere"] is None and marks["Open3D: any rays, coherent"] is None
    assert marks["ours: a shading normal costs, beside depth and normal"] is True  # 1.25 <= 1.3
    assert marks["ours: diffuse without shadows, beside depth and normal"] is False  # 2 > 1.6
    assert marks["whole process: `caster render` beside `mitsuba`"] is False  # 1.25 times the scalar one's


def test_meshes_have_targets_in_each_set():
    """1 and 4 times as fast are twice as fast, and not two and a half; the worst scene counts."""

    def timed(name: str, theirs: float) -> SceneResult:
        return SceneResult(name, "", FILM, 1, (row("ours", (1.0,)), row("raw-robust", (theirs,))), aovs=AOVS)

    both = tuple(timed(name + end, t) for name, t in (("a", 4.0), ("b", 1.0)) for end in ("", "-smooth", "-lit"))
    run = replace(FIXED, requested=tuple(each.name for each in both), scenes=both)
    worst, mean, *_ = performance_targets.outcomes(run)
    assert (worst.reached, worst.where, worst.ok) == (1.0, "b", False)
    assert mean.reached == pytest.approx(math.sqrt(4.0)) and mean.ok
    assert next(performance_targets.of_meshes(run, [])).ok is None


def test_the_pareto_front_is_of_those_that_none_beats_in_both():
    """The third is slower than the second and no more right, the last slower and worse."""
    assert performance_plots.front([(9.0, 1.0), (1.0, 5.0), (3.0, 5.0), (2.0, 3.0), (10.0, 4.0)]) == [
        (1, 5),
        (2, 3),
        (9, 1),
    ]


def test_the_page_states_all_of_it(tmp_path):
    (tmp_path / performance_page.NOTES).write_text("## What bounds it\n\nWords by hand.\n")
    performance_page.write_report(FIXED, tmp_path)
    text = (tmp_path / performance_page.PAGE).read_text()
    assert "medians of 3 alternations, fewer than the 7" in text
    assert "Words by hand." in text and "an abacus" in text and "Not timed: one-sphere." in text
    assert "| Open3D | died: SIGSEGV |" in text
    assert (
        "| Mitsuba LLVM, robust, AOV integrator | 10^2 | 500.0 | 60.00 | 16.7 | 6.00 | 5.25 | 0.25 | 0+1 | 3+4 | 1 |"
        in text
    )
    assert "**missed**" in text and "reached" in text and "not measured" in text
    assert "| ours | 1.0 | 2.0 | 20.0 | 0.65 | 1.00 |" in text  # the sweep, its slopes
    assert "| [mesh-70k](#mesh-70k) | 1.20 | 2.40 | - | 6.00 | - | - | - | - | - |" in text
    assert "| mesh-70k | 16.00 | 1.60 | 10.0 | 10.0 % |" in text  # 16 bytes in 1 ns are 16 GB/s
    assert "mesh-70k 2.00" in text  # what `coherent` is worth
    assert all(len(line) <= 120 or line.startswith(("|", "!", "<!--")) for line in text.splitlines())
    drawn = {path.stem for path in (tmp_path / performance_page.IMAGE_FOLDER).iterdir()}
    assert drawn == {"pareto", "triangles", "copying"}
    assert all(f"performance/{name}.png" in text for name in drawn)


def test_words_by_hand_stay_and_are_there_once(tmp_path):
    (tmp_path / performance_page.NOTES).write_text("Words by hand.\n")
    texts = []
    for _ in range(2):
        performance_page.write_report(FIXED, tmp_path)
        texts.append((tmp_path / performance_page.PAGE).read_text())
    assert texts[0] == texts[1] and texts[0].count("Words by hand.") == 1


def test_small_numbers_are_not_rounded_away():
    assert [results.number(x, 2) for x in (None, 0.0, 1.234, 0.00123)] == ["-", "0.00", "1.23", "1.2e-03"]


# --- the command


def test_an_unknown_scene_is_named_with_what_may_be_meant(capsys):
    assert main(["bench", "mesh-70"]) == 2
    assert "scene 'mesh-70': unknown, did you mean 'mesh-70k'?" in capsys.readouterr().err


def test_nothing_selected_is_stated(capsys):
    assert main(["bench", "-k", "no-such"]) == 5
    assert "nothing selected" in capsys.readouterr().err


def test_more_threads_than_there_are_processors_are_refused(capsys):
    assert main(["bench", "one-sphere", "--threads", "4096"]) == 2
    assert "--threads 4096: this process may use" in capsys.readouterr().err


def test_scenes_are_listed(capsys):
    assert main(["bench", "-k", "rays", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        "rays-coherent", "rays-incoherent", "rays-shadow",
    ]  # fmt: skip


def test_the_tables_of_an_earlier_run_are_printed_again(tmp_path, capsys):
    write_result(FIXED, str(tmp_path / "run.json"))
    assert main(["bench", "--from", str(tmp_path / "run.json")]) == 0
    out = capsys.readouterr().out
    assert "mesh-70k: a closed mesh (70,224 primitives)" in out
    assert re.search(r"^mesh-70k +depth, normal +1\.0e-03 +1\.20 +6\.00$", out, re.MULTILINE)
    assert re.search(r"^process +mitsuba, LLVM +1\.00 +2\.00$", out, re.MULTILINE)
    assert "3 of 3 scenes, 12 rows, 1 without numbers; medians of 3 alternations" in out
    assert main(["bench", "--from", str(tmp_path / "missing.json")]) == 4
    (tmp_path / "other.json").write_text("{}")
    assert main(["bench", "--from", str(tmp_path / "other.json")]) == 2

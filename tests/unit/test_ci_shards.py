"""Shards: every scene in exactly one, alike every time, about as large; and put together, nothing may be missing."""

import json
import random
from dataclasses import replace

import pytest
from verdict_factory import scene as made

import caster
from caster.system import processor
from mitsuba_ref.__main__ import main
from mitsuba_ref.judge.verdict import Finding, Verdict
from mitsuba_ref.runner.many_scenes import SceneEntry
from mitsuba_ref.runner.resume import read_verdict, verdict_of
from mitsuba_ref.runner.shards import Shard, judged_with, scenes_of_shard, version_in
from mitsuba_ref.runner.validation_run import run_identity

CAMERA = caster.Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0))


def entries(sizes):
    return [
        SceneEntry(caster.Scene(film=caster.Film(width=w, height=h), camera=CAMERA), f"scene-{i}", f"scene-{i}.toml")
        for i, (w, h) in enumerate(sizes)
    ]


@pytest.mark.parametrize("parts", [1, 2, 3, 7, 50])
def test_every_scene_is_in_exactly_one_shard_and_none_is_much_larger(parts):
    rng = random.Random(3)
    every = entries([(rng.randint(1, 300), rng.randint(1, 300)) for _ in range(40)])
    shards = [scenes_of_shard(every, Shard(part, parts)) for part in range(1, parts + 1)]
    names = [entry.name for shard in shards for entry in shard]
    assert sorted(names) == sorted(entry.name for entry in every)
    for shard in shards:
        assert shard == [entry for entry in every if entry in shard]  # in the order of the whole
    loads = [sum(e.scene.film.width * e.scene.film.height for e in shard) for shard in shards]
    largest = max(e.scene.film.width * e.scene.film.height for e in every)
    assert max(loads) <= sum(loads) / parts + largest  # of any greedy choice
    shuffled = every[::-1]
    again = [{entry.name for entry in scenes_of_shard(shuffled, Shard(part, parts))} for part in range(1, parts + 1)]
    assert again == [{entry.name for entry in shard} for shard in shards]


@pytest.mark.parametrize("word", ["0/3", "4/3", "1", "1/", "/2", "a/b", "-1/2", "1/0"])
def test_a_shard_that_is_none_is_reported(word, capsys):
    assert main(["validate", f"--shard={word}"]) == 2
    assert f"expected I/N with 1 <= I <= N, such as 2/4, got '{word}'" in capsys.readouterr().err


NAMES = ("a", "b", "c", "d")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """1.json and 2.json, the two shards of a run of four scenes that pass."""
    monkeypatch.chdir(tmp_path)
    write("1.json", shard("1/2", "a", "c"))
    write("2.json", shard("2/2", "b", "d"))
    return tmp_path


def shard(which, *names, left=(), ok=True, **more):
    scenes = tuple(made(name, ok=ok or name != names[-1]) for name in names)
    return Verdict(scenes, len(names) + len(left), (*names, *left), which, NAMES, **{"code": "c0", **more})


def of(which, **more):
    """The shard of b and d, judged otherwise."""
    part = shard(which, "b", "d")
    return replace(part, scenes=tuple(replace(scene, **more) for scene in part.scenes))


def write(file, verdict):
    with open(file, "w", encoding="utf-8") as out:
        json.dump(verdict.to_dict(), out, allow_nan=False)


def merged(capsys, *words):
    code = main(["merge", *words, "--json", "all.json", "--junit", "all.xml", "--summary-md", "all.md"])
    found = capsys.readouterr()
    return code, found.out, found.err


def test_all_shards_together_are_the_run(folder, capsys):
    code, out, _ = merged(capsys, "2.json", "1.json")
    assert code == 0 and "4 scenes: 4 pass, 0 fail" in out
    whole = read_verdict("all.json")
    assert whole.ok and tuple(scene.name for scene in whole.scenes) == NAMES and whole.shard == ""
    assert (folder / "all.md").read_text().startswith("## PASS: 4 scenes") and "shard" not in out
    assert 'tests="4"' in (folder / "all.xml").read_text()


def test_a_folder_stands_for_its_verdict(folder, capsys):
    (folder / "out-1").mkdir()
    (folder / "1.json").rename(folder / "out-1/verdict.json")
    assert merged(capsys, "out-1", "2.json")[0] == 0


def test_a_shard_that_is_missing_fails_and_its_scenes_are_named(folder, capsys):
    code, out, err = merged(capsys, "1.json")
    assert code == 1 and "shard 2/2 is missing" in err
    assert "FAIL  b  not judged" in out and "FAIL  d  not judged" in out
    assert "4 scenes: 2 pass, 0 fail, 2 not judged" in out
    assert not read_verdict("all.json").ok and 'errors="2"' in (folder / "all.xml").read_text()


def test_an_empty_shard_may_not_be_missing_either(folder, capsys):
    write("1.json", replace(shard("1/3", "a", "c"), selected=NAMES))
    write("2.json", shard("2/3", "b", "d"))
    assert merged(capsys, "1.json", "2.json")[0] == 1
    write("3.json", shard("3/3"))
    assert read_verdict("3.json").ok and merged(capsys, "1.json", "2.json", "3.json")[0] == 0


def test_a_scene_that_fails_or_was_left_in_its_shard_fails_the_whole(folder, capsys):
    write("2.json", shard("2/2", "b", "d", ok=False))
    code, out, _ = merged(capsys, "1.json", "2.json")
    assert code == 1 and "FAIL  d  depth: 1 wrong" in out and "4 scenes: 3 pass, 1 fail" in out
    write("2.json", shard("2/2", "b", left=("d",)))
    code, out, _ = merged(capsys, "1.json", "2.json")
    assert code == 1 and "FAIL  d  not judged" in out


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (shard("1/2", "b", "d"), "shard 1/2 once more"),
        (shard("2/3", "b", "d"), "expected a shard of the same run"),
        (replace(shard("2/2", "b", "d"), selected=("a", "b", "c")), "expected a shard of the same run"),
        (shard("2/2", "a", "b"), "scene a is in another shard, too"),
        (shard("2/2", "b", "e"), "scenes that the run did not select: e"),
        (shard("2/2", "b", "d", code="c1"), "it is of other code or other scenes than 1.json"),
        (of("2/2", candidate="mine:trace"), "2.json: it judged mine:trace, and 1.json judged ours"),
        (
            replace(shard("2/2", left=("b", "d")), requested_candidate="mine:trace"),
            "2.json: it judged mine:trace, and 1.json judged ours",
        ),
        (of("2/2", resized=True), "2.json: it has films of 12 x 10, and 1.json has films of the scenes' own sizes"),
        (replace(shard("", "b", "d"), selected=()), "expected a shard, got a run that was not divided"),
    ],
)
def test_what_are_not_parts_of_one_run_are_not_put_together(folder, capsys, other, says):
    write("2.json", other)
    code, _, err = merged(capsys, "1.json", "2.json")
    assert code == 3 and says in err and not (folder / "all.json").exists()


def with_versions(which, names, versions=None, **judged_with):
    """A shard whose run and whose scenes say what they were judged with."""
    part = shard(which, *names, judged_with=WITH | judged_with)
    scenes = (replace(scene, versions=scene.versions | (versions or {})) for scene in part.scenes)
    return replace(part, scenes=tuple(scenes))


WITH = {"machine": "x86_64", "mitsuba": "3.9.1", "numpy": "2.1", "variant of triangles": "llvm_ad_rgb"}
LLVM_19 = {"variant": "llvm_ad_rgb", "libllvm": "/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1"}


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (with_versions("2/2", "bd", mitsuba="3.9.0"), "2.json was judged with mitsuba 3.9.0, 1.json with 3.9.1\n"),
        (with_versions("2/2", "bd", {"drjit": "1.4.0"}), "2.json was judged with drjit 1.4.0, 1.json with 1.5.0\n"),
        (with_versions("2/2", "bd", numpy="2.0"), "2.json was judged with numpy 2.0, 1.json with 2.1\n"),
        (
            with_versions("2/2", "bd", LLVM_19 | {"libllvm": "/opt/libLLVM-18.so.1"}),
            "2.json was judged with libLLVM 18.1, 1.json with 19.1\n",
        ),
        (
            with_versions("2/2", "bd", **{"variant of triangles": "scalar_rgb"}),
            "2.json was judged with variant of triangles scalar_rgb, 1.json with llvm_ad_rgb\n",
        ),
    ],
)
def test_shards_of_other_versions_are_put_together_only_if_requested(folder, capsys, other, says):
    write("1.json", with_versions("1/2", "ac", LLVM_19 | {"drjit": "1.5.0"}))
    write("2.json", other)
    code, _, err = merged(capsys, "1.json", "2.json")
    assert code == 3 and says in err and "--other-versions" in err and not (folder / "all.json").exists()
    code, out, err = merged(capsys, "1.json", "2.json", "--other-versions")
    assert code == 0 and f"{says.strip()}: merged all the same, by --other-versions" in err and "4 pass" in out
    together = read_verdict("all.json").judged_with
    assert together == {
        what: " and ".join(dict.fromkeys((version, other.judged_with[what]))) for what, version in WITH.items()
    }


def test_shards_of_other_processors_are_put_together_and_it_is_said(folder, capsys):
    intel, amd = "GenuineIntel family 6 model 142 (x86-64-v3)", "AuthenticAMD family 25 model 17 (x86-64-v4)"
    write("1.json", with_versions("1/2", "ac", processor=intel))
    write("2.json", with_versions("2/2", "bd", processor=amd))
    code, out, err = merged(capsys, "1.json", "2.json")
    assert code == 0 and "4 pass" in out
    assert f"2.json was judged with processor {amd}, 1.json with {intel}: merged; only last bits" in err
    assert read_verdict("all.json").judged_with["processor"] == f"{intel} and {amd}"
    write("2.json", with_versions("2/2", "bd", processor=intel))
    assert merged(capsys, "1.json", "2.json")[2] == ""


def test_the_same_libraries_in_other_folders_and_scenes_of_other_variants_are_alike(folder, capsys):
    write("1.json", with_versions("1/2", "ac", LLVM_19))
    write("2.json", with_versions("2/2", "bd", LLVM_19 | {"libllvm": "/usr/lib64/libLLVM.so.19.1"}))
    assert merged(capsys, "1.json", "2.json")[0] == 0
    write("2.json", with_versions("2/2", "bd", {"libllvm": "none"}))
    assert merged(capsys, "1.json", "2.json")[0] == 0


def test_a_run_states_what_it_judged_with(monkeypatch):
    found = judged_with()
    assert found["mitsuba"] == "3.9.1" and found["variant of quadrics"] == "scalar_rgb"
    assert found["processor"] == processor.description()
    monkeypatch.setenv("MITSUBA_REF_VARIANT", "scalar_rgb")
    assert judged_with()["variant of triangles"] == "scalar_rgb" and judged_with()["libLLVM"] == "none"
    assert version_in("/usr/lib/llvm-19/lib/libLLVM.so.19.1") == "19.1"
    assert run_identity([], None)["judged_with"] == judged_with()


def test_a_file_that_is_no_verdict_is_reported(folder, capsys):
    good = json.loads((folder / "2.json").read_text())
    for content, says in (
        ("", "expected JSON"),
        ("[1]", "expected a verdict of format"),
        (json.dumps(good | {"format": 1}), "expected a verdict of format 3, got 1"),
        (json.dumps(good | {"ok": False}), "its ok is False, by its scenes it is True"),
        (json.dumps({k: v for k, v in good.items() if k != "scenes"}), "not a whole verdict"),
        (json.dumps(good | {"scenes": [{}]}), "not a whole verdict"),
    ):
        (folder / "2.json").write_text(content)
        code, _, err = merged(capsys, "1.json", "2.json")
        assert code == 4 and says in err and "2.json: " in err
    assert merged(capsys, "1.json", "none.json")[0] == 4


def test_a_verdict_comes_back_from_json_as_it_was():
    whole = Verdict((made("a"), made("b", ok=False), made("c", ok=False, problem="crash")), 4, ("a", "b", "c", "d"))
    assert verdict_of(json.loads(json.dumps(whole.to_dict()))) == whole


def test_a_verdict_on_a_candidate_comes_back_from_json_as_it_was():
    said = {"candidate": "mine:trace", "precision": "float32", "unjudged": ("diffuse",), "notes": ("a note",)}
    said["options"] = ("--candidate", "mine:trace")
    wrong = made("b", ok=False, findings=(Finding(1, "missed", 3, 4),), **said)
    whole = Verdict((made("a", **said), wrong), 2, ("a", "b"))
    record = json.loads(json.dumps(whole.to_dict()))
    assert record["counts"]["wrong"] == 1 and record["candidate"] == "mine:trace"
    assert verdict_of(record) == whole
    nothing = Verdict((), 1, ("a",), requested_candidate="mine:trace")  # interrupted before the first scene was done
    assert verdict_of(json.loads(json.dumps(nothing.to_dict()))) == nothing


def test_shards_of_other_scenes_of_the_same_names_are_of_different_runs(tmp_path):
    part = Shard(1, 2)
    entries = [SceneEntry(caster.load_scene("scenes/one-sphere.toml"), "a", "a.toml")]
    other = [SceneEntry(caster.load_scene("scenes/one-sphere.toml").with_film(width=8, height=8), "a", "a.toml")]
    assert run_identity(entries, part) == run_identity(list(entries), part) and run_identity(entries, part)[
        "selected"
    ] == ("a",)
    assert run_identity(entries, part)["code"] != run_identity(other, part)["code"]

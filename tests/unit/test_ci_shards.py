"""Shards hold each scene once, are reproducible and of similar size; merging them notices missing scenes."""

import json
from dataclasses import replace

import pytest
from outputs import json_of
from verdict_factory import scene as made

from mitsuba_ref.__main__ import main
from mitsuba_ref.judge.verdict import Finding, Verdict
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry
from mitsuba_ref.runner.shards import run_identity
from mitsuba_ref.runner.validation_run import ValidationRun
from mitsuba_ref.runner.verdict_files import read_verdict


@pytest.mark.parametrize("parts", [1, 2, 3, 7, 50])
def test_every_scene_is_in_exactly_one_shard_and_none_is_larger_by_two(parts):
    every = [SceneEntry(f"scene-{i}", "") for i in range(40)]
    each = ((part, parts) for part in range(1, parts + 1))
    shards = [ValidationRun(every, JudgeOptions(), shard=part).entries for part in each]
    assert sorted(entry.name for shard in shards for entry in shard) == sorted(entry.name for entry in every)
    for shard in shards:
        assert shard == [entry for entry in every if entry in shard]  # in the order of the whole
    assert max(map(len, shards)) - min(map(len, shards)) <= 1


@pytest.mark.parametrize("word", ["0/3", "4/3", "1", "1/", "/2", "a/b", "-1/2", "1/0"])
def test_a_shard_that_is_none_is_reported(word, capsys):
    assert main(["validate", f"--shard={word}"]) == 2
    assert f"expected I/N with 1 <= I <= N, such as 2/4, got '{word}'" in capsys.readouterr().err


NAMES = ("a", "b", "c", "d")


@pytest.fixture
def folder(here):
    """1.json and 2.json, the two shards of a run of four scenes that pass."""
    write("1.json", shard("1/2", "a", "c"))
    write("2.json", shard("2/2", "b", "d"))
    return here


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
    """A folder stands for its verdict; the processors of both are named."""
    write("1.json", shard("1/2", "a", "c", judged_with=WITH))
    write("2.json", shard("2/2", "b", "d", judged_with=WITH | {"processor": "two"}))
    (folder / "out-1").mkdir()
    (folder / "1.json").rename(folder / "out-1/verdict.json")
    code, out, _ = merged(capsys, "2.json", "out-1")
    assert code == 0 and "4 scenes: 4 pass, 0 fail" in out
    whole = read_verdict("all.json")
    assert whole.judged_with["processor"] == "two and one"
    assert whole.ok and tuple(scene.name for scene in whole.scenes) == NAMES and whole.shard == ""
    assert (folder / "all.md").read_text().startswith("## PASS: 4 scenes") and "shard" not in out
    assert 'tests="4"' in (folder / "all.xml").read_text()


def test_a_shard_that_is_missing_fails_and_its_scenes_are_named(folder, capsys):
    code, out, err = merged(capsys, "1.json")
    assert code == 1 and "1 of 2 shards are missing: 2/2 first" in err
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


WITH = {"machine": "x86_64", "mitsuba": "3.9.1", "processor": "one"}


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (shard("1/2", "b", "d"), "shard 1/2 once more"),
        (shard("2/3", "b", "d"), "its number of shards is 3, there it is 2"),
        (replace(shard("2/2", "b", "d"), selected=("a", "b", "c")), "its selection is a, b, c, there it is a, b, c, d"),
        (shard("2/2", "b", "d", code="c1"), "its hash of code and scenes is c1, there it is c0"),
        (of("2/2", candidate="mine:trace"), "its subject is mine:trace, there it is our caster"),
        (
            replace(shard("2/2", left=("b", "d")), requested_candidate="mine:trace"),
            "its subject is mine:trace, there it is our caster",
        ),
        (replace(shard("", "b", "d"), selected=()), "its number of shards is 1, there it is 2"),
        (shard("2/2", "b", "d", judged_with=WITH | {"mitsuba": "3.9.0"}), "its mitsuba is 3.9.0, there it is 3.9.1"),
    ],
)
def test_what_are_not_parts_of_one_run_are_not_put_together(folder, capsys, other, says):
    write("1.json", shard("1/2", "a", "c", judged_with=WITH))
    write("2.json", other)
    code, _, err = merged(capsys, "1.json", "2.json")
    assert code == 3 and says in err and "2.json: " in err and not (folder / "all.json").exists()


def test_a_file_that_is_no_verdict_is_reported(folder, capsys):
    good = json_of(folder / "2.json")
    for content, says in (
        ("", "not a whole verdict: Expecting value"),
        ("[1]", "expected a verdict of format"),
        (json.dumps(good | {"format": 1}), "expected a verdict of format 6, got 1"),
        (json.dumps(good | {"ok": False}), "its ok is False, by its numbers it is True"),
        (json.dumps(good | {"shard": "2/x"}), "not a whole verdict: shard: "),
    ):
        (folder / "2.json").write_text(content)
        code, _, err = merged(capsys, "1.json", "2.json")
        assert code == 4 and says in err and "2.json: " in err
    assert merged(capsys, "1.json", "none.json")[0] == 4


def test_a_verdict_comes_back_from_json_as_it_was(tmp_path):
    said = {"candidate": "mine:trace", "precision": "float32", "unjudged": ("diffuse",), "notes": ("a note",)}
    said["options"] = ("--candidate", "mine:trace")
    wrong = made("b", ok=False, findings=(Finding(1, "missed", 3, 4),), **said)
    for whole in (
        Verdict((made("a"), made("b", ok=False), made("c", ok=False, problem="crash")), 4, ("a", "b", "c", "d")),
        Verdict((made("a", **said), wrong), 2, ("a", "b")),
        Verdict((), 1, ("a",), requested_candidate="mine:trace"),  # interrupted before the first scene was done
    ):
        write(tmp_path / "v.json", whole)
        assert read_verdict(tmp_path / "v.json") == whole


def test_shards_of_other_scenes_of_the_same_names_are_of_different_runs():
    part = (1, 2)
    first, again = (run_identity([SceneEntry("a", "scenes/one-sphere.toml")], part) for _ in range(2))
    assert first == again and first["selected"] == ("a",)
    assert run_identity([SceneEntry("a", "scenes/one-sphere.toml", (8, 8))], part)["code"] != first["code"]

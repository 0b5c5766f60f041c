"""A verdict of equal inputs is taken from the store and marked; anything else is judged again."""

import hashlib
import os
from dataclasses import replace
from pathlib import Path

import pytest
from outputs import json_of
from places import ROOT
from verdict_factory import scene as made

from caster.scene.files import load_scene
from mitsuba_ref.__main__ import main
from mitsuba_ref.reference import store, variants
from mitsuba_ref.runner import many_scenes, verdict_files

BALL = '[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n[[shape]]\ntype = "sphere"\nradius = {}\n'


@pytest.fixture
def judged(here, monkeypatch):
    """Three scenes, and a judge that is made up; run(...) gives the names of those that were judged."""
    monkeypatch.setenv(store.STORE_VARIABLE, str(here / "store"))
    Path("scenes").mkdir()
    for i, name in enumerate("abc"):
        Path(f"scenes/{name}.toml").write_text(BALL.format(1 + i))

    def validate(task, *, folder=None, **options):
        with Path("judged").open("a") as asked:  # by a worker
            asked.write(f"{task.name}\n")
        return replace(made(task.name), path=task.path, reproducers=())

    monkeypatch.setattr(many_scenes, "validate_scene", validate)

    def run(*words: str, code: int = 0) -> list[str]:
        Path("judged").write_text("")
        assert main(["validate", "scenes", "-j", "1", "--json", "v.json", *words]) == code
        kept = [scene["name"] for scene in json_of("v.json")["scenes"] if scene["kept"]]
        asked = sorted(Path("judged").read_text().split())
        assert sorted([*kept, *asked]) == ["a", "b", "c"]
        return asked

    return run


ALL = ["a", "b", "c"]


def test_the_same_inputs_are_found_and_stated(judged, capsys):
    assert judged() == ALL and judged() == []
    out = capsys.readouterr().out
    assert "kept:       3 scenes were not judged now" in out and "PASS  a" in out
    assert judged("--no-store") == ALL
    assert judged("--html", "report") == ALL == judged("--out", "out")  # whose pixels are not kept


def test_another_option_judges_all_anew(judged):
    assert judged() == ALL
    for words in (("--size", "20", "10"), ("--mesh-dir", "scenes")):
        assert judged(*words) == ALL and judged(*words) == [], words


def edit_scene(monkeypatch):
    Path("scene.toml").write_text(BALL.format(7))


def patched(where, name, value):
    def change(monkeypatch):
        monkeypatch.setattr(where, name, value)
        store.this_machine.cache_clear()

    return change


CHANGES = {
    "the scene": edit_scene,
    "code": patched(verdict_files, "code_hash", lambda modules=None: "other"),
    "a version": patched(store, "installed_version", lambda name: "9"),
    "the variant": patched(verdict_files, "variant_of", lambda scene: "other"),
    "libLLVM": patched(variants, "environment_for", lambda variant: {"DRJIT_LIBLLVM_PATH": "/other"}),
    "a setting": lambda monkeypatch: monkeypatch.setenv("CASTER_ANYTHING", "1"),
    "the instruction set of the reference": lambda monkeypatch: monkeypatch.setenv("EMBREE_CONFIG", "isa=avx2"),
    "a kind of another package": patched(verdict_files, "SHAPES", (many_scenes.SceneEntry,)),
}


@pytest.mark.parametrize("change", CHANGES)
def test_whatever_changes_is_another_key(here, monkeypatch, change):
    Path("scene.toml").write_text(BALL.format(1))
    before, again = (verdict_files.verdict_key(load_scene("scene.toml"), "scene.toml") for _ in range(2))
    with monkeypatch.context() as patch:
        CHANGES[change](patch)
        after = verdict_files.verdict_key(load_scene("scene.toml"), "scene.toml")
    store.this_machine.cache_clear()
    assert before == again != after and bool(after) == (change != "a kind of another package")


def test_an_interrupted_run_goes_on_where_it_ended(judged, monkeypatch):
    judge = many_scenes.validate_scene

    def killed(task, **options):
        return os._exit(1) if task.name == "b" else judge(task, **options)

    with monkeypatch.context() as patch:
        patch.setattr(many_scenes, "validate_scene", killed)
        assert main(["validate", "scenes", "-j", "1", "--maxfail", "1"]) == 1
    assert judged() in (["b"], ["b", "c"])


def test_a_verdict_without_a_comparison_is_not_kept(judged, monkeypatch):
    monkeypatch.setattr(many_scenes, "validate_scene", lambda task, **o: made(task.name, ok=False, problem="x"))
    assert main(["validate", "scenes"]) == main(["validate", "scenes", "--json", "v.json"]) == 1
    assert not any(scene["kept"] for scene in json_of("v.json")["scenes"])


def test_what_the_store_holds_in_place_of_a_verdict_is_judged_anew(judged, monkeypatch):
    assert judged() == ALL
    monkeypatch.setattr(store.StoreFolder, "get", lambda self, key: b'{"name": "a"}')
    assert judged() == ALL


def test_the_bytes_of_every_source_file_count():
    found = {name: source.digest for name, source in verdict_files.sources().items()}
    files = [path for package in verdict_files.PACKAGES for path in (ROOT / package).rglob("*.py")]
    teapot = (ROOT / "caster/shapes/teapot").with_suffix
    expected = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }
    with_data = hashlib.sha256(teapot(".py").read_bytes() + teapot(".txt").read_bytes()).hexdigest()
    assert found == expected | {"caster.shapes.teapot": with_data}

"""Which scenes a command is about: files, folders, and -k."""

import contextlib
import os
from pathlib import Path

import pytest

from caster.cli.shared_arguments import display_names, scene_files
from caster.description.errors import FileMissing, SceneError
from mitsuba_ref.runner.many_scenes import matching

NAMES = ("teapot", "mesh-tea", "mesh", "sphere")


def chosen(expression: str) -> list[str]:
    fits = matching(expression)
    return [name for name in NAMES if fits(name)]


@pytest.mark.parametrize(
    ("expression", "names"),
    [
        ("mesh", ["mesh-tea", "mesh"]),
        ("mesh and tea", ["mesh-tea"]),
        ("mesh or tea", ["teapot", "mesh-tea", "mesh"]),
        ("not mesh", ["teapot", "sphere"]),
        ("not mesh and not sphere", ["teapot"]),
        ("sphere or mesh and tea", ["mesh-tea", "sphere"]),
        ("(sphere or mesh) and tea", ["mesh-tea"]),
        ("not (sphere or tea)", ["mesh"]),
        ("(" * 50 + "mesh" + ")" * 50, ["mesh-tea", "mesh"]),
        ("(mesh)and(tea)", ["mesh-tea"]),
        ("  mesh   and\ttea ", ["mesh-tea"]),
        ("organd", []),
        ("Mesh", []),
    ],
)
def test_an_expression_chooses_by_parts_of_names(expression, names):
    assert chosen(expression) == names


def test_without_an_expression_every_name_fits():
    assert all(map(matching(None), NAMES))


@pytest.mark.parametrize(
    "expression", ["", "mesh and", "or mesh", "not", "()", "(mesh", "mesh)", "mesh tea", "(" * 10**5]
)
def test_an_expression_that_does_not_read_is_refused(expression):
    with pytest.raises(SceneError, match="expected parts of names with and, or, not and parentheses") as error:
        matching(expression)
    assert str(error.value).startswith("-k '") and error.value.exit_code == 2


@pytest.mark.parametrize("expression", ["__import__('os')", "1/0", "has", "\\"])
def test_a_word_is_a_part_of_a_name_whatever_it_is(expression):
    with contextlib.suppress(SceneError):
        assert chosen(expression) == []


def test_a_folder_gives_its_scene_files_in_order_and_not_what_lies_deeper(tmp_path):
    for name in ("b.toml", "a.json", "notes.txt", "deeper/c.toml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert scene_files([str(tmp_path)]) == [str(tmp_path / "a.json"), str(tmp_path / "b.toml")]


def test_a_file_that_is_named_is_taken_whatever_its_suffix_and_only_once(tmp_path):
    file = tmp_path / "scene.txt"
    file.touch()
    assert scene_files([str(file), str(file)]) == [str(file)]
    (tmp_path / "scene.toml").touch()
    assert scene_files([str(tmp_path), str(tmp_path / "scene.toml")]) == [str(tmp_path / "scene.toml")]


def test_a_place_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileMissing, match=r"nowhere: expected a scene file or a folder of them, found nothing"):
        scene_files([str(tmp_path / "nowhere")])


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["s/a.toml", "s/b.toml"], ["a", "b"]),
        (["s/a.toml", "t/a.toml"], ["s-a.toml", "t-a.toml"]),
        (["s/a.toml", "../s/a.toml", "../../s/a.toml"], ["s-a.toml", "s-a.toml-2", "s-a.toml-3"]),
    ],
)
def test_no_two_scenes_have_the_same_name(files, names):
    """They name the files of --out: one would be written over the other."""
    assert display_names(files) == names


def test_a_file_name_that_is_no_utf_8_is_reported(tmp_path):
    file = os.fsdecode(bytes(tmp_path) + b"/\xff.toml")
    Path(file).write_text("")
    for place in (file, str(tmp_path)):
        with pytest.raises(SceneError, match=r"udcff\.toml': expected a name in UTF-8"):
            scene_files([place])

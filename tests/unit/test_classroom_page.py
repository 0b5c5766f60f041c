"""docs/classroom.md: its scenes load, its caster runs and is right, and what it prints is what the page shows."""

import re
import runpy
import sys

import pytest
from places import ROOT

import caster
from caster.__main__ import main
from caster.classroom.course_files import load_course_scene

PAGE = (ROOT / "docs/classroom.md").read_text(encoding="utf-8")


def as_shown(file):
    """The file as the page has it."""
    (code,) = re.findall(rf"`{re.escape(file)}`:\n\n```\w*\n(.*?)```", PAGE, re.DOTALL)
    return code


def output_of(command):
    """What the page says that a command prints."""
    (text,) = re.findall(rf"^    \$ {re.escape(command)}\n((?:    .*\n)+)", PAGE, re.MULTILINE)
    return re.sub("(?m)^    ", "", text)


@pytest.fixture
def folder(here, monkeypatch):
    for file in ("lesson.toml", "lesson.txt", "student.py", "check.py"):
        (here / file).write_text(as_shown(file))
    monkeypatch.syspath_prepend(here)
    yield here
    sys.modules.pop("student", None)


def check(capsys):
    runpy.run_path("check.py")
    return capsys.readouterr().out


def test_the_caster_of_the_page_is_right_and_prints_what_the_page_shows(folder, capsys):
    assert check(capsys) == output_of("python check.py")


@pytest.mark.parametrize(
    ("right", "wrong", "says"),
    [
        (
            "np.where(t > 0.0, t, np.inf), np.tile(normal",
            "t, np.tile(normal",
            "rays: 38400 hits: 38400 hit by one of the two alone: 6378\n",
        ),
        ("v = np.cross(u, w)", "v = np.array(up)", "pixels of the image beyond 1e-12 of their depth: "),
        ("return t, p / radius", "return t, p", "normals beyond 1e-12: "),
        ("beta + gamma <= 1.0", "beta + gamma <= 2.0", "t beyond 1e-12 of it: "),
    ],
)
def test_its_check_finds_mistakes(folder, capsys, right, wrong, says):
    """Those that the page describes, and one more."""
    code = as_shown("student.py")
    if right not in code:
        pytest.fail(f"the page's caster has no {right!r}")
    (folder / "student.py").write_text(code.replace(right, wrong))
    found, expected = check(capsys), output_of("python check.py")
    changed = set(found.splitlines()) - set(expected.splitlines())
    assert any(line.startswith(says.strip()) for line in changed), found


def test_both_scenes_are_the_same(folder):
    ours, course = caster.load_scene("lesson.toml"), load_course_scene("lesson.txt", 240, 160).scene
    assert ours.camera == course.camera and ours.film == course.film
    plain = [shape.model_copy(update={"material": ""}) for shape in course.shapes]
    assert list(ours.shapes) == plain


def test_its_commands_run(folder):
    commands = re.findall(r"(?m)^    (caster (?:render|preview) lesson.*|caster 6837 -input lesson.*)$", PAGE)
    assert len(commands) == 3
    for command in commands:
        assert main(command.split()[1:]) == 0, command
    assert {"lesson.png", "out.png", "depth.png", "normals.png"} <= {file.name for file in folder.iterdir()}


def test_its_error_is_what_is_stated(folder, capsys):
    (folder / "bad.txt").write_text(as_shown("lesson.txt").replace("0.8", "-0.8"))
    assert main(["6837", "-input", "bad.txt", "-output", "out.png"]) == 2
    assert capsys.readouterr().err == output_of("caster 6837 -input bad.txt -output out.png")

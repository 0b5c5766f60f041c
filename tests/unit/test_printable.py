"""Control, format and bidirectional characters never reach a terminal."""

import json
import sys

import pytest

import caster.__main__
import mitsuba_ref.__main__
from caster.description.errors import SceneError
from caster.system.process import run_command
from caster.system.terminal import printable
from mitsuba_ref.report import validation
from mitsuba_ref.report.results import Column, format_table

HOSTILE = "a\x1b[2J\x07\r\x9b31m\u202eb\u2066\u200b\x7f"


def test_escapes_are_those_of_json():
    shown = printable(HOSTILE, keep="")
    assert shown.isprintable() and json.loads(f'"{shown}"') == HOSTILE
    assert printable("é ☃ 漢 \n\t") == "é ☃ 漢 \n\t"
    assert printable("\U000e0041") == "\\udb40\\udc41"
    assert "\n" not in format_table([Column("name")], [["x\nPASS  forged"]]).partition("\n")[2]


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_what_any_command_prints_is_escaped(stream, capfd):
    def command():
        print(HOSTILE, file=getattr(sys, stream))
        raise SceneError(f"{HOSTILE}.toml: no")

    assert run_command(command) == 2
    out, err = capfd.readouterr()
    assert all(c.isprintable() or c == "\n" for c in out + err)
    assert "\\u001b[2J" in (out if stream == "stdout" else err) and "\\u202e" in err


@pytest.mark.parametrize(
    ("main", "argv"),
    [
        (caster.__main__.main, ["render"]),
        (caster.__main__.main, ["check"]),
        (caster.__main__.main, ["info"]),
        (caster.__main__.main, ["no-such-command"]),
        (mitsuba_ref.__main__.main, ["validate"]),
        (mitsuba_ref.__main__.main, ["validate", "scenes", "-k"]),
        (mitsuba_ref.__main__.main, ["stress", "--list", "-k"]),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)
def test_hostile_arguments_and_source_lines_are_escaped(main, argv, capfd, tmp_path):
    scene = tmp_path / f"{HOSTILE}.toml"
    scene.write_text(f'"{HOSTILE}" = 3\n[film]\nwidth = "{HOSTILE}"\n', encoding="utf-8", newline="")
    assert main([*argv, str(scene)]) in (2, 4, 5)
    out, err = capfd.readouterr()
    assert out + err and all(c.isprintable() or c in "\n\t" for c in out + err)


def test_a_film_beyond_the_memory_is_refused_with_the_numbers(monkeypatch):
    scene = caster.load_scene("scenes/one-sphere.toml").with_film(width=20_000, height=20_000)
    monkeypatch.setattr(validation, "available_bytes", lambda: 8e9)
    with pytest.raises(SceneError, match=r"20000 x 20000 pixels need some 580\.0 GB .* and 8\.0 GB are left"):
        validation.check_memory(scene)
    validation.check_memory(scene.with_film(crop=(0, 0, 100, 100)))
    monkeypatch.undo()
    assert 1e6 < validation.available_bytes() < 1e15

"""Control, format and bidirectional characters never reach a terminal."""

import json
import sys

import pytest

import caster.__main__
import mitsuba_ref.__main__
from caster.description.errors import SceneError
from caster.system.process import run_command
from caster.system.terminal import printable

HOSTILE = "a\x1b[2J\x07\r\x9b31m\u202eb\u2066\u200b\x7f"


def test_escapes_are_those_of_json():
    shown = printable(HOSTILE, keep="")
    assert shown.isprintable() and json.loads(f'"{shown}"') == HOSTILE
    assert printable("é ☃ 漢 \n\t") == "é ☃ 漢 \n\t"
    assert printable("\U000e0041") == "\\udb40\\udc41"


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_what_any_command_prints_is_escaped(stream, capfd):
    def command():
        print(HOSTILE, file=getattr(sys, stream))
        raise SceneError(f"{HOSTILE}.toml: no")

    assert run_command(command) == 2
    out, err = capfd.readouterr()
    assert all(c.isprintable() or c == "\n" for c in out + err)
    assert "\\u001b[2J" in (out if stream == "stdout" else err) and "\\u202e" in err


@pytest.mark.parametrize("main", [caster.__main__.main, mitsuba_ref.__main__.main], ids=["caster", "mitsuba-ref"])
@pytest.mark.parametrize("command", ["render", "check", "validate", "no-such-command"])
def test_hostile_arguments_and_source_lines_are_escaped(main, command, capfd, tmp_path):
    scene = tmp_path / f"{HOSTILE}.toml"
    scene.write_text(f'"{HOSTILE}" = 3\n[film]\nwidth = "{HOSTILE}"\n', encoding="utf-8", newline="")
    assert main([command, str(scene)]) in (2, 4, 5)
    out, err = capfd.readouterr()
    assert out + err and all(c.isprintable() or c in "\n\t" for c in out + err)

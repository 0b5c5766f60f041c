"""Progress on standard error: on a terminal, into a pipe, and how much work it counts."""

import io
import os
import re
import subprocess
import sys

import numpy as np
import pytest

import caster
from caster.__main__ import main
from caster.rendering.images import render_film
from caster.system.terminal import LOG_SECONDS, QUIET_SECONDS, REFRESH_SECONDS, ProgressBar, StatusLine
from mitsuba_ref.cli import options

SCENE = """
[film]
width = 150
height = 70
[camera]
type = "pinhole"
eye = [0.3, 0.4, 5]
look_at = [0, 0, 0]
[[shape]]
type = "sphere"
"""


END = "<end>"
CONTROL = re.compile(r"\x1b\[(\?25[lh]|\d*[A-Zm]|[\d;]+m)|\r|\n|[^\x1b\r\n]+")


def screen(written):
    """The lines left on a terminal: what a reader sees after cursor movements and erasures."""
    lines, row, column = [""], 0, 0
    for found in CONTROL.finditer(written):
        code = found[0]
        if code == "\r":
            column = 0
        elif code == "\n":
            row, column = row + 1, 0
            lines += [""] * (row + 1 - len(lines))
        elif code == "\x1b[2K":
            lines[row] = ""
        elif code.endswith("A") and code.startswith("\x1b"):
            row -= int(code[2:-1] or 1)
        elif not code.startswith("\x1b"):
            lines[row] = lines[row][:column].ljust(column) + code + lines[row][column + len(code) :]
            column += len(code)
    return [line.rstrip() for line in lines if line.strip()]


def assert_erased(written):
    assert written.endswith("\x1b[2K"), written
    assert written.count("\x1b[?25h") == 1, "the cursor is shown again"


class Clock:
    """Seconds that pass when a test says so."""

    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def terminal(monkeypatch):
    """(a stream that is a terminal, a function that reads what came out of it)."""
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("TERM", "xterm")
    outer, inner = os.openpty()
    stream = os.fdopen(inner, "w", encoding="utf-8")

    def read():
        stream.write(END)  # what goes through a terminal arrives when it likes
        stream.flush()
        said = b""
        while not said.endswith(END.encode()):
            said += os.read(outer, 1 << 16)
        return said.decode().removesuffix(END)

    yield stream, read
    stream.close()
    os.close(outer)


def test_a_terminal_gets_one_line_that_is_drawn_again_and_erased(terminal):
    stream, read = terminal
    clock = Clock()
    bar = ProgressBar("rendering", 4000, "rays", stream, clock)
    for step in range(1, 3):
        clock.now = step * QUIET_SECONDS
        bar.add(1000)
    drawn = read()
    (line,) = screen(drawn)
    assert line == f"rendering {'#' * 12}{'-' * 12} 50 %, 2k of 4k rays, 1k rays/s, 2 s left"
    bar.close()
    erased = read()
    assert_erased(erased)
    assert screen(drawn + erased) == []
    bar.close()
    assert read() == ""


def test_the_line_makes_way_for_what_is_printed(terminal):
    stream, read = terminal
    clock = Clock()
    bar = ProgressBar("validating", 10, "rays", stream, clock)
    clock.now = QUIET_SECONDS
    bar.add(3, "1 of 2 scenes")
    written = read()
    assert "30 %, 1 of 2 scenes, 3 of 10 rays" in written
    with bar.aside():
        written += read()
        assert screen(written) == []
        stream.write("a row\n")
    clock.now += REFRESH_SECONDS
    bar.add(2)
    row, line = screen(written + read())
    assert row == "a row" and "50 %, 1 of 2 scenes, 5 of 10 rays" in line
    bar.close()


def test_a_pipe_gets_whole_lines_now_and_then():
    stream, clock = io.StringIO(), Clock()
    bar = ProgressBar("validating", 4, "rays", stream, clock)
    for second in (1.0, LOG_SECONDS, LOG_SECONDS + 1.0, 2 * LOG_SECONDS):
        clock.now = second
        bar.add(1, "1 of 2 scenes")
    bar.close()
    assert stream.getvalue() == "validating: 50 %, 1 of 2 scenes, 2 of 4 rays, 0.2 rays/s, 10 s left\n"


def test_where_standard_error_is_closed_work_goes_on(monkeypatch):
    monkeypatch.setattr("sys.stderr", None)
    clock = Clock()
    bar = ProgressBar("rendering", 10, "rays", clock=clock)
    clock.now = LOG_SECONDS
    bar.add(5)
    bar.close()
    assert bar.done == 5 and not bar.line.live


def sweeping():
    said = options.Progress("1/22 scale")
    said("m" * 50)
    return said.clear


def fuzzing():
    line = StatusLine()
    line.show("f" * 50)
    return line.erase


LINES = pytest.mark.parametrize("said", [sweeping, fuzzing])


@LINES
def test_every_line_is_cut_to_the_terminal_and_erased_once(terminal, monkeypatch, said):
    """A wrapped line could not be erased."""
    stream, read = terminal
    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setattr("sys.stderr", stream)
    end = said()
    drawn = read()
    (line,) = screen(drawn)
    assert len(line) == 30
    end()
    end()
    erased = read()
    assert_erased(erased)
    assert screen(drawn + erased) == []


@LINES
@pytest.mark.parametrize("where", ["closed", "dumb"])
def test_no_line_needs_a_terminal(terminal, monkeypatch, said, where):
    stream, read = terminal
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr("sys.stderr", None if where == "closed" else stream)
    said()()
    assert "\x1b" not in read()


def test_rich_is_loaded_when_a_bar_is_drawn_and_not_before():
    source = (
        "import sys, io; from caster.system.terminal import ProgressBar, StatusLine\n"
        "bar = ProgressBar('rendering', 10, 'rays', io.StringIO(), lambda: 0.0); bar.add(5); bar.close()\n"
        "StatusLine(io.StringIO()).show('text')\n"
        "assert not {'rich', 'numba', 'numpy'} & sys.modules.keys()\n"
    )
    subprocess.run([sys.executable, "-c", source], check=True)


@pytest.mark.parametrize(
    ("aovs", "camera"),
    [
        (("depth", "normal"), "pinhole"),  # painted at once
        (("depth", "position"), "pinhole"),
        (("depth",), "fisheye"),
    ],
)
@pytest.mark.parametrize("threads", [1, 3])
def test_a_render_reports_each_of_its_pixels_once(tmp_path, aovs, camera, threads):
    """So many that tiles have no equal share of them; and the picture is the same whether somebody listens or not."""
    (tmp_path / "s.toml").write_text(SCENE.replace("pinhole", camera))
    scene = caster.load_scene(tmp_path / "s.toml").with_film(crop=(3, 5, 150, 68))
    told = []
    heard = render_film(scene, aovs, threads=threads, on_progress=told.append)
    assert sum(told) == 147 * 63 and len(told) > 1 and min(told) > 0
    unheard = render_film(scene, aovs, threads=threads)
    assert all(np.array_equal(heard.aovs[name], unheard.aovs[name]) for name in aovs)


def test_render_shows_how_far_it_is_on_a_terminal_alone(tmp_path, terminal, monkeypatch, capsys):
    """Standard output holds the result and nothing else."""
    stream, read = terminal
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text(SCENE)
    monkeypatch.setattr("caster.system.terminal.QUIET_SECONDS", 0.0)
    assert main(["render", "s.toml", "--aov", "depth,position"]) == 0  # standard error is a pipe here
    said = capsys.readouterr()
    assert "rendering" not in said.err
    monkeypatch.setattr("sys.stderr", stream)
    assert main(["render", "s.toml", "--aov", "depth,position"]) == 0
    shown = read()
    assert "rendering " in shown and " of 10.5k rays, " in shown
    assert_erased(shown)
    assert screen(shown) == []
    assert capsys.readouterr().out == said.out

"""Progress on standard error, on a terminal and in a pipe, and the work that it counts."""

import io
import os
import re
import time
from types import SimpleNamespace

import numpy as np
import pytest

import caster
from caster.__main__ import main
from caster.rendering.images import render_film
from caster.system import terminal as progress
from caster.system.terminal import QUIET_SECONDS, REFRESH_SECONDS, ProgressBar, StatusLine

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


@pytest.fixture
def clock(monkeypatch):
    """Seconds, `now`, that pass when a test says so."""
    found = SimpleNamespace(now=0.0)
    monkeypatch.setattr(progress, "monotonic", lambda: found.now)
    return found


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


def test_a_terminal_gets_one_line_that_is_drawn_again_and_erased(terminal, monkeypatch, clock):
    stream, read = terminal
    monkeypatch.setattr("sys.stderr", stream)
    bar = ProgressBar("validating", 10)
    clock.now = QUIET_SECONDS
    bar.add(3, "1 of 2 scenes")
    clock.now = 2 * QUIET_SECONDS
    bar.add(2)
    drawn = read()
    (line,) = screen(drawn)
    assert line == f"validating {'#' * 5}{'-' * 5} 50 %, 1 of 2 scenes, 2 s left"
    with bar.aside():
        drawn += read()
        assert screen(drawn) == []
        stream.write("a row\n")
    clock.now += REFRESH_SECONDS
    bar.add(1)
    drawn += read()
    row, line = screen(drawn)
    assert row == "a row" and "60 %, 1 of 2 scenes" in line
    bar.close()
    erased = read()
    assert_erased(erased)
    assert screen(drawn + erased) == ["a row"]
    bar.close()
    assert read() == ""


def test_before_anything_is_counted_the_bar_says_what_a_fork_does(terminal, monkeypatch):
    stream, read = terminal
    monkeypatch.setattr(progress, "QUIET_SECONDS", 0.0)
    monkeypatch.setattr(progress, "TICK_SECONDS", 0.02)
    monkeypatch.setattr("sys.stderr", stream)
    bar = ProgressBar("validating", 10)
    if not (child := os.fork()):
        progress.report_stage("asking Mitsuba")
        os._exit(0)
    os.waitpid(child, 0)
    time.sleep(0.5)
    bar.close()
    drawn = read()
    assert f"validating {'-' * 10} 0 %, asking Mitsuba" in drawn and screen(drawn) == []


@pytest.mark.parametrize("stream", [None, io.StringIO()], ids=["closed", "pipe"])
def test_without_a_terminal_work_goes_on_and_nothing_is_drawn(monkeypatch, clock, stream):
    monkeypatch.setattr("sys.stderr", stream)
    bar = ProgressBar("rendering", 10)
    clock.now = 2 * QUIET_SECONDS
    bar.add(5)
    bar.close()
    assert bar.done == 5 and (stream is None or stream.getvalue() == "")


def test_a_line_is_cut_to_the_terminal_and_erased_once(terminal, monkeypatch):
    """A wrapped line could not be erased."""
    stream, read = terminal
    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setattr("sys.stderr", stream)
    line = StatusLine()
    line.show(f"1/22 scale: {'m' * 50}")
    drawn = read()
    assert list(map(len, screen(drawn))) == [30]
    line.erase()
    line.erase()
    erased = read()
    assert_erased(erased)
    assert screen(drawn + erased) == []


@pytest.mark.parametrize("where", ["closed", "dumb"])
def test_no_line_needs_a_terminal(terminal, monkeypatch, where):
    stream, read = terminal
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr("sys.stderr", None if where == "closed" else stream)
    line = StatusLine()
    line.show("f" * 50)
    line.erase()
    assert "\x1b" not in read()


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


def test_render_shows_how_far_it_is_on_a_terminal_alone(here, terminal, monkeypatch, capsys):
    """Standard output holds the result and nothing else."""
    stream, read = terminal
    (here / "s.toml").write_text(SCENE)
    monkeypatch.setattr("caster.system.terminal.QUIET_SECONDS", 0.0)
    assert main(["render", "s.toml", "--aov", "depth,position"]) == 0  # standard error is a pipe here
    said = capsys.readouterr()
    assert "rendering" not in said.err
    monkeypatch.setattr("sys.stderr", stream)
    assert main(["render", "s.toml", "--aov", "depth,position"]) == 0
    shown = read()
    assert "rendering " in shown and " %, " in shown
    assert_erased(shown)
    assert screen(shown) == []
    assert capsys.readouterr().out == said.out

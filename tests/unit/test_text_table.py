"""Tables of the terminal: aligned plain text anywhere, colour on a terminal alone."""

import os
import re
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from outputs import unfolded
from places import shipped
from verdict_factory import scene as made

from caster.system.terminal import folded
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import AGREE, CLASSES, EXPLAINED, REFERENCE_WRONG, TIE, UNDECIDED, WRONG
from mitsuba_ref.report.output import aligned, print_lines
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.report.verdict_text import LEGEND, failure_text, table_head, table_row
from mitsuba_ref.subjects.function import FunctionSubject


def printed(text):
    """What a terminal gets."""
    outer, inner = os.openpty()
    with os.fdopen(inner, "w", encoding="utf-8") as stream:
        print_lines(text, stream)
    found = b""
    with suppress(OSError):  # EIO once the other end is closed and all was read; one read may give a part
        while part := os.read(outer, 1 << 16):
            found += part
    os.close(outer)
    return found.decode().replace("\r\n", "\n")


TEXT = "PASS  one [bold]\nFAIL  two\n      three FAIL"


@pytest.fixture(autouse=True)
def terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)


def test_pass_and_fail_are_coloured_on_a_terminal_and_nothing_else():
    assert printed(TEXT) == "\x1b[32mPASS\x1b[0m  one [bold]\n\x1b[1;31mFAIL\x1b[0m  two\n      three FAIL\n"


def test_no_color_dumb_terminals_and_pipes_get_plain_text(monkeypatch, capsys):
    monkeypatch.setenv("NO_COLOR", "1")
    assert printed(TEXT) == TEXT + "\n"
    monkeypatch.delenv("NO_COLOR")
    monkeypatch.setenv("TERM", "dumb")
    assert printed(TEXT) == TEXT + "\n"
    print_lines(TEXT)
    assert capsys.readouterr().out == TEXT + "\n"


LONGEST = 26  # characters of the longest name of a shipped scene


@pytest.mark.parametrize(
    "counts",
    [
        {AGREE: 1048576},
        {AGREE: 64813, TIE: 212},
        {AGREE: 999999, EXPLAINED: 123456, TIE: 123456, REFERENCE_WRONG: 99999, WRONG: 512, UNDECIDED: 33825},
    ],
    ids=len,
)
def test_a_row_of_scenes_fits_80_columns_and_names_only_classes_that_it_has(counts):
    scene = replace(made("n" * LONGEST), counts=dict.fromkeys(CLASSES, 0) | counts)
    lines = [*table_head(LONGEST).splitlines(), *table_row(scene, LONGEST).splitlines()]
    assert max(map(len, lines)) <= 80 and lines[0] == LEGEND
    text = unfolded(" ".join(lines[2:]))
    for name in CLASSES[1:]:
        words = f"{counts.get(name, 0)} {name.replace('_', ' ')}"
        assert (words in text) == bool(counts.get(name)), (words, text)


POINT = r"\((?:-?[\d.]+, ){2}-?[\d.]+\)"


def test_a_scene_that_nothing_hits_says_where_its_shapes_are():
    scene = shipped("one-sphere", 4, 3)
    away = scene.model_copy(update={"camera": scene.camera.model_copy(update={"look_at": (0.0, 0.0, 99.0)})})
    text = failure_text(
        validate_scene(
            Task(away, "away", subject=FunctionSubject("none", lambda scene, o, d: (o[:, 0] + np.inf, 0 * o)))
        )
    )
    words = unfolded(text)
    where = rf"the shapes lie between {POINT} and {POINT}; the ray in the middle starts at {POINT}"
    assert "no pixel hits anything" in text and re.search(where, words), text


def test_printed_lines_fit_80_columns_but_for_commands_and_paths_and_keep_every_word():
    path, command = f"/{'long/' * 20}scene.toml", f"mitsuba-ref probe {'x' * 60} 21 2 --size 48 48"
    text = "\n".join(
        [
            f"FAIL  ball  depth: {'beyond its bound ' * 9}",
            f"      reference: {'hit at t 0.1234567890 ' * 7}",
            f"reading:   {'a step of the conversion ' * 5}{path}",
            f"      replay:    {command}",
            f"            {command}",
            f"      up = [{'0, ' * 40}1]",
            "             ^",
            "short",
        ]
    )
    lines = folded(text).splitlines()
    assert unfolded(folded(text)) == unfolded(text)
    assert [line.strip() for line in lines if len(line) > 80] == [
        path,
        f"replay:    {command}",
        command,
        f"up = [{'0, ' * 40}1]",
    ]
    assert lines[-1] == "short"
    below = [folded(line).splitlines()[1] for line in text.splitlines()[:3]]
    assert [len(line) - len(line.lstrip()) for line in below] == [6, 17, 11]  # below the scene, or the label's text


def test_a_table_that_is_too_wide_continues_below_with_its_groups_of_columns_whole():
    titles = ["x", *(f"{name}{i}" for i in range(7) for name in ("caster number ", "wrong "))]
    lines = aligned([titles, ["1e-20", *map(str, range(14))], ["2", "did not run"]], step=2)
    tables = "\n".join(lines).split("\n\n")
    assert max(map(len, lines)) <= 80 and lines[2].split() == ["2", "did", "not", "run"] and len(tables) > 2
    numbers = [row.split() for row in (each.splitlines()[1] for each in tables)]
    assert {row[0] for row in numbers} == {"1e-20"} and all(len(row) % 2 for row in numbers)
    assert [cell for row in numbers for cell in row[1:]] == [*map(str, range(14))]

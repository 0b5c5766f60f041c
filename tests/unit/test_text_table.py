"""Tables of the terminal: aligned plain text anywhere, colour on a terminal alone."""

import os
from contextlib import suppress

import pytest

from mitsuba_ref.report.results import Column, format_table, print_lines

COLUMNS = (Column("scene"), Column("ref.\nwrong", "right", 5), Column("bound"))


def test_columns_are_aligned_and_lines_end_without_blanks():
    text = format_table(COLUMNS, [("a", "12", "K u S [/x]"), ("longer name", "3", "")])
    assert text.splitlines() == [
        "              ref.",
        "scene        wrong  bound",
        "a               12  K u S [/x]",
        "longer name      3",
    ]


def test_rows_alone_are_as_wide_as_their_columns_and_never_cut():
    row = format_table(COLUMNS, [("a", "1234567", "b" * 300)], header=False, gap=1)
    assert row == f"a 1234567 {'b' * 300}"


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


def test_no_color_and_dumb_terminals_get_plain_text(monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    assert printed(TEXT) == TEXT + "\n"
    monkeypatch.delenv("NO_COLOR")
    monkeypatch.setenv("TERM", "dumb")
    assert printed(TEXT) == TEXT + "\n"


def test_pipes_get_plain_text(capsys):
    print_lines(TEXT)
    assert capsys.readouterr().out == TEXT + "\n"

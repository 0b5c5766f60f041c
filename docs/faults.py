"""Writes docs/faults.md: every planted fault, what catches it, and the first line of the message.

    python docs/faults.py [ARGUMENTS OF pytest]     # run and write the rows of the faults that were run

Each row is of a test that ran: the fault was planted in a copy, and found, or the row says that it was not. Rows of
faults that were not run this time stay, those of faults that are gone go.
"""

import importlib
import os
import re
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/faults.md"
FOLDERS = ("reference", "agreement", "unit", "")  # of tests/, from which its modules import each other


class Table(NamedTuple):
    """A list of planted faults: the test that runs each, with the fault's name for its parameter."""

    title: str
    module: str  # below tests/
    test: str
    names: tuple[str, ...] = ("FAULTS",)


TABLES = (
    Table("what is compared with Mitsuba", "reference/test_planted_faults", "test_a_planted_fault_fails_by"),
    Table("options, and thresholds in scene units", "reference/test_option_and_scale_faults", "test_a_planted"),
    Table("one route alone", "reference/test_route_faults", "test_a_planted"),
    Table("written images", "reference/test_file_faults", "test_a_planted"),
    Table("mesh files and generated meshes", "reference/test_reader_faults", "test_a_planted"),
    Table("packing, processes, key of the cache", "reference/test_packing_crash_key_faults", "test_a_planted"),
    Table("error bounds that are too small", "reference/test_bound_faults", "test_a_bound", ("BOUNDS",)),
    Table("intersections, for fuzz", "reference/test_fuzz_faults", "test_a_planted"),
    Table("lanes and tiles, compiled", "agreement/test_lane_faults", "test_a_fault", ("FAULTS", "TILE_FAULTS")),
)
MESSAGE_LENGTH = 150  # characters


def planted(table: Table) -> list[tuple[str, str]]:
    """(name, family or "") of every fault of a table."""
    for folder in FOLDERS:
        if str(ROOT / "tests" / folder) not in sys.path:
            sys.path.append(str(ROOT / "tests" / folder))
    module = importlib.import_module(Path(table.module).name)
    faults = [fault for name in table.names for fault in getattr(module, name)]
    return [(getattr(fault, "what", fault), getattr(fault, "family", "")) for fault in faults]


def row_key(name: str) -> str:
    """How a test's parameter spells a name."""
    return name.replace(" ", "-")


class Row(NamedTuple):
    """What is known of one fault."""

    caught_by: str
    message: str


def caught(said: str, nodeid: str) -> Row:
    """Of what a passing test printed: by a check, by `fuzz`, by a test that fails, or by the test itself."""
    patterns = (
        (r"^.*?FAIL  (\S+)  (\w+): (.*)", lambda m: Row(f"`{m[2]}` of {m[1]}", m[3])),
        (r"^.*?FAIL  (\S+)  (.*)\n      (\w+): ", lambda m: Row(f"`{m[3]}` of {m[1]}", m[2])),
        (r"^.*?FAIL  ([\w.-]+): (.*)", lambda m: Row(f"fuzz: {m[1]}", m[2])),
        (r"caught by fuzz as (.*)", lambda m: Row(f"fuzz: {m[1]}", m[1])),
        (r"^FAILED (\S+?)(?: - (.*))?$", lambda m: Row(f"`{m[1].split('[')[0]}`", m[2] or "fails")),
    )
    for pattern, row in patterns:
        if found := re.search(pattern, said, re.MULTILINE):
            return row(found)
    return Row(f"`{nodeid.split('[')[0]}`", "other numbers than NumPy's or plain Python's")


def printable(message: str) -> str:
    """One cell: of one line, without folders of this machine, cut off at a length."""
    line = re.sub(r"/\S*/(pytest-of-\S+?/)?", "", message).replace("|", "\\|").replace("`", "'").strip()
    return line if len(line) <= MESSAGE_LENGTH else line[: MESSAGE_LENGTH - 4].rstrip("\\") + " ..."


NOT_CAUGHT = Row("**nothing**", "its test fails: not found when this row was written")


class Recorder:
    """A plug-in of pytest that keeps what each test of a fault printed."""

    def __init__(self) -> None:
        self.rows: dict[tuple[str, str], Row] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when != "call" or "[" not in report.nodeid:
            return
        place, _, parameter = report.nodeid.partition("[")
        for table in TABLES:
            if f"tests/{table.module}.py::{table.test}" in place:
                said = caught(report.capstdout, report.nodeid) if report.passed else NOT_CAUGHT
                self.rows[table.module, row_key(parameter[:-1])] = said._replace(message=printable(said.message))


def rows_of_page(text: str) -> dict[tuple[str, str], Row]:
    """Of a page that this program wrote."""
    rows, module = {}, ""
    for line in text.splitlines():
        if line.startswith("`tests/"):
            module = line[len("`tests/") : line.index(".py`")]
        cells = re.split(r"(?<!\\) \| ", line.strip("| ")) if line.startswith("| ") else []
        if len(cells) == 3 and cells[0] != "fault":
            rows[module, row_key(cells[0].split(" (")[0])] = Row(cells[1], cells[2])
    return rows


HEAD = """# Planted faults

What the judge has been seen to find. A planted fault is an edit of a copy of the packages, which a test makes; the
judge is run from that copy and has to fail. This page is written by `python docs/faults.py`, which runs every test of
a fault and keeps what is said first: by a check of `validate`, with its scene, as a finding of `fuzz`, or by a test.
`make faults` runs them all, `make test` some. Faults by rule are on [another page](mutants.md).
"""


def missing(rows: dict[tuple[str, str], Row]) -> list[str]:
    """Faults without a row."""
    return [
        f"{table.module}: {name}"
        for table in TABLES
        for name, _ in planted(table)
        if (table.module, row_key(name)) not in rows
    ]


def page(rows: dict[tuple[str, str], Row]) -> str:
    """The whole page; faults without a row are left out, and a test notices."""
    lines = [HEAD]
    for table in TABLES:
        faults = planted(table)
        lines += [
            f"## {table.title[0].upper()}{table.title[1:]}",
            "",
            f"`tests/{table.module}.py`: {len(faults)} faults.",
            "",
        ]
        lines += ["| fault | caught by | first line of the message |", "|---|---|---|"]
        for name, family in faults:
            row = rows.get((table.module, row_key(name)))
            if row is not None:
                lines.append(f"| {name}{f' ({family})' if family else ''} | {row.caught_by} | {row.message} |")
        lines.append("")
    return "\n".join(lines)


def main(argv: list[str]) -> int:
    os.environ["FAULTS"] = "all"
    recorder = Recorder()
    files = [f"tests/{table.module}.py" for table in TABLES]
    chosen = any(argument.startswith("tests/") for argument in argv)
    words = ["-q", "-p", "no:cacheprovider", "-k", "fault or bound", *argv, *([] if chosen else files)]
    code = pytest.main([*words, f"--rootdir={ROOT}"], plugins=[recorder])
    known = rows_of_page(PAGE.read_text(encoding="utf-8")) if PAGE.exists() else {}
    PAGE.write_text(page(known | recorder.rows), encoding="utf-8")
    return int(code)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Run the commands of pages, and put what they print below them: python docs/console.py PAGE...

A block of code whose first line is a comment with nothing but a file's name is that file, in a folder of the page's
own. In a ```console block each line `$ COMMAND` is run there by sh; the lines below it are replaced by its output, and
`$ COMMAND  # exit 1` states its exit code. An output that ends with `...` on the page keeps that many lines. Modules
are found in the folder first, so that a page may change a copy of the packages; $CLONE is this tree.
"""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

FENCED = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE_NAME = re.compile(r"(?:#|//) ([\w-]+\.\w+)\n")
ROOT = Path(__file__).resolve().parents[1]
EXIT = re.compile(r"  # exit (\d+)$")
MORE = "..."
SECONDS = 600.0  # for one command
# How far a run is, and what earlier runs have left to it.
UNSTABLE = re.compile(
    r"mitsuba-ref \w+: loading .*|validating: .*|compiling .*|reference: .* answered in earlier runs.*"
)


def renewed(page: str, folder: Path) -> str:
    """The page with the outputs of its commands, run in the folder.

    Raises AssertionError for an exit code that the page does not state.
    """

    def block(found: re.Match[str]) -> str:
        kind, text = found.groups()
        if kind != "console":
            if name := FILE_NAME.match(text):
                (folder / name[1]).write_text(text, encoding="utf-8")
            return found[0]
        return "```console\n" + "".join(said_again(text, folder)) + "```"

    return FENCED.sub(block, page)


def said_again(block: str, folder: Path) -> Iterator[str]:
    """Each command of a block with its output of today, cut as before."""
    for part in re.split(r"^(?=\$ )", block, flags=re.MULTILINE)[1:]:
        line, *before = part.splitlines()
        code = EXIT.search(line)
        command = EXIT.sub("", line)[2:]
        lines = output(command, int(code[1]) if code else 0, folder)
        if before and before[-1] == MORE and len(lines) >= len(before):
            lines = [*lines[: len(before) - 1], MORE]
        yield "".join(f"{each}\n" for each in [line, *lines])


def output(command: str, code: int, folder: Path) -> list[str]:
    """The lines that a command prints, without those on progress."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    found = subprocess.run(
        command,
        shell=True,
        cwd=folder,
        env=os.environ | {"PATH": path, "NO_COLOR": "1", "PYTHONPATH": str(folder), "CLONE": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=SECONDS,
    )
    assert found.returncode == code, f"{command}: exit code {found.returncode}, expected {code}\n{found.stdout}"
    lines = found.stdout.replace(f"{folder}/", "").replace(str(ROOT), "$CLONE").splitlines()
    return [line.rstrip() for line in lines if not UNSTABLE.fullmatch(line)]


def main() -> None:
    for page in map(Path, sys.argv[1:]):
        with tempfile.TemporaryDirectory(prefix="console-") as folder:
            page.write_text(renewed(page.read_text(encoding="utf-8"), Path(folder)), encoding="utf-8")


if __name__ == "__main__":
    main()

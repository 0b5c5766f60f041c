"""Make docs/debugging.md: python docs/debugging.py

A fault is planted in a copy of the tree and found there; every block of the page is what the commands print.
"""

import difflib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/debugging.md"
FILE = "caster/kernels/exact/primitives.py"
GOOD, BAD = "    if sign(u) * sign(v) < 0:\n", "    if sign(u) * sign(v) <= 0:\n"
SCENE = "scenes/shared-edges-cube.toml"
MODULES = {"mitsuba-ref": "mitsuba_ref", "caster": "caster"}


class Said(NamedTuple):
    """What a command came to."""

    command: str
    code: int
    text: str  # stdout and stderr


class Tree:
    """A copy of the packages and the scene, with the fault in it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for package in MODULES.values():
            shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
        (folder / "scenes").mkdir()
        shutil.copy(ROOT / SCENE, folder / SCENE)
        self.put(BAD, instead_of=GOOD)

    def put(self, new: str, *, instead_of: str) -> None:
        source = (self.folder / FILE).read_text(encoding="utf-8")
        assert source.count(instead_of) == 1, f"{FILE}: expected once: {instead_of!r}"
        (self.folder / FILE).write_text(source.replace(instead_of, new), encoding="utf-8")

    def line(self) -> int:
        """Where the fault is."""
        return (self.folder / FILE).read_text(encoding="utf-8").partition(BAD)[0].count("\n") + 1

    def run(self, command: str, typed: str = "") -> Said:
        """A command of the copy; typed: what goes to its standard input."""
        name, *words = command.split()
        start = [sys.executable, "-P", "-m", *(["pdb", "-m"] if name == "pdb" else [])]
        module = words.pop(0) if name == "pdb" else MODULES[name]
        environment = os.environ | {"PYTHONPATH": str(self.folder), "CASTER_JIT": "0", "NO_COLOR": "1"}
        found = subprocess.run(
            [*start, module, *words],
            cwd=self.folder,
            env=environment,
            input=typed,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=300,
        )
        text = re.sub(r"(?m)^mitsuba-ref \w+: loading .*\n", "", found.stdout)
        return Said(command, found.returncode, text.replace(str(self.folder) + "/", ""))


def diff() -> str:
    source = (ROOT / FILE).read_text(encoding="utf-8")
    lines = (text.splitlines(keepends=True) for text in (source, source.replace(GOOD, BAD)))
    return "".join([*difflib.unified_diff(*lines, FILE, FILE, n=1)][2:])


def replay_in(text: str) -> str:
    """The command that the failing text names."""
    found = re.search(r"replay: +mitsuba-ref (probe .*)", text)
    assert found, text
    return f"mitsuba-ref {found[1]}"


def stepping(tree: Tree) -> Said:
    """pdb with a breakpoint at the line of the fault; what is typed stands after each prompt, as on a terminal."""
    typed = [f"tbreak {FILE}:{tree.line()}", "c", "p sign(u), sign(v)", "p corners[0]", "n", "q"]
    said = tree.run("pdb caster probe edge.toml 0 0", "".join(f"{line}\n" for line in typed))
    answers = said.text.split("(Pdb) ")
    text = answers[0] + "".join(f"(Pdb) {a}\n{b}" for a, b in zip(typed, answers[1:], strict=True))
    return Said("CASTER_JIT=0 python -m pdb -m caster probe edge.toml 0 0", said.code, text)


def shown(said: Said, *, start: str = "", lines: int = 1000) -> str:
    """A block: the command and its output, from the line that begins with `start`, at most so many lines."""
    text = said.text.splitlines()
    first = next(i for i, line in enumerate(text) if line.startswith(start))
    kept = text[first : first + lines]
    more = ["..."] if first + lines < len(text) else []
    return "\n".join(["```", f"$ {said.command}", *(["..."] if first else []), *kept, *more, "```"])


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="debugging-") as folder:
        tree = Tree(Path(folder))
        failing = tree.run("mitsuba-ref validate scenes --size 15 15")
        replay = replay_in(failing.text)
        probed = tree.run(f"{replay} --save edge.toml")
        assert (tree.folder / "edge.toml").exists(), probed.text
        alone = (tree.folder / "edge.toml").read_text(encoding="utf-8").rstrip()
        near = tree.run("caster probe edge.toml 0 0")
        stepped = stepping(tree)
        tree.put(GOOD, instead_of=BAD)
        fixed = tree.run("mitsuba-ref probe edge.toml 0 0")
        passing = tree.run("mitsuba-ref validate scenes --size 15 15")
    assert (failing.code, probed.code, fixed.code, passing.code) == (1, 1, 0, 0)
    PAGE.write_text(
        TEXT.format(
            diff=diff(),
            failing=shown(failing, lines=16),
            probed=shown(probed, lines=17),
            alone=alone,
            near=shown(near, start="miss"),
            stepped=shown(stepped, start="(Pdb) tbreak", lines=13),
            fixed=shown(fixed, lines=1),
            passing=shown(passing, lines=5),
        ),
        encoding="utf-8",
    )


TEXT = """# Debugging an edge case

From a pixel that fails to the line that is wrong. A fault is planted in a copy of this tree; every block
below is what the commands printed there, and `python docs/debugging.py` makes the page anew.

## The fault

A ray through an edge belongs to both faces. Somebody writes `<=` where `<` stands:

```diff
{diff}```

Only rays whose edge function is exactly zero see a difference, and only integers decide those.

## 1. What fails, where, and what to type next

{failing}

The table counts pixels by class; ours is wrong at some, by exact arithmetic. The text below it is of the
worst pixel: each side's answer, what is right, and a command that looks at this pixel again. The exit code
is 1.

## 2. All witnesses of one pixel

The replay command, with an option: `--save` writes the ray and what it may hit as a scene of its own,
exact to the bit.

{probed}

Ours is alone with its miss, so it is not a matter of rounding or of one mode of Mitsuba. The exact answer
is an edge, and two faces share it.

## 3. The pixel as a scene of its own

`edge.toml`, to be kept as a test or sent to somebody:

```toml
{alone}
```

## 4. Which primitive, and how nearly

`caster probe` tests every primitive by itself. The signs of the margins are exact:

{near}

Both faces have the ray exactly on an edge, and both say miss, decided by integers: float64 cannot tell. So
the integers' rule for edges is to be looked at.

## 5. Step through it

Without the compiler the kernels are plain Python, with the same bits. pdb stops in the very code that
decides:

{stepped}

A sign of 0 is a ray on the edge: the product is 0, and the line calls that outside. The float64 tests that
come before are in `caster/kernels/triangles.py`, `_intersect`, and in `caster/shapes/sphere.py` and its
like: a breakpoint there stops at every primitive that is tried.

## 6. The fix, and the same commands again

With `<` back in its place, first the ray alone, then all scenes:

{fixed}

{passing}

The reproducer goes into `scenes/` where `make validate` will see it, or into a test.
"""


if __name__ == "__main__":
    main()

"""Planted faults: edits of a copy of both packages, each of which a named command or test has to find.

The faults are data, in tests/faults/*.toml: edits (text that is there exactly once, and its replacement), the command
that has to find them, and a pattern of what it says. `make faults` (FAULTS=all) plants all of them; without it only
those marked `quick` are planted.
"""

import os
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from edited_tree import LONG_CHECKS, ROOT, copy_tree, edit, ended_well, said_beside_progress


class Fault(NamedTuple):
    """One entry of a file in tests/faults."""

    name: str
    run: str  # a command of mitsuba-ref, or pytest; {scenes}: shipped ones, {files}: Mitsuba's, {out}: an empty folder
    says: str  # a pattern of its output
    edit: list[dict[str, str]]  # file, old, new
    code: int = 1  # exit code
    quick: bool = False
    compiled: bool = False  # whether the command runs with the compiler
    group: str = ""  # the file's name


def read_faults(path: Path) -> list[Fault]:
    data: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    compiled = data.get("compiled", False)
    return [Fault(**fault, compiled=compiled, group=path.stem) for fault in data["fault"]]


FAULTS = [fault for path in sorted(ROOT.glob("tests/faults/*.toml")) for fault in read_faults(path)]
CHOSEN = [fault for fault in FAULTS if fault.quick or os.environ.get("FAULTS") == "all"]


@pytest.fixture
def obey(forks, coarse_scenes, tmp_path):
    """Runs a fault's command in a tree; long checks that the fault does not name are left out."""

    def run(tree: Path, fault: Fault, says: str = ""):
        (tmp_path / "out").mkdir(exist_ok=True)
        places = {"scenes": coarse_scenes, "files": ROOT / "tests/mitsuba_files", "out": tmp_path / "out"}
        module, *words = shlex.split(fault.run.format(**places))
        if module == "pytest":
            cache = {"CASTER_JIT": "1", "XDG_CACHE_HOME": str(tmp_path)} if fault.compiled else {}
            environment = {"COLUMNS": "200", **cache}
            return forks.run(tree, "-q", "-x", *words, module=module, environment=environment)
        without = [name for name in LONG_CHECKS if name not in says] if module == "validate" else ()
        return forks.run(tree, module, *words, without=without)

    return run


def test_every_fault_fits_the_source_of_today():
    unfit = []
    for fault in FAULTS:
        for each in fault.edit:
            path = ROOT / each["file"]
            count = path.read_text(encoding="utf-8").count(each["old"]) if path.exists() else 0
            if count != 1:
                unfit.append(f"{fault.name}: {each['file']} has {count} times, not once: {each['old']!r}")
    assert not unfit, "\n".join(unfit)
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)


@pytest.mark.parametrize("fault", CHOSEN, ids=lambda fault: f"{fault.group}: {fault.name}")
def test_a_planted_fault_is_found(obey, unedited, tmp_path, fault):
    tree = copy_tree(tmp_path / "tree", unedited)
    for each in fault.edit:
        edit(tree, **each)
    found = obey(tree, fault, fault.says)
    assert found.returncode == fault.code, f"not found: {fault.name}\n{found.stdout}{found.stderr}"
    unfolded = re.sub(r"\n {6}(?! )", " ", found.stdout)
    said = any(re.search(fault.says, text, re.MULTILINE) for text in (found.stdout, unfolded))
    assert said, f"{fault.name}: expected {fault.says}\n{found.stdout}"


RIGHT = {fault.run: fault for fault in CHOSEN if not fault.run.startswith("pytest")}


@pytest.mark.parametrize("run", RIGHT)
@pytest.mark.slow("each runs in plain Python", keep=1)
def test_without_a_fault_nothing_is_found(obey, unedited, run):
    assert "FAIL" not in ended_well(obey(unedited, RIGHT[run])).stdout


@pytest.mark.parametrize(("name", "pixel_class"), [("far root for near", "wrong"), ("depth as z", "undecided")])
@pytest.mark.slow("each judges in plain Python", keep=1)
def test_the_replay_of_a_pixel_shows_its_failure_again(obey, forks, unedited, tmp_path, name, pixel_class):
    """`undecided`: an image that contradicts our own hit."""
    (fault,) = (fault for fault in FAULTS if fault.name == name)
    tree = copy_tree(tmp_path / "tree", unedited)
    edit(tree, **fault.edit[0])
    found = obey(tree, fault, fault.says)
    (again,) = re.findall(r"^      replay:    mitsuba-ref (probe .* --size \d+ \d+)$", found.stdout, re.MULTILINE)
    shown = forks.run(tree, *shlex.split(again))
    assert (shown.returncode, said_beside_progress(shown)) == (1, [])
    assert shown.stdout.splitlines()[0].endswith(f": {pixel_class}")


@pytest.mark.slow("judges in plain Python")
def test_the_reproducer_of_an_aimed_ray_shows_its_failure_again(obey, forks, unedited, tmp_path):
    (fault,) = (fault for fault in FAULTS if fault.name == "closest approach")
    tree = copy_tree(tmp_path / "tree", unedited)
    edit(tree, **fault.edit[0])
    obey(tree, fault, fault.says)
    file = min((tmp_path / "out").glob("*.knife-edge.*.toml"))
    again = forks.run(tree, "validate", str(file), "-j", "1")
    assert again.returncode == 1 and "knife_edges: " in again.stdout, again.stdout

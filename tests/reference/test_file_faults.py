"""Faults of written images: `validate --out` reads each file back and fails by the check `files`.

Each is planted in a copy, and judged in plain Python. All of them by `make faults` (FAULTS=all); without it only QUICK.
"""

import os
import re
from typing import NamedTuple

import pytest
from edited_tree import ROOT, copy_tree, edit, run

CHANNELS, EXR, STORED = (f"caster/image/{name}.py" for name in ("channels", "exr", "exr_validation"))
NORMAL, DIFFUSE = (f"caster/aovs/{name}.py" for name in ("normal", "diffuse"))
NARROW = '        narrow = np.array(values, np.float32, order="C")\n'


class Fault(NamedTuple):
    """An edit, and a pattern of what is said."""

    what: str
    message: str
    file: str
    old: str
    new: str


FAULTS = (
    Fault(
        "X and Y of normals exchanged", r"normal\.[XY] at ", NORMAL, '"normal.X", "normal.Y"', '"normal.Y", "normal.X"'
    ),
    Fault("red and blue exchanged", r"[RB] at ", DIFFUSE, '"R", "G", "B"', '"B", "G", "R"'),
    Fault("a channel of another name", r"channels A, .*expected", NORMAL, '"normal.Z"', '"normal.W"'),
    Fault("all numbers halved", r" at \(", STORED, NARROW, f"{NARROW}        narrow *= np.float32(0.5)\n"),
    Fault(
        "one bit of one pixel",
        r" at \(",
        STORED,
        NARROW,
        f"{NARROW}        narrow[-1, -1] = np.nextafter(narrow[-1, -1], np.float32(9))\n",
    ),
    Fault(
        "rounded to halves",
        r" at \(",
        STORED,
        NARROW,
        f"{NARROW}        narrow = narrow.astype(np.float16).astype(np.float32)\n",
    ),
    Fault(
        "lines from the bottom up",
        r" at \(",
        EXR,
        "copies = {name: to_storable(name, channels[name], window)",
        "copies = {name: to_storable(name, channels[name][::-1], window)",
    ),
    Fault(
        "the data window one pixel off",
        r"dataWindow .*expected",
        EXR,
        '"dataWindow": _inclusive(window)',
        '"dataWindow": _inclusive((window[0] + 1, window[1], window[2] + 1, window[3]))',
    ),
    Fault(
        "the film as large as its crop",
        r"displayWindow .*expected",
        EXR,
        '"displayWindow": _inclusive(film)',
        '"displayWindow": _inclusive(window)',
    ),
    Fault(
        "ids counted from one",
        r"id\.\w+ at ",
        CHANNELS,
        "plane.astype(np.int64)).astype(np.uint32)",
        "plane.astype(np.int64) + 1).astype(np.uint32)",
    ),
    Fault(
        "a mask of hits everywhere",
        r"A at ",
        CHANNELS,
        '{"A": aovs.hit.astype(np.float32)}',
        '{"A": np.ones(aovs.hit.shape, np.float32)}',
    ),
)
QUICK = ("X and Y of normals exchanged", "the film as large as its crop")
CHOSEN = [fault for fault in FAULTS if fault.what in QUICK or os.environ.get("FAULTS") == "all"]


@pytest.mark.parametrize("fault", CHOSEN, ids=lambda fault: fault.what)
@pytest.mark.slow("each judges in plain Python", keep=1)
def test_a_planted_fault_is_found(tmp_path, fault):
    tree = copy_tree(tmp_path / "tree")
    edit(tree, fault.file, fault.old, fault.new)
    words = ("scenes/crop-window.toml", "--size", "24", "16", "-j", "1", "--out", tmp_path / "out")
    found = run(tree, "validate", *map(str, words))
    print(found.stdout)
    assert found.returncode == 1, f"this passes: {fault.what}\n{found.stdout}{found.stderr}"
    assert re.search(rf"^FAIL  crop-window  files: .*\.exr: .*{fault.message}", found.stdout, re.MULTILINE)


def test_every_fault_fits_the_source_of_today():
    for fault in FAULTS:
        assert (ROOT / fault.file).read_text(encoding="utf-8").count(fault.old) == 1, fault
    assert set(QUICK) <= {fault.what for fault in FAULTS}

"""Error bounds of kernels that are too small: `validate` fails by its aimed rays, and its reproducers show the same.

All of them by `make faults` (FAULTS=all); without it only those in QUICK.
"""

import os
import re

import pytest
from edited_tree import ROOT, copy_tree, edit, run

VEC, ROOTS, TRIANGLES = (f"caster/kernels/{name}.py" for name in ("math/vec", "math/quadric_roots", "triangles"))
SIZE = ("30", "20")  # 150 aimed rays

# what is trusted to the last bit: (scene, file, text, what it becomes)
BOUNDS = {
    "edge functions": ("shared-edges-icosphere", TRIANGLES, "EDGE_ERROR = 16.0 * U", "EDGE_ERROR = 0.0"),
    "heights over triangles": ("flat-shapes", TRIANGLES, "= 9.0 * U, 8.0 * U", "= 0.0, 8.0 * U"),
    "object space": ("flat-shapes", VEC, "TO_OBJECT_SPACE_ERROR = 6.0 * U", "TO_OBJECT_SPACE_ERROR = 0.0"),
    "closest approach": ("one-sphere", ROOTS, "    within_error = moved *", "    within_error = 0.0\n    _ = moved *"),
    "the smaller root": ("ellipsoids", ROOTS, "small_error = 2.0 * (", "small_error = 0.0 * ("),
    "every sum and product": ("one-sphere", VEC, "U = 2.0**-53  #", "U = 2.0**-80  #"),
}
QUICK = ("closest approach",)
CHOSEN = [what for what in BOUNDS if what in QUICK or os.environ.get("FAULTS") == "all"]


@pytest.mark.parametrize("what", CHOSEN)
def test_a_bound_that_is_too_small_fails_validate(tmp_path, what):
    scene, *fault = BOUNDS[what]
    tree, out = copy_tree(tmp_path / "tree"), tmp_path / "out"
    edit(tree, *fault)
    words = ["validate", f"scenes/{scene}.toml", "--size", *SIZE, "-j", "1", "--out", str(out)]
    found = run(tree, *words)
    print(f"{what}: {found.stdout}")
    assert found.returncode == 1, f"this passes: {what}\n{found.stdout}"
    assert re.search(rf"^FAIL  {scene}  knife_edges: ", found.stdout, re.MULTILINE), found.stdout
    for file in sorted(out.glob("*.knife-edge.*.toml"))[:1]:
        again = run(tree, "validate", str(file), "-j", "1")
        assert again.returncode == 1 and "knife_edges: " in again.stdout, again.stdout
        return
    pytest.fail("no reproducer was written")


def test_every_fault_fits_the_source_of_today():
    for _, file, old, _ in BOUNDS.values():
        assert (ROOT / file).read_text(encoding="utf-8").count(old) == 1, (file, old)
    assert set(QUICK) <= set(BOUNDS)

"""docs/debugging.md is up to date: its commands run again in a copy with the same fault."""

import importlib.util
import re
from pathlib import Path

import pytest

# The page in plain Python, which continuous integration runs with the other slow tests.
pytestmark = pytest.mark.slow("a page of docs, in plain Python")
ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/debugging.md").read_text(encoding="utf-8")


def script():
    spec = importlib.util.spec_from_file_location("debugging_page", ROOT / "docs/debugging.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def story(tmp_path_factory):
    """(the script, a tree with the fault, outputs of `validate` and of the replay there)."""
    module = script()
    tree = module.Tree(tmp_path_factory.mktemp("faulty"))
    failing = tree.run("mitsuba-ref validate scenes --size 15 15")
    probed = tree.run(f"{module.replay_in(failing.text)} --save edge.toml")
    return module, tree, failing, probed


def on_the_page(text):
    """Lines of an output that the page quotes literally."""
    return [line for line in text.splitlines() if line.strip() and line in PAGE]


def test_the_fault_is_detected_and_the_replay_shows_which_side_is_wrong(story):
    module, _, failing, probed = story
    assert failing.code == probed.code == 1
    assert module.diff() in PAGE and f"$ {failing.command}" in PAGE
    (head,) = [line for line in failing.text.splitlines() if "mask: 15 wrong of 225" in line]
    (replay,) = [line for line in failing.text.splitlines() if "replay:    mitsuba-ref probe" in line]
    (exact,) = [line for line in failing.text.splitlines() if "exact:     cube" in line]
    assert all(line in PAGE for line in (head, replay, exact))
    assert re.search(r"  ours +WRONG +miss", probed.text)
    assert re.search(r"mitsuba scalar_rgb robust +right +cube, prim 8", probed.text)
    assert len(on_the_page(probed.text)) >= 9


def test_pdb_stops_at_the_fault_and_shows_the_sign(story):
    module, tree, _, _ = story
    said = module.stepping(tree).text
    assert f"(Pdb) tbreak {module.FILE}:{tree.line()}" in PAGE  # else the page is of another source: make it anew
    assert f"{module.FILE}({tree.line()})exact_triangle()\n-> {module.BAD.strip()}" in said
    assert "(Pdb) p sign(u), sign(v)\n(0, 1)" in said and "-> return no_root()" in said
    assert "Traceback" not in said and "internal error" not in said


def test_with_the_line_put_right_everything_passes(story):
    module, tree, _, _ = story
    tree.put(module.GOOD, instead_of=module.BAD)
    fixed = tree.run("mitsuba-ref validate scenes --size 15 15")
    tree.put(module.BAD, instead_of=module.GOOD)
    assert fixed.code == 0 and "1 scene: 1 pass, 0 fail" in fixed.text

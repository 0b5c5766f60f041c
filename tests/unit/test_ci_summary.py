"""The Markdown summary: a heading and the text of the log, which no name can leave, of a limited size."""

import re

import pytest
from verdict_factory import scene, verdict

from caster.system.atomic_files import OutputError
from mitsuba_ref.report.ci_summaries import CUT, SUMMARY_LIMIT_BYTES, append, markdown


def block(text: str) -> str:
    """The block of code below the heading, which has to be all that follows."""
    found = re.fullmatch(r"## [^\n]*\n\n(`{3,})\n(.*)\n\1\n\n", text, re.DOTALL)
    assert found and found[1] not in found[2]
    return found[2]


def test_the_outcome_comes_first_then_what_fails_with_its_replay_then_every_scene():
    text = markdown(verdict(scene("good"), scene("bad", ok=False)), 2.0)
    assert text.startswith("## FAIL: 2 scenes: 1 pass, 1 fail\n\n```\nFAIL  bad  depth: 1 wrong of 100 hit pixels")
    said = ("replay:    mitsuba-ref probe scenes/bad.toml 3 4\n", "2 scenes: 1 pass, 1 fail, in 2.0 s\n", "PASS  good")
    places = [block(text).index(each) for each in said]
    assert places == sorted(places)


def test_a_candidate_and_scenes_that_were_not_judged_are_named():
    text = block(markdown(verdict(scene("old", kept=True), names=("left",), requested_candidate="mine:trace"), 1.0))
    assert "candidate:  mine:trace" in text and "FAIL  left  not judged" in text and " kept" in text


@pytest.mark.parametrize("name", ["```", "`````x", "x\n```\n# y", "<b>", "\x1b[0m", "é€😀"])
def test_no_name_ends_the_block(name):
    for names in ((), (name,)):
        text = block(markdown(verdict(scene(name, ok=False), names=names), 1.0))
        assert "\x1b" not in text


def test_what_does_not_fit_is_cut_off_and_the_whole_file_stays_below_the_limit(tmp_path):
    many = verdict(*(scene(f"bäd-{i}", ok=False) for i in range(90)))
    assert CUT not in markdown(many, 1.0) and len(markdown(many, 1.0)) < SUMMARY_LIMIT_BYTES
    for limit in range(4096, 4100):
        text = markdown(many, 1.0, limit)
        assert limit - 4 < len(text.encode()) <= limit and block(text).endswith(CUT)
    assert markdown(many, 1.0, 100) == ""
    file = tmp_path / "summary.md"
    file.write_text("# Another step's words\n")
    append(file, verdict(scene("good")), 1.0)
    append(file, many, 1.0, limit=16384)
    assert file.read_text().startswith("# Another step's words\n## PASS") and "\n## FAIL" in file.read_text()
    assert len(file.read_bytes()) <= 16384
    with pytest.raises(OutputError, match="none"):
        append(tmp_path / "none" / "summary.md", verdict(scene("good")), 1.0)

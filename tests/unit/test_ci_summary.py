"""The Markdown summary: order, folded parts, escaping and maximum length."""

import html
import re

import pytest
from verdict_factory import scene, verdict

from caster.system.atomic_files import OutputError
from mitsuba_ref.report.ci_summaries import SUMMARY_LIMIT_BYTES, append, markdown

NASTY = ("a|b", "<img src=x onerror=alert(1)>", "`code`", "**bold**", "[link](http://x)", "_under_", "x\ny", "é€😀")


def matrix_rows(text):
    return [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| ---")]


def test_the_verdict_comes_first_then_what_fails_with_its_replay_and_what_passes_is_folded():
    text = markdown(verdict(scene("good"), scene("bad", ok=False)), 2.0)
    assert text.startswith("## FAIL: 2 scenes: 1 pass, 1 fail\n")
    bad = next(line for line in matrix_rows(text) if line.startswith("| bad "))
    cells = [html.unescape(cell) for cell in bad.strip("| ").split(" | ")]
    assert cells[:6] == ["bad", "100", "99", "0.25", "1.2", "1 wrong"]
    failure = "depth: 1 wrong of 100 hit pixels, worst 41x its bound at (3, 4)"
    assert cells[6:] == [failure, "<code>mitsuba-ref probe scenes/bad.toml 3 4</code>"]
    assert text.index("<details><summary>1 scenes pass</summary>") < text.index("| good ")
    assert text.index("| bad ") < text.index("| good ")
    assert text.count("<details>") == text.count("</details>") == 1


def test_a_run_that_judged_a_candidate_or_was_about_to_names_it_and_never_ours():
    said = {"candidate": "mine:trace", "precision": "float32", "unjudged": ("diffuse",)}
    for done in (scene("good", **said), scene("bad", ok=False, **said)), ():
        text = html.unescape(markdown(verdict(*done, names=("left",), requested_candidate="mine:trace"), 1.0))
        assert "mine:trace" in text and "ours wrong" not in text
        assert not done or ("| 1 wrong |" in text and "float32" in text)
        assert ("- not judged: diffuse" in text) is bool(done) and "not judged: \n" not in text


def test_scenes_that_were_not_judged_or_kept_are_named():
    text = markdown(verdict(scene("good"), scene("old", kept=True), names=("left|over",)), 1.0)
    assert text.startswith("## FAIL: 3 scenes: 2 pass, 0 fail, 1 not judged\n")
    assert "Not judged, 1 scenes:\n\n- left&#124;over\n" in text
    assert "| old | 100 | 100 | 0.25 | kept |" in text and "\n- kept: 1 scenes were not judged now" in text


@pytest.mark.parametrize("ok", [True, False])
@pytest.mark.parametrize("name", NASTY)
def test_any_name_stays_in_its_cell_and_means_nothing(name, ok):
    plain, text = (markdown(verdict(scene(each, ok=ok)), 1.0) for each in ("plain", name))
    assert len(matrix_rows(text)) == len(matrix_rows(plain))
    row = matrix_rows(text)[-1]
    assert row.count(" | ") == matrix_rows(plain)[-1].count(" | ")
    cell = row[2:].partition(" | ")[0]
    assert not re.search(r"[|<>`*_\[\]\\]", cell)
    assert html.unescape(cell) == name.replace("\n", "\\u000a")
    tags = re.findall(r"</?(\w+)", text)
    assert set(tags) <= {"code", "details", "summary"}


def test_what_does_not_fit_is_left_out_and_counted():
    many = verdict(*(scene(f"bad-{i}", ok=False) for i in range(40)), *(scene(f"good-{i}") for i in range(400)))
    whole = markdown(many, 1.0)
    assert "Left out" not in whole and len(whole) < SUMMARY_LIMIT_BYTES
    for limit in (4096, 16384, 24000):
        text = markdown(many, 1.0, limit)
        assert 0 < len(text.encode()) <= limit
        rows = sum(line.startswith("| bad-") for line in text.splitlines())
        good = sum(line.startswith("| good-") for line in text.splitlines())
        said = text.rpartition("Left out, for the size that a summary may have: ")[2].strip()
        assert rows == 40 or good == 0  # failing ones come first
        assert (f"{40 - rows} failing scenes" in said) == (rows < 40)
        assert f"{400 - good} scenes that pass" in said and said.endswith("verdict.json has all.")


def test_the_summary_is_added_to_what_is_there_and_the_whole_stays_below_the_limit(tmp_path):
    file = tmp_path / "summary.md"
    file.write_text("# Another step's words\n")
    append(file, verdict(scene("good")), 1.0)
    append(file, verdict(scene("bad", ok=False)), 1.0)
    text = file.read_text()
    assert text.startswith("# Another step's words\n## PASS") and "\n## FAIL" in text
    append(file, verdict(*(scene(f"bad-{i}", ok=False) for i in range(90))), 1.0, limit=16384)
    assert len(file.read_bytes()) <= 16384 and "Left out" in file.read_text()
    with pytest.raises(OutputError, match="none"):
        append(tmp_path / "none" / "summary.md", verdict(scene("good")), 1.0)

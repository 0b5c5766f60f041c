"""What a report leaves on disk."""

import json
import re
from dataclasses import replace
from importlib import resources

import pytest

from caster.system.atomic_files import OutputError
from mitsuba_ref.judge.verdict import Failure, SceneVerdict
from mitsuba_ref.report.html_report import SCRIPTS, HtmlReport, index_row, page, script_json
from mitsuba_ref.report.verdict_text import failure_text

FAILURE = Failure(3, 4, "wrong", "depth", 41.0, "a", "b", "c", "by exact arithmetic, ours is wrong")
FAILING = SceneVerdict("two words", "scenes/two words.toml", 100, 100, failures=(FAILURE,))
FAILING = replace(FAILING, counts=FAILING.counts | {"wrong": 100})
PASSING = SceneVerdict("good", "good.toml", 9, 9)
PASSING = replace(PASSING, counts=PASSING.counts | {"agree": 9})


def test_a_run_that_is_cut_off_has_its_page(tmp_path):
    """Whatever ends the process: the list is there from the first scene on."""
    report = HtmlReport(tmp_path / "r", 43)
    report.add(PASSING)
    text = (tmp_path / "r/index.html").read_text(encoding="utf-8")
    assert "43 scenes: 1 pass, 0 fail, 42 not judged" in text


def test_no_text_ends_its_script():
    evil = "</script><script>alert(1)</script><!--\u2028"
    text = "".join(page({"summary": evil, "candidate": evil}, [index_row(replace(FAILING, name=evil), "")]))
    assert text.count("<script") == 3 and "alert(1)<" not in text and "\u2028" not in script_json(evil)
    assert json.loads(script_json(evil)) == evil


def test_every_script_of_the_page_is_in_it():
    files = {each.name for each in (resources.files("mitsuba_ref.report") / "page").iterdir()}
    assert {f"{name}.js" for name in SCRIPTS} | {"page.html", "page.css"} == files
    text = "".join(page({"summary": "", "candidate": ""}, []))
    assert not re.findall(r"https?://|\bfetch\(|\bimport\b|new Worker|\beval\(", text)


PAIRS = [
    *(("text", ground) for ground in ("bg", "panel", "soft", "bad-bg")),
    *(("quiet", ground) for ground in ("bg", "panel", "soft")),
    *((ink, "panel") for ink in ("accent", "good", "bad", "ours", "reference")),
    *((("good", "good-bg"), ("bad", "bad-bg"), ("on-accent", "accent"))),
]
ENOUGH = 4.5  # WCAG 2.2, 1.4.3: contrast of text of this size


@pytest.mark.parametrize("theme", [0, 1, 2], ids=["light", "dark by the system", "dark by choice"])
def test_words_stand_out_from_what_they_are_on(theme):
    css = (resources.files("mitsuba_ref.report") / "page" / "page.css").read_text(encoding="utf-8")
    blocks = re.findall(r"\{([^{}]*--bg:[^{}]*)\}", css)
    assert len(blocks) == 3
    colors = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", blocks[theme]))
    poor = {pair: contrast(colors[pair[0]], colors[pair[1]]) for pair in PAIRS}
    assert {pair: value for pair, value in poor.items() if value < ENOUGH} == {}


def contrast(one, other):
    """Of two sRGB colours, as WCAG 2.2 defines it: 1 to 21."""
    lighter, darker = sorted((luminance(one), luminance(other)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def luminance(color):
    parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_a_failure_names_the_pixel_in_the_report():
    words = failure_text(FAILING, "out/index.html")
    assert "      look:      out/index.html#s=two%20words&x=3&y=4\n" in words
    assert "look:" not in failure_text(FAILING)


def test_a_place_that_cannot_be_written_is_refused_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        HtmlReport(tmp_path / "file", 1)
    with pytest.raises(OutputError):
        HtmlReport(tmp_path / "r.html", 1)  # a report is a folder

"""The page of a candidate's run in a browser: the textbook caster of docs/candidates, with its mistake."""

import re

import numpy as np
import planted
import pytest
import textbook_pages
from test_pages import NUMBERS, color_at, section

from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.report.validation import Validation

SIZE = (textbook_pages.WIDTH, textbook_pages.HEIGHT)


@pytest.fixture(scope="module")
def report(judged, tmp_path_factory):
    return Validation(tuple(judged.values())).write_html(tmp_path_factory.mktemp("candidate") / "report")


def place(scene, row, layer):
    return f"#s={scene}&x={row % SIZE[0]}&y={row // SIZE[0]}&a={layer}"


def test_the_list_names_the_candidate_and_no_answer_is_words(visit, report):
    page = visit(report).page
    assert page.inner_text("#who") == "candidate docs.candidates.inside:trace"
    assert "candidate wrong" in page.locator(".row .classes").first.inner_text()
    assert "ours" not in page.inner_text("#app").lower()
    page.select_option("#class", "wrong")
    assert page.locator(".row .name a").all_inner_texts() == ["inside", "single"]
    page.evaluate("location.hash = '#s=silent'")
    page.wait_for_selector("#message >> text=the candidate gave no answer")
    assert "expected two arrays (t, n)" in page.inner_text("#message")
    page.evaluate("location.hash = '#s=outside&x=12&y=10&a=shape_id'")
    page.wait_for_selector("#pixel section >> text=Not given")
    assert "inf" not in page.inner_text("#pixel")


def test_the_inspector_has_the_candidates_numbers_to_the_bit(visit, report, judged):
    page = visit(report).page
    for name, layers in {"inside": ("depth", "normal"), "single": ("depth",)}.items():
        seen, precision = judged[name].seen, judged[name].precision
        row = int(np.flatnonzero(seen.judge.subject.hit.ravel())[0])
        page.evaluate(f"location.hash = '{place(name, row, 'depth')}'")
        page.wait_for_selector("#pixel section:has-text('Not given by the candidate')")
        page.wait_for_selector(f"#pixel section >> text=/\u00d7 {precision}\u2019s bound/")
        for layer in layers:
            sides = [
                np.atleast_1d(aov_rows(aovs, layer)[row]) for aovs in (seen.judge.subject, seen.judge.pair.reference)
            ]
            text = section(page, layer).inner_text()
            assert NUMBERS.findall(text) == [float(value).hex() for value in np.column_stack(sides).ravel()]
            assert "ulp of float32" in text or "the same number" in text
        t = float(textbook_pages.RETURNED[name][row])
        facts = page.inner_text("#pixel dl")
        assert re.search(rf"candidate\s+hit\s+t {re.escape(repr(t))}\s+{re.escape(t.hex())}", facts)
    assert t == np.float32(t), "the last one is a float32 number"


@pytest.mark.parametrize("width", [1440, 390])
def test_a_long_path_of_a_replay_is_wrapped_within_the_inspector(visit, report, width):
    page = visit(report, "#s=inside&x=12&y=10", viewport={"width": width, "height": 844}).page
    page.wait_for_selector("#pixel .note code")
    page.evaluate("document.querySelector('#pixel .note code').textContent = '/a/long/path/of/scenes'.repeat(20)")
    assert page.evaluate("(pixel => pixel.scrollWidth <= pixel.clientWidth)(document.querySelector('#pixel'))")


def test_what_is_not_given_is_stated_and_not_drawn(visit, report):
    page = visit(report, "#s=single&a=normal").page
    page.wait_for_selector("#summary >> text=held to the bounds of float32")
    assert page.locator(".pane.ours .legend").inner_text() == ""
    page.click("[data-layer=shape_id]")
    page.wait_for_selector(".pane.reference .legend >> text=one colour per number")
    assert page.locator(".pane.ours .legend").inner_text() == ""
    page.locator(".pane.ours canvas").click(position={"x": 60, "y": 60})
    words = page.inner_text("#pixel section:has-text('Not given')")
    assert "normal, position, shading normal, uv, shape, diffuse" in words


PATCHES = [(6, 4, 1.01), (15, 4, 1.01), (2, 13, -1.0)]  # x, y of the corner of 3 x 3 pixels, and the factor of t or n


def patched(scene, o, d):
    t, n = (a.copy() for a in textbook_pages.trace(scene, o, d))
    for x, y, factor in PATCHES:
        rows = [row for row in range(len(t)) if x <= row % SIZE[0] < x + 3 and y <= row // SIZE[0] < y + 3]
        if factor > 0:
            t[rows] *= factor
        else:
            n[rows] *= factor
    return t, n


@pytest.fixture(scope="module")
def patches(tmp_path_factory):
    scene = planted.scene().with_film(width=SIZE[0], height=SIZE[1])
    found = [planted.judged_candidate(f"patches-{i}", patched, scene) for i in range(2)]
    return Validation(tuple(found), scene_count=2).write_html(tmp_path_factory.mktemp("patches") / "page")


def test_n_goes_from_region_to_region_and_a_cause_chooses_its_pixels(visit, patches):
    page = visit(patches, "#s=patches-0").page
    page.wait_for_selector(".cause")
    corners, words = set(), []
    for _ in range(3):
        page.keyboard.press("n")
        page.wait_for_timeout(60)
        corners.add(tuple(map(int, page.inner_text("#pixel .xy").split(","))))
        words.append(page.inner_text("#status-line"))
    near = {(x, y) for a, b in corners for x, y, _ in PATCHES if x <= a < x + 3 and y <= b < y + 3}
    assert near == {(x, y) for x, y, _ in PATCHES} and all(" of 3: 9 pixels" in each for each in words), words
    causes = page.locator(".cause")
    assert sorted(causes.all_inner_texts()) == ["18 pixels", "9 pixels"]
    page.click(".cause >> text=/^9 pixels/")
    assert page.get_attribute(".cause[aria-pressed=true]", "data-cause") == "1"
    page.keyboard.press("n")
    page.keyboard.press("n")
    assert "group 1 of 1: 9 pixels" in page.inner_text("#status-line")
    page.keyboard.press(".")
    assert "of 9 failing pixels" in page.inner_text("#status-line")
    assert color_at(page, "class", (3, 14), SIZE) == [255, 0, 0] != color_at(page, "class", (7, 5), SIZE)
    page.click(".cause[aria-pressed=true]")
    assert color_at(page, "class", (7, 5), SIZE) == [255, 0, 0]

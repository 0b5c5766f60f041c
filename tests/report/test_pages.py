"""Reports in a browser, opened from their files."""

import re
from dataclasses import replace
from urllib.parse import parse_qs, quote

import numpy as np
import planted
from test_records import unpacked

from caster.image.exr import write_exr
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.exr_compare.two_files import compare_exr
from mitsuba_ref.judge.verdict import EXPECTED, UNSUPPORTED, KindBias, SceneCheck
from mitsuba_ref.report.scene_record import scene_record
from mitsuba_ref.report.validation import Validation

BAD = "bad & <worse>"
NUMBERS = re.compile(r"-?(?:0x[01]\.[0-9a-f]+p[+-]\d+)")


def at(pixel, scene=BAD, **more):
    x, y = pixel
    return f"#s={quote(scene)}&x={x}&y={y}" + "".join(f"&{key}={value}" for key, value in more.items())


def hash_of(opened):
    return {key: value[0] for key, value in parse_qs(opened.address().lstrip("#")).items()}


def section(page, title):
    """A layer in the inspector."""
    return page.locator("#pixel section", has=page.locator(f"h3:text-matches('^{title} ')"))


def ready(page):
    """All layers of the scene are unpacked."""
    page.wait_for_selector("#pixel section >> nth=4")


# ---- the list ----


def test_the_list_states_what_became_of_each_scene_and_filters_are_in_the_address(visit, folder):
    opened = visit(folder)
    page = opened.page
    assert page.locator(".row .name a").all_inner_texts() == [BAD, "crashed", "good"]  # failing first
    assert page.locator(".row .badge").all_inner_texts() == ["FAIL", "CRASH", "PASS"]
    assert "1 ours wrong, 3 reference wrong, unlisted" in page.locator(".row .classes").first.inner_text()
    assert page.inner_text("#total") == "4 scenes: 1 pass, 2 fail, 1 not judged"
    assert "3 of 4 scenes are here" in page.inner_text("#banner")
    assert page.locator(".row img").count() == 2
    page.keyboard.press("/")
    page.keyboard.type("oo")
    assert page.locator(".row .name a").all_inner_texts() == ["good"]
    assert hash_of(opened) == {"q": "oo"}
    page.fill("#find", "")
    page.select_option("#status", "fail")
    page.select_option("#check", "mask")
    assert page.locator(".row .name a").all_inner_texts() == [BAD]
    page.evaluate("location.hash = '#st=pass&cl=agree'")
    assert page.locator(".row .name a").all_inner_texts() == ["good"]
    assert page.input_value("#status") == "pass"


def test_without_scripts_it_says_what_it_needs(visit, folder):
    page = visit(folder, java_script_enabled=False).page
    assert "needs scripts" in page.inner_text("body") and not page.locator("#app").is_visible()


def test_a_scene_without_an_answer_has_its_words(visit, folder):
    page = visit(folder, "#s=crashed").page
    assert "no images" in page.inner_text("#message") and "<b>words</b>" in page.inner_text("#message")


# ---- pixels ----


def test_every_number_of_the_images_comes_back(visit, folder, verdicts):
    """What the page unpacks, against the arrays: all layers, both sides, at pixels that are stored without loss."""
    page = visit(folder, at(planted.NAN, a="position", v="ours", z=96)).page
    ready(page)
    pair = verdicts["bad"].seen.judge.pair
    assert page.inner_text("#pixel .xy") == "8, 12" and "unlisted" in page.inner_text("#pixel .class")
    rows = unpacked(scene_record(verdicts["bad"].seen).about["rows"])
    hits = rows[pair.subject.hit.ravel()[rows]]
    for y, x in np.column_stack(np.divmod(hits, planted.WIDTH))[::31].tolist():
        page.evaluate(f"location.hash = '{at((x, y), a='position')}'")
        page.wait_for_selector(f"#pixel .xy:text-is('{x}, {y}')")
        row = planted.row_of((x, y))
        for layer in ("depth", "normal", "position", "diffuse"):
            found = NUMBERS.findall(section(page, layer).inner_text())
            sides = [np.atleast_1d(aov_rows(aovs, layer)[row]) for aovs in (pair.subject, pair.reference)]
            expected = [float(v).hex() for v in np.column_stack(sides).ravel() if np.isfinite(v)]
            assert found == expected, (x, y, layer)


def color_at(page, pane, pixel, size=(planted.WIDTH, planted.HEIGHT)):
    """The colour in the middle of a pixel, as the pane shows it."""
    x, y = pixel
    script = """([which, x, y, width, height]) => {
        const canvas = document.querySelector(`.pane.${which} canvas`);
        const scale = Math.min(canvas.width / width, canvas.height / height);
        const px = canvas.width / 2 + (x + 0.3 - width / 2) * scale;
        const py = canvas.height / 2 + (y + 0.3 - height / 2) * scale;
        return [...canvas.getContext("2d").getImageData(px, py, 1, 1).data].slice(0, 3);
    }"""
    page.wait_for_timeout(100)  # the next frame
    return page.evaluate(script, [pane, x, y, *size])


def test_a_fault_is_a_red_pixel_and_the_next_bad_one(visit, folder):
    page = visit(folder, f"#s={quote(BAD)}&a=depth").page
    page.wait_for_selector(".pane.class .legend >> text=ours wrong")
    assert color_at(page, "class", planted.OURS_WRONG) == [255, 0, 0]
    assert color_at(page, "class", planted.NAN) == [255, 105, 180]
    seen = []
    for key in ("n", "n", "n", "n", "n", "N"):
        page.keyboard.press(key)
        page.wait_for_timeout(60)  # the next frame
        seen.append(tuple(map(int, page.inner_text("#pixel .xy").split(","))))
    rows = [planted.REFERENCE_MISSES, planted.OURS_WRONG, planted.NAN, planted.INFINITE]
    assert seen == [*rows, rows[0], rows[-1]]  # from the worst on row by row, around, and back
    page.evaluate(f"location.hash = '{at(planted.OURS_WRONG, a='depth')}'")
    page.wait_for_selector("#pixel .class >> text=ours wrong")
    assert "t is off: behind what is hit, by 1e-05 of itself" in page.inner_text("#pixel .class")
    exact = page.inner_text("#pixel dl")
    assert "ball, prim 0 (inside)" in exact and "0x1.f4c65ce5b5ddbp+1" in exact


def test_keys_and_what_is_remembered(visit, folder):
    opened = visit(folder, "#s=good", color_scheme="light")
    page = opened.page
    page.wait_for_selector(".pane canvas")
    ready_layers = {"2": "normal", "5": "uv", "6": "diffuse", "7": "shape_id", "a": "all", "1": "depth"}
    for key, layer in ready_layers.items():
        page.keyboard.press(key)
        page.wait_for_selector(f"[data-layer={layer}][aria-pressed=true]")
    for key, view in {"d": "difference", "x": "ratio", "l": "class", "b": "blink", "w": "wipe", "o": "ours"}.items():
        page.keyboard.press(key)
        page.wait_for_selector(f"[data-view={view}][aria-pressed=true]")
    page.keyboard.down("Shift")
    page.wait_for_selector("figcaption >> text=reference")
    page.keyboard.up("Shift")
    page.wait_for_selector("figcaption >> text=ours")
    for key in ("+", "e", "ArrowRight", "ArrowDown"):
        page.keyboard.press(key)
    place = hash_of(opened)
    assert float(place["z"]) > 20 and float(place["e"]) == 0.5 and place["v"] == "ours"
    assert (place["x"], place["y"]) == ("12", "11")  # the first arrow pins the middle
    page.keyboard.press("f")
    assert "z" not in hash_of(opened)
    page.keyboard.press("k")
    page.keyboard.press("k")
    assert page.inner_text("#scene-name") == BAD
    page.keyboard.press("?")
    assert "hold: the reference in place of ours" in page.inner_text("#help")
    page.keyboard.press("Escape")
    page.keyboard.press("t")
    assert page.get_attribute("html", "data-theme") == "dark"
    page.reload()
    assert page.get_attribute("html", "data-theme") == "dark"
    page.keyboard.press("Escape")
    page.wait_for_selector("#list:not([hidden])")


def test_the_command_to_replay_is_copied(visit, folder, browser):
    opened = visit(folder, at(planted.NAN), permissions=["clipboard-read", "clipboard-write"])
    ready(opened.page)
    opened.page.keyboard.press("c")
    opened.page.wait_for_selector("#status-line >> text=copied")
    words = f"mitsuba-ref probe 'scenes/{BAD}.toml' 8 12"
    assert opened.page.evaluate("navigator.clipboard.readText()") == words
    assert opened.page.inner_text(".replay code") == words


def test_a_narrow_screen_is_not_wider_than_it_is(visit, folder):
    page = visit(folder, viewport={"width": 420, "height": 800}).page
    for place, shown in (("", ".row"), (at(planted.NAN), ".pane canvas")):
        page.evaluate(f"location.hash = '{place}'")
        page.wait_for_selector(shown)
        assert page.evaluate("document.documentElement.scrollWidth") <= 420


def test_a_file_that_is_gone_is_named(visit, verdicts, tmp_path):
    index = Validation((verdicts["good"],)).write_html(tmp_path)
    (tmp_path / "data/good.js").unlink()
    opened = visit(index, "#s=good")
    opened.page.wait_for_selector("#message >> text=data/good.js is not there")
    assert opened.errors
    opened.errors.clear()  # the browser's own words about the file


def test_a_waived_scene_is_no_failure_and_is_counted(visit, verdicts, tmp_path):
    known = replace(verdicts["bad"], name="known", waived=EXPECTED)
    declined = replace(verdicts["crashed"], name="declined", waived=UNSUPPORTED)
    passing = verdicts["good"]
    index = Validation((declined, known, passing), scene_count=3).write_html(tmp_path / "report")
    page = visit(index).page
    assert page.locator(".row .badge").all_inner_texts() == ["SKIP", "KNOWN", "PASS"]
    assert page.inner_text("#total") == "3 scenes: 1 pass, 0 fail, 1 declined by the candidate, 1 known failures"
    assert page.get_attribute("#total", "class") == "good"
    page.select_option("#status", "fail")
    assert page.locator(".row").count() == 0
    page.select_option("#status", "waived")
    assert page.locator(".row").count() == 2 and "FAIL" not in page.inner_text("#list")
    assert visit(index, "#s=known").page.inner_text("#scene-mark") == "KNOWN"


def test_a_failing_scene_check_has_its_evidence_and_the_key_n_leads_there(visit, verdicts, tmp_path):
    broken = SceneCheck("bias", 3.0, "t of Spheres is biased: z -15.0 of 900 groups")
    kinds = (KindBias("Spheres", 900, -15.0), KindBias("Planes", 1, 1.0))
    leaning = replace(verdicts["good"], checks=(broken, *verdicts["good"].checks), biases=kinds)
    index = Validation((leaning,)).write_html(tmp_path / "report")
    page = visit(index).page
    assert "3\u00d7 bias" in page.locator(".row .worst").inner_text()
    page.click(".row")
    page.wait_for_selector("#bad:enabled >> text=evidence")
    page.keyboard.press("n")
    page.wait_for_selector("[data-view=difference][aria-pressed=true]")
    words = page.inner_text("#pixel")
    assert "have a mean that chance does not explain" in words and broken.what in words
    bars = page.locator(".bars").first
    assert bars.locator("rect.over").count() == 1 and "too few groups" in bars.inner_text()
    assert page.locator(".signs rect").count() == 40 and "No pixel is pinned" in words


def test_an_image_keeps_its_place_when_views_and_layers_change(visit, folder):
    page = visit(folder, "#s=good&v=ours").page
    page.wait_for_selector(".pane canvas")
    places = set()
    for key in ("o", "r", "d", "x", "l", "w", "b", "2", "6", "7"):
        page.keyboard.press(key)
        page.wait_for_timeout(80)
        if page.locator(".pane").count() == 1:
            places.add(str(page.locator(".pane canvas").bounding_box()))
    assert len(places) == 1


def test_levels_choose_what_is_drawn_dark_and_light(visit, folder):
    opened = visit(folder, "#s=good&v=ours&a=depth")
    page = opened.page
    page.wait_for_selector("#low:enabled")
    before = color_at(page, "ours", planted.OURS_WRONG)
    page.fill("#low", "0")
    page.fill("#high", "100")
    page.press("#high", "Enter")
    page.wait_for_selector(".legend >> text=100")
    assert color_at(page, "ours", planted.OURS_WRONG) != before
    assert hash_of(opened)["hi"] == "100"
    page.fill("#offset", "0.5")
    page.press("#offset", "Enter")
    page.wait_for_timeout(80)
    assert color_at(page, "ours", planted.OURS_WRONG)[0] < 200
    page.keyboard.press("0")
    page.wait_for_timeout(80)
    assert color_at(page, "ours", planted.OURS_WRONG) == before
    page.keyboard.press("2")
    assert "hi" not in hash_of(opened)


def test_every_pixel_is_reached_and_its_values_are_copied_by_keys_alone(visit, folder):
    opened = visit(folder, "#s=good", permissions=["clipboard-read", "clipboard-write"])
    page = opened.page
    page.wait_for_selector("#pixel >> text=Classes of pixels here")
    for key in ("ArrowLeft", "PageUp", "PageUp", "Home", "Home"):
        page.keyboard.press(key)
    assert (hash_of(opened)["x"], hash_of(opened)["y"]) == ("0", "0")
    for key in ("PageDown", "PageDown", "End", "End"):
        page.keyboard.press(key)
    assert (hash_of(opened)["x"], hash_of(opened)["y"]) == (str(planted.WIDTH - 1), str(planted.HEIGHT - 1))
    ready(page)
    page.keyboard.press("v")
    page.wait_for_selector("#status-line >> text=copied: values of pixel")
    lines = page.evaluate("navigator.clipboard.readText()").splitlines()
    assert lines[0].split("\t")[1:] == ["ours", "reference"] and any(line.startswith("depth\t") for line in lines)


def test_the_sheet_of_a_narrow_screen_covers_no_image(visit, folder):
    page = visit(folder, at(planted.NAN), viewport={"width": 390, "height": 844}).page
    ready(page)
    for _ in range(2):
        images, sheet = (page.locator(each).bounding_box() for each in ("#stages", "#side"))
        assert images["y"] + images["height"] <= sheet["y"] + 1 and sheet["y"] + sheet["height"] <= 845
        page.click("#sheet")


def test_the_head_and_the_words_of_the_page(visit, folder):
    page = visit(folder).page
    facts = page.inner_text("#facts")
    assert all(term in facts for term in ("command", "date", "versions", "processor", "duration", "reference"))
    page.click("#meaning summary")
    assert "differs by less than the error bound" in page.inner_text("#legend")
    page.keyboard.press("?")
    assert "Decided by exact arithmetic" in page.inner_text("#terms")


# ---- two images without a judge


def test_two_images_without_a_judge_have_the_same_viewer(visit, tmp_path):
    y, x = np.mgrid[0:12, 0:16].astype(np.float32)
    ours = np.stack([x / 16, y / 12, 0 * x], axis=-1)
    other = ours.copy()
    other[5:7, 8:10] += 0.25
    other[2, 3, 0] = np.nan
    files = [tmp_path / name for name in ("a.exr", "b <1>.exr")]
    for file, colors in zip(files, (ours, other), strict=True):
        write_exr(file, {f"beauty.{c}": colors[..., i] for i, c in enumerate("RGB")} | {"level": x + 1})
    compare_exr(*files, html=tmp_path / "report")
    opened = visit(tmp_path / "report/index.html")
    page = opened.page
    page.wait_for_selector("#summary >> text=largest difference")
    assert "largest difference" in page.inner_text("#summary") and "beyond their bound" in page.inner_text("#summary")
    assert page.locator("[data-layer]").all_inner_texts() == ["1\nbeauty.RGB", "2\nlevel"]
    assert not page.locator("[data-view=class]").is_visible() and not page.locator("[data-do=back]").is_visible()
    page.keyboard.press("n")
    page.wait_for_selector("#pixel .xy")
    seen = set()
    for _ in range(5):
        seen.add(page.inner_text("#pixel .xy"))
        page.keyboard.press(".")
        page.wait_for_timeout(60)
    assert seen == {"3, 2", "8, 5", "9, 5", "8, 6", "9, 6"}
    page.evaluate("location.hash = '#x=8&y=5&a=beauty.RGB'")
    page.wait_for_selector("#pixel .xy:text-is('8, 5')")
    expected = [float(value).hex() for value in np.column_stack([ours[5, 8], other[5, 8]]).ravel()]
    assert NUMBERS.findall(section(page, "beauty.RGB").inner_text()) == expected
    assert "b <1>.exr" in page.inner_text("#views")
    page.keyboard.press("Escape")
    page.keyboard.press("Escape")
    assert page.locator("#scene").is_visible()

"""What the page is told about a candidate: without a browser."""

import base64
import zlib

import numpy as np
import planted
import pytest
import textbook_pages

from mitsuba_ref.judge.verdict import CLASSES, UNLISTED, WRONG
from mitsuba_ref.report.html_report import index_row
from mitsuba_ref.report.scene_record import FLOAT_LAYERS, scene_record
from mitsuba_ref.report.validation import Validation

WRONG = CLASSES.index(WRONG)


def recorded(verdict, exact=True):
    return scene_record(verdict.seen, exact=exact)


def unpacked(array, like=None):
    """The way back, as mitsuba_ref/report/page/arrays.js has it, in a few lines of NumPy."""
    kind = np.dtype(array["type"])
    planes = np.frombuffer(zlib.decompress(base64.b64decode(array["z"])), np.uint8).reshape(kind.itemsize, -1)
    bits = np.ascontiguousarray(planes.T).view(f"u{kind.itemsize}").ravel()
    if array.get("delta"):
        bits = np.cumsum(bits, dtype=bits.dtype)
    if array.get("xor"):
        numbers = np.where(np.isnan(like), 0.0, like).astype(kind)
        bits = bits ^ numbers.view(bits.dtype)
    return bits.view(kind)


def test_a_record_has_what_the_candidate_gives_and_no_more(judged):
    assert set(recorded(judged["inside"]).layers) == {"ids", "ratio", "depth", "normal", "edges"}
    assert set(recorded(judged["single"]).layers) == {"ids", "ratio", "depth", "edges"}
    ids = recorded(judged["inside"]).layers["ids"]
    assert set(ids) == {"shape_reference", "prim_reference", "t_reference", "t_ours"}
    assert set(recorded(judged["inside"]).layers) < {"ids", "ratio", *FLOAT_LAYERS, "edges"}
    assert judged["single"].unjudged == ("normal", "position", "shading_normal", "uv", "shape_id", "diffuse")


@pytest.mark.parametrize("name", ["inside", "single"])
def test_t_is_what_the_function_returned_to_the_bit(judged, name):
    expected = textbook_pages.RETURNED[name]
    for exact in (True, False):
        ids = recorded(judged[name], exact).layers["ids"]
        reference = unpacked(ids["t_reference"])
        found = unpacked(ids["t_ours"], reference)
        assert np.array_equal(reference, judged[name].seen.judge.result.t)
        # Rounded to float32, for want of room, a float32 number stays what it is.
        assert np.array_equal(found, expected if exact or name == "single" else expected.astype(np.float32))
    assert 0 < np.isfinite(expected).sum() < len(expected)


def test_what_is_no_answer_is_nan_and_never_zero():
    verdict = planted.judged_candidate("gaps", textbook_pages.trace_with_gaps, planted.scene())
    found = recorded(verdict)
    sides = {}
    for name, channels in (("depth", 1), ("normal", 3)):
        layer = found.layers[name]
        ours = unpacked(layer["ours"], unpacked(layer["reference"]))
        sides[name] = ours.reshape(channels, -1)
    no_normal, no_t = map(planted.row_of, (textbook_pages.NO_NORMAL, textbook_pages.NO_T))
    assert np.isnan(sides["normal"][:, no_normal]).all() and np.isnan(sides["depth"][:, no_t]).all()
    assert np.isnan(sides["normal"]).sum() == 3 and np.isnan(sides["depth"]).sum() == 1
    assert [finding.what for finding in verdict.findings] == [
        "no answer: t is NaN",
        "no answer: the normal is not finite on a hit",
    ]


def test_rows_and_pages_name_the_candidate(judged, tmp_path):
    assert "wrong" in index_row(judged["inside"], "", "")["counts"]
    index = Validation(tuple(judged.values())).write_html(tmp_path / "page")
    text = index.read_text(encoding="utf-8")
    assert '"candidate":"docs.candidates.inside:trace"' in text and f'"wrong","undecided","{UNLISTED}"' in text
    assert "<caption>candidate docs.candidates.inside:trace: 1 of 4 scenes pass</caption>" in text
    plain = text[text.index('<table id="plain">') : text.index("</table>")]
    assert '<th scope="col">candidate wrong</th>' in plain and "ours" not in plain

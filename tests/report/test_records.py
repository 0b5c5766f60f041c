"""Records of scenes for their pages, without a browser: to the bit where promised, never too small elsewhere."""

import base64
import zlib

import numpy as np
import planted
import pytest
import textbook_pages

from mitsuba_ref.judge.verdict import UNLISTED
from mitsuba_ref.report.html_report import index_row
from mitsuba_ref.report.scene_record import (
    ENTIRE,
    FLOAT_LAYERS,
    INF_CODE,
    LARGEST_CODE,
    LEAST_SHARE,
    NAN_CODE,
    NO_BOUND,
    error_codes,
    image,
    packed,
    scene_record,
    share_codes,
    value_codes,
    value_steps,
)
from mitsuba_ref.report.validation import Validation


def unpacked(array):
    """The way back, as mitsuba_ref/report/page/arrays.js has it, in a few lines of NumPy."""
    kind = np.dtype(array["type"])
    planes = np.frombuffer(zlib.decompress(base64.b64decode(array["z"])), np.uint8).reshape(kind.itemsize, -1)
    bits = np.ascontiguousarray(planes.T).view(f"u{kind.itemsize}").ravel()
    if "width" not in array:
        return bits.view(kind)
    folded = bits.astype(np.int64).reshape(-1, array["height"], array["width"])
    codes = (folded >> 1) ^ -(folded & 1)
    return codes.cumsum(axis=1).cumsum(axis=2) if array["plane"] else codes


# ---- of a candidate


def test_a_record_has_what_the_candidate_gives_and_no_more(judged):
    assert set(scene_record(judged["inside"].seen).layers) == {"ids", "depth", "normal"}
    assert set(scene_record(judged["single"].seen).layers) == {"ids", "depth"}
    ids = scene_record(judged["inside"].seen).layers["ids"]
    assert set(ids) == {"shape_reference", "prim_reference", "exact"}
    assert set(scene_record(judged["inside"].seen).layers) < {"ids", *FLOAT_LAYERS}
    assert judged["single"].unjudged == ("normal", "position", "shading_normal", "uv", "shape_id", "diffuse")


@pytest.mark.parametrize("name", ["inside", "single"])
def test_t_is_what_the_function_returned_to_the_bit(judged, name):
    record, seen = scene_record(judged[name].seen), judged[name].seen
    rows, exact = unpacked(record.about["rows"]), record.layers["ids"]["exact"]
    reference, expected = unpacked(exact["t_reference"]), textbook_pages.RETURNED[name][rows]
    assert np.array_equal(reference, seen.judge.result.t[rows])
    assert np.array_equal(unpacked(exact["t_ours"]), expected)
    assert 0 < np.isfinite(expected).sum() < len(expected)


def test_what_is_no_answer_is_nan_and_never_zero():
    verdict = planted.judged_candidate("gaps", textbook_pages.trace_with_gaps, planted.scene())
    found = scene_record(verdict.seen)
    rows = unpacked(found.about["rows"])
    no_normal, no_t = map(planted.row_of, (textbook_pages.NO_NORMAL, textbook_pages.NO_T))
    for name, row in (("depth", no_t), ("normal", no_normal)):
        layer, place = found.layers[name], int(np.flatnonzero(rows == row)[0])
        ours = unpacked(layer["exact"]["ours"]).reshape(-1, len(rows))
        codes = unpacked(layer["ours"]) + unpacked(layer["reference"])
        assert np.isnan(ours[:, place]).all() and np.isnan(ours).any(axis=0).sum() == 1
        assert np.flatnonzero((codes == NAN_CODE).all(axis=0)).tolist() == [row]
    assert [finding.what for finding in verdict.findings] == [
        "no answer: t is NaN",
        "no answer: the normal is not finite on a hit",
    ]


def test_a_passing_scene_takes_a_few_bytes_a_pixel(tmp_path):
    """Nine scenes of 256 x 256 pixels are to fit into 4 MB, 6.8 bytes a pixel."""
    found = planted.judged("ball", size=(200, 180))
    Validation((found,)).write_html(tmp_path)
    assert 0 < (tmp_path / "data/ball.js").stat().st_size < 6.8 * 200 * 180 + 20_000  # and what any verdict takes


def test_rows_and_pages_name_the_candidate(judged, tmp_path):
    assert "wrong" in index_row(judged["inside"], None)["counts"]
    index = Validation(tuple(judged.values())).write_html(tmp_path / "page")
    text = index.read_text(encoding="utf-8")
    assert '"candidate":"docs.candidates.inside:trace"' in text and f'"wrong","undecided","{UNLISTED}"' in text


# ---- arrays


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32, np.uint8])
def test_what_goes_in_comes_out_to_the_bit(dtype):
    numbers = np.random.default_rng(4).normal(0.0, 40.0, (300, 3))
    values = numbers.astype(dtype) if dtype != np.uint8 else np.abs(numbers).astype(dtype)
    if values.dtype.kind == "f":
        values[:6, 0] = [-0.0, np.inf, -np.inf, np.nan, 5e-324, 3e38]
    assert unpacked(packed(values)).tobytes() == np.ascontiguousarray(values.T).tobytes()


def test_an_image_comes_out_as_it_goes_in():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[0:14, 0:20]
    smooth = np.stack([3 * x - 5 * y, (x * y) // 3, 40 * x], axis=-1).reshape(-1, 3)
    for codes in (smooth, rng.integers(-INF_CODE, INF_CODE + 1, (280, 1)), np.zeros((280, 2), np.int64)):
        for found in (image(codes, (14, 20)), image(codes, (14, 20), smooth=False)):
            assert np.array_equal(unpacked(found).reshape(codes.shape[1], -1).T, codes)


def test_values_are_rounded_to_a_step_and_what_is_no_number_stays_none():
    values = np.array([[0.0, 1.0, -3.5, 1e300, -1e300, np.nan, np.inf, -np.inf]]).T
    codes = value_codes(values, np.array([0.5]))[:, 0].tolist()
    assert codes == [0, 2, -7, LARGEST_CODE, -LARGEST_CODE, NAN_CODE, INF_CODE, -INF_CODE]
    assert value_steps(np.linspace(-1.0, 1.0, 10001)[:, None]) == pytest.approx(1.96 / 255)
    assert value_steps(np.zeros((9, 2))).tolist() == [1.0, 1.0]
    assert np.isfinite(value_steps(np.array([[-1.7e308], [1.7e308], [np.inf]]))).all()


def test_shares_are_never_reported_smaller_than_they_are():
    shares = np.concatenate([10.0 ** np.random.default_rng(4).uniform(-3.0, 30.0, 5000), [0.0, 1.0]])
    codes = share_codes(shares).astype(np.float64)
    told = np.where(codes == 0, 2.0**-LEAST_SHARE, 2.0 ** ((codes - ENTIRE) / 2))
    assert np.all(told >= shares * (1.0 - 2.0**-50)) and np.all((told <= shares * 1.42) | (codes == 0))
    just = np.nextafter([1.0, 1.0], [0.0, 2.0])
    assert share_codes(np.array([*just, np.inf, np.nan])).tolist() == [ENTIRE, ENTIRE + 1, NO_BOUND, NO_BOUND]


def test_errors_keep_their_sign_and_their_size_within_the_root_of_2():
    rng = np.random.default_rng(4)
    reference = rng.normal(size=(4000, 3))
    ours = reference + np.array([1e-9, -3e-9, 2e-9]) * rng.lognormal(size=(4000, 1))
    unit, codes = error_codes(ours - reference)
    error = (ours - reference)[:, 1]
    told = np.sign(codes) * unit * 2.0 ** (np.abs(codes) - 1.0)
    large = np.abs(error) > 2.0 * unit
    assert large.sum() > 2500 and np.all(np.abs(np.log2(told[large] / error[large])) < 0.501)
    assert not error_codes(np.zeros((9, 3)))[1].any() and error_codes(np.array([[5e-324], [1.0]]))[1].tolist()[0] >= 0

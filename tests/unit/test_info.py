"""`caster info`: what an EXR holds, in numbers and in words."""

import json

import numpy as np
import OpenEXR
import pytest

from caster.description.errors import FileMissing
from caster.image.exr import UnreadableExr, write_exr
from caster.image.exr_info import (
    ASCII_RAMP,
    BINS,
    BLOCK_RAMP,
    bin_counts,
    describe_exr,
    format_info,
    histogram_text,
    hit_mask,
    ramp_for,
)

NO_ID = 0xFFFFFFFF


def image() -> dict[str, np.ndarray]:
    """3 x 2 pixels: four hits, two misses."""
    hit = np.array([[1, 1, 0], [1, 1, 0]], bool)
    return {
        "A": hit.astype(np.float32),
        "depth.Z": np.where(hit, [[2.0, 2.5, 0], [3.0, 3.5, 0]], np.inf).astype(np.float32),
        "normal.Z": np.where(hit, -0.5, 0.0).astype(np.float32),
        "id.shape": np.where(hit, [[0, 7, 0], [1, 2, 0]], NO_ID).astype(np.uint32),
    }


def test_channels_ranges_hits_and_provenance_are_reported(tmp_path):
    write_exr(tmp_path / "a.exr", image(), {"version": "1.2"})
    info = describe_exr(tmp_path / "a.exr")
    assert (info["width"], info["height"], info["hit_pixels"], info["hit_channel"]) == (3, 2, 4, "A")
    assert info["bytes"] == (tmp_path / "a.exr").stat().st_size
    depth, shape = info["channels"]["depth.Z"], info["channels"]["id.shape"]
    assert (depth["type"], depth["min"], depth["max"], depth["plus_inf"], depth["nan"]) == ("float", 2.0, 3.5, 2, 0)
    assert (shape["type"], shape["min"], shape["max"], shape["no_id"]) == ("uint", 0, 7, 2)
    assert info["provenance"] == {"caster/version": "1.2"}
    assert info["warnings"] == []
    told = format_info(info)
    assert "hit pixels: 4 of 6 (66.7 %), by channel A" in told
    assert "caster/version  1.2" in told
    assert "depth.Z" in told and "3.5" in told


def test_the_json_is_strict_even_for_an_image_of_nan(tmp_path):
    nothing = {"A": np.full((2, 2), np.nan), "Z": np.full((2, 2), np.inf), "id.prim": np.full((2, 2), NO_ID, np.uint32)}
    write_exr(tmp_path / "a.exr", nothing)
    info = json.loads(json.dumps(describe_exr(tmp_path / "a.exr"), allow_nan=False))
    assert info["channels"]["A"]["nan"] == 4 and info["channels"]["A"]["min"] is None
    assert info["channels"]["Z"]["plus_inf"] == 4 and info["channels"]["Z"]["max"] is None
    assert info["channels"]["id.prim"]["max"] is None and info["channels"]["id.prim"]["no_id"] == 4
    assert "warning: A is NaN in 4 pixels, first [0, 0]" in format_info(info)


def test_what_no_image_of_ours_holds_is_a_warning_with_its_pixel(tmp_path):
    wrong = image()
    wrong["normal.Z"][1, 0] = np.nan
    wrong["depth.Z"][0, 1] = np.inf
    wrong["depth.Z"][1, 2] = 0.0
    write_exr(tmp_path / "a.exr", wrong, data_window=(10, 20, 13, 22))
    info = describe_exr(tmp_path / "a.exr")
    assert info["warnings"] == [
        "depth.Z is infinite in 1 pixels, first [11, 20]",
        "normal.Z is NaN in 1 pixels, first [10, 21]",
        "depth.Z is finite where A is a miss in 1 pixels, first [12, 21]",
    ]
    assert info["channels"]["normal.Z"]["first_nan"] == [10, 21]


def test_a_crop_is_reported(tmp_path):
    write_exr(tmp_path / "a.exr", image(), data_window=(1, 2, 4, 4), display_window=(0, 0, 9, 9))
    info = describe_exr(tmp_path / "a.exr")
    assert (info["data_window"], info["display_window"]) == ([1, 2, 4, 4], [0, 0, 9, 9])
    assert "pixels [1, 2, 4, 4] of the film [0, 0, 9, 9]" in format_info(info)


def test_half_floats_are_distinguished(tmp_path):
    OpenEXR.File({}, {"Z": np.ones((2, 2), np.float16)}).write(str(tmp_path / "a.exr"))
    assert describe_exr(tmp_path / "a.exr")["channels"]["Z"]["type"] == "half"


def test_without_a_channel_of_hits_they_are_unknown(tmp_path):
    write_exr(tmp_path / "a.exr", {"normal.X": np.zeros((2, 2))})
    info = describe_exr(tmp_path / "a.exr")
    assert info["hit_pixels"] is None and "hit pixels: unknown" in format_info(info)
    assert "provenance: none" in format_info(info)


@pytest.mark.parametrize(("present", "asked"), [("A", "A"), ("id.shape", "id.shape"), ("depth.Z", "depth.Z")])
def test_the_mask_comes_from_the_most_certain_channel(present, asked):
    channels = image()
    for name in ("A", "id.shape", "depth.Z"):
        if name == present:
            break
        del channels[name]
    mask, source = hit_mask(channels)
    assert source == asked and mask is not None
    assert mask.tolist() == [[True, True, False], [True, True, False]]


def test_nan_depth_is_not_taken_for_a_miss():
    mask, _ = hit_mask({"depth.Z": np.array([[np.nan, np.inf, 1.0]])})
    assert mask is not None and mask.tolist() == [[True, False, True]]


def test_text_from_a_file_cannot_drive_the_terminal_and_is_cut(tmp_path):
    write_exr(tmp_path / "a.exr", image(), {"note": "\x1b[31mred\nline", "scene_json": "y" * 5000})
    told = format_info(describe_exr(tmp_path / "a.exr"))
    assert "\x1b" not in told and "[31mred line" in told
    assert "(5000 characters)" in told and len(max(told.splitlines(), key=len)) < 120


def test_unusable_files_are_errors(tmp_path):
    (tmp_path / "empty.exr").touch()
    with pytest.raises(UnreadableExr, match="empty"):
        describe_exr(tmp_path / "empty.exr")
    with pytest.raises(FileMissing, match="no such file"):
        describe_exr(tmp_path / "absent.exr")


def test_histograms_count_every_finite_value_once(tmp_path):
    """The oracle is NumPy's; its bins are half open but for the last, as these."""
    rng = np.random.default_rng(3)
    values = np.round(rng.normal(0.0, 5.0, (40, 50)), 2).astype(np.float32)
    values[0, :3] = np.nan, np.inf, -np.inf
    write_exr(tmp_path / "a.exr", {"x.Y": values})
    told = describe_exr(tmp_path / "a.exr")["channels"]["x.Y"]["histogram"]
    finite = values[np.isfinite(values)].astype(np.float64)
    assert sum(told) == finite.size == 40 * 50 - 3 and len(told) == BINS
    assert np.abs(np.array(told) - np.histogram(finite, BINS)[0]).sum() <= 2  # a value on an edge may go either way


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([], []),
        ([7.0, 7.0], [2]),
        ([0.0, 1.0], [1, 0, 0, 1]),
        ([0.0, 0.3, 0.3, 0.5, 0.99], [1, 2, 1, 1]),
        ([-1.7e308, 1.7e308], [1, 0, 0, 1]),
    ],
)
def test_histograms_of_few_values(values, expected):
    assert bin_counts(np.array(values), 4) == expected


def test_a_histogram_is_drawn_in_what_the_terminal_can_show():
    """A single value among many still shows."""
    assert histogram_text([0, 1, 400, 800]) == " ▁▄█" and histogram_text([]) == ""
    assert histogram_text([0, 1, 400, 800], ramp_for("latin-1")) == " .=@"
    assert ramp_for("utf-8") == BLOCK_RAMP and ramp_for(None) == ramp_for("no-such-encoding") == ASCII_RAMP
    assert len(BLOCK_RAMP) == len(ASCII_RAMP)


def test_info_shows_a_histogram_for_each_channel(tmp_path):
    write_exr(tmp_path / "a.exr", {"x.Y": np.linspace(0.0, 1.0, 48).reshape(6, 8)})
    info = describe_exr(tmp_path / "a.exr")
    assert f"|{'█' * BINS}|" in format_info(info) and f"|{'@' * BINS}|" in format_info(info, "ascii")

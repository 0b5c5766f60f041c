"""`caster info`: the size, channels, hits and provenance of an EXR file."""

import json

import numpy as np
import OpenEXR
import pytest

from caster.cli.viewing import describe_exr, format_info
from caster.image import exr_validation
from caster.image.channels import hit_mask
from caster.image.exr import NO_ID, UnreadableExr, write_exr

HIT = np.array([[1, 1, 0], [1, 1, 0]], bool)
CHANNELS = {
    "A": HIT.astype(np.float32),
    "id.shape": np.where(HIT, [[0, 7, 0], [1, 2, 0]], NO_ID).astype(np.uint32),
    "depth.Z": np.where(HIT, [[2.0, 2.5, 0], [np.nan, 3.5, 0]], np.inf).astype(np.float32),
}


def test_size_channels_hits_and_provenance_are_reported(tmp_path):
    write_exr(tmp_path / "a.exr", CHANNELS, {"version": "1.2"}, data_window=(1, 2, 4, 4), display_window=(0, 0, 9, 9))
    info = json.loads(json.dumps(describe_exr(tmp_path / "a.exr"), allow_nan=False))
    assert (info["width"], info["height"], info["hit_pixels"], info["hit_channel"]) == (3, 2, 4, "A")
    assert info["bytes"] == (tmp_path / "a.exr").stat().st_size
    assert {name: channel["type"] for name, channel in info["channels"].items()} == {
        "A": "float",
        "depth.Z": "float",
        "id.shape": "uint",
    }
    assert info["provenance"] == {"caster/version": "1.2"}
    lines = format_info(info).splitlines()
    assert lines[1] == "pixels [1, 2, 4, 4] of the film [0, 0, 9, 9] (x1 and y1 are outside)"
    assert lines[2] == "hit pixels: 4 of 6 (66.7 %), by channel A"
    assert "  depth.Z   float" in lines and "  caster/version  1.2" in lines


def test_a_file_of_half_floats_without_hits_or_provenance(tmp_path):
    OpenEXR.File({}, {"Z": np.ones((2, 2), np.float16)}).write(str(tmp_path / "a.exr"))
    info = describe_exr(tmp_path / "a.exr")
    assert info["channels"] == {"Z": {"type": "half"}} and info["hit_pixels"] is None
    assert "hit pixels: unknown" in format_info(info) and "provenance: none" in format_info(info)


@pytest.mark.parametrize("first", range(3))
def test_the_mask_comes_from_the_most_certain_channel(first):
    """A depth of NaN is a hit."""
    mask, source = hit_mask(dict(list(CHANNELS.items())[first:]))
    assert source == list(CHANNELS)[first] and np.array_equal(mask, HIT)


def test_text_from_a_file_cannot_drive_the_terminal_and_is_cut(tmp_path):
    write_exr(tmp_path / "a.exr", CHANNELS, {"note": "\x1b[31mred\nline", "scene_json": "y" * 5000})
    lines = format_info(describe_exr(tmp_path / "a.exr"))
    assert "\x1b" not in lines and "\\u001b[31mred\\u000aline" in lines
    assert "(5000 characters)" in lines and len(max(lines.splitlines(), key=len)) < 120


def test_an_image_beyond_the_memory_is_refused_with_the_numbers(tmp_path, monkeypatch):
    write_exr(tmp_path / "a.exr", CHANNELS)
    monkeypatch.setattr(exr_validation, "available_bytes", lambda: 50.0)
    with pytest.raises(UnreadableExr, match=r"3 x 2 pixels of 3 channels need 0\.0 GB, and 0\.0 GB are left"):
        describe_exr(tmp_path / "a.exr")

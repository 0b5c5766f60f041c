"""Multi-part EXR files of other programs are read as one image, or refused with the reason."""

import itertools
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from test_exr import SHAPE, ramp

from caster.__main__ import main as caster_main
from caster.image.exr import UnreadableExr, read_exr
from caster.system.process import FILE
from mitsuba_ref.__main__ import main

FLAT = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
DEEP = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}


def save(path: Path, parts: dict[str, dict[str, np.ndarray]], **headers: dict) -> Path:
    """A part for each name; headers: what else some of them say."""
    made = [
        OpenEXR.Part(FLAT | headers.get(name, {}), {n: a.copy() for n, a in channels.items()}, name)
        for name, channels in parts.items()
    ]
    OpenEXR.File(made).write(str(path))
    return path


def of(*names: str) -> dict[str, np.ndarray]:
    return {name: ramp(sum(name.encode())) for name in names}


# ---- what channels are called ----


@pytest.mark.parametrize(
    ("parts", "called"),
    [
        ({"rgba": "RGBA", "depth": "Z", "N": "XYZ"}, "A B G N.X N.Y N.Z R depth.Z"),
        ({"View.Depth": ["View.Depth.Z"], "View.P": ["View.P.X"]}, "View.Depth.Z View.P.X"),  # Blender
        ({"View.Combined": "A", "diffuse": "A", "Z": "Z"}, "A Z diffuse.A"),
        ({"depth": ["depth.Z"], "normal": "X"}, "depth.Z normal.X"),
        ({"Part0": "Z", "subimage01": "Y"}, "Y Z"),  # what programs call parts without a name
        ({"near": ["depth.Z"], "far": ["depth.Z"]}, "far.depth.Z near.depth.Z"),
        ({"rgb": "Z", "beauty": "Z"}, "beauty.Z rgb.Z"),
    ],
    ids=str,
)
def test_a_channel_is_called_after_its_layer_or_else_after_its_part(tmp_path, parts, called):
    seeds = itertools.count()
    given = {part: {n: ramp(next(seeds)) for n in names} for part, names in parts.items()}
    read = read_exr(save(tmp_path / "a.exr", given))
    assert list(read.channels) == called.split()
    assert list(read.parts) == list(parts)
    for part, channels in given.items():
        for name, values in channels.items():
            (found,) = (each for each, other in read.channels.items() if np.array_equal(values, other))
            assert found in (name, f"{part}.{name}")


def test_provenance_is_that_of_all_parts_and_types_are_kept(tmp_path):
    ids = np.arange(35, dtype=np.uint32).reshape(SHAPE)
    told = {"caster/version": "1"}
    path = save(tmp_path / "a.exr", {"rgba": of("A"), "id": {"shape": ids}}, rgba=told, id=told)
    read = read_exr(path)
    assert read.provenance == told and read.channels["id.shape"].tobytes() == ids.tobytes()


# ---- what makes no picture ----


def deep() -> np.ndarray:
    samples = np.empty(SHAPE, object)
    for i in np.ndindex(SHAPE):
        samples[i] = np.ones(2, np.float32)
    return samples


TILES = OpenEXR.TileDescription()
TILES.mode = OpenEXR.MIPMAP_LEVELS
SMALL = {"displayWindow": ((0, 0), (6, 4)), "dataWindow": ((2, 1), (4, 2))}
REFUSED = {
    "sizes": (
        {"rgba": of("A"), "depth": {"Z": np.zeros((2, 3), np.float32)}},
        {"depth": SMALL},
        "parts of different sizes, expected layers of one image: pixels (x0, y0, x1, y1): "
        "part 'rgba' shows (0, 0, 7, 5), 'depth' shows (2, 1, 5, 3)",
    ),
    "deep": (
        {"rgba": of("A"), "cloud": {"Z": deep()}},
        {"cloud": DEEP},
        "deep data, many samples per pixel, in part 'cloud'; write flat parts",
    ),
    "views": (
        {"rgba.left": of("A"), "rgba.right": of("A")},
        {"rgba.left": {"view": "left"}, "rgba.right": {"view": "right"}},
        "images of 2 views ('left', 'right')",
    ),
    "not decoded": (  # the library cannot read all that it writes, and leaves such parts out
        {"rgba": of("A"), "mip": of("Z")},
        {"mip": {"type": OpenEXR.tiledimage, "tiles": TILES}},
        "cannot read part 'mip': damaged, truncated or of an unknown kind",
    ),
    "contradiction": (
        {"a": of("A"), "b": of("Z")},
        {"a": {"caster/scene_sha256": "1"}, "b": {"caster/scene_sha256": "2"}},
        "its parts have different values of 'caster/scene_sha256'",
    ),
}


@pytest.mark.parametrize("why", REFUSED)
def test_parts_that_make_no_image_are_refused_by_every_command(tmp_path, capfd, why):
    parts, headers, says = REFUSED[why]
    path = save(tmp_path / "a.exr", parts, **headers)
    for command in ([caster_main, "info", path], [main, "compare", path, path], [caster_main, "preview", path]):
        assert command[0]([str(word) for word in command[1:]]) == FILE
        out, err = capfd.readouterr()
        assert out == "" and err.startswith(f"{path}: ") and says in err, err


def test_two_channels_of_one_name_are_refused(tmp_path):
    path = save(tmp_path / "a.exr", {"a": of("b.c"), "x": of("b.c"), "a.b": of("c")})
    with pytest.raises(UnreadableExr, match=r"two parts have a channel that would be called 'a\.b\.c'"):
        read_exr(path)


def test_info_lists_the_parts(tmp_path, capsys):
    path = save(tmp_path / "a.exr", {"rgba": of("R", "A"), "depth": of("Z")})
    assert caster_main(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert "2 parts as one image: rgba, depth\n" in out and "depth.Z  float" in out


@pytest.mark.parametrize("second", [ramp(), np.full(SHAPE, np.nan, np.float32)], ids=["good", "NaN"])
def test_two_parts_that_hold_the_same_layers_never_pass(tmp_path, capsys, second):
    """Which part is meant? It is a question, also where the first part is good."""
    good, parts = tmp_path / "good.exr", tmp_path / "parts.exr"
    save(good, {"0": {"depth.Z": ramp()}})
    save(parts, {"0": {"depth.Z": ramp()}, "1": {"depth.Z": second}})
    for pair in ((good, parts), (parts, good), (parts, parts)):
        assert main(["compare", *map(str, pair), "--depth-rtol=1e30"]) == 3
        assert "may both be the depth: --map depth=0.depth.Z" in capsys.readouterr().err

"""`caster render` writes the numbers of `caster.render`, for each AOV, also in crops.

The file is read by the OpenEXR library, and each channel has the name that docs/scene-format.md gives it.
"""

import json
import weakref

import numpy as np
import OpenEXR
import pytest
from places import ROOT
from programs import printed_by

import caster
from caster.__main__ import main
from caster.aovs import AOVS, Aovs
from caster.image.channels import aovs_to_channels, channels_to_aovs
from caster.image.exr import NO_ID
from caster.rendering import images

SCENE, SIZE, CROP = str(ROOT / "scenes/flat-shapes.toml"), (24, 18), (5, 3, 20, 17)
NAMES = tuple(aov.NAME for aov in AOVS)
CHANNELS = {
    "hit": ("A",),
    "depth": ("depth.Z",),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "shading_normal": ("shading_normal.X", "shading_normal.Y", "shading_normal.Z"),
    "position": ("position.X", "position.Y", "position.Z"),
    "uv": ("uv.U", "uv.V"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "diffuse": ("R", "G", "B"),
    "shape_id": ("id.shape",),
    "prim_id": ("id.prim",),
}


def stored_planes(aovs):
    """The planes that docs/scene-format.md promises: ids as uint32, all else as float32."""
    planes = {"A": aovs.hit.astype(np.float32)}
    for name, image in aovs.items():
        layers = np.moveaxis(image.reshape(*aovs.hit.shape, -1), -1, 0)
        for channel, layer in zip(CHANNELS[name], layers, strict=True):
            ids = layer.dtype.kind == "i"
            planes[channel] = np.where(layer < 0, 2**32 - 1, layer).astype(np.uint32) if ids else np.float32(layer)
    return planes


@pytest.mark.parametrize("crop", [None, CROP], ids=["whole", "crop"])
@pytest.mark.parametrize("names", [("depth",), NAMES], ids=" ".join)
def test_a_file_holds_what_render_gives(tmp_path, names, crop):
    path = tmp_path / "image.exr"
    words = ["render", SCENE, "-o", str(path), "--size", *map(str, SIZE), "--aov", ",".join(names)]
    assert main([*words, "--crop", *map(str, crop)] if crop else words) == 0
    scene = caster.load_scene(SCENE).with_film(width=SIZE[0], height=SIZE[1], crop=crop or (0, 0, *SIZE))
    planes = stored_planes(caster.render(scene, names))
    x0, y0, x1, y1 = scene.film.window
    with OpenEXR.File(str(path), separate_channels=True) as file:
        boxes = [np.array(file.header()[name]).tolist() for name in ("dataWindow", "displayWindow")]
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    assert boxes == [[[x0, y0], [x1 - 1, y1 - 1]], [[0, 0], [SIZE[0] - 1, SIZE[1] - 1]]]
    assert channels.keys() == planes.keys()
    for name, expected in planes.items():
        assert channels[name].dtype == expected.dtype
        assert np.array_equal(channels[name].view(np.uint32), expected.view(np.uint32)), name


LIT = str(ROOT / "scenes/lights-and-shadows.toml")
BEYOND_RASTER = str(ROOT / "scenes/fisheye.toml")


@pytest.mark.parametrize("scene_path", [SCENE, LIT, BEYOND_RASTER])
@pytest.mark.parametrize("crop", [(0, 0, 30, 200), (5, 7, 28, 166)], ids=["whole", "crop"])
def test_bands_change_neither_file_nor_counts(tmp_path, monkeypatch, capsys, scene_path, crop):
    """Images of one band are those that other tests compare with `caster.render`."""
    options = ["--size", "30", "200", "--crop", *map(str, crop), "--aov", ",".join(NAMES), "--json"]
    files, told = [], []
    for pixels in (images.BAND_PIXELS, 1, 30 * 128):
        monkeypatch.setattr(images, "BAND_PIXELS", pixels)
        assert main(["render", scene_path, "-o", str(tmp_path / "image.exr"), *options]) == 0
        files.append((tmp_path / "image.exr").read_bytes())
        told.append({**json.loads(capsys.readouterr().out), "kernels": {}})
    assert files[1:] == files[:1] * 2 and told[1:] == told[:1] * 2
    assert told[0]["surfaces"]["hits"] > 0 and any(kind["looked_for"] for kind in told[0]["primitives"])


def test_of_a_large_film_two_bands_at_most_are_in_memory(tmp_path, monkeypatch, capsys):
    alive, most = [], []

    def counted(scene, *arguments, **options):
        rendered = render_film(scene, *arguments, **options)
        if scene.film.height == 640:  # no film that compiles kernels
            alive.append(scene.film.window)
            weakref.finalize(rendered.aovs["normal"], alive.remove, scene.film.window)
            most.append(len(alive))
        return rendered

    render_film = images.render_film
    monkeypatch.setattr(images, "render_film", counted)
    monkeypatch.setattr(images, "BAND_PIXELS", 1)
    words = ["render", SCENE, "-o", str(tmp_path / "image.exr"), "--size", "8", "640", "--aov", "normal"]
    assert main(words) == 0 and "8 x 640 pixels" in capsys.readouterr().out
    assert len(most) == 10 and max(most) == 2


@pytest.mark.slow("renders 268 million pixels")
def test_16384_x_16384_pixels_need_less_than_a_gigabyte(tmp_path):
    words = ["render", SCENE, "-o", str(tmp_path / "image.exr"), "--size", "16384", "16384", "--aov", "depth,normal"]
    program = (
        "import resource, sys; from caster.__main__ import main; code = main(sys.argv[1:]); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss); sys.exit(code)"
    )
    assert int(printed_by("-c", program, *words).split()[-1]) < 1 << 20  # KiB


def test_every_number_of_a_primitive_goes_through_a_file_unrounded():
    ids = np.array([[0, 2**24 + 1, 2**31 - 1, -1]], np.int32)
    channels = aovs_to_channels(Aovs({"prim_id": ids}, ids >= 0))
    assert channels["id.prim"].tolist() == [[0, 2**24 + 1, 2**31 - 1, NO_ID]]
    assert channels_to_aovs(channels)["prim_id"].tolist() == ids.tolist()

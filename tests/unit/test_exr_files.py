"""`caster render` writes the numbers of `caster.render`, for each AOV, also in crops.

The file is read by the OpenEXR library, and each channel has the name that docs/scene-format.md gives it.
"""

import numpy as np
import OpenEXR
import pytest
from places import ROOT

import caster
from caster.__main__ import main
from caster.aovs import AOVS, Aovs
from caster.image.channels import aovs_to_channels, channels_to_aovs
from caster.image.exr import NO_ID

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


def stored_planes(images):
    """The planes that docs/scene-format.md promises: ids as uint32, all else as float32."""
    planes = {"A": images.hit.astype(np.float32)}
    for name, image in images.items():
        layers = np.moveaxis(image.reshape(*images.hit.shape, -1), -1, 0)
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


def test_every_number_of_a_primitive_goes_through_a_file_unrounded():
    ids = np.array([[0, 2**24 + 1, 2**31 - 1, -1]], np.int32)
    channels = aovs_to_channels(Aovs({"prim_id": ids}, ids >= 0))
    assert channels["id.prim"].tolist() == [[0, 2**24 + 1, 2**31 - 1, NO_ID]]
    assert channels_to_aovs(channels)["prim_id"].tolist() == ids.tolist()

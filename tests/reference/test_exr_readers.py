"""Mitsuba reads our EXR files: every channel by its name, layers as groups, all bits unchanged."""

import numpy as np
import pytest
from places import shipped
from programs import printed_by

import caster
from caster import __version__
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import write_exr
from mitsuba_ref.exr_compare.two_files import Reading, compare_exr
from mitsuba_ref.reference.shared_input import export_scene

READ = """
import sys
import mitsuba as mi
import numpy as np
mi.set_variant("scalar_rgb")
bitmap = mi.Bitmap(sys.argv[1])
values = np.array(bitmap)
np.savez(sys.argv[2], **{field.name: values[..., i] for i, field in enumerate(bitmap.struct_())})
print(*(f"{name}:{layer.pixel_format()}" for name, layer in bitmap.split()))
"""
LAYERS = (
    "<root>:PixelFormat.RGBA",
    "depth:PixelFormat.MultiChannel",
    "normal:PixelFormat.XYZ",
    "uv:PixelFormat.MultiChannel",
)


def test_mitsubas_bitmap_sees_every_channel_bit_for_bit(tmp_path):
    rng = np.random.default_rng(3)
    names = ("R", "G", "B", "A", "depth.Z", "normal.X", "normal.Y", "normal.Z", "uv.U", "uv.V")
    channels = {name: rng.normal(size=(5, 7)).astype(np.float32) for name in names}
    channels["depth.Z"][2, 3] = np.inf
    write_exr(tmp_path / "a.exr", channels, {"caster/version": "0"})
    told = printed_by("-c", READ, tmp_path / "a.exr", tmp_path / "a.npz")
    read = np.load(tmp_path / "a.npz")
    assert set(read.files) == set(channels)
    assert all(np.array_equal(read[name], channels[name]) for name in channels)
    assert tuple(told.split()) == LAYERS


RENDER = """
import sys
import mitsuba as mi
mi.set_variant("scalar_rgb")
scene = mi.load_file(sys.argv[1], optimize=False)
mi.render(scene, spp=1)
scene.sensors()[0].film().bitmap().write(sys.argv[2])
"""


@pytest.mark.parametrize("name", ["cornell-box", "near-far-clip", "orthographic"])
def test_mitsubas_own_image_of_our_export_passes_with_its_conventions_stated(tmp_path, name):
    """Its depth counts from the near plane, and a miss is 0."""
    scene = shipped(name, 32, 24)
    xml = export_scene(scene).write(tmp_path)
    printed_by("-c", RENDER, xml, tmp_path / "theirs.exr")
    aovs = caster.render(scene, aovs=("depth", "normal", "shading_normal", "position"))
    write_exr(tmp_path / "ours.exr", aovs_to_channels(aovs), provenance(scene, __version__))
    result = compare_exr(tmp_path / "ours.exr", tmp_path / "theirs.exr", reading=Reading(depth="near", scene=scene))
    assert result.ok, str(result)
    assert {group.name for group in result.groups} >= {"hit", "depth", "normal", "shading_normal", "position"}
    stated = "\n".join(result.stated)
    assert "depth.T is depth.Z" in stated and "depth is the distance from the near plane along the ray" in stated

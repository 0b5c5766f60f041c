"""What `caster render` writes is what `caster.render` gives, for each AOV, in crops as well."""

from pathlib import Path

import numpy as np
import pytest

import caster
from caster.__main__ import main
from caster.aovs import AOVS, Aovs
from caster.image.channels import aovs_to_channels, channels_to_aovs
from caster.image.exr import NO_ID
from mitsuba_ref.judge.checks.exr_files import WrittenImage, difference, stored_planes

ROOT = Path(__file__).resolve().parents[2]
SCENE, SIZE, CROP = str(ROOT / "scenes/every-shape.toml"), (24, 18), (5, 3, 20, 17)
NAMES = tuple(aov.NAME for aov in AOVS)


@pytest.mark.parametrize("crop", [None, CROP], ids=["whole", "crop"])
@pytest.mark.parametrize("names", [("depth",), NAMES], ids=" ".join)
def test_a_file_holds_what_render_gives(tmp_path, names, crop):
    path = tmp_path / "image.exr"
    words = ["render", SCENE, "-o", str(path), "--size", *map(str, SIZE), "--aov", ",".join(names)]
    assert main([*words, "--crop", *map(str, crop)] if crop else words) == 0
    scene = caster.load_scene(SCENE).with_film(width=SIZE[0], height=SIZE[1], crop=crop or (0, 0, *SIZE))
    planes = stored_planes(caster.render(scene, names))
    assert difference(WrittenImage(path, planes, scene.film.window, SIZE)) == ""
    if "depth" in names:
        nudged = planes | {"depth.Z": np.nextafter(planes["depth.Z"], np.float32(0))}
        assert difference(WrittenImage(path, nudged, scene.film.window, SIZE)).startswith("depth.Z at (")


def test_ids_and_numbers_beyond_float32_are_stored_as_the_page_states():
    hit = np.array([[True, False]])
    planes = stored_planes(Aovs({"shape_id": np.array([[2, -1]]), "depth": np.array([[1e300, np.inf]])}, hit))
    assert planes["id.shape"].tolist() == [[2, 4294967295]] and planes["id.shape"].dtype == np.uint32
    assert planes["depth.Z"].tolist() == [[float(np.finfo(np.float32).max), np.inf]]
    assert planes["A"].tolist() == [[1.0, 0.0]]


def test_every_number_of_a_primitive_goes_through_a_file_unrounded():
    ids = np.array([[0, 2**24 + 1, 2**31 - 1, -1]], np.int32)
    channels = aovs_to_channels(Aovs({"prim_id": ids}, ids >= 0))
    assert channels["id.prim"].tolist() == [[0, 2**24 + 1, 2**31 - 1, NO_ID]]
    assert channels_to_aovs(channels)["prim_id"].tolist() == ids.tolist()

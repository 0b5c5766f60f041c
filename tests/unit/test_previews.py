"""Previews of AOVs: colours of known values, misses, broken values and files."""

import numpy as np
import pytest
from PIL import Image
from places import ROOT, SHIPPED

import caster
from caster.__main__ import main
from caster.aovs import BY_NAME
from caster.image.previews import (
    CHECKER_GREYS,
    COLORMAP_ANCHORS,
    NON_FINITE_COLOR,
    aov_view,
    checkerboard,
    colormap_lookup,
    label_colors,
)

pytestmark = pytest.mark.usefixtures("warm")

SCENE = """
[film]
width = 24
height = 16
[camera]
type = "pinhole"
eye = [0.3, 0.4, 5]
look_at = [0, 0, 0]
[[shape]]
type = "sphere"
"""
LIGHT = """
[[light]]
type = "point"
position = [2, 3, 4]
intensity = [9, 8, 7]
"""


@pytest.fixture
def folder(here):
    (here / "s.toml").write_text(SCENE + LIGHT)
    return here


def read_image(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def luminance(pixels):
    """Relative luminance of bytes on an sRGB screen."""
    x = np.asarray(pixels) / 255.0
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722]


def test_the_scale_gets_lighter_all_the_way():
    light = luminance(colormap_lookup(np.linspace(0.0, 1.0, 65)))
    assert (np.diff(light) > 0.0).all() and light[0] < 0.02 and light[-1] > 0.85
    assert (colormap_lookup(np.array([-1.0, 2.0])) == COLORMAP_ANCHORS[[0, -1]]).all()


def test_every_aov_of_a_render_is_shown(folder):
    """Hits are not the checker, misses are; broken values are magenta."""
    aovs = caster.render(caster.load_scene("s.toml"), tuple(BY_NAME))
    behind = checkerboard(aovs.hit.shape)
    for name in BY_NAME:
        shown = aov_view(name, aovs[name], aovs.hit)
        assert shown.pixels.shape == (16, 24, 3) and shown.pixels.dtype == np.uint8
        assert (shown.pixels[~aovs.hit] == behind[~aovs.hit]).all(), name
        assert "magenta" not in shown.legend, name


def test_values_that_are_not_finite_are_magenta_and_counted():
    values, hit = np.ones((2, 3)), np.ones((2, 3), bool)
    values[0, 1], values[1] = np.nan, np.inf
    hit[1, 2] = False
    shown = aov_view("depth", values, hit)
    assert shown.legend.endswith("; 3 pixels not finite: magenta")
    assert (shown.pixels == NON_FINITE_COLOR).all(axis=-1).tolist() == [[False, True, False], [True, True, False]]
    nothing = aov_view("normal", np.full((1, 1, 3), np.nan), np.ones((1, 1), bool))
    assert nothing.legend.startswith("nothing to show; 1 ")


def one_row(name, *values):
    rows = np.array([values], np.float64)
    return aov_view(name, rows, np.ones(rows.shape[:2], bool))


@pytest.mark.parametrize(
    ("depths", "middle", "says"),
    [
        ((-1.0, 0.0, 1.0), 0.5, "-1 (light) to 1 (dark)"),
        ((1.0, 100.0, 10000.0), 0.5, "by its logarithm, 1 (light) to 10000 (dark)"),
    ],
)
def test_depth_is_light_near_and_dark_far_and_states_its_range(depths, middle, says):
    shown = one_row("depth", *depths)
    assert shown.legend == says
    assert shown.pixels[0].tolist() == colormap_lookup(np.array([1.0, middle, 0.0])).tolist()


def test_directions_positions_uv_and_light_have_known_colours():
    assert one_row("normal", [-1.0, 0.0, 1.0]).pixels[0, 0].tolist() == [0, 128, 255]
    assert one_row("position", [1.0, 5.0, 7.0], [3.0, 5.0, 6.0]).pixels[0].tolist() == [[0, 0, 255], [255, 0, 0]]
    uv = one_row("uv", [0.0, 1.0], [0.2, 0.6], [0.1, 0.6])
    assert uv.pixels[0].tolist() == [[0, 255, 0], [255, 0, 0], [128, 0, 0]]
    assert uv.legend == "red 0 to 0.2, green 0.6 to 1"
    assert one_row("albedo", [0.0, 0.5, 1.0]).pixels[0, 0].tolist() == [0, 188, 255]
    assert one_row("diffuse", [0.0, 2.0, 4.0]).pixels[0, 0].tolist() == [0, 188, 255]
    assert one_row("diffuse", [0.0, 0.0, 0.0]).pixels[0, 0].tolist() == [0, 0, 0]


def test_a_file_is_shown_as_its_render(folder, capsys):
    assert main(["render", "s.toml"]) == 0
    assert main(["preview", "s.exr"]) == 0
    said = capsys.readouterr()
    assert said.err.startswith("s.png: diffuse: 0 to ") and said.out.endswith("s.png\n")
    aovs = caster.render(caster.load_scene("s.toml"))
    shown = aov_view("diffuse", aovs["diffuse"].astype(np.float32), aovs.hit)
    assert np.abs(read_image("s.png").astype(int) - shown.pixels).max() <= 1


def test_classes_have_the_colours_and_names_that_their_file_gives_them(folder, capsys):
    classes = np.array([[0, 1, 7], [1, 1, 0]], np.uint32)
    hit = np.array([[1, 1, 1], [1, 0, 1]], np.float32)
    about = {"classes": "0 agree, 1 tie", "class_colors": "0 #010203, 1 #ff0000"}
    caster.write_exr("v.exr", {"class.I": classes, "A": hit}, about)
    assert main(["preview", "v.exr"]) == 0
    assert capsys.readouterr().err == "v.png: class: agree 2, tie 2, 7 1\n"
    pixels = read_image("v.png").tolist()
    assert pixels[0][:2] == [[1, 2, 3], [255, 0, 0]] and pixels[0][2] == label_colors(np.array(7)).tolist()
    assert pixels[1][1] == [CHECKER_GREYS[0]] * 3


def test_an_aov_that_a_file_lacks_is_named(folder, capsys):
    assert main(["render", "s.toml", "--aov", "depth"]) == 0
    assert main(["preview", "s.exr", "--aov", "dept"]) == 2
    assert "no 'dept' in it, did you mean 'depth'? (it has hit, depth)" in capsys.readouterr().err
    caster.write_exr("o.exr", {"ratio.Y": np.ones((2, 2))})
    assert main(["preview", "o.exr"]) == 2
    assert "nothing to show" in capsys.readouterr().err


def test_the_sheet_of_the_readme_shows_the_scenes_that_there_are():
    """Made anew by: python docs/scenes.py"""
    with Image.open(ROOT / "docs/scenes.png") as image:
        shown = image.text["Description"].split(", ")
    assert sorted(shown) == sorted(path.stem for path in SHIPPED)
    assert (ROOT / "docs/scenes.png").stat().st_size < 1_000_000

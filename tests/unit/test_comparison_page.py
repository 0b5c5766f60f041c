"""`compare --html`: any two images, with measures that decide nothing."""

import importlib.util

import numpy as np
import OpenEXR
import pytest

from caster.image.exr import write_exr
from mitsuba_ref.__main__ import main
from mitsuba_ref.exr_compare import comparison_page
from mitsuba_ref.exr_compare.two_files import compare_exr

HEIGHT, WIDTH = 6, 9
AT = (4, 7)  # row, column of the pixel that differs


def foreign(**changes: float) -> dict[str, np.ndarray]:
    """An image of another renderer: names that nobody knows beside known ones. changes: of one pixel."""
    y, x = np.indices((HEIGHT, WIDTH)).astype(np.float32)
    made = {"R": 0.1 * x, "G": 0.1 * y, "B": 0.05 * x, "roughness": 0.2 + 0 * x, "View.Depth.Z": 2 + 0.1 * y}
    made |= {f"Light.{letter}": 0.3 * x for letter in "RGB"}
    made = {name: values.astype(np.float32) for name, values in made.items()}
    for name, change in changes.items():
        made[name][AT] += np.float32(change)
    return made


@pytest.fixture
def compared(tmp_path):
    def compare(ours, reference, **options):
        for name, channels in (("a", ours), ("b", reference)):
            OpenEXR.File({}, channels).write(str(tmp_path / f"{name}.exr"))
        return compare_exr(tmp_path / "a.exr", tmp_path / "b.exr", **options)

    return compare


@pytest.mark.parametrize("name", ["R", "roughness", "Light.G", "View.Depth.Z"])
def test_every_channel_of_two_files_of_another_program_is_compared(compared, name):
    assert compared(foreign(), foreign()).ok
    result = compared(foreign(**{name: 0.25}), foreign())
    assert result.exit_code == 1 and result.differing_pixels == 1, str(result)
    assert "left out" not in str(result)


def test_the_page_has_each_layer_and_states_measures_for_information(compared, tmp_path, capsys):
    ours, reference = foreign(roughness=0.5, R=0.25), foreign()
    result = compared(ours, reference, html=tmp_path / "page")
    found = dict(result.measures)
    assert found["roughness: largest difference"] == f"0.5 at ({AT[1]}, {AT[0]})"
    assert found["roughness: mean squared error"] == f"{0.25 / (HEIGHT * WIDTH):.3g}"
    assert found["diffuse: largest difference"] == f"0.25 at ({AT[1]}, {AT[0]})"
    assert "diffuse: FLIP, mean" in found and not any(what.startswith("depth") for what in found)  # which is equal
    assert "for information:" in str(result) and (tmp_path / "page/index.html").is_file()
    words = ["compare", *(str(tmp_path / f"{each}.exr") for each in "ab"), "--html", str(tmp_path / "page")]
    assert main(words) == 1
    address = (tmp_path / "page/index.html").as_uri()
    assert capsys.readouterr().out.endswith(f"report:     {address}\n")
    write_exr(tmp_path / "b.exr", {"R": np.zeros((2, 2), np.float32)})
    assert main(words) == 3 and not (tmp_path / "page/index.html").exists()  # not that of the earlier images


def test_the_page_of_another_program_is_not_replaced(compared, tmp_path, capsys):
    compared(foreign(), foreign())
    (tmp_path / "site").mkdir()
    (tmp_path / "site/index.html").write_text("<title>mine</title>")
    words = ["compare", *(str(tmp_path / f"{each}.exr") for each in "ab"), "--html", str(tmp_path / "site")]
    assert main(words) == 4 and "choose another folder" in capsys.readouterr().err
    assert (tmp_path / "site/index.html").read_text() == "<title>mine</title>"


def test_values_that_are_not_finite_are_no_part_of_a_measure(tmp_path):
    channels = {"R": np.array([[1.0, np.nan], [2.0, 3.0]], np.float32)}
    channels |= {"G": channels["R"], "B": channels["R"], "A": np.array([[1, 1], [1, 0]], np.float32)}
    other = channels | {"R": np.array([[1.5, 1.0], [2.0, 9.0]], np.float32)}
    for name, image in (("a", channels), ("b", other)):
        write_exr(tmp_path / f"{name}.exr", image)
    found = dict(compare_exr(tmp_path / "a.exr", tmp_path / "b.exr", html=tmp_path / "page").measures)
    assert found["diffuse: mean squared error"] == f"{0.25 / 6:.3g}"  # of the two pixels that both hit, finite
    assert found["diffuse: largest difference"] == "0.5 at (0, 0)"
    assert found["diffuse: FLIP, mean"] == "not computed: a value is not finite"


# ---- FLIP ----


def test_without_flip_the_way_to_it_is_stated(monkeypatch):
    monkeypatch.setattr(comparison_page, "FLIP_PROGRAM", "raise ImportError(\"No module named 'flip_evaluator'\")")
    grey = np.full((4, 4, 3), 0.5)
    assert comparison_page.flip(grey, grey) == "not computed; pip install flip-evaluator"


@pytest.mark.skipif(not importlib.util.find_spec("flip_evaluator"), reason="flip-evaluator is not installed")
def test_flip_is_0_for_equal_images_and_a_black_one_does_not_end_the_program():
    ramp = np.linspace(0.0, 1.0, 300).reshape(10, 10, 3)
    assert comparison_page.flip(ramp, ramp) == "0"
    assert 0.0 < float(comparison_page.flip(ramp, np.flip(ramp, 1))) < 1.0
    assert comparison_page.flip(0.0 * ramp, 0.0 * ramp).startswith("not computed: ")

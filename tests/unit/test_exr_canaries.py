"""Faulty images that other comparison tools have passed fail in `mitsuba-ref compare`, whatever the tolerances.

idiff of OpenImageIO 3.2.2 passes all those with NaN or inf, the renamed layer, and a second part that is all NaN; FLIP
and gates such as `abs(a - b).max() > tolerance` pass the NaN. Each canary is compared both ways round.
"""

from collections.abc import Callable

import numpy as np
import OpenEXR
import pytest

from caster.image.exr import NO_ID, write_exr
from caster.system.process import DIFFERENCES, MEANINGS, OK
from mitsuba_ref.__main__ import main

Channels = dict[str, np.ndarray]
NOT_COMPARABLE = 3

HEIGHT, WIDTH = 12, 16
MIDDLE, EDGE = (6, 8), (6, 3)  # (y, x): inside of the disk, and its leftmost pixel in that row
WIDE_OPEN = [f"--{name}=1e30" for name in ("depth-rtol", "normal-atol", "uv-atol", "color-rtol", "color-atol")]


def picture() -> Channels:
    """A disk that leans back a little."""
    y, x = np.indices((HEIGHT, WIDTH))
    hit = (x - 8) ** 2 + (y - 6) ** 2 <= 25
    assert hit[EDGE] and not hit[EDGE[0], EDGE[1] - 1]
    channels = {"A": hit, "depth.Z": np.where(hit, 2.0 + 0.01 * y, np.inf)}
    channels |= {"normal.X": 0.0 * hit, "normal.Y": 0.6 * hit, "normal.Z": 0.8 * hit}
    channels |= {"R": 0.3 * hit, "G": 0.4 * hit, "B": 0.5 * hit}
    channels |= {"position.X": x * hit, "position.Y": y * hit, "position.Z": -2.0 * hit}
    floats = {name: values.astype(np.float32) for name, values in channels.items()}
    return {**floats, "id.shape": np.where(hit, 0, NO_ID).astype(np.uint32)}


def canary(name: str, value: float, where: object = ...) -> Callable[[], Channels]:
    """A picture with some values of a channel replaced."""

    def make() -> Channels:
        made = picture()
        made[name][where] = value
        return made

    return make


def all_nan() -> Channels:
    return {name: a if a.dtype == np.uint32 else np.full_like(a, np.nan) for name, a in picture().items()}


def renamed_layer() -> Channels:
    return {name.replace("normal", "shading_normal"): values for name, values in picture().items()}


def other_size() -> Channels:
    return {name: values[:, 1:] for name, values in picture().items()}


def one_missed_edge_pixel() -> Channels:
    made = picture()
    for name, values in made.items():
        values[EDGE] = np.inf if name == "depth.Z" else NO_ID if name == "id.shape" else 0.0
    return made


SPOILT = ("A", "R", "depth.Z", "position.Z")
CANARIES = {
    "all NaN": (all_nan, DIFFERENCES),
    "one NaN in a normal": (canary("normal.X", np.nan, MIDDLE), DIFFERENCES),
    "one NaN where nothing is hit": (canary("normal.X", np.nan, (0, 0)), DIFFERENCES),
    "-inf against finite": (canary("normal.Z", -np.inf, MIDDLE), DIFFERENCES),
    "-inf against +inf": (canary("depth.Z", -np.inf, (0, 0)), DIFFERENCES),
    **{
        f"{value} in {name}": (canary(name, value, MIDDLE), DIFFERENCES)
        for name in SPOILT
        for value in (np.nan, np.inf)
    },
    "one missed edge pixel": (one_missed_edge_pixel, DIFFERENCES),
    "a renamed layer": (renamed_layer, NOT_COMPARABLE),
    "another size": (other_size, NOT_COMPARABLE),
}
ABOUT = {"ours": {"caster/version": "0"}, "foreign": {}}  # of files that say they are ours, and of those that do not


@pytest.mark.parametrize("about", ABOUT)
@pytest.mark.parametrize("name", CANARIES)
def test_a_canary_fails(tmp_path, capsys, name, about):
    make, code = CANARIES[name]
    write_exr(tmp_path / "good.exr", picture(), ABOUT[about])
    write_exr(tmp_path / "bad.exr", make(), ABOUT[about])
    for pair in (("good", "bad"), ("bad", "good")):
        assert main(["compare", *(str(tmp_path / f"{each}.exr") for each in pair), *WIDE_OPEN]) == code
        told = capsys.readouterr().out
        assert ("FAIL" if code == DIFFERENCES else "NOT COMPARABLE") in told and "PASS" not in told


@pytest.mark.parametrize("parts", [("good", "good"), ("good", "bad")])
def test_two_parts_that_hold_the_same_layers_never_pass(tmp_path, capsys, parts):
    """Which part is meant? It is a question, also where the first part is good."""
    pictures = {"good": picture(), "bad": all_nan()}
    made = [OpenEXR.Part({}, pictures[part], f"{i}.{part}") for i, part in enumerate(parts)]
    OpenEXR.File(made).write(str(tmp_path / "parts.exr"))
    write_exr(tmp_path / "good.exr", picture())
    for pair in (("good", "parts"), ("parts", "good"), ("parts", "parts")):
        names = [str(tmp_path / f"{each}.exr") for each in pair]
        assert main(["compare", *names, *WIDE_OPEN]) == NOT_COMPARABLE
        assert "may both be the depth: --map depth=0.good.depth.Z" in capsys.readouterr().err


def test_the_image_itself_passes(tmp_path, capsys):
    """A canary that dies of something else proves nothing."""
    for name in ("a", "b"):
        write_exr(tmp_path / f"{name}.exr", picture())
    assert main(["compare", str(tmp_path / "a.exr"), str(tmp_path / "b.exr")]) == OK
    assert "PASS" in capsys.readouterr().out and NOT_COMPARABLE in MEANINGS


def test_two_images_that_are_wrong_alike_fail_too(tmp_path):
    write_exr(tmp_path / "a.exr", all_nan())
    assert main(["compare", str(tmp_path / "a.exr"), str(tmp_path / "a.exr"), *WIDE_OPEN]) == DIFFERENCES

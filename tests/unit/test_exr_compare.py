"""`mitsuba-ref compare`: equal images pass, and no wrong one ever does."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from outputs import unfolded

from caster.description.errors import SceneError
from caster.image.exr import write_exr
from mitsuba_ref.__main__ import main
from mitsuba_ref.error_model.tolerances import DEPTH_RTOL
from mitsuba_ref.exr_compare.two_files import FileComparison, Tolerances, compare_exr

WIDTH, HEIGHT = 32, 24
EYE = (0.3, 0.4, 3.0)
CAMERA = {"type": "pinhole", "eye": EYE, "look_at": (*EYE[:2], 0.0), "fov": float(2.0 * np.degrees(np.arctan(0.5)))}
SCENE = {"caster/scene_json": json.dumps({"film": {"width": WIDTH, "height": HEIGHT}, "camera": CAMERA})}
NO_ID = 0xFFFFFFFF

Channels = dict[str, np.ndarray]


def directions() -> np.ndarray:
    """(h, w, 3) unit, float32 numbers: both witnesses get the very same rays."""
    x = (2 * (np.arange(WIDTH) + 0.5) / WIDTH - 1) * 0.5
    y = (1 - 2 * (np.arange(HEIGHT) + 0.5) / HEIGHT) * 0.5 * HEIGHT / WIDTH
    d = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), -1)
    return (d / np.linalg.norm(d, axis=-1, keepdims=True)).astype(np.float32)


def image(kind: type) -> Channels:
    """A sphere with a Lambert term, computed in the type `kind`."""
    o, d = np.array(EYE, np.float32).astype(kind), directions().astype(kind)
    centre, radius = np.array([0.1, -0.2, 0.05], np.float32).astype(kind), kind(0.75)
    with np.errstate(invalid="ignore"):
        oc = o - centre
        b = (oc * d).sum(-1)
        apart = oc - b[..., None] * d
        t = -b - np.sqrt(radius**2 - (apart**2).sum(-1))
        hit = np.isfinite(t)
        p = o + np.where(hit, t, 0)[..., None].astype(kind) * d
        n = ((p - centre) / radius).astype(kind)
        light = np.array([2, 3, 2], kind) - p
        square = (light * light).sum(-1)
        shade = np.maximum((n * light).sum(-1), 0) / (np.sqrt(square) * square) * kind(3.1)
    return channels(hit, t, p, n, shade, 0)


def channels(hit, t, p, n, shade, shape) -> Channels:
    made = {"A": hit.astype(np.float32), "depth.Z": np.where(hit, t, np.inf)}
    for c, axis in enumerate("XYZ"):
        made[f"position.{axis}"] = np.where(hit, p[..., c], 0)
        made[f"normal.{axis}"] = np.where(hit, n[..., c], 0)
    for k, colour in enumerate("RGB"):
        made[colour] = np.where(hit, shade * (k + 1), 0)
    made["id.shape"] = np.where(hit, shape, NO_ID).astype(np.uint32)
    return {name: a if a.dtype == np.uint32 else a.astype(np.float32) for name, a in made.items()}


EXACT, ROUNDED = image(np.float64), image(np.float32)
HIT = EXACT["A"] == 1
INSIDE = (14, 15)  # row, column of a pixel on the ball


def copy(image: Channels) -> Channels:
    return {name: values.copy() for name, values in image.items()}


def compared(folder: Path, ours: Channels, reference: Channels = ROUNDED, *args, about=SCENE) -> FileComparison:
    write_exr(folder / "ours.exr", ours, about)
    write_exr(folder / "reference.exr", reference, about)
    return compare_exr(folder / "ours.exr", folder / "reference.exr", *args)


def group(result: FileComparison, name: str):
    return next(entry for entry in result.groups if entry.name == name)


# ---- what passes ----


def test_float32_arithmetic_on_the_same_rays_passes_within_the_derived_bounds(tmp_path):
    result = compared(tmp_path, EXACT)
    assert result.ok, str(result)
    assert group(result, "depth").bound == "K*u*S/cos"
    assert 0 < group(result, "depth").worst.ratio < 1
    assert not np.array_equal(EXACT["depth.Z"], ROUNDED["depth.Z"])


def test_the_derived_bound_is_a_few_roundings_and_no_more(tmp_path):
    """Power: a hundred-thousandth of the depth is found nearly everywhere."""
    ours = copy(EXACT)
    ours["depth.Z"] = (ours["depth.Z"].astype(np.float64) * (1 + 1e-5)).astype(np.float32)
    result = compared(tmp_path, ours)
    assert result.exit_code == 1
    assert group(result, "depth").differ > 0.9 * HIT.sum()


@pytest.mark.parametrize("scene_json", ["", "{", "[]", "3", '{"camera": 1}', '{"camera": {"eye": "here"}}'])
def test_a_foreign_scene_text_means_the_plain_bound(tmp_path, scene_json):
    write_exr(tmp_path / "a.exr", EXACT, {"scene_json": scene_json})
    result = compare_exr(tmp_path / "a.exr", tmp_path / "a.exr")
    assert result.ok and f"{DEPTH_RTOL:.2g} relative" in group(result, "depth").bound


def test_a_hit_near_the_worlds_origin_is_not_held_to_its_own_tiny_size(tmp_path):
    ours = copy(EXACT)
    reference = copy(EXACT)
    for axis in "XYZ":
        reference[f"position.{axis}"][INSIDE] = 1e-9
        ours[f"position.{axis}"][INSIDE] = 2e-9
    assert compared(tmp_path, ours, reference).ok


# ---- canaries: each must fail ----


def with_value(name: str, value: float, where=INSIDE) -> Channels:
    ours = copy(EXACT)
    ours[name][where] = value
    return ours


MISS = tuple(int(i) for i in np.argwhere(~HIT)[0])
FLOATS = [name for name in EXACT if name != "id.shape"]
NO_LIMIT = Tolerances(**dict.fromkeys(("depth_rtol", "normal_atol", "uv_atol", "color_rtol", "color_atol"), 1e30))
EVERY_PIXEL = replace(NO_LIMIT, max_pixels=10**6)


@pytest.mark.parametrize("provenance", [SCENE, {}], ids=["ours", "foreign"])
def test_values_that_are_not_finite_fail_whatever_the_tolerances_also_where_both_files_agree(tmp_path, provenance):
    """The depth of a miss is the one infinity that means something.

    idiff of OpenImageIO 3.2.2 passes NaN and inf; FLIP and gates such as `abs(a - b).max() > tolerance` pass NaN.
    """
    places = (np.nan, INSIDE), (np.inf, INSIDE), (-np.inf, INSIDE), (np.nan, MISS), (-np.inf, MISS)
    images = [with_value(name, value, where) for name in FLOATS for value, where in places]
    images.append({n: a if n == "id.shape" else np.full_like(a, np.nan) for n, a in EXACT.items()})
    write_exr(tmp_path / "good.exr", EXACT, provenance)
    for wrong in images:
        write_exr(tmp_path / "bad.exr", wrong, provenance)
        for pair in (("good", "bad"), ("bad", "good"), ("bad", "bad")):
            result = compare_exr(*(tmp_path / f"{each}.exr" for each in pair), EVERY_PIXEL)
            assert result.exit_code == 1 and "FAIL" in str(result), pair


def test_one_missed_pixel_fails_and_is_named(tmp_path):
    ours = copy(EXACT)
    for name, values in ours.items():
        values[INSIDE] = {"depth.Z": np.inf, "id.shape": NO_ID}.get(name, 0)
    result = compared(tmp_path, ours)
    assert result.exit_code == 1 and result.differing_pixels == 1
    assert (group(result, "hit").differ, group(result, "hit").worst.x, group(result, "hit").worst.y) == (1, 15, 14)
    assert group(result, "depth").differ == group(result, "depth").non_finite == 0  # counted once, as a hit
    assert result.hit_ours == HIT.sum() - 1 and result.hit_either == HIT.sum()
    assert f"FAIL  hit: 1 of {HIT.sum()} hit pixels" in str(result) and "(15, 14)" in str(result)
    assert compared(tmp_path, ours, EXACT, Tolerances(max_pixels=1)).ok
    assert (
        compared(tmp_path, ours, EXACT, NO_LIMIT).exit_code == compared(tmp_path, EXACT, ours, NO_LIMIT).exit_code == 1
    )


def test_a_value_in_a_missed_pixel_is_compared_too(tmp_path):
    assert compared(tmp_path, with_value("R", 0.25, MISS)).exit_code == 1
    assert compared(tmp_path, with_value("position.X", 0.25, MISS)).exit_code == 1


def each(names: list[str], change):
    """A fault of some channels: change(values) of each."""
    return lambda image: image.update({name: change(image[name]) for name in names})


def at(name: str, change):
    """A fault of one value."""
    return lambda image: image[name].__setitem__(INSIDE, change(image[name][INSIDE]))


NORMALS = [f"normal.{axis}" for axis in "XYZ"]
FAULTS = {
    "normals of another length": each(NORMALS, lambda n: n * np.float32(1.001)),
    "shifted by a pixel": each(list(EXACT), lambda a: np.roll(a, 1, axis=1)),
    "a radius 5e-6 too large": each(["depth.Z"], lambda depth: depth + np.float32(5e-6) * (EXACT["id.shape"] == 0)),
    "swapped colours": lambda image: image.update({"R": image["B"], "B": image["R"]}),
    "one wrong id": at("id.shape", lambda _: 1),
    "one half covered pixel": at("A", lambda _: 0.5),
    "a brighter pixel": at("G", lambda value: value * np.float32(1.0001)),
}


@pytest.mark.parametrize("provenance", [SCENE, {}], ids=["derived", "plain"])
def test_a_planted_fault_fails(tmp_path, provenance):
    for fault, change in FAULTS.items():
        ours = copy(EXACT)
        change(ours)
        result = compared(tmp_path, ours, EXACT, about=provenance)
        assert result.exit_code == 1 and "FAIL" in str(result), (fault, str(result))


def test_one_bright_pixel_does_not_loosen_the_others(tmp_path):
    ours, reference = copy(EXACT), copy(EXACT)
    for image in (ours, reference):
        image["R"][INSIDE] = 1e30
    ours["R"][INSIDE[0], INSIDE[1] + 3] *= np.float32(1.001)
    assert compared(tmp_path, ours, reference).exit_code == 1


# ---- not comparable ----


def test_a_missing_or_extra_channel_is_not_comparable_unless_left_out(tmp_path):
    less = {name: values for name, values in EXACT.items() if not name.startswith("normal")}
    for ours, reference in ((less, EXACT), (EXACT, less)):
        assert compared(tmp_path, ours, reference).exit_code == 3
        for ignore in (("normal",), ("normal.*",), NORMALS):
            result = compared(tmp_path, ours, reference, Tolerances(ignore=ignore))
            assert result.ok and result.ignored == tuple(NORMALS)
            assert "not compared, by --ignore: normal.X, normal.Y, normal.Z" in str(result)


def test_another_data_window_is_not_comparable(tmp_path):
    write_exr(tmp_path / "a.exr", EXACT)
    write_exr(tmp_path / "b.exr", EXACT, data_window=(1, 0, 33, 24))
    result = compare_exr(tmp_path / "a.exr", tmp_path / "b.exr")
    assert result.exit_code == 3 and "data window: ours shows pixels (0, 0, 32, 24)" in str(result)


def test_ids_stored_as_floats_are_not_comparable(tmp_path):
    ours = copy(EXACT)
    ours["id.shape"] = ours["id.shape"].astype(np.float32)
    result = compared(tmp_path, ours, EXACT)
    assert result.exit_code == 3 and "id.shape: ours holds float32, the reference uint32" in str(result)


# ---- nothing hit ----


def test_two_images_that_hit_nothing_are_nothing_to_compare(tmp_path):
    flat, vectors = np.zeros((4, 4)), np.zeros((4, 4, 3))
    empty = channels(flat > 0, flat, vectors, vectors, flat, flat)
    result = compared(tmp_path, empty, empty)
    assert result.exit_code == 5 and not result.ok and "EMPTY" in str(result)
    broken = copy(empty)
    broken["normal.X"][1, 2] = np.nan
    assert compared(tmp_path, broken, empty).exit_code == 1
    assert compared(tmp_path, EXACT, {n: np.zeros_like(a) for n, a in EXACT.items()}).exit_code == 1
    black = {name: flat for name in "RGB"}  # no mask: whatever both failed to render agrees
    assert compared(tmp_path, black, black).exit_code == 5


def test_without_any_channel_of_hits_every_pixel_counts(tmp_path):
    normals = {name: EXACT[name] for name in NORMALS}
    result = compared(tmp_path, normals, normals)
    assert result.ok and result.hit_either == HIT.size and "hits unknown" in str(result)
    wrong = copy(normals)
    wrong["normal.Y"][MISS] = 1
    assert compared(tmp_path, wrong, normals).exit_code == 1


# ---- tolerances that are asked for ----


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("depth.Z", {"depth_rtol": 2e-3}),
        ("position.Z", {"depth_rtol": 2e-3}),
        ("normal.Z", {"normal_atol": 2e-3}),
        ("R", {"color_rtol": 2e-3}),
        ("R", {"color_atol": 2e-3}),
    ],
)
def test_a_stated_tolerance_replaces_the_bound(tmp_path, name, option):
    ours = copy(EXACT)
    ours[name][INSIDE] *= np.float32(1.001)
    assert compared(tmp_path, ours, EXACT).exit_code == 1
    result = compared(tmp_path, ours, EXACT, Tolerances(**option))
    assert result.ok and any("as given" in g.bound for g in result.groups)
    assert compared(tmp_path, ours, EXACT, Tolerances(**dict.fromkeys(option, 0.0))).exit_code == 1


def test_max_pixels_counts_each_pixel_once(tmp_path):
    ours = with_value("normal.X", 0.5)
    ours["depth.Z"][INSIDE] = 1.0
    ours["G"][INSIDE[0], INSIDE[1] + 1] = 5.0
    result = compared(tmp_path, ours, EXACT, Tolerances(max_pixels=1))
    assert result.exit_code == 1 and result.differing_pixels == 2
    passed = compared(tmp_path, ours, EXACT, Tolerances(max_pixels=2))
    assert passed.ok and "PASS  2 pixels differ, 2 may" in str(passed)


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_a_tolerance_that_is_no_tolerance_is_an_error(value):
    for option in ("depth_rtol", "normal_atol", "uv_atol", "color_rtol", "color_atol", "max_pixels"):
        with pytest.raises(SceneError, match=f"--{option.replace('_', '-')}: expected a number >= 0"):
            Tolerances(**{option: value})


def test_leaving_out_a_channel_of_neither_file_is_an_error_with_a_suggestion(tmp_path):
    with pytest.raises(SceneError, match=r"--ignore norml: .*did you mean 'normal'\?"):
        compared(tmp_path, EXACT, EXACT, Tolerances(ignore=("norml",)))


def test_unlisted_channels_and_uv_are_compared_too(tmp_path):
    extra = {"uv.U": EXACT["R"], "uv.V": EXACT["G"], "roughness": EXACT["B"], "id.light": EXACT["id.shape"]}
    ours, reference = copy(EXACT | extra), EXACT | extra
    assert compared(tmp_path, ours, reference).ok
    for name, value in (("uv.V", 0.7), ("roughness", 0.7), ("id.light", 9)):
        changed = copy(ours)
        changed[name][INSIDE] = value
        result = compared(tmp_path, changed, reference)
        assert result.exit_code == 1 and result.differing_pixels == 1, name


# ---- what is said ----


def test_a_failure_states_how_many_how_far_where_on_the_film_and_what_next(tmp_path):
    window = {"data_window": (100, 200, 132, 224), "display_window": (0, 0, 640, 480)}
    about = SCENE | {"caster/scene": "scenes/two balls.toml"}
    write_exr(tmp_path / "ours.exr", with_value("depth.Z", 3.25), about, **window)
    write_exr(tmp_path / "reference.exr", EXACT, SCENE, **window)
    result = compare_exr(tmp_path / "ours.exr", tmp_path / "reference.exr")
    expected = f"FAIL  depth: 1 of {HIT.sum()} hit pixels"
    line = next(line for line in result.messages if line.startswith(expected))
    assert "worst" in line and "at (115, 214) in depth.Z: ours 3.25, reference 2." in line
    assert "      replay: mitsuba-ref probe 'scenes/two balls.toml' 115 214" in result.messages


def test_files_that_name_different_scenes_are_compared_only_on_demand(tmp_path):
    """A reference of the scene as it was last week proves nothing about the scene of today."""
    a, b = tmp_path / "a.exr", tmp_path / "b.exr"
    write_exr(a, EXACT, {"scene_sha256": "1"})
    write_exr(b, EXACT, {"scene_sha256": "2"})
    refused = compare_exr(a, b)
    assert refused.exit_code == 3 and "different scenes" in str(refused)
    write_exr(b, {name: values[:, 1:] for name, values in EXACT.items()}, {"scene_sha256": "2"})  # of the film, too
    other_size = str(compare_exr(a, b, Tolerances(other_scene=True)))
    assert other_size == str(compare_exr(a, b)) and "size: ours is 32 x 24, the reference 31 x 24" in other_size
    write_exr(b, EXACT, {"scene_sha256": "2"})
    assert compare_exr(a, b, Tolerances(other_scene=True)).exit_code == 0


def test_halves_get_the_bound_of_a_half_as_its_text_says(tmp_path):
    write_exr(tmp_path / "a.exr", EXACT)
    for factor, code in ((1.0, 0), (1 + 2.0**-8, 1)):
        halves = {name: (a * factor).astype(np.float16) if name in FLOATS else a for name, a in EXACT.items()}
        halves["A"] = EXACT["A"].astype(np.float16)
        OpenEXR.File({}, halves).write(str(tmp_path / "b.exr"))
        result = compare_exr(tmp_path / "a.exr", tmp_path / "b.exr")
        assert result.exit_code == code, str(result)
        assert group(result, "depth").bound.endswith("+ half")


def test_the_json_is_strict_and_holds_the_counts(tmp_path):
    ours = with_value("normal.X", np.nan)
    ours["id.shape"][INSIDE] = 1
    result = compared(tmp_path, ours)
    told = json.loads(json.dumps(result.model_dump(mode="json"), allow_nan=False))
    assert (told["ok"], told["exit_code"], told["differing_pixels"]) == (False, 1, 1)
    by_name = {entry["name"]: entry for entry in told["groups"]}
    assert by_name["normal"]["non_finite"] == 1 and by_name["normal"]["worst"]["ours"] == "nan"
    assert by_name["shape_id"]["worst"]["ratio"] == "inf" and by_name["shape_id"]["worst"]["x"] == 15
    other = compared(tmp_path, {name.replace("A", "a"): values for name, values in EXACT.items()})
    json.dumps(other.model_dump(mode="json"), allow_nan=False)


# ---- two folders ----


def test_files_of_the_same_names_are_compared_and_the_highest_code_counts(tmp_path, capsys):
    folders = tmp_path / "ours", tmp_path / "references"

    def run(*more):
        code = main(["compare", *map(str, folders), *more])
        return code, capsys.readouterr().out

    for folder in folders:
        folder.mkdir()
        for name in ("a", "b"):
            write_exr(folder / f"{name}.exr", EXACT, SCENE)
    write_exr(folders[0] / "new.exr", EXACT)
    code, out = run()
    assert code == 0 and "PASS  a.exr  " in out and "2 images: 2 pass, 0 fail" in out
    assert "not compared, without a reference: new.exr" in out
    write_exr(folders[0] / "b.exr", with_value("depth.Z", 3.25), SCENE)
    code, out = run()
    assert code == 1 and "PASS  a.exr" in out and "FAIL  b.exr  depth: 1 of " in out and "(15, 14)" in out
    assert run("--max-pixels", "1")[0] == 0 and run("--ignore", "depth")[0] == 0
    (folders[0] / "a.exr").unlink()
    code, out = run()
    assert (
        code == 4
        and "FAIL  a.exr" in out
        and "No such file" in unfolded(out)
        and "FAIL  b.exr  depth" in out
        and "2 images: 0 pass, 2 fail" in out
    )
    assert [each["exit_code"] for each in json.loads(run("--json")[1])] == [4, 1]
    (folders[1] / "a.exr").unlink()
    (folders[1] / "left").mkdir()
    write_exr(folders[1] / "left/C.EXR", EXACT, SCENE)
    code, out = run("--max-pixels", "1")
    assert code == 4 and "PASS  b.exr" in out and "FAIL  left/C.EXR" in out and "No such file" in unfolded(out)
    assert main(["compare", *map(str, folders), "--html", str(tmp_path / "page")]) == 2


@pytest.mark.parametrize(("codes", "code"), [((0, 0), 0), ((0, 5), 5), ((1, 5), 1), ((5, 5), 5), ((1, 4), 4)])
def test_nothing_to_compare_hides_no_other_failure_of_a_folder(tmp_path, monkeypatch, codes, code):
    made = {f"{i}.exr": each for i, each in enumerate(codes)}
    for name in made:
        (tmp_path / name).touch()

    def compared_as(ours, reference, *_, **__):
        return FileComparison(ours=ours, reference=reference, exit_code=made[Path(ours).name])

    monkeypatch.setattr("mitsuba_ref.cli.exr_comparison.compare_exr", compared_as)
    assert main(["compare", str(tmp_path), str(tmp_path), "--json"]) == code

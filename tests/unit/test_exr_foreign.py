"""`mitsuba-ref compare` with files of other programs: names, depths and misses are told by evidence, and stated."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import caster
from caster import __version__
from caster.description.errors import SceneError
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import write_exr
from mitsuba_ref.exr_compare.depth_conventions import ViewRays
from mitsuba_ref.exr_compare.two_files import FileComparison, Reading, Tolerances, compare_exr

Channels = dict[str, np.ndarray]
FLT_MAX = float(np.finfo(np.float32).max)


def scene_of(**camera: object) -> caster.Scene:
    wide = caster.Pinhole(**({"eye": (0.1, 0.2, 5), "look_at": (0, 0, 0), "fov": 60} | camera))
    shapes = [caster.Sphere(center=(0.3, 0, 0)), caster.Cube(to_world=[{"translate": [-2, 0.2, -1]}])]
    return caster.Scene(film=caster.Film(width=32, height=24), camera=wide, shapes=shapes)


SCENE = scene_of()
VIEW = ViewRays.of(SCENE)


@pytest.fixture(scope="module")
def ours() -> Channels:
    """What our caster gives, as an EXR file has it."""
    given = aovs_to_channels(caster.render(SCENE, aovs=("depth", "normal", "shading_normal", "position")))
    assert 150 < given["A"].sum() < given["A"].size - 150
    return {name: values.astype(np.float32) for name, values in given.items()}


def named(ours: Channels, depth: str = "", miss: float = np.inf, **layers: str) -> Channels:
    """Some of it by other names: depth, with the value of a miss, and layers such as normal=Ng, or normal=N:rgb."""
    made = {}
    if depth:
        made[depth] = np.where(ours["A"] == 1, ours["depth.Z"], np.float32(miss))
    for layer, name in layers.items():
        name, _, letters = name.partition(":")
        for letter, axis in zip(letters or "XYZ", "XYZ", strict=True):
            made[f"{name}.{letter}"] = ours[f"{layer}.{axis}"]
    return made


def compared(folder: Path, ours: Channels, theirs: Channels, **reading: object) -> FileComparison:
    """Our file, with its provenance, against theirs, without any."""
    write_exr(folder / "ours.exr", ours, provenance(SCENE, __version__))
    OpenEXR.File({}, {name: np.ascontiguousarray(a) for name, a in theirs.items()}).write(str(folder / "theirs.exr"))
    return compare_exr(folder / "ours.exr", folder / "theirs.exr", reading=Reading(**reading))


def text(result: FileComparison) -> str:
    return result.format_table()


# ---- names ----

PROGRAMS = {
    "Mitsuba, as we export": {"depth": "depth.T", "normal": "normal", "shading_normal": "shading_normal"},
    "Mitsuba, as it is documented": {"depth": "dd.y.T", "shading_normal": "nn", "position": "position"},
    "Blender": {
        "depth": "ViewLayer.Depth.Z",
        "shading_normal": "ViewLayer.Normal",
        "position": "ViewLayer.Position",
        "miss": 1e10,
    },
    "Arnold": {"depth": "Z", "shading_normal": "N:RGB", "position": "P:RGB"},
    "RenderMan": {"depth": "z", "normal": "Ngn:xyz", "shading_normal": "Nn:xyz", "miss": FLT_MAX},
}


@pytest.mark.parametrize("program", PROGRAMS)
def test_the_names_of_other_programs_are_recognised_and_stated(tmp_path, ours, program):
    names = PROGRAMS[program]
    result = compared(tmp_path, ours, named(ours, **names))
    assert result.ok, text(result)
    groups = {group.name for group in result.groups}
    assert groups == {"hit", *names} - {"miss"}
    if names["depth"] != "depth.Z":
        assert f"{names['depth']} is depth.Z" in text(result)
    assert "the distance from the eye along the ray" in text(result)
    assert "not compared, since only one file has them: A" in text(result)


def test_what_is_not_known_is_left_out_and_stated(tmp_path, ours):
    theirs = named(ours, depth="depth.T") | {"Cryptomatte00.R": ours["A"]}
    result = compared(tmp_path, ours, theirs)
    assert result.ok and "not recognised, and left out: Cryptomatte00.R (--map OURS=THEIRS)" in text(result)


def test_two_channels_that_may_be_the_same_are_a_question_not_a_guess(tmp_path, ours):
    theirs = named(ours, depth="ViewLayer.Depth.Z") | named(ours, depth="Close.Depth.Z")
    result = compared(tmp_path, ours, theirs)
    assert result.exit_code == 3
    assert "Close.Depth.Z and ViewLayer.Depth.Z may both be the depth: --map depth=Close.Depth.Z" in text(result)
    said = compared(tmp_path, ours, theirs, maps=("depth=ViewLayer.Depth.Z",))
    assert said.ok, text(said)


def test_any_name_can_be_mapped(tmp_path, ours):
    theirs = named(ours, depth="range", normal="facing:xyz")
    result = compared(tmp_path, ours, theirs, maps=("depth=range", "normal=facing"))
    assert result.ok and {group.name for group in result.groups} == {"hit", "depth", "normal"}, text(result)
    single = ("depth=range", "normal.X=facing.x", "normal.Y=facing.y", "normal.Z=facing.z")
    assert compared(tmp_path, ours, theirs, maps=single).ok


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("depth", "expected OURS=THEIRS"),
        ("dept=Z", "unknown, did you mean 'depth'?"),
        ("depth=range", "neither file has 'range'"),
    ],
)
def test_a_map_that_maps_nothing_is_an_error(tmp_path, ours, option, says):
    with pytest.raises(SceneError) as caught:
        compared(tmp_path, ours, named(ours, depth="Z"), maps=(option,))
    assert says in str(caught.value)


# ---- misses ----


@pytest.mark.parametrize(
    ("miss", "name"),
    [(0.0, "0"), (np.inf, "inf"), (1e10, "1e10"), (FLT_MAX, "FLT_MAX"), (65504.0, "65504"), (-1.0, "-1")],
)
def test_the_value_of_a_miss_is_detected_and_stated(tmp_path, ours, miss, name):
    result = compared(tmp_path, ours, named(ours, depth="Z", miss=miss))
    misses = int((ours["A"] == 0).sum())
    assert result.ok and f"a miss is depth {name} ({misses} pixels)" in text(result)


def test_two_values_of_a_miss_are_a_question(tmp_path, ours):
    theirs = named(ours, depth="Z", miss=0.0)
    theirs["Z"][0, 0] = 1e10
    result = compared(tmp_path, ours, theirs)
    assert result.exit_code == 3 and "which of them is a miss? --miss 0" in text(result)
    told = compared(tmp_path, ours, theirs, miss="0")
    assert told.exit_code == 1 and "as given" in text(told)  # 1e10 then is a depth, and wrong


def test_what_is_no_number_is_an_error():
    with pytest.raises(SceneError, match="--miss 'sky': expected a number"):
        Reading(miss="sky")
    with pytest.raises(SceneError, match="--near: expected a number > 0"):
        Reading(near=-1.0)


def test_a_pixel_that_only_they_miss_fails(tmp_path, ours):
    theirs = named(ours, depth="Z", miss=1e10)
    y, x = np.argwhere(ours["A"] == 1)[50]
    theirs["Z"][y, x] = 1e10
    result = compared(tmp_path, ours, theirs)
    assert result.exit_code == 1 and f"({x}, {y})" in text(result)


# ---- what depth counts ----


def along_z(ours: Channels) -> Channels:
    return {"Z": np.where(ours["A"] == 1, ours["depth.Z"] * VIEW.cosine, 1e10).astype(np.float32)}


def test_depth_along_z_is_seen_by_the_camera_of_our_file_and_stated(tmp_path, ours):
    result = compared(tmp_path, ours, along_z(ours))
    assert result.ok, text(result)
    assert "depth is z along the view axis" in text(result) and "100 % as z" in text(result)


def test_depth_from_the_near_plane_is_detected(tmp_path, ours):
    near = scene_of(near=1.0)
    depth = np.where(ours["A"] == 1, ours["depth.Z"] - ViewRays.of(near).near, 0).astype(np.float32)
    result = compared(tmp_path, ours, {"depth.T": depth}, scene=near)
    assert result.ok and "the distance from the near plane along the ray" in text(result), text(result)


def test_a_near_plane_that_the_camera_does_not_have_may_be_given(tmp_path, ours):
    depth = np.where(ours["A"] == 1, ours["depth.Z"] - ViewRays.of(SCENE, 0.5).near, 0).astype(np.float32)
    result = compared(tmp_path, ours, {"depth.T": depth}, near=0.5)
    assert result.ok and "the distance from the near plane along the ray" in text(result), text(result)
    assert compared(tmp_path, ours, {"depth.T": depth}).exit_code == 1


def test_parallel_rays_along_the_axis_leave_nothing_to_request(tmp_path):
    along = caster.Orthographic(eye=(0.1, 0.2, 5), look_at=(0, 0, 0), width=4)
    scene = SCENE.model_copy(update={"camera": along})
    given = {n: a.astype(np.float32) for n, a in aovs_to_channels(caster.render(scene, aovs=("depth",))).items()}
    write_exr(tmp_path / "a.exr", given, provenance(scene, __version__))
    OpenEXR.File({}, named(given, depth="Z", miss=0.0)).write(str(tmp_path / "b.exr"))
    assert compare_exr(tmp_path / "a.exr", tmp_path / "b.exr").ok


def test_a_mask_that_covers_everything_is_left_out(tmp_path, ours):
    theirs = named(ours, depth="Z", miss=1e10) | {"A": np.ones_like(ours["A"])}
    result = compared(tmp_path, ours, theirs)
    assert result.ok and "A covers everything, and is left out" in text(result), text(result)


def test_an_image_is_not_taken_for_our_diffuse(tmp_path, ours):
    lit = ours | dict.fromkeys("RGB", ours["A"])
    theirs = named(ours, depth="Z") | dict.fromkeys("RGB", 0.5 * ours["A"])
    result = compared(tmp_path, lit, theirs)
    assert result.ok and "not recognised, and left out: B, G, R" in text(result)
    asked = compared(tmp_path, lit, theirs, maps=("R=R", "G=G", "B=B"))
    assert asked.exit_code == 1 and "FAIL  diffuse" in text(asked)


def test_without_a_camera_z_cannot_be_recognised_and_fails_with_the_way_out(tmp_path, ours):
    write_exr(tmp_path / "a.exr", ours, {"caster/version": "0"})
    OpenEXR.File({}, along_z(ours)).write(str(tmp_path / "b.exr"))
    result = compare_exr(tmp_path / "a.exr", tmp_path / "b.exr")
    assert result.exit_code == 1 and "z needs a camera: --scene SCENE" in text(result)
    assert compare_exr(tmp_path / "a.exr", tmp_path / "b.exr", reading=Reading(scene=SCENE)).ok
    asked = compare_exr(tmp_path / "a.exr", tmp_path / "b.exr", reading=Reading(depth="z"))
    assert asked.exit_code == 3 and "--depth z needs the camera: --scene SCENE" in text(asked)


def test_a_convention_may_be_demanded_and_then_a_wrong_one_fails(tmp_path, ours):
    assert compared(tmp_path, ours, along_z(ours), depth="z").ok
    result = compared(tmp_path, ours, along_z(ours), depth="distance")
    assert result.exit_code == 1 and "along the ray, as given" in text(result)


def test_a_file_of_ours_is_never_converted(tmp_path, ours):
    """Depth along z in a file that says what its depth is, is a fault."""
    wrong = ours | {"depth.Z": along_z(ours)["Z"]}
    wrong["depth.Z"][ours["A"] == 0] = np.inf
    for name, channels in (("a", ours), ("b", wrong)):
        write_exr(tmp_path / f"{name}.exr", channels, provenance(SCENE, __version__))
    result = compare_exr(tmp_path / "a.exr", tmp_path / "b.exr")
    assert result.exit_code == 1 and result.stated == ()


def test_a_depth_of_no_convention_fails_and_states_it(tmp_path, ours):
    theirs = {"Z": np.where(ours["A"] == 1, ours["depth.Z"] * 1.01, 0).astype(np.float32)}
    result = compared(tmp_path, ours, theirs)
    assert result.exit_code == 1 and "no convention fits (0 % as distance, 0 % as z" in text(result)


def test_where_two_conventions_fit_it_is_a_question(tmp_path):
    """A view so narrow that z and distance are nearly the same, and a picture that is not exact enough to tell."""
    narrow = scene_of(fov=1.0, eye=(0.3, 0, 500.0), look_at=(0.3, 0, 0))
    given = {n: a.astype(np.float32) for n, a in aovs_to_channels(caster.render(narrow, aovs=("depth",))).items()}
    theirs = {"Z": np.where(given["A"] == 1, given["depth.Z"] * np.float32(1.0001), 0).astype(np.float32)}
    write_exr(tmp_path / "a.exr", given, provenance(narrow, __version__))
    OpenEXR.File({}, theirs).write(str(tmp_path / "b.exr"))
    result = compare_exr(tmp_path / "a.exr", tmp_path / "b.exr")
    assert result.exit_code == 3 and "the numbers fit both" in text(result) and "--depth" in text(result)


def test_two_foreign_files_are_taken_as_they_are_and_that_is_stated(tmp_path, ours):
    for name in "ab":
        OpenEXR.File({}, named(ours, depth="ViewLayer.Depth.Z", miss=1e10)).write(str(tmp_path / f"{name}.exr"))
    result = compare_exr(tmp_path / "a.exr", tmp_path / "b.exr")
    assert result.ok and "neither file states its convention (--depth)" in text(result)


# ---- halves ----


@pytest.mark.parametrize(("factor", "code"), [(1.0, 0), (1 + 2.0**-8, 1)])
def test_halves_of_other_programs_get_the_bound_of_a_half(tmp_path, ours, factor, code):
    theirs = named(ours, depth="Z", normal="Ng")
    theirs = {name: (a * np.float32(factor)).astype(np.float16) for name, a in theirs.items()}
    result = compared(tmp_path, ours, theirs)
    assert result.exit_code == code, text(result)
    assert "the reference holds halves" in text(result)


def test_tolerances_still_count(tmp_path, ours):
    theirs = named(ours, depth="Z")
    theirs["Z"] = theirs["Z"] * np.float32(1.0001)
    write_exr(tmp_path / "a.exr", ours, provenance(SCENE, __version__))
    OpenEXR.File({}, theirs).write(str(tmp_path / "b.exr"))
    assert compare_exr(tmp_path / "a.exr", tmp_path / "b.exr").exit_code == 1
    assert compare_exr(tmp_path / "a.exr", tmp_path / "b.exr", Tolerances(depth_rtol=2e-4)).ok

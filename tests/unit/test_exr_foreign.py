"""`mitsuba-ref compare` with files of other programs: names are recognised, and options state what depth means."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import caster
from caster import __version__
from caster.description.errors import SceneError
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import write_exr
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import camera_axes
from mitsuba_ref.exr_compare.conventions import Unclear
from mitsuba_ref.exr_compare.two_files import FileComparison, Reading, compare_exr

Channels = dict[str, np.ndarray]
FLT_MAX = float(np.finfo(np.float32).max)


def scene_of(**camera: object) -> caster.Scene:
    wide = caster.Pinhole(**({"eye": (0.1, 0.2, 5), "look_at": (0, 0, 0), "fov": 60} | camera))
    shapes = [caster.Sphere(center=(0.3, 0, 0)), caster.Cube(to_world=[{"translate": [-2, 0.2, -1]}])]
    return caster.Scene(film=caster.Film(width=32, height=24), camera=wide, shapes=shapes)


SCENE = scene_of()


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
    miss = {np.inf: None, 1e10: "1e10", FLT_MAX: "FLT_MAX"}[names.get("miss", np.inf)]
    result = compared(tmp_path, ours, named(ours, **names), miss=miss)
    assert result.ok, str(result)
    groups = {group.name for group in result.groups}
    assert groups == {"hit", *names} - {"miss"}
    if names["depth"] != "depth.Z":
        assert f"{names['depth']} is depth.Z" in str(result)
    assert "the distance from the eye along the ray" in str(result)
    assert "not compared, since only one file has them: A" in str(result)


def test_parts_are_read_as_one_image_and_stated(tmp_path, ours):
    """As Arnold writes them: normals in R, G and B of a part."""
    normals = {letter: ours[f"shading_normal.{axis}"] for letter, axis in zip("RGB", "XYZ", strict=True)}
    parts = {"RGBA": {"A": ours["A"]}, "Z": named(ours, depth="Z"), "N": normals}
    write_exr(tmp_path / "ours.exr", ours, provenance(SCENE, __version__))
    OpenEXR.File([OpenEXR.Part({}, channels, name) for name, channels in parts.items()]).write(str(tmp_path / "p.exr"))
    result = compare_exr(tmp_path / "ours.exr", tmp_path / "p.exr")
    assert result.ok and {group.name for group in result.groups} == {"hit", "depth", "shading_normal"}, str(result)
    assert "3 parts as one image: RGBA, Z, N" in str(result)


def test_what_is_not_known_is_left_out_and_stated(tmp_path, ours):
    theirs = named(ours, depth="depth.T") | {"Cryptomatte00.R": ours["A"]}
    result = compared(tmp_path, ours, theirs)
    assert result.ok and "not recognised, and left out: Cryptomatte00.R (--map OURS=THEIRS)" in str(result)


def test_two_channels_that_may_be_the_same_are_a_question_not_a_guess(tmp_path, ours):
    theirs = named(ours, depth="ViewLayer.Depth.Z") | named(ours, depth="Close.Depth.Z")
    with pytest.raises(
        Unclear, match=r"^the reference: Close\.Depth\.Z and ViewLayer\.Depth\.Z may both be the depth: --map"
    ):
        compared(tmp_path, ours, theirs)
    said = compared(tmp_path, ours, theirs, maps=("depth=ViewLayer.Depth.Z",))
    assert said.ok, str(said)


def test_any_name_can_be_mapped(tmp_path, ours):
    theirs = named(ours, depth="range", normal="facing:xyz")
    result = compared(tmp_path, ours, theirs, maps=("depth=range", "normal=facing"))
    assert result.ok and {group.name for group in result.groups} == {"hit", "depth", "normal"}, str(result)
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


# ---- misses and what depth measures ----


@pytest.mark.parametrize("miss", ["0", "1e10", "FLT_MAX"])
def test_the_depth_of_a_miss_is_stated_by_an_option(tmp_path, ours, miss):
    theirs = named(ours, depth="Z", miss=FLT_MAX if miss == "FLT_MAX" else float(miss))
    stated = compared(tmp_path, ours, theirs, miss=miss)
    assert stated.ok and f"a miss is depth {miss} ({(ours['A'] == 0).sum()} pixels)" in str(stated)
    assert compared(tmp_path, ours, theirs).exit_code == 1


def test_what_is_no_number_is_an_error():
    for reading, says in (
        ({"miss": "sky"}, "--miss 'sky': expected a number"),
        ({"depth": "w"}, "--depth 'w': expected distance, z, near"),
    ):
        with pytest.raises(SceneError, match=says):
            Reading(**reading)


def test_a_pixel_that_only_they_miss_fails(tmp_path, ours):
    theirs = named(ours, depth="Z", miss=1e10)
    y, x = np.argwhere(ours["A"] == 1)[50]
    theirs["Z"][y, x] = 1e10
    result = compared(tmp_path, ours, theirs, miss="1e10")
    assert result.exit_code == 1 and f"({x}, {y})" in str(result)


def rays_of(scene: caster.Scene) -> tuple[np.ndarray, np.ndarray]:
    """(cosine of each ray with the view axis, distance along it to the near plane), (h, w)."""
    y, x = (axis.ravel() + 0.5 for axis in np.indices((24, 32)))
    rays = reference_of_camera(scene.camera).rays(scene.camera, scene.film, x, y)
    cosine = rays.d @ camera_axes(scene.camera)[2] / np.linalg.norm(rays.d, axis=1)
    return cosine.reshape(24, 32), rays.t_min.reshape(24, 32)


def along_z(ours: Channels) -> Channels:
    return {"Z": np.where(ours["A"] == 1, ours["depth.Z"] * rays_of(SCENE)[0], np.inf).astype(np.float32)}


NEAR = scene_of(near=1.0)


def from_near(ours: Channels) -> Channels:
    return {"depth.T": np.where(ours["A"] == 1, ours["depth.Z"] - rays_of(NEAR)[1], np.inf).astype(np.float32)}


@pytest.mark.parametrize(
    ("change", "reading", "words"),
    [
        (along_z, {"depth": "z"}, "z along the view axis"),
        (from_near, {"depth": "near", "scene": NEAR}, "the distance from the near plane along the ray"),
    ],
)
def test_what_depth_measures_is_stated_by_an_option_and_hinted_at_without_it(tmp_path, ours, change, reading, words):
    stated = compared(tmp_path, ours, change(ours), **reading)
    assert stated.ok and f"depth is {words}" in str(stated), str(stated)
    result = compared(tmp_path, ours, change(ours), **{**reading, "depth": None})
    assert result.exit_code == 1 and f"depth looks like {words}: --depth {reading['depth']}" in str(result)
    assert compared(tmp_path, ours, named(ours, depth="Z"), **reading).exit_code == 1


def test_without_a_camera_z_cannot_be_read_and_the_way_out_is_stated(tmp_path, ours):
    write_exr(tmp_path / "a.exr", ours, {"caster/version": "0"})
    OpenEXR.File({}, along_z(ours)).write(str(tmp_path / "b.exr"))
    with pytest.raises(Unclear, match="--depth z needs a camera: --scene SCENE"):
        compare_exr(tmp_path / "a.exr", tmp_path / "b.exr", reading=Reading(depth="z"))
    assert compare_exr(tmp_path / "a.exr", tmp_path / "b.exr", reading=Reading(depth="z", scene=SCENE)).ok


def test_a_mask_that_the_stated_misses_contradict_is_left_out(tmp_path, ours):
    theirs = named(ours, depth="Z", miss=1e10) | {"A": np.ones_like(ours["A"])}
    result = compared(tmp_path, ours, theirs, miss="1e10")
    assert result.ok and "and A, which differs, is left out" in str(result), str(result)


def test_an_image_is_not_taken_for_our_diffuse(tmp_path, ours):
    lit = ours | dict.fromkeys("RGB", ours["A"])
    theirs = named(ours, depth="Z") | dict.fromkeys("RGB", 0.5 * ours["A"])
    result = compared(tmp_path, lit, theirs)
    assert result.ok and "not recognised, and left out: B, G, R" in str(result)
    asked = compared(tmp_path, lit, theirs, maps=("R=R", "G=G", "B=B"))
    assert asked.exit_code == 1 and "FAIL  diffuse" in str(asked)


def test_a_file_of_ours_is_never_converted(tmp_path, ours):
    """Depth along z in a file that says what its depth is, is a fault."""
    wrong = ours | {"depth.Z": along_z(ours)["Z"]}
    for name, channels in (("a", ours), ("b", wrong)):
        write_exr(tmp_path / f"{name}.exr", channels, provenance(SCENE, __version__))
    result = compare_exr(tmp_path / "a.exr", tmp_path / "b.exr", reading=Reading(depth="z"))
    assert result.exit_code == 1 and result.stated == ()

"""Failing scenes on disk: what is read is what was written, to the bit, and any scene command takes them."""

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from caster.description.errors import FileMissing, SceneError
from caster.rendering.hits import cast
from caster.scene.files import load_scene
from mitsuba_ref.fuzz import cases
from mitsuba_ref.fuzz.cases import Case, one_ray
from mitsuba_ref.shapes.targets import mesh_files

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
points = st.lists(numbers, min_size=3, max_size=3)
FOUND_BY = "--seed 1 --family any --examples 2..2"
BALL = {"type": "sphere", "center": [0.1, 0.0, 5e-324], "radius": 1.0 / 3.0}


def a_case(ray=None, shapes=(BALL,)):
    camera = {"type": "pinhole", "eye": [0.0, 0.0, 3.0], "look_at": [0.0, 0.0, 0.0]}
    return Case({"width": 2, "height": 1}, camera, list(shapes), ray)


def written(folder, case, kind="missed"):
    return cases.write_kept(folder, "name", kind, "ours misses,\nexactly it is hit", FOUND_BY, case)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(points, points.filter(any), numbers.map(abs), st.one_of(st.just(np.inf), numbers.map(abs)))
def test_a_ray_comes_back_to_the_bit(tmp_path, o, d, t_min, t_max):
    case = a_case(one_ray(o, d, t_min, t_max))
    one = cases.read_kept(written(tmp_path, case))
    assert one.kind == "missed" and one.found_by == FOUND_BY
    for ours, theirs in zip(one.case.ray, case.ray, strict=True):
        assert ours.tobytes() == theirs.tobytes()
    assert one.case.shapes == case.shapes


def test_the_scene_casts_the_very_ray(tmp_path):
    ray = one_ray([0.1, -0.0, 2.5], [1e-17, -0.0, -0.1], 0.0, 40.0)
    scene = load_scene(written(tmp_path, a_case(ray)))
    assert scene.camera.origin == (0.1, 0.0, 2.5) and scene.camera.direction == (1e-17, 0.0, -0.1)
    assert np.signbit(scene.camera.direction[1]) and scene.camera.t_max == 40.0
    assert (scene.film.width, scene.film.height) == (1, 1)
    assert cast(scene, ray.o, ray.d).shape_id.tolist() == [0]


def test_an_image_keeps_its_camera(tmp_path):
    one = cases.read_kept(written(tmp_path, a_case()))
    assert one.case.ray is None
    assert one.case.camera == a_case().camera and one.case.film == a_case().film


def test_a_mesh_goes_along(tmp_path):
    case = a_case(shapes=[{"type": "mesh", "file": mesh_files()[0], "face_normals": True}])
    file = written(tmp_path / "new", case)
    assert sorted(path.name for path in file.parent.iterdir()) == ["name.toml", "octahedron.obj"]
    again = cases.write_kept(tmp_path / "new", "name", "t", "", FOUND_BY, cases.read_kept(file).case)
    assert load_scene(again).shapes[0].load().faces.shape == (8, 3)


def test_the_file_states_how_it_was_found_and_how_to_see_it_again(tmp_path):
    text = written(tmp_path, a_case(one_ray([0.0] * 3, [0.0, 0.0, 1.0], 0.0, np.inf))).read_text()
    assert f"# Found by mitsuba-ref fuzz {FOUND_BY}: there is a hit by exact arithmetic" in text
    assert "# ours misses, exactly it is hit\n" in text
    assert "# Again: mitsuba-ref fuzz --replay name.toml" in text
    assert "0x1.5555555555555p-2" in text, "numbers as hex floats"


GOOD = {
    "kind": "t",
    "found_by": "",
    "ray": {"o": ["0x0p+0"] * 3, "d": ["0x1p+0"] * 3, "t_min": "0x0p+0", "t_max": "inf"},
}


def changed(**ray):
    return json.dumps(GOOD | {"ray": GOOD["ray"] | ray})


@pytest.mark.parametrize(
    ("record", "says"),
    [
        ("{", "Invalid JSON"),
        ("[" * 100_000, "Invalid JSON: recursion"),
        ("[]", "should be an object"),
        ("{}", "kind: Field required"),
        (json.dumps(GOOD | {"kind": "warp"}), "kind: .*expected one of error, missed, .*got 'warp'"),
        (json.dumps(GOOD | {"ray": 1}), "ray: Input should be"),
        (changed(o=["0x0p0"]), "ray.o.1: Field required"),
        (changed(d=["0x0p0"] * 3), "ray.d: .*d must not be zero"),
        (changed(d=["nan"] * 3), "ray.d.0: .*finite"),
        (changed(t_min=0.0), "ray.t_min: .*expected a hex float as text, got 0.0"),
        (changed(t_max="soon"), "ray.t_max: .*invalid hexadecimal"),
        (changed(o=["0x1p99999"] * 3), "ray.o.0: .*too large"),
    ],
)
def test_a_damaged_file_is_reported_with_its_line(tmp_path, record, says):
    file = written(tmp_path, a_case(one_ray([0.0] * 3, [0.0, 0.0, 1.0], 0.0, np.inf)))
    lines = file.read_text().splitlines()
    (number,) = (i for i, line in enumerate(lines) if line.startswith(cases.RECORD_PREFIX))
    file.write_text("\n".join([*lines[:number], cases.RECORD_PREFIX + record, *lines[number + 1 :]]))
    with pytest.raises(SceneError, match=rf"name.toml:{number + 1}: damaged: .*{says}"):
        cases.read_kept(file)


def test_a_good_record_passes():
    record = cases.CaseRecord.model_validate_json(json.dumps(GOOD))
    assert record.ray.t_max == np.inf and json.loads(record.model_dump_json()) == GOOD


def test_a_plain_scene_is_no_kept_one(tmp_path):
    (tmp_path / "plain.toml").write_text('[camera]\ntype = "panorama"\neye = [0, 0, 0]\nlook_at = [1, 0, 0]\n')
    with pytest.raises(SceneError, match="expected one line that begins with '# fuzz:', found 0"):
        cases.read_kept(tmp_path / "plain.toml")


def test_a_scene_that_does_not_load_is_reported_as_any_other(tmp_path):
    file = written(tmp_path, a_case())
    file.write_text(file.read_text().replace('"sphere"', '"spear"'))
    with pytest.raises(SceneError, match=r"name.toml:\d+:\d+: .*spear.*did you mean 'sphere'"):
        cases.read_kept(file)


def test_files_are_found(tmp_path):
    file = written(tmp_path, a_case())
    assert cases.kept_files(str(tmp_path)) == cases.kept_files(str(file)) == [file]
    with pytest.raises(FileMissing, match="expected a scene file that fuzz has kept"):
        cases.kept_files(str(tmp_path / "none"))

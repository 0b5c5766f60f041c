"""`mitsuba-ref fuzz`: examples, findings, kept cases and shrinking. Without Mitsuba."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from caster.cameras import CAMERAS
from caster.description.errors import SceneError
from caster.geometry.packing import pack, packed
from caster.rendering.hits import cast
from caster.scene.files import load_scene
from caster.scene.model import Scene
from caster.shapes import SHAPES
from mitsuba_ref.error_model.intersections import Rays
from mitsuba_ref.fuzz import cases, checks
from mitsuba_ref.fuzz.cases import case_of, ray_of, scene_data
from mitsuba_ref.fuzz.checks import SCENE_ERRORS, adjudicate, check_image, check_rays, check_surfaces
from mitsuba_ref.fuzz.findings import Finding, Tally
from mitsuba_ref.fuzz.fuzz_run import Example, check_example
from mitsuba_ref.fuzz.shrink import Shrinker
from mitsuba_ref.hard import BY_NAME, FAMILIES
from mitsuba_ref.hard.family import scene_of
from mitsuba_ref.judge.checks.knife_edges import NearestHits, cast_by_culling
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.shapes import KINDS
from mitsuba_ref.shapes.targets import MESH_FILES

FEW = 6  # examples of each family

# ---- examples


@pytest.fixture(scope="module")
def examples():
    return [Example(3, number, FAMILIES[number % len(FAMILIES)]) for number in range(FEW * len(FAMILIES))]


def test_every_shape_camera_and_primitive_is_drawn(examples):
    shapes = {shape["type"] for each in examples for shape in each.made.data["shape"]}
    cameras = {each.made.data["camera"]["type"] for each in examples}
    kinds = {type(part) for each in examples for part in pack(each.made.scene()).parts}
    assert shapes == {cls.model_fields["type"].default for cls in SHAPES}
    assert cameras == {cls.model_fields["type"].default for cls in CAMERAS} and kinds == set(KINDS)


def test_transforms_span_decades():
    made = [Example(3, number, BY_NAME["transforms"]) for number in range(60)]
    matrices = [shape.matrix[:3, :3] for each in made for shape in each.made.scene().shapes]
    assert max(np.linalg.cond(matrix) for matrix in matrices) > 1e5
    assert sum(np.linalg.det(matrix) < 0.0 for matrix in matrices) > len(matrices) / 4


def test_rays_are_strange_where_they_should_be(examples):
    d = np.concatenate([each.rays(pack(each.made.scene())).d for each in examples[::2]])
    length = np.abs(d).max(axis=1)
    assert np.isfinite(d).all() and d.any(axis=1).all() and (length < 1e-9).any() and (length > 1e9).any()
    assert ((d == 0.0) & np.signbit(d)).any(), "no -0.0"
    assert ((d != 0.0) & (np.abs(d) < np.finfo(float).tiny)).any(), "no denormal component"


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
@pytest.mark.slow("each decides some hundred rays exactly", every=4)
def test_a_family_finds_nothing_and_has_hits_where_rounding_decides(family):
    tally = Tally()
    for number in range(8):
        assert not check_example(Example(8, number, family), tally)
    assert tally.rays >= 8 * 40 and tally.hits >= tally.rays / 8 and tally.outside == 0
    assert family.values or tally.edges + tally.ties >= 6


# ---- findings

SQUARE = (
    [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]],
    [[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],
)
SCENE = {
    "film": {"width": 4, "height": 4},
    "camera": {"type": "orthographic", "eye": [0.0, 0.0, 5.0], "direction": [0.0, 0.0, -1.0], "width": 4.0},
    "shape": [{"type": "triangle", "vertices": corners} for corners in (*SQUARE, SQUARE[0])],
}
AT = np.array([[0.0, -0.5], [0.5, -0.5], [0.25, 0.25], [3.0, 0.0]])  # inside, inside, on the diagonal, beside
RIGHT = [2.0, 2.0, 2.0, np.inf], [0, 0, 0, -1]


def rays(t_min=0.0, t_max=np.inf):
    o = np.column_stack([AT, np.full(4, -2.0)])
    return Rays(o, np.tile([0.0, 0.0, 1.0], (4, 1)), np.full(4, t_min), np.full(4, t_max))


@pytest.fixture(scope="module")
def subject():
    scene = Scene.model_validate(SCENE)
    return scene, Oracle(packed(scene))


def found_by(subject, t, prim, tally=None):
    findings = adjudicate(subject[1], rays(), NearestHits(np.array(t), np.array(prim)), tally or Tally())
    return [(int(np.flatnonzero((rays().o == f.ray.o[0]).all(axis=1))[0]), f.kind) for f in findings]


def test_the_caster_itself_is_right_about_this_square(subject):
    tally = Tally()
    assert found_by(subject, *RIGHT, tally) == []
    assert (tally.rays, tally.hits, tally.edges, tally.ties) == (4, 3, 1, 3)
    tally = Tally()
    assert check_rays(*subject, rays(), tally, np.random.default_rng(1)) == []
    assert tally.rays == 4 + 3, "three hits are cast again with limits"
    assert check_image(*subject, tally) == [] and tally.rays == 4 + 3 + 16


@pytest.mark.parametrize(
    ("row", "t", "prim", "kind"),
    [
        (0, np.inf, -1, "missed"),
        (3, 2.0, 1, "phantom"),
        (0, 2.0, 2, "prim"),  # of the tied the higher
        (1, 2.0 + 2.0**-44, 0, "t"),
        (1, np.inf, 0, "t"),
        (1, np.nan, 0, "t"),
        (1, -2.0, 0, "t"),
    ],
)
def test_a_wrong_answer_is_found_and_named(subject, row, t, prim, kind):
    answers = [list(column) for column in RIGHT]
    answers[0][row], answers[1][row] = t, prim
    assert found_by(subject, *answers) == [(row, kind)]


def test_the_last_bits_of_t_are_free_and_no_more(subject):
    """4 units in the last place of o, d and the corners, times their condition: here some 20 of t."""
    bits = [k for k in range(1, 60) if not found_by(subject, [2.0 + k * 2.0**-51, 2.0, 2.0, np.inf], RIGHT[1])]
    assert bits == list(range(1, len(bits) + 1)) and 4 <= len(bits) <= 40


def test_a_limit_at_the_hit_is_compared_exactly(subject):
    """A hit at t = 2 lies within t <= 2 and without t > 2."""
    ours = NearestHits(*(np.array(column) for column in RIGHT))
    for limits, kinds in (((0.0, 2.0), []), ((2.0, np.inf), 3 * ["phantom"]), ((np.nextafter(2.0, 0.0), 2.0), [])):
        assert [finding.kind for finding in adjudicate(subject[1], rays(*limits), ours, Tally())] == kinds


def test_a_bit_between_two_cullings_is_found(subject, monkeypatch):
    def off_by_a_bit(packed, given, culling):
        found = cast_by_culling(packed, given, culling)
        return found if culling == "bvh" else NearestHits(np.nextafter(found.t, 0.0), found.prim)

    monkeypatch.setattr(checks, "cast_by_culling", off_by_a_bit)
    kinds = [finding.kind for finding in check_rays(*subject, rays(), Tally())]
    assert kinds == 4 * ["culling"], "t of a miss counts, too"


def test_a_failing_check_of_the_image_is_found(subject, monkeypatch):
    failing = SceneCheck("scaling", np.inf, "other bits")
    monkeypatch.setattr(checks.registry, "make_checks", lambda *_: (failing, SceneCheck("culling", 0.0, "")))
    (finding,) = check_image(*subject, Tally())
    assert (finding.mode, finding.what) == (("check", "scaling"), "scaling: other bits")


def test_a_normal_of_another_length_is_found(subject):
    hits = cast(subject[0], rays().o, rays().d)
    hits.surfaces["normal"][1] *= 1.0 + 2.0**-40
    (finding,) = check_surfaces(hits, rays())
    assert finding.kind == "surface" and np.array_equal(finding.ray.o[0], rays().o[1])


# ---- kept cases

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
points = st.lists(numbers, min_size=3, max_size=3)
BALL = {"type": "sphere", "center": [0.1, 0.0, 5e-324], "radius": 1.0 / 3.0}
VIEW = {"film": {"width": 2, "height": 1}, "camera": {"type": "pinhole", "eye": [0, 0, 3.0], "look_at": [0, 0, 0.0]}}
FOUND_BY = "--seed 1 --family any --examples 2..2"


def ray_along(o, d, t_min=0.0, t_max=np.inf):
    return Rays(*(np.array([value]) for value in (o, d, t_min, t_max)))


ALONG_Z = ray_along([0.0] * 3, [0.0, 0.0, 1.0])


def a_case(ray=None, shapes=(BALL,)):
    return case_of({**VIEW, "shape": list(shapes)}, ray)


def written(folder, case, kind="missed"):
    return cases.write_kept(folder, "name", Finding(kind, "ours misses,\nexactly it is hit"), FOUND_BY, case)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(points, points.filter(any), numbers.map(abs), st.one_of(st.just(np.inf), numbers.map(abs)))
def test_a_ray_comes_back_to_the_bit(tmp_path, o, d, t_min, t_max):
    case = a_case(ray_along(o, d, t_min, max(t_min, t_max)))
    kind, again = cases.read_kept(written(tmp_path, case))
    assert kind == "missed" and repr(ray_of(again)) == repr(ray_of(case))
    assert again["shape"] == case["shape"]


def test_the_file_casts_the_very_ray_and_states_how_to_see_it_again(tmp_path):
    ray = ray_along([0.1, -0.0, 2.5], [1e-17, -0.0, -0.1], t_max=40.0)
    file = written(tmp_path, a_case(ray))
    scene, text = load_scene(file), file.read_text()
    assert scene.camera.origin == (0.1, 0.0, 2.5) and scene.camera.direction == (1e-17, 0.0, -0.1)
    assert np.signbit(scene.camera.direction[1]) and scene.camera.t_max == 40.0
    assert cast(scene, ray.o, ray.d).shape_id.tolist() == [0]
    assert f"# Found by mitsuba-ref fuzz {FOUND_BY}: by exact arithmetic the ray hits" in text
    assert "# ours misses, exactly it is hit\n" in text and "# Again: mitsuba-ref fuzz --replay name.toml" in text


def test_an_image_keeps_its_camera_and_a_mesh_goes_along(tmp_path):
    mesh = [{"type": "mesh", "file": MESH_FILES[0], "face_normals": True}]
    file = written(tmp_path / "new", a_case(shapes=mesh))
    _, kept = cases.read_kept(file)
    assert "limits" not in kept and kept["camera"] == VIEW["camera"] and kept["film"] == VIEW["film"]
    assert sorted(path.name for path in file.parent.iterdir()) == ["name.toml", "octahedron.obj"]
    assert load_scene(written(tmp_path / "new", kept)).shapes[0].mesh().faces.shape == (8, 3)


@pytest.mark.parametrize("record", ["", "warp", "t t_min=0.0", "t t_min=soon t_max=inf", "t t_min=nan t_max=inf"])
def test_a_damaged_record_is_reported(tmp_path, record):
    file = written(tmp_path, a_case(ALONG_Z))
    head, _, tail = file.read_text().partition("# fuzz: ")
    file.write_text(f"{head}# fuzz: {record}\n{tail.partition(chr(10))[2]}")
    with pytest.raises(SceneError, match=r"name.toml: expected one comment line '# fuzz: KIND'"):
        cases.read_kept(file)


def test_other_files_are_reported_as_what_they_are(tmp_path):
    (tmp_path / "plain.toml").write_text('[camera]\ntype = "panorama"\neye = [0, 0, 0]\nlook_at = [1, 0, 0]\n')
    with pytest.raises(SceneError, match=r"expected one comment line '# fuzz: KIND'.* got 0 such"):
        cases.read_kept(tmp_path / "plain.toml")
    file = written(tmp_path / "kept", a_case())
    file.write_text(file.read_text().replace('"sphere"', '"spear"'))
    with pytest.raises(SceneError, match=r"name.toml:\d+:\d+: .*spear.*did you mean 'sphere'"):
        cases.read_kept(file)


# ---- shrinking


def loaded(case):
    """The shapes; none of an invalid scene."""
    try:
        return scene_of(scene_data(case)).shapes
    except SCENE_ERRORS:
        return ()


def has_three_and_seven(case):
    """A failure that takes two shapes of certain sizes."""
    radii = [shape.radius for shape in loaded(case)]
    wrong = any(r >= 6.5 for r in radii) and any(2.6 < r < 3.5 for r in radii)
    return [Finding("prim", str(len(radii)))] if wrong else []


def many_spheres():
    radii = np.linspace(0.1234, 9.7654, 25).tolist()
    shapes = [{"type": "sphere", "radius": r, "center": [r, 0.1, -r], "name": f"n{r}"} for r in radii]
    return a_case(ALONG_Z, shapes) | {"light": [{"type": "ambient", "radiance": [1.0, 1.0, 1.0]}]}


@pytest.mark.parametrize("attempts", [0, 1, 7, 40, 5000])
def test_everything_that_does_not_matter_goes_and_what_is_left_fails(attempts):
    shrinker = Shrinker(many_spheres(), Finding("prim", "25"), has_three_and_seven, attempts)
    shrinker.run()
    assert has_three_and_seven(shrinker.case) == [shrinker.finding]
    if attempts == 5000:
        assert sorted(shrinker.case) == ["camera", "film", "limits", "shape"]
        assert len(shrinker.case["shape"]) == 2 and "name" not in repr(shrinker.case)


def test_no_attempt_is_made_when_the_time_is_up():
    shrinker = Shrinker(many_spheres(), Finding("prim", "25"), has_three_and_seven, until=0.0)
    shrinker.run()
    assert shrinker.case == many_spheres() and shrinker.finding.what == "25"


def hits_something(case):
    """For a fault: every ray that meets a shape is said to be wrong."""
    if not loaded(case) or (ray := ray_of(case)) is None:
        return []
    packed = pack(scene_of(scene_data(case)))
    return [Finding("prim", "it is hit")] if Oracle(packed).first_hit(ray.o[0], ray.d[0]).hit else []


@pytest.mark.parametrize("number", [0, 19])
def test_a_mesh_shrinks_to_one_triangle(number):
    tried = Example(7, number, BY_NAME["edges"])
    given_rays = tried.rays(pack(tried.made.scene()))
    batches = [given_rays.take([i]) for i in range(len(given_rays.t_min))]
    ray = next(each for each in batches if hits_something(case_of(tried.made.data, each)))
    shrinker = Shrinker(case_of(tried.made.data), Finding("prim", "it is hit", ray), hits_something)
    shrinker.run()
    assert [shape["type"] for shape in shrinker.case["shape"]] == ["triangle"] and hits_something(shrinker.case)


def test_a_film_shrinks_to_one_pixel_and_that_to_its_ray():
    """Where the finding is of the image alone, it stays a pixel."""
    camera = {"type": "pinhole", "eye": [0, 0, 5], "look_at": [0, 0, 0], "fov": 40}
    case = {"film": {"width": 4, "height": 4}, "camera": camera, "shape": [{"type": "sphere"}]}

    def differs(each):
        x0, y0, x1, y1 = each["film"].get("crop", (0, 0, 4, 4))
        wrong = loaded(each) and x0 <= 3 < x1 and y0 <= 2 < y1 and (by_ray or "limits" not in each)
        return [Finding("check", "other bits")] if wrong else []

    for by_ray in (True, False):
        shrinker = Shrinker(case, Finding("check", "other bits"), differs)
        shrinker.run()
        assert ("limits" in shrinker.case) == by_ray and (by_ray or shrinker.case["film"]["crop"] == [3, 2, 4, 3])

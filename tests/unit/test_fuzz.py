"""`mitsuba-ref fuzz`: examples, findings, kept cases and shrinking. Without Mitsuba."""

import itertools

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from caster.cameras import CAMERAS
from caster.description.errors import FileMissing, SceneError
from caster.geometry.packing import pack
from caster.rendering.hits import cast
from caster.scene.files import load_scene
from caster.scene.model import Scene
from caster.shapes import SHAPES
from mitsuba_ref.fuzz import cases, checks
from mitsuba_ref.fuzz.campaign import check_example, example
from mitsuba_ref.fuzz.cases import SCENE_ERRORS, case_of, scene_data
from mitsuba_ref.fuzz.checks import adjudicate, check_rays, check_surfaces
from mitsuba_ref.fuzz.findings import Finding, Tally, first_of_each_kind
from mitsuba_ref.fuzz.shrink import (
    Budget,
    Shrinker,
    complexity,
    fewer_fields,
    fewer_shapes,
    primitive_shapes,
    rounder_numbers,
    simpler_numbers,
    smallest_case,
    walk,
)
from mitsuba_ref.hard import BY_NAME, FAMILIES
from mitsuba_ref.hard.family import scene_of
from mitsuba_ref.hard.random_parts import random_camera, random_frame, random_shape, shape_types
from mitsuba_ref.hard.rays import Frame, RayBatch, perturbed_by_ulps
from mitsuba_ref.judge.checks.knife_edges import NearestHits, cast_by_culling, prepared_scene
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.shapes import KINDS
from mitsuba_ref.shapes.targets import mesh_files

FEW = 6  # examples of each family

# ---- examples


@pytest.fixture(scope="module")
def examples():
    return [example(3, number, FAMILIES) for number in range(FEW * len(FAMILIES))]


def test_an_example_is_the_same_whenever_and_beside_whichever_families_it_is_made(examples):
    for tried in examples[::3]:
        alone = example(tried.seed, tried.number, [tried.family])
        assert alone.data == tried.data and alone.family is tried.family
        rays, same = (each.rays(pack(scene_of(each.data))) for each in (tried, alone))
        assert all(np.array_equal(a, b) for a, b in zip(rays, same, strict=True))
    others = [repr(example(seed, number, FAMILIES).data) for seed in (1, 2) for number in range(len(FAMILIES))]
    assert len(set(others)) == len(others)


def test_every_shape_camera_and_primitive_is_drawn(examples):
    shapes = {shape["type"] for each in examples for shape in each.data["shape"]}
    cameras = {each.data["camera"]["type"] for each in examples}
    kinds = {type(part) for each in examples for part in pack(scene_of(each.data)).parts}
    assert shapes == {cls.model_fields["type"].default for cls in SHAPES}
    assert cameras == {cls.model_fields["type"].default for cls in CAMERAS} and kinds == set(KINDS)


def test_transforms_and_frames_span_decades():
    made = [example(3, number, [BY_NAME["transforms"]]) for number in range(60)]
    matrices = [shape.matrix[:3, :3] for each in made for shape in scene_of(each.data).shapes]
    assert max(np.linalg.cond(matrix) for matrix in matrices) > 1e5
    assert sum(np.linalg.det(matrix) < 0.0 for matrix in matrices) > len(matrices) / 4
    frames = [random_frame(np.random.default_rng([9, i])) for i in range(300)]
    sizes, away = [f.size for f in frames], [np.abs(f.center).max() / f.size for f in frames]
    assert min(sizes) < 1e-2 and max(sizes) > 1e2 and max(away) > 1e5 and sum(f.lattice for f in frames) > 100


def test_rays_are_strange_where_they_should_be(examples):
    d = np.concatenate([each.rays(pack(scene_of(each.data))).d for each in examples[::2]])
    length = np.abs(d).max(axis=1)
    assert np.isfinite(d).all() and d.any(axis=1).all() and (length < 1e-9).any() and (length > 1e9).any()
    assert ((d == 0.0) & np.signbit(d)).any(), "no -0.0"
    assert ((d != 0.0) & (np.abs(d) < np.finfo(float).tiny)).any(), "no denormal component"


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
@pytest.mark.slow("each decides some hundred rays exactly", every=4)
def test_a_family_finds_nothing_and_has_hits_where_rounding_decides(family):
    tally = Tally()
    for number in range(8):
        assert not check_example(example(8, number, [family]), tally)
    assert tally.rays >= 8 * 40 and tally.hits >= tally.rays / 8 and tally.outside == 0
    assert family.values or tally.edges + tally.ties >= 6


def test_lattice_coordinates_differ_without_rounding():
    """Which is what makes a ray from one to another pass exactly through it."""
    frame = Frame(size=0.25, lattice=True)
    points = frame.on_lattice(np.random.default_rng(1).uniform(-4.0, 4.0, (200, 3)))
    for a, b in itertools.pairwise(points):
        assert np.array_equal(a + (b - a), b)
    x = np.array([1.0, -3.5, 0.0, 1e300, 5e-324])
    moved = np.array([perturbed_by_ulps(np.random.default_rng(i), x, 2) for i in range(50)])
    assert np.all(np.abs(moved - x) <= 2.0 * np.spacing(np.abs(x))) and np.all((moved != x).any(axis=0))


def test_what_cannot_be_drawn_is_named_with_what_to_write():
    rng = np.random.default_rng(1)
    with pytest.raises(SceneError, match=r"type 'cone' .*mitsuba_ref.shapes"):
        random_shape(rng, "cone", Frame())
    with pytest.raises(SceneError, match=r"type 'drone' .*mitsuba_ref.cameras"):
        random_camera(rng, Frame(), ["drone"])


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
    return RayBatch(o, np.tile([0.0, 0.0, 1.0], (4, 1)), np.full(4, t_min), np.full(4, t_max))


@pytest.fixture(scope="module")
def subject():
    return prepared_scene(Scene.model_validate(SCENE))


def found_by(subject, t, prim, tally=None):
    findings = adjudicate(subject, rays(), NearestHits(np.array(t), np.array(prim)), tally or Tally())
    return [(int(np.flatnonzero((rays().o == f.ray.o[0]).all(axis=1))[0]), f.kind) for f in findings]


def test_the_caster_itself_is_right_about_this_square(subject):
    tally = Tally()
    assert found_by(subject, *RIGHT, tally) == []
    assert (tally.rays, tally.hits, tally.edges, tally.ties) == (4, 3, 1, 3)
    tally = Tally()
    assert check_rays(subject, rays(), tally, np.random.default_rng(1)) == []
    assert tally.rays == 4 + 3, "three hits are cast again with limits"
    assert checks.check_image(subject, tally) == [] and tally.rays == 4 + 3 + 16


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
    worst = []
    for t in (RIGHT[0], [2.0 + 2.0**-51, 2.0, 2.0, np.inf], [2.0, 2.0, 2.0 + 2.0**-30, np.inf]):
        tally = Tally()
        found_by(subject, t, RIGHT[1], tally)
        worst.append(tally.worst)
    assert worst[0] == 0.0 < worst[1] < 1.0 < worst[2] < np.inf
    tally.add(Tally(worst=2.0 * worst[2]))
    assert tally.worst == 2.0 * worst[2]


@pytest.mark.parametrize(
    ("t_min", "t_max", "hit"), [(0.0, 2.0, True), (2.0, np.inf, False), (np.nextafter(2.0, 0.0), 2.0, True)]
)
def test_limits_are_compared_exactly(subject, t_min, t_max, hit):
    """A hit at t = 2 lies within t <= 2 and without t > 2."""
    ours = NearestHits(*(np.array(column) for column in RIGHT))
    findings = adjudicate(subject, rays(t_min, t_max), ours, Tally())
    assert [finding.kind for finding in findings] == ([] if hit else 3 * ["phantom"])


def test_a_bit_between_two_cullings_is_found(subject, monkeypatch):
    def off_by_a_bit(packed, given, culling):
        found = cast_by_culling(packed, given, culling)
        return found if culling == "bvh" else NearestHits(np.nextafter(found.t, 0.0), found.prim)

    monkeypatch.setattr(checks, "cast_by_culling", off_by_a_bit)
    kinds = [finding.kind for finding in check_rays(subject, rays(), Tally())]
    assert kinds == 4 * ["culling"], "t of a miss counts, too"


def off_in_position(images, culling):
    if culling == "raster":
        images["position"][1, 2, 0] = np.nextafter(images["position"][1, 2, 0], 9.0)


def off_in_depth(images, culling):
    images["depth"][1, 2] *= 1.0 + 2.0**-40


@pytest.mark.parametrize(("spoil", "kind"), [(off_in_position, "culling"), (off_in_depth, "t")])
def test_an_error_of_an_image_is_found(subject, monkeypatch, spoil, kind):
    usual = checks.render

    def spoilt(scene, names, *, culling, threads):
        images = usual(scene, names, culling=culling, threads=threads)
        spoil(images, culling)
        return images

    monkeypatch.setattr(checks, "render", spoilt)
    (finding,) = checks.check_image(subject, Tally())
    assert finding.kind == kind and finding.pixel == (2, 1)


def test_a_normal_of_another_length_is_found(subject, monkeypatch):
    usual = checks.cast

    def longer(scene, o, d):
        hits = usual(scene, o, d)
        hits.surface.n[1] *= 1.0 + 2.0**-40
        return hits

    monkeypatch.setattr(checks, "cast", longer)
    (finding,) = check_surfaces(subject.scene, rays())
    assert finding.kind == "surface" and np.array_equal(finding.ray.o[0], rays().o[1])


def test_one_of_each_kind_is_reported_first_things_first():
    findings = [Finding("t", "a"), Finding("missed", "b"), Finding("t", "c")]
    assert [(f.kind, f.what) for f in first_of_each_kind(findings)] == [("missed", "b"), ("t", "a")]


# ---- kept cases

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
points = st.lists(numbers, min_size=3, max_size=3)
BALL = {"type": "sphere", "center": [0.1, 0.0, 5e-324], "radius": 1.0 / 3.0}
VIEW = {"film": {"width": 2, "height": 1}, "camera": {"type": "pinhole", "eye": [0, 0, 3.0], "look_at": [0, 0, 0.0]}}
FOUND_BY = "--seed 1 --family any --examples 2..2"
ALONG_Z = {"o": [0.0] * 3, "d": [0.0, 0.0, 1.0], "t_min": 0.0, "t_max": np.inf}


def a_case(ray=None, shapes=(BALL,)):
    return {**VIEW, "shape": list(shapes)} | ({"ray": ray} if ray else {})


def written(folder, case, kind="missed"):
    return cases.write_kept(folder, "name", Finding(kind, "ours misses,\nexactly it is hit"), FOUND_BY, case)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(points, points.filter(any), numbers.map(abs), st.one_of(st.just(np.inf), numbers.map(abs)))
def test_a_ray_comes_back_to_the_bit(tmp_path, o, d, t_min, t_max):
    case = a_case({"o": o, "d": d, "t_min": t_min, "t_max": t_max})
    kind, again = cases.read_kept(written(tmp_path, case))
    assert kind == "missed" and repr(again["ray"]) == repr(case["ray"]) and again["shape"] == case["shape"]


def test_the_file_casts_the_very_ray_and_states_how_to_see_it_again(tmp_path):
    ray = {"o": [0.1, -0.0, 2.5], "d": [1e-17, -0.0, -0.1], "t_min": 0.0, "t_max": 40.0}
    file = written(tmp_path, a_case(ray))
    scene, text = load_scene(file), file.read_text()
    assert scene.camera.origin == (0.1, 0.0, 2.5) and scene.camera.direction == (1e-17, 0.0, -0.1)
    assert np.signbit(scene.camera.direction[1]) and scene.camera.t_max == 40.0
    assert cast(scene, np.array([ray["o"]]), np.array([ray["d"]])).shape_id.tolist() == [0]
    assert f"# Found by mitsuba-ref fuzz {FOUND_BY}: there is a hit by exact arithmetic" in text
    assert "# ours misses, exactly it is hit\n" in text and "# Again: mitsuba-ref fuzz --replay name.toml" in text
    assert "0x1.5555555555555p-2" in text, "numbers as hex floats"


def test_an_image_keeps_its_camera_and_a_mesh_goes_along(tmp_path):
    mesh = [{"type": "mesh", "file": mesh_files()[0], "face_normals": True}]
    file = written(tmp_path / "new", a_case(shapes=mesh))
    kept = cases.read_kept(file).case
    assert "ray" not in kept and kept["camera"] == VIEW["camera"] and kept["film"] == VIEW["film"]
    assert sorted(path.name for path in file.parent.iterdir()) == ["name.toml", "octahedron.obj"]
    assert load_scene(written(tmp_path / "new", kept)).shapes[0].mesh().faces.shape == (8, 3)


@pytest.mark.parametrize(
    "record",
    ["", "warp", "t t_min=0x0p+0", "t t_min=soon t_max=inf", "t t_min=nan t_max=inf", "t t_min=0 t_max=0x1p9999"],
)
def test_a_damaged_file_is_reported_with_its_line(tmp_path, record):
    file = written(tmp_path, a_case(ALONG_Z))
    lines = file.read_text().splitlines()
    (number,) = (i for i, line in enumerate(lines) if line.startswith(cases.RECORD_PREFIX))
    file.write_text("\n".join([*lines[:number], f"{cases.RECORD_PREFIX} {record}", *lines[number + 1 :]]))
    with pytest.raises(SceneError, match=rf"name.toml:{number + 1}: damaged: expected '# fuzz: KIND'"):
        cases.read_kept(file)


def test_other_files_are_reported_as_what_they_are(tmp_path):
    (tmp_path / "plain.toml").write_text('[camera]\ntype = "panorama"\neye = [0, 0, 0]\nlook_at = [1, 0, 0]\n')
    with pytest.raises(SceneError, match="expected one line that begins with '# fuzz:', found 0"):
        cases.read_kept(tmp_path / "plain.toml")
    file = written(tmp_path / "kept", a_case())
    assert cases.kept_files(str(file.parent)) == cases.kept_files(str(file)) == [file]
    with pytest.raises(FileMissing, match="expected a scene file that fuzz has kept"):
        cases.kept_files(str(tmp_path / "none"))
    file.write_text(file.read_text().replace('"sphere"', '"spear"'))
    with pytest.raises(SceneError, match=r"name.toml:\d+:\d+: .*spear.*did you mean 'sphere'"):
        cases.read_kept(file)


# ---- shrinking


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_simpler_numbers_are_finite_simpler_and_end_at_zero(x):
    for other in simpler_numbers(x):
        assert np.isfinite(other) and complexity(other) < complexity(x)
    assert next(simpler_numbers(x), 0.0) == 0.0 and list(simpler_numbers(np.inf)) == []


def has_three_and_seven(data):
    """A failure that takes two shapes, one of them with a number of three bits."""
    radii = [shape.get("radius", 1.0) for shape in data["shape"]]
    return any(r >= 6.5 for r in radii) and any(2.6 < r < 3.5 for r in radii)


def many_spheres():
    radii = np.linspace(0.1, 9.7, 25).tolist()
    shapes = [{"type": "sphere", "radius": r, "center": [r, 0.1, -r], "name": f"n{r}"} for r in radii]
    return {"film": {}, "camera": {}, "shape": shapes}


@pytest.mark.parametrize("attempts", [0, 1, 7, 40, 200, 5000])
def test_everything_that_does_not_matter_goes_and_what_is_left_fails(attempts):
    small = Shrinker(many_spheres(), has_three_and_seven, Budget(attempts)).run(
        [fewer_shapes, fewer_fields, rounder_numbers]
    )
    assert has_three_and_seven(small)
    if attempts == 5000:
        assert small["shape"] == [{"type": "sphere", "radius": 3.0}, {"type": "sphere", "radius": 8.0}]


def test_no_attempt_is_made_when_the_time_is_up():
    asked = []
    shrinker = Shrinker(many_spheres(), lambda data: bool(asked.append(data)), Budget(until=0.0))
    assert shrinker.run([fewer_shapes, rounder_numbers]) == many_spheres() and asked == []


@pytest.mark.parametrize("kind", shape_types())
def test_shapes_written_anew_have_the_same_primitives(kind):
    """In the same order, so that ties stay what they are."""
    exercised = 0
    for number in range(200):
        data = example(6, number, [BY_NAME["any"]]).data
        for i, shape in enumerate(data["shape"]):
            if shape["type"] != kind:
                continue
            (part,) = pack(scene_of({**data, "shape": [shape]})).parts
            parts = pack(scene_of({**data, "shape": primitive_shapes(data, i)})).parts
            for k, other in enumerate(parts):
                assert type(other) is type(part)
                exercised += 1
                for ours, theirs in zip(corners(part, k), corners(other, 0), strict=True):
                    np.testing.assert_allclose(ours, theirs, rtol=4e-16, atol=0.0)
        if exercised > 20:
            break
    assert exercised >= 3


def corners(part, k):
    """The numbers that say where primitive k is."""
    if hasattr(part, "faces"):
        return [part.vertices[part.faces[k]]]
    return [a[k] for name, a in part._asdict().items() if name not in ("turn", "to_object")]


def hits_something(case):
    """For a fault: every ray that meets a shape is said to be wrong."""
    try:
        packed = pack(scene_of(scene_data(case)))
    except SCENE_ERRORS:
        return []
    return [Finding("prim", "it is hit")] if Oracle(packed).first_hit(case["ray"]["o"], case["ray"]["d"]).hit else []


@pytest.mark.parametrize("number", [0, 7, 19, 33])
def test_a_mesh_shrinks_to_one_triangle_and_round_numbers(number):
    tried = example(7, number, [BY_NAME["edges"]])
    given_rays = tried.rays(pack(scene_of(tried.data)))
    with_ray = [case_of(tried.data, given_rays.taken(slice(i, i + 1))) for i in range(len(given_rays.t_min))]
    case = next(each for each in with_ray if hits_something(each))
    small = smallest_case(case, hits_something(case)[0], hits_something)
    assert [shape["type"] for shape in small["shape"]] == ["triangle"] and hits_something(small)
    found = [x for _, x in walk(small["shape"]) if isinstance(x, float)]
    assert len(found) == 9 and sum(complexity(x)[0] <= 4 for x in found) >= 6

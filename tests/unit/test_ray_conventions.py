"""A candidate's conventions, from rays of other lengths and mirrored ones, which no image of unit directions shows."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from places import shipped

import caster
from mitsuba_ref.judge.checks import ray_conventions
from mitsuba_ref.judge.checks.ray_conventions import LENGTHS, LIMITS, RAYS, check_ray_conventions, check_ray_limits
from mitsuba_ref.subjects.command import RayCommand
from mitsuba_ref.subjects.function import FunctionSubject
from mitsuba_ref.subjects.requests import parse_candidate


def scene_of(name):
    return shipped(name, 24, 20)


def length(d):
    return np.linalg.norm(d, axis=1)


def right(scene, o, d):
    found = caster.cast(scene, o, d)
    return found.t, found.normal


def changed(change):
    """The right caster, its t changed."""
    return lambda scene, o, d: (change(d, right(scene, o, d)[0]), None)


def of_unit_directions(scene, o, d):
    return right(scene, o, d / length(d)[:, None])[0], None


def refusing_other_directions(error):
    def cast(scene, o, d):
        if not np.allclose(length(d), 1.0, atol=1e-5):
            raise error("|d| has to be 1")
        return right(scene, o, d)

    return cast


def checked(call, name="one-sphere"):
    return check_ray_conventions(FunctionSubject("candidate", call), scene_of(name))


@pytest.mark.parametrize("name", ["one-sphere", "triangles", "near-far-clip", "plane-edge-on-pinhole", "one-ray"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_right_candidate_passes(name, dtype):
    found = checked(lambda scene, o, d: (right(scene, o, d)[0].astype(dtype), None), name)
    assert found.ok and (found.what == f"{7 * RAYS} rays" or name not in ("one-sphere", "triangles"))


PLANTED = [
    (of_unit_directions, "t is a distance, it has to count in lengths of d"),
    (changed(lambda d, t: t / length(d)), "t is divided by |d| once too often"),
    (changed(lambda d, t: np.where(length(d) > 1.1, 0.9 * t, t)), "right for |d| = 1, wrong for |d| = 2, |d| = 7"),
    *(
        (refusing_other_directions(error), f"rays in other directions, |d| not 1: candidate raised {error.__name__}")
        for error in (ValueError, NotImplementedError)
    ),
]


@pytest.mark.parametrize(("call", "says"), PLANTED)
def test_a_wrong_convention_is_named(call, says):
    found = checked(call)
    assert not found.ok and says in found.what, found.what
    assert "mirrored" not in found.what


def test_a_caster_of_one_side_is_wrong_along_mirrored_rays():
    """The camera of one-sphere looks along -z."""
    found = checked(changed(lambda d, t: np.where(d[:, 2] > 0.0, np.inf, t)))
    assert not found.ok and found.what == "nothing is hit: right for |d| = 1, wrong for rays mirrored in z"


@pytest.mark.parametrize("box", [False, True], ids=["a wall", "a wall and a box behind it"])
def test_a_caster_that_culls_back_faces_is_named_where_mirrored_rays_alone_show_it(box):
    """Along -z the wall shows its front, along +z its back: the box tells culling from a lost sign of d.z."""

    def culled(scene, o, d):
        hits = caster.cast(scene, o, d)
        return np.where((hits.normal * d).sum(axis=1) > 0.0, np.inf, hits.t), None

    shapes = [caster.Rectangle(to_world=[{"scale": 3}])]
    if box:
        shapes.append(caster.Cube(to_world=[{"scale": 0.4}, {"translate": (0.5, 0.5, -2)}]))
    scene = caster.Scene(camera=caster.Pinhole(eye=(0.1, 0.2, 4), look_at=(0, 0, 0)), shapes=shapes)
    found = check_ray_conventions(FunctionSubject("candidate", culled), scene.with_film(width=24, height=20))
    other = "" if box else ", or the sign of a component of d is lost"
    wrong = "right for |d| = 1, wrong for rays mirrored in z"
    assert not found.ok and found.what == f"back faces are missed{other}: {wrong}"


@pytest.mark.parametrize("power", [0, 1], ids=["right", "t is a distance"])
def test_a_function_of_whole_films_is_given_whole_films(power):
    def of_a_film(scene, o, d):
        return right(scene, o, d)[0].reshape(20, 24).ravel() * length(d) ** power, None

    assert checked(of_a_film).ok is (power == 0)


def test_rays_that_are_wrong_at_an_edge_do_not_keep_the_others_from_being_judged():
    """Of a scene of edges, a caster may miss most rays of length 1, and a wrong convention must still show."""

    def of_few(scene, o, d):
        t = right(scene, o, d)[0] * length(d)
        return np.where(abs(d[:, 0]) > 0.05 * length(d), np.inf, t), None

    found = checked(of_few)
    assert not found.ok and found.what.startswith("t is a distance"), found.what


def test_a_caster_right_for_no_ray_of_length_1_fails():
    found = checked(lambda scene, o, d: (np.where(abs(length(d) - 1.0) < 1e-6, np.inf, right(scene, o, d)[0]), None))
    assert not found.ok and found.what.endswith("is right for |d| = 1: nothing is hit"), found.what


def test_back_faces_that_are_hit_are_not_called_missed():
    found = checked(changed(lambda d, t: np.where(d[:, 2] > 0.0, 1.001 * t, t)))
    assert not found.ok and found.what.startswith("other hits: "), found.what


def test_what_fails_already_or_is_not_there_is_not_judged():
    assert check_ray_conventions(FunctionSubject("candidate", right), scene_of("one-sphere"), failing=True) is None
    away = scene_of("one-sphere").model_copy(update={"shapes": ()})
    found = check_ray_conventions(FunctionSubject("candidate", right), away)
    assert found.what == "not judged: no ray of the camera hits anything"
    assert not parse_candidate("true {xml} -o {exr}").takes_rays  # so that it is not asked


CASTER = """import sys
import numpy as np
from caster import cast, load_scene

rays = np.fromfile(sys.argv[2], "<f8").reshape(-1, 8)
o, d, t_min, t_max = rays[:, :3], rays[:, 3:6], rays[:, 6], rays[:, 7]
scene = load_scene(sys.argv[1])
{body}
np.column_stack([hits.t, hits.normal]).tofile(sys.argv[3])
"""
LIMITED = [
    ("hits = cast(scene, o, d, t_min=t_min, t_max=t_max)", True, f"{len(LIMITS)} rays"),
    ("hits = cast(scene, o, d, t_min=t_min)", False, "a hit has t_min < t <= t_max: surfaces at t = 2 and 4, t_min 0"),
    ("hits = cast(scene, o, d, t_max=t_max)", False, "a hit has t_min < t <= t_max: "),
    ("hits = cast(scene, o, d, t_min=t_min, t_max=np.nextafter(t_max, 0))", True, "a hit is missed at t_max"),
    # t one place off, as rounding may have it, hides nothing
    ("hits = cast(scene, o, d, t_min=t_min, t_max=t_max); hits.t[:] *= 1 + 2**-52", True, f"{len(LIMITS)} rays"),
    ("hits = cast(scene, o, d, t_min=t_min); hits.t[:] *= 1 + 2**-52", False, "a hit has t_min < t <= t_max: "),
]


@pytest.mark.parametrize(("body", "ok", "says"), LIMITED)
def test_limits_of_t_that_a_program_is_given_are_heeded(tmp_path, body, ok, says):
    program = tmp_path / "program.py"
    program.write_text(CASTER.format(body=body))
    words = sys.executable, str(program), "{toml}", "{rays}", "{hits}"
    subject = RayCommand("program", words, "float64", 60.0)
    found = check_ray_limits(subject)
    assert found.ok is ok and found.what.startswith(says), found.what
    assert check_ray_limits(replace(subject, takes_limits=False)) is None


def test_mirrored_rays_whose_t_float32_does_not_resolve_excuse_no_wrong_answer(monkeypatch):
    """Half of the mirrored rays have no bound: of the others, each is wrong."""
    expected = ray_conventions.expected_t

    def some_unbounded(scene, o, d):
        t, off, slope = expected(scene, o, d)
        mirrored = np.arange(len(t)) >= len(LENGTHS) * RAYS
        return t, np.where(mirrored & (np.arange(len(t)) % 3 > 0), np.inf, off), slope

    monkeypatch.setattr(ray_conventions, "expected_t", some_unbounded)
    found = checked(changed(lambda d, t: np.where(d[:, 2] > 0.0, 1.5 * t, t)))
    assert not found.ok and found.what.endswith("rays mirrored in z"), found.what

"""z of groups of errors: what chance gives, what a bias gives, and who has too few groups to tell."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from places import SCENES

from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32
from caster.scene.files import load_scene
from caster.shapes import SHAPES
from caster.shapes.linear_curve import RoundSegments
from mitsuba_ref.error_model.intersections import SAME_NORMAL_TOLERANCE, by_approach, by_matrix, by_normal, single_group
from mitsuba_ref.error_model.tolerances import LARGEST_Z, MIN_GROUPS
from mitsuba_ref.judge.checks.bias import check_bias, kind_biases, untied, z_of_groups
from mitsuba_ref.judge.verdict import KindBias, SceneVerdict, Verdict
from mitsuba_ref.report.verdict_text import failure_text
from mitsuba_ref.shapes import KINDS


def alone(error: np.ndarray) -> tuple[int, float]:
    """Each error is a group of its own."""
    return z_of_groups(np.arange(len(error))[:, None], error)


# ---- z ----


@pytest.mark.parametrize("size", [1e-12, 1.0])
def test_errors_that_are_all_alike_give_the_root_of_their_number_and_no_more(size):
    for count in (1, 9, 400):
        groups, z = alone(np.full(count, -size))
        assert groups == count and z == pytest.approx(-math.sqrt(count))
    assert math.sqrt(MIN_GROUPS - 1) <= LARGEST_Z < math.sqrt(MIN_GROUPS)


def test_a_group_counts_once_however_many_pixels_it_has():
    error = np.r_[np.full(10_000, 0.5), [-0.5]]
    key = np.r_[np.zeros(10_000), [1.0]][:, None]
    assert z_of_groups(key, error) == (2, pytest.approx(0.0, abs=1e-12))
    assert alone(error)[1] > 90.0


def test_chance_does_not_reach_the_limit_however_different_the_groups():
    """At most 2 exp(-x^2 / 2) of all tosses are beyond x (Hoeffding), whatever the groups' sizes."""
    rng = np.random.default_rng(2)
    sizes = 10.0 ** rng.uniform(-4.0, 0.0, 60)
    found = np.array([alone(sizes * rng.choice([-1.0, 1.0], 60))[1] for _ in range(4000)])
    assert np.abs(found).max() < LARGEST_Z
    for x in (1.5, 2.0, 2.5):
        assert 0 < np.mean(np.abs(found) >= x) <= 2.0 * math.exp(-0.5 * x * x)


# ---- groups ----


def groups(key: np.ndarray) -> int:
    return len(np.unique(key, axis=0))


def test_every_kind_of_primitive_has_its_groups():
    scenes = [
        load_scene(SCENES / f"{name}.toml")
        for name in ("every-shape", "ellipsoids", "sphere-clouds", "ellipsoid-clouds", "linear-curves")
    ]
    assert {type(shape) for scene in scenes for shape in scene.shapes} == set(SHAPES)
    kinds = {type(kind.prims) for scene in scenes for kind in pack(scene, as_float32).kinds}
    assert kinds == set(KINDS)
    # of segments, whose roundings are not analysed that far, all hits are one: they are no evidence of a bias
    assert {name for name, kind in KINDS.items() if single_group in kind.rounding_groups} == {RoundSegments}


def test_parallel_faces_and_mirror_images_are_one_group():
    n = np.array([[0.0, 0, 1], [-0.0, 0, 1], [0, 0.6, 0.8], [0, 0.6 + 2.0**-30, 0.8], [0, -0.6, 0.8]])
    assert groups(by_normal(n=n)) == 2
    assert groups(by_normal(n=n[:1] @ np.eye(3)[[1, 2, 0]])) == 1
    turned = np.array([[0.0, 0, 1], [2 * SAME_NORMAL_TOLERANCE, 0, 1]])
    assert groups(by_normal(n=turned)) == 2


def test_primitives_of_one_matrix_are_one_group():
    prims = SimpleNamespace(to_world=np.stack([np.eye(3), np.diag([1.0, -1, 1]), 2.0 * np.eye(3)]))
    assert groups(by_matrix(prims=prims, k=np.array([0, 0, 1, 2]))) == 2


def test_spheres_are_grouped_by_where_the_ray_passes_their_centres():
    """Parallel rays at balls side by side are all solved from one rounded t; rays that spread are not."""
    prims = SimpleNamespace(center=np.array([[0.0, 0, 0], [3, 0, 0]]))
    k = np.array([0, 0, 1])
    o = np.array([[0.1, 0.2, 7], [-0.1, 0.3, 7], [3.1, 0, 7]])
    assert groups(by_approach(prims=prims, k=k, o=o, d=np.tile([0.0, 0, -1], (3, 1)))) == 1
    spread = np.array([[0.0, 0, -1], [0.01, 0, -1], [0.02, 0.01, -1]])
    assert groups(by_approach(prims=prims, k=k, o=np.tile([0.0, 0, 7], (3, 1)), d=spread)) == 3


def test_a_primitive_whose_ties_outweigh_chance_is_no_evidence_and_others_are():
    prim, kind = np.repeat([0, 1, 2], 100), np.repeat([0, 0, 1], 100)
    ties = np.zeros(20, int)  # of primitive 0, in kind 0, which has 200 pixels: 14 may drop out by chance
    assert untied(prim, kind, ties[:14], ties[:14]).all()
    assert np.array_equal(untied(prim, kind, ties[:15], ties[:15]), prim != 0)
    assert untied(prim, kind, ties[:0], ties[:0]).all()


@pytest.mark.parametrize(("off", "biased"), [(0.0, False), (0.4, True)])
def test_excused_pixels_are_no_evidence_and_hide_no_bias_of_the_others(off, biased):
    """A tiny ellipsoid is seen only where rounding made a discriminant positive: those errors all have one sign."""
    rng, count = np.random.default_rng(5), 400
    scene = load_scene(SCENES / "one-sphere.toml")
    d = np.column_stack([rng.uniform(-0.2, 0.2, (count, 2)), -np.ones(count)])  # t differs at each closest approach
    chance = rng.choice([-0.5, 0.5], count) + off
    excused = np.arange(count) % 2 == 0
    hit, zero, one = np.ones(count, bool), np.zeros(count), np.ones(count)
    judge = SimpleNamespace(
        scene=scene,
        model=SimpleNamespace(packed=pack(scene, as_float32)),
        answer=SimpleNamespace(t=one),
        result=SimpleNamespace(
            t=1.0 + np.where(excused, np.abs(chance), chance),
            hit=hit,
            answer=SimpleNamespace(versions={"variant": "scalar_rgb"}),
        ),
        at=SimpleNamespace(t_error=one, n_error=one),
        own=SimpleNamespace(n=d),
        o=np.zeros((count, 3)),
        d=d,
        prim=np.zeros(count, np.int32),
        sides=lambda name: (zero, zero),
        distance=lambda name: zero,
    )
    assert not check_bias(kind_biases(judge, ~hit)).ok
    assert check_bias(kind_biases(judge, excused)).ok is not biased


# ---- what is recorded and checked ----


def test_the_check_fails_on_a_bias_and_states_of_what():
    for z in (5.1, -15.0):
        found = check_bias((KindBias("Spheres", 900, z), KindBias("Disks", 1, 1.0)))
        assert found.name == "bias" and not found.ok and found.ratio == pytest.approx(abs(z) / 5.0)
        assert found.what == f"t of Spheres is biased: z {z:.1f} of 900 groups, 5 at most by chance"
    within = check_bias((KindBias("Spheres", 900, -4.9), KindBias("Disks", 1, 1.0)))
    assert within.ok and within.what == "Spheres z -4.9 of 900 groups; Disks z 1.0 of 1 groups, too few to tell"
    assert check_bias(()).ok


def test_a_kind_with_few_groups_is_recorded_and_never_the_one_with_the_largest_bias():
    few, many = KindBias("Planes", MIN_GROUPS - 1, 4.9), KindBias("Triangles", MIN_GROUPS, -2.0)
    assert (few.enough_groups, many.enough_groups) == (False, True)
    assert check_bias((few, many)).ratio == 0.4 and check_bias((few,)).ratio == 0.0


def test_the_verdict_reports_it():
    biased = (KindBias("Spheres", 900, -15.0),)
    scene = SceneVerdict("ball", "ball.toml", checks=(check_bias(biased),), biases=biased)
    verdict = Verdict((scene,))
    (record,) = json.loads(json.dumps(verdict.to_dict(), allow_nan=False))["scenes"]
    assert record["biases"] == [
        {"kind": "Spheres", "groups": 900, "z": -15.0, "quantity": "t", "t_bias": 0.0, "enough_groups": True}
    ]
    assert (
        not scene.checks_pass
        and "bias: 3x its bound; t of Spheres is biased: z -15.0 of 900 groups" in failure_text(scene)
    )

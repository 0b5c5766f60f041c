"""Random scenes for `mitsuba-ref fuzz`: the same for the same numbers, of every kind there is, and full of trouble."""

import collections
import itertools

import numpy as np
import pytest

from caster.cameras import CAMERAS
from caster.description.errors import SceneError
from caster.geometry.packing import pack
from caster.shapes import SHAPES
from mitsuba_ref.fuzz.campaign import check_example
from mitsuba_ref.fuzz.families import BY_NAME, FAMILIES, example, scene_of
from mitsuba_ref.fuzz.findings import Tally
from mitsuba_ref.fuzz.settings import random_camera, random_setting, random_shape
from mitsuba_ref.judge.checks.adversarial_rays import Setting, perturbed_by_ulps
from mitsuba_ref.shapes import KINDS, kind_of

FEW = 8  # examples of each family


def drawn(families=FAMILIES, count=None, seed=3):
    return [example(seed, number, families) for number in range(count or FEW * len(families))]


@pytest.fixture(scope="module")
def examples():
    return drawn()


def test_an_example_is_the_same_whenever_it_is_made(examples):
    for number, (tried, again) in enumerate(zip(examples, drawn(), strict=True)):
        assert tried.data == again.data
        if number % 4:
            continue
        shots, same = (each.rays(pack(scene_of(each.data))) for each in (tried, again))
        assert all(np.array_equal(a, b) for a, b in zip(shots, same, strict=True))


def test_an_example_is_the_same_when_its_family_is_requested_alone(examples):
    """So the options that a failure is reported with make the very scene again."""
    for tried in examples:
        alone = example(tried.seed, tried.number, [tried.family])
        assert alone.data == tried.data and alone.family is tried.family


def test_other_seeds_and_numbers_give_other_examples():
    texts = [repr(each.data) for each in (*drawn(seed=1), *drawn(seed=2))]
    assert len(set(texts)) == len(texts)


def test_every_kind_of_shape_and_camera_is_drawn(examples):
    counted = collections.Counter(shape["type"] for each in examples for shape in each.data["shape"])
    assert set(counted) == {cls.model_fields["type"].default for cls in SHAPES}
    seen = {each.data["camera"]["type"] for each in examples}
    assert seen == {cls.model_fields["type"].default for cls in CAMERAS}


def test_every_kind_of_primitive_has_places_to_aim_at(examples):
    kinds = {type(part) for each in examples for part in pack(scene_of(each.data)).parts}
    assert kinds == set(KINDS)


def test_transforms_are_mirrored_and_reach_a_condition_of_a_million():
    matrices = [
        shape.matrix[:3, :3] for each in drawn([BY_NAME["transforms"]], 60) for shape in scene_of(each.data).shapes
    ]
    assert max(np.linalg.cond(matrix) for matrix in matrices) > 1e5
    assert sum(np.linalg.det(matrix) < 0.0 for matrix in matrices) > len(matrices) / 4


def test_settings_span_decades_of_size_and_offset():
    settings = [random_setting(np.random.default_rng([9, i])) for i in range(300)]
    sizes = [setting.size for setting in settings]
    away = [np.abs(setting.center).max() / setting.size for setting in settings]
    assert min(sizes) < 1e-2 and max(sizes) > 1e2 and max(away) > 1e5
    assert sum(setting.lattice for setting in settings) > 100


def test_rays_are_strange_where_they_should_be(examples):
    shots = [each.rays(pack(scene_of(each.data))) for each in examples[::2]]
    d = np.concatenate([each.d for each in shots])
    assert np.isfinite(d).all() and d.any(axis=1).all()
    length = np.abs(d).max(axis=1)
    assert (length < 1e-9).any() and (length > 1e9).any()
    assert ((d == 0.0) & np.signbit(d)).any(), "no -0.0"
    assert ((d != 0.0) & (np.abs(d) < np.finfo(float).tiny)).any(), "no denormal component"


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
@pytest.mark.slow("each decides some hundred rays exactly", every=2)
def test_a_family_finds_trouble_to_check_example(family):
    """Hits on edges, corners, rims and tangents, or several at once; no scene is thrown away."""
    tally = Tally()
    for number in range(FEW):
        check_example(example(8, number, [family]), tally)
    assert tally.rays >= 60 * FEW and tally.hits >= tally.rays / 8
    assert tally.edges + tally.ties >= 6
    assert tally.outside == 0


def test_lattice_coordinates_differ_without_rounding():
    """Which is what makes a ray from one to another pass exactly through it."""
    setting = Setting(size=0.25, lattice=True)
    points = setting.on_lattice(np.random.default_rng(1).uniform(-4.0, 4.0, (200, 3)))
    for a, b in itertools.pairwise(points):
        assert np.array_equal(a + (b - a), b)


def test_nudged_moves_by_units_in_the_last_place():
    x = np.array([1.0, -3.5, 0.0, 1e300, 5e-324])
    moved = np.array([perturbed_by_ulps(np.random.default_rng(i), x, 2) for i in range(50)])
    assert np.all(np.abs(moved - x) <= 2.0 * np.spacing(np.abs(x)))
    assert np.all((moved != x).any(axis=0))


@pytest.mark.parametrize(
    ("draw", "says"),
    [
        (lambda rng: random_shape(rng, "cone", Setting()), r"type 'cone' .*mitsuba_ref.shapes"),
        (lambda rng: random_camera(rng, Setting(), ["drone"]), r"type 'drone' .*mitsuba_ref.cameras"),
        (lambda rng: kind_of(Setting()), r"Setting: .*mitsuba_ref.shapes .*adding-a-shape"),
    ],
)
def test_what_cannot_be_drawn_is_named_with_what_to_write(draw, says):
    with pytest.raises((SceneError, LookupError), match=says):
        draw(np.random.default_rng(1))

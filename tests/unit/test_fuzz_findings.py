"""What `mitsuba-ref fuzz` holds against an answer: each kind of wrong answer has its name, right ones have none."""

import numpy as np
import pytest

from caster.geometry.packing import pack
from caster.scene.model import Scene
from mitsuba_ref.fuzz import checks
from mitsuba_ref.fuzz.checks import adjudicate, check_rays, check_surfaces
from mitsuba_ref.fuzz.findings import FINDING_KINDS, Finding, Tally, first_of_each_kind
from mitsuba_ref.judge.checks.adversarial_rays import RayBatch
from mitsuba_ref.judge.checks.knife_edges import NearestHits, cast_by_culling, prepared_scene
from mitsuba_ref.judge.checks.routes import RouteDifference
from mitsuba_ref.judge.checks.scaling import Difference
from mitsuba_ref.oracle.oracle import Oracle

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


def rays(d=1.0):
    o = np.column_stack([AT, np.full(4, -2.0)])
    return RayBatch(o, np.tile([0.0, 0.0, d], (4, 1)), np.zeros(4), np.full(4, np.inf))


@pytest.fixture(scope="module")
def subject():
    return prepared_scene(Scene.model_validate(SCENE))


def found_by(subject, t, prim):
    tally = Tally()
    findings = adjudicate(subject, rays(), NearestHits(np.array(t), np.array(prim)), tally)
    return [(int(np.flatnonzero((rays().o == f.ray.o[0]).all(axis=1))[0]), f.kind) for f in findings], tally


RIGHT = [2.0, 2.0, 2.0, np.inf], [0, 0, 0, -1]


def test_a_right_answer_is_left_alone(subject):
    found, tally = found_by(subject, *RIGHT)
    assert found == []
    assert (tally.rays, tally.hits, tally.edges, tally.ties) == (4, 3, 1, 3)


@pytest.mark.parametrize(
    ("row", "t", "prim", "kind"),
    [
        (0, np.inf, -1, "missed"),
        (3, 2.0, 1, "phantom"),
        (0, 2.0, 2, "prim"),  # of the tied the higher
        (2, 2.0, 1, "prim"),
        (1, 2.0 + 2.0**-44, 0, "t"),
        (1, np.inf, 0, "t"),
        (1, np.nan, 0, "t"),
        (1, -2.0, 0, "t"),
    ],
)
def test_a_wrong_answer_is_found_and_named(subject, row, t, prim, kind):
    answers = [list(column) for column in RIGHT]
    answers[0][row], answers[1][row] = t, prim
    assert found_by(subject, *answers)[0] == [(row, kind)]


def test_the_last_bits_of_t_are_free_and_no_more(subject):
    """4 units in the last place of o, d and the corners, times their condition: here some 20 of t."""
    bits = [k for k in range(1, 60) if not found_by(subject, [2.0 + k * 2.0**-51, 2.0, 2.0, np.inf], RIGHT[1])[0]]
    assert bits == list(range(1, len(bits) + 1)) and 4 <= len(bits) <= 40


def test_limits_are_compared_exactly(subject):
    """A hit at t = 2 lies within t <= 2 and without t > 2."""
    for t_min, t_max, hit in ((0.0, 2.0, True), (2.0, np.inf, False), (np.nextafter(2.0, 0.0), 2.0, True)):
        shots = rays()._replace(t_min=np.full(4, t_min), t_max=np.full(4, t_max))
        ours = NearestHits(*(np.array(column) for column in RIGHT))
        kinds = [finding.kind for finding in adjudicate(subject, shots, ours, Tally())]
        assert kinds == ([] if hit else 3 * ["phantom"])


def test_a_bit_between_two_cullings_is_found(subject, monkeypatch):
    def off_by_a_bit(packed, shots, culling):
        found = cast_by_culling(packed, shots, culling)
        return found if culling == "bvh" else NearestHits(np.nextafter(found.t, 0.0), found.prim)

    monkeypatch.setattr(checks, "cast_by_culling", off_by_a_bit)
    kinds = [finding.kind for finding in check_rays(subject, rays(), Tally())]
    assert kinds == 4 * ["culling"], "t of a miss counts, too"


def test_a_bit_between_two_images_is_found(subject, monkeypatch):
    usual = checks.render

    def off_by_a_bit(scene, names, *, culling, threads):
        images = usual(scene, names, culling=culling, threads=threads)
        if culling == "raster":
            images["position"][1, 2, 0] = np.nextafter(images["position"][1, 2, 0], 9.0)
        return images

    monkeypatch.setattr(checks, "render", off_by_a_bit)
    (finding,) = checks.check_image(subject, Tally())
    assert finding.kind == "culling" and finding.pixel == (2, 1) and "position" in finding.what


def test_what_another_scale_or_another_route_shows_is_found(subject, monkeypatch):
    scaled = [Difference(30, "depth", np.array([6]))]
    routes = [RouteDifference("caster.cast(scene, o, d).t", "depth", 1, 2, "5.0", "6.0", 1)]
    monkeypatch.setattr(checks, "scaling_differences", lambda scene, exponents: scaled)
    monkeypatch.setattr(checks, "route_differences", lambda scene: routes)
    found = checks.check_image(subject, Tally())
    assert [(each.kind, each.pixel) for each in found] == [("scaling", (2, 1)), ("route", (1, 2))]


def test_a_wrong_depth_in_all_images_is_found(subject, monkeypatch):
    usual = checks.render

    def too_deep(scene, names, **options):
        images = usual(scene, names, **options)
        images["depth"][1, 2] *= 1.0 + 2.0**-40
        return images

    monkeypatch.setattr(checks, "render", too_deep)
    (finding,) = checks.check_image(subject, Tally())
    assert finding.kind == "t" and finding.pixel == (2, 1) and finding.ray is not None


def test_a_normal_of_another_length_is_found(subject, monkeypatch):
    usual = checks.cast

    def longer(scene, o, d):
        hits = usual(scene, o, d)
        hits.surface.n[1] *= 1.0 + 2.0**-40
        return hits

    monkeypatch.setattr(checks, "cast", longer)
    (finding,) = check_surfaces(subject.scene, rays())
    assert finding.kind == "surface" and np.array_equal(finding.ray.o[0], rays().o[1])


def test_the_caster_itself_is_right_about_this_square(subject):
    tally = Tally()
    assert check_rays(subject, rays(), tally, np.random.default_rng(1)) == []
    assert tally.rays == 4 + 3, "three hits are cast again with limits"
    assert checks.check_image(subject, tally) == []
    assert tally.rays == 4 + 3 + 16


def test_one_of_each_kind_is_reported_first_things_first():
    findings = [Finding("t", "a"), Finding("missed", "b"), Finding("t", "c")]
    assert [(f.kind, f.what) for f in first_of_each_kind(findings)] == [("missed", "b"), ("t", "a")]
    assert next(iter(FINDING_KINDS)) == "error"


def test_subjects_share_what_is_packed(subject):
    assert isinstance(subject.oracle, Oracle)
    assert subject.packed.first[-1] == pack(subject.scene).first[-1] == 3


def test_the_largest_error_of_t_is_reported_in_units_of_its_bound(subject):
    """A t that is a bit off counts by its bound, a miss and another primitive do not; of several the largest."""
    told = []
    for t in (RIGHT[0], [2.0 + 2.0**-51, 2.0, 2.0, np.inf], [2.0, 2.0, 2.0 + 2.0**-30, np.inf]):
        tally = Tally()
        adjudicate(subject, rays(), NearestHits(np.array(t), np.array(RIGHT[1])), tally)
        told.append(tally.worst)
    assert told[0] == 0.0 < told[1] < 1.0 < told[2] < np.inf
    tally.add(Tally(worst=2.0 * told[2]))
    tally.add(Tally(worst=0.5))
    assert tally.worst == 2.0 * told[2]

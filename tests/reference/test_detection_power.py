"""Faults that the comparison with Mitsuba detects without our own float64 bounds and without exact arithmetic.

Faults are planted in what ours is traced from, or along which rays; the reference and the bounds get the right numbers.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from places import SCENES, SHIPPED, shipped

import caster
from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32
from caster.kernels.nearest import Rays
from caster.rendering.hits import RayHits, trace_rays
from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.error_model.tolerances import LARGEST_Z, MIN_GROUPS, U32
from mitsuba_ref.judge.checks.bias import check_bias, kind_biases
from mitsuba_ref.judge.classification import Judge
from mitsuba_ref.judge.comparison import check_ratios, pair_images
from mitsuba_ref.judge.verdict import KindBias
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import SendRequest
from mitsuba_ref.reference.rendering import ReferenceResult, trace_reference
from mitsuba_ref.reference.shared_input import SharedRays, model_of, shared_rays
from mitsuba_ref.subjects.subject import answer_of_view, cast_ours


class Asked:
    """A scene with Mitsuba's answer, asked for once; ours is traced anew for each fault."""

    def __init__(self, send: SendRequest, name: str, width: int, height: int, more: Sequence[Any] = ()):
        scene = shipped(name, width, height)
        self.scene: Scene = scene.model_copy(update={"shapes": [*scene.shapes, *more]})
        self.rays: SharedRays = shared_rays(self.scene)
        self.model: SceneModel = model_of(self.scene, self.rays)
        answer = trace_reference(self.scene, self.model, self.rays, send=send)
        assert not isinstance(answer, Crash), answer
        self.witness: ReferenceResult = answer

    def judge(self, view: RayHits) -> Judge:
        """Ours as it is seen there, the reference's bounds of the right geometry along the right rays."""
        return Judge(
            self.scene, self.model, pair_images(self.scene, self.rays, answer_of_view(self.scene, view), self.witness)
        )

    def altered(self, alter: Callable[[Any], None]) -> RayHits:
        """Ours traced through packed arrays that `alter` has changed, a kind at a time; float64, not rounded again."""
        faulty = pack(self.scene, as_float32)
        for kind in faulty.kinds:
            alter(kind.prims)
        limits = np.zeros(len(self.rays.o)), self.rays.t_max.astype(np.float64)
        rays = Rays(self.rays.o.astype(np.float64), self.rays.d.astype(np.float64), *limits)
        return trace_rays(self.scene, faulty, rays, self.rays.start)

    def grown(self, share: float) -> RayHits:
        """Hits of balls that are larger by this share of their radius."""

        def grow(prims: Any) -> None:
            prims.radius[:] *= 1.0 + share

        return self.altered(grow)

    def farther(self, share: float, witness: ReferenceResult | None = None) -> list[KindBias]:
        """Of our t as they are, but larger by this share of themselves, and of another answer of Mitsuba's if given."""
        answer = answer_of_view(self.scene, self.view)
        answer = replace(answer, t=answer.t * (1.0 + share))
        pair = pair_images(self.scene, self.rays, answer, witness or self.witness)
        return biases(Judge(self.scene, self.model, pair))

    @cached_property
    def view(self) -> RayHits:
        """Hits of our caster, unaltered."""
        return cast_ours(self.scene, self.rays)

    def shifted(self, pixels: float) -> RayHits:
        """Pixel centres to the side by so many pixels; rays in float32 as ever."""
        camera = self.scene.camera
        assert isinstance(camera, caster.Pinhole)
        across, above = camera.principal_point
        moved = camera.model_copy(update={"principal_point": (across + pixels / self.scene.film.width, above)})
        return cast_ours(self.scene, shared_rays(self.scene.model_copy(update={"camera": moved})))


def biases(judge: Judge) -> list[KindBias]:
    """Of all pixels: exact arithmetic, which excuses some, is left out here."""
    return kind_biases(judge, np.zeros(len(judge.hit), bool))


def beyond(judge: Judge) -> np.ndarray:
    """(hits,) bool: whether t is beyond its bound, where both hit."""
    found: np.ndarray = check_ratios(judge)["depth"][judge.both_hit] > 1.0
    return found


def errors(asked: Asked, view: RayHits) -> list[KindBias]:
    return biases(asked.judge(view))


def z_of(found: list[KindBias]) -> float:
    """The largest bias of the kinds with enough groups."""
    return max((each.z for each in found if each.enough_groups), key=abs, default=0.0)


@pytest.fixture(scope="module")
def ball(send) -> Asked:
    return Asked(send, "one-sphere", 256, 256)


def test_the_right_caster_is_within_every_bound_and_not_biased(ball):
    view = cast_ours(ball.scene, ball.rays)
    found = errors(ball, view)
    print(f"\nright: z {z_of(found):.1f}")
    assert not beyond(ball.judge(view)).any()
    assert abs(z_of(found)) < LARGEST_Z and check_bias(found).ok


def test_a_radius_off_by_three_millionths_is_beyond_the_bound_at_every_hit(ball):
    found = beyond(ball.judge(ball.grown(3e-6)))
    assert found.all() and len(found) >= 30_000


@pytest.mark.parametrize(("share", "least"), [(1e-8, 10.0), (1e-7, 100.0)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_radius_off_by_less_than_float32_resolves_is_a_bias(ball, share, least, side):
    """No single pixel shows it."""
    view = ball.grown(side * share)
    found = errors(ball, view)
    print(f"\nradius {side * share:+.0e}: z {z_of(found):.1f}")
    assert not beyond(ball.judge(view)).any()
    assert side * z_of(found) > least and not check_bias(found).ok


@pytest.mark.parametrize(("share", "biased"), [(0.0, False), (1e-7, True)])
def test_spheres_at_the_same_place_are_no_bias_and_hide_none_of_another_sphere(send, share, biased):
    """The reference chooses one of the two by the sign of a rounding: pixels of the other are biased by selection."""
    (first,) = load_scene(SCENES / "one-sphere.toml").shapes
    x, y, z = first.center
    twin = first.model_copy(update={"name": "twin"})
    third = caster.Sphere(center=(x + 0.3, y + 0.3, z + 1.8), radius=0.4)  # in front of a part of both
    asked = Asked(send, "one-sphere", 96, 96, [twin, third])
    judge = asked.judge(asked.grown(share))
    names = [images["shape_id"].ravel() for images in (judge.subject, judge.pair.reference)]
    assert np.sum(names[0] != names[1]) >= 1000  # many are tied
    found = errors(asked, asked.grown(share))
    print(f"\ntwo at one place and another, larger by {share:g}: {found}")
    assert [bias.enough_groups for bias in found] == [True]
    assert check_bias(found).ok is not biased and (abs(z_of(found)) > 2.0 * LARGEST_Z) is biased


def test_pixel_centres_off_by_a_thousandth_are_beyond_the_bound_at_most_hits(ball):
    found = beyond(ball.judge(ball.shifted(1e-3)))
    print(f"\npixel centre 1e-3: {found.mean():.3f}")
    assert found.mean() > 0.5 and len(found) >= 30_000


def bias_of(found: list[KindBias], quantity: str) -> KindBias | None:
    """Of the kind that is traced as triangles, or of one whose t is tested; None if it has too few groups."""
    return next((each for each in found if each.quantity == quantity and each.enough_groups), None)


def test_no_reciprocal_is_blamed_on_ours_and_faults_of_both_signs_are_found_all_the_same(send):
    """Over 9 / 512 Embree divides throughout this map. No float32 is nearer to 1 / 9 than by an eighth of a rounding,
    so its t are biased on every CPU: by +0.19 with AVX-512 and by -1.03 without, of z +6.0 and -6.4 in groups of t."""
    asked = Asked(send, "map-from-above", 160, 120)
    found = {share: bias_of(asked.farther(share), "position") for share in (0.0, 1e-8, -1e-8)}
    print(f"\nmap: {found}")
    assert abs(found[0.0].t_bias) > 0.1 and abs(found[0.0].z) < UNFAULTED_Z and found[0.0].groups >= 5000
    assert found[1e-8].z < -10.0 * LARGEST_Z and found[-1e-8].z > 10.0 * LARGEST_Z


@pytest.mark.parametrize("roundings", [-2.5, 1.0])
def test_a_bias_of_mitsubas_t_of_triangles_is_recorded_and_no_failure(send, roundings):
    """Another instruction set may have such a bias: only the record changes."""
    asked = Asked(send, "torus-smooth", 160, 120)
    right = bias_of(asked.farther(0.0), "position")
    witness = replace(asked.witness, t=asked.witness.t * (1.0 + roundings * U32))
    found = asked.farther(0.0, witness)
    assert bias_of(found, "position").z == pytest.approx(right.z, abs=0.1) and check_bias(found).ok
    assert bias_of(found, "position").t_bias - right.t_bias == pytest.approx(roundings, abs=0.05)


def test_a_bias_of_mitsubas_t_of_spheres_is_one_still(ball):
    found = ball.farther(0.0, replace(ball.witness, t=ball.witness.t * (1.0 - 1.0 * U32)))
    assert bias_of(found, "position") is None
    assert bias_of(found, "t").z < -10.0 * LARGEST_Z and not check_bias(found).ok


# Where nothing is wrong, on any instruction set: chance goes beyond it once in 1500 times (2 exp(-4^2 / 2)).
UNFAULTED_Z = 4.0
# |z| is at most the root of the number of groups: from this on, half of that is enough.
GROUPS_THAT_TELL = 4 * MIN_GROUPS
ROUNDED_TOO_COARSELY = "far-from-origin"  # positions, to 1e4 times as much as distances


@pytest.mark.slow("every shipped scene", every=25)
@pytest.mark.parametrize("name", [path.stem for path in SHIPPED])
def test_ours_off_by_a_hundred_millionth_is_a_bias_and_right_it_is_none(send, name):
    """In each scene with groups of triangles that tell."""
    scene = load_scene(SCENES / f"{name}.toml")
    asked = Asked(send, name, scene.film.width, scene.film.height)
    found = [asked.farther(share) for share in (0.0, 1e-8, -1e-8)]
    right, farther, nearer = (bias_of(each, "position") for each in found)
    assert abs(z_of(found[0])) < UNFAULTED_Z, found[0]
    if right is not None and farther is not None and nearer is not None:
        print(f"\n{name}: z {right.z:.1f}, {farther.z:.1f}, {nearer.z:.1f} of {right.groups}; t {right.t_bias:+.3f}")
        if right.groups >= GROUPS_THAT_TELL and name != ROUNDED_TOO_COARSELY:
            assert farther.z < -LARGEST_Z and nearer.z > LARGEST_Z


@pytest.mark.parametrize(("share", "biased"), [(0.0, False), (3e-8, True)])
def test_a_mesh_that_is_nearer_by_less_than_float32_resolves_is_a_bias(send, share, biased):
    """Each face has an error of its own, for all rays; there are enough faces that these have to cancel."""
    asked = Asked(send, "torus-smooth", 160, 120)
    eye = np.array(asked.scene.camera.eye)

    def pull(prims: Any) -> None:
        prims.vertices[:] += share * (eye - prims.vertices)

    judge = asked.judge(asked.altered(pull))
    found = biases(judge)
    print(f"\nmesh nearer by {share:g}: z {z_of(found):.1f} of {found}")
    assert [bias.enough_groups for bias in found] == [True]
    assert check_bias(found).ok is not biased and (z_of(found) > 2.0 * LARGEST_Z) is biased

"""The check knife_edges aims at every kind of primitive, is reproducible and finds errors."""

from fractions import Fraction

import numpy as np
import pytest

from caster.geometry.packing import packed
from caster.scene.model import Scene
from mitsuba_ref.hard.rays import endless
from mitsuba_ref.judge.checks import knife_edges as module
from mitsuba_ref.judge.checks.knife_edges import cast_by_culling, check_knife_edges, rays_at_edges
from mitsuba_ref.oracle.oracle import Oracle

SHAPES = [
    {"type": "sphere", "center": [0.0, 0.0, 0.0], "radius": 0.5},
    {"type": "triangle", "vertices": [[-1.0, -1.0, -1.0], [1.0, -1.0, -1.0], [0.0, 1.0, -1.0]]},
    {"type": "disk", "to_world": [{"translate": [2.0, 0.0, 0.0]}]},
    {"type": "cylinder", "to_world": [{"translate": [-3.0, 0.0, 0.0]}]},
]


def scene_of(shapes=SHAPES, size=16):
    camera = {"type": "pinhole", "eye": [0.0, 0.0, 5.0], "direction": [0.0, 0.0, -1.0]}
    return Scene.model_validate({"film": {"width": size, "height": size}, "camera": camera, "shape": shapes})


def test_rays_depend_on_the_geometry_alone():
    first, second = (rays_at_edges(scene_of()) for _ in range(2))
    moved = rays_at_edges(scene_of([*SHAPES[1:], {"type": "sphere", "radius": 0.25}]))
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    assert not np.array_equal(first.d, moved.d)


def test_many_rays_hit_edges_rims_and_tangents_of_every_shape():
    scene = scene_of(size=40)
    hits = [hit for answer in Oracle(packed(scene)).first_hits(*rays_at_edges(scene)) for hit in answer.ties]
    assert {hit.prim for hit in hits} == {0, 1, 2, 3}
    assert sum(hit.where != "inside" for hit in hits) >= 20


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda hits: hits._replace(t=np.nextafter(hits.t, np.inf) * (1.0 + 1e-9)), "off"),
        (lambda hits: hits._replace(prim=np.full_like(hits.prim, -1), t=np.full_like(hits.t, np.inf)), "ours misses"),
        (lambda hits: hits._replace(prim=np.where(hits.prim == 2, 3, hits.prim)), "ours hits primitive 3"),
        (lambda hits: hits._replace(t=np.where(hits.prim == 1, np.nan, hits.t)), "nan off"),
    ],
)
def test_a_wrong_hit_fails_with_a_scene_of_its_ray(monkeypatch, spoil, words):
    failures = []
    assert check_knife_edges(scene_of(), failures).ok and not failures
    monkeypatch.setattr(module, "cast_by_culling", lambda *given: spoil(cast_by_culling(*given)))
    check = check_knife_edges(scene_of(), failures)
    assert not check.ok and words in check.what
    assert failures and all(failure.scene.camera.type == "ray" for failure in failures)


def test_nothing_to_aim_at_is_no_failure():
    check = check_knife_edges(scene_of([]), [])
    assert check.ok and check.what == "no primitive to aim at"


def test_directions_too_short_or_long_to_square_give_the_bits_of_t_that_they_have_themselves():
    """t of a direction 2^-k as long is 2^k times as large; also where t is denormal for the scaled direction."""
    numbers = packed(scene_of())
    plain = np.array([[0.01 * k, 0.02, -1.0] for k in range(-8, 9)])
    o = np.tile([0.0, 0.0, 5.0], (len(plain), 1))

    expected = cast_by_culling(numbers, endless(o, plain), "brute-force")
    assert (expected.prim >= 0).all()
    for power in (-900, -300, 0, 300, 900):
        found = cast_by_culling(numbers, endless(o, np.ldexp(plain, power)), "brute-force")
        assert np.array_equal(found.prim, expected.prim)
        assert np.array_equal(found.t, np.ldexp(expected.t, -power))


def test_a_hit_so_near_that_the_scaled_t_is_denormal_keeps_the_bits_of_t():
    numbers = packed(scene_of([{**SHAPES[1], "vertices": [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]}]))
    for power in (-900, -400):
        d = np.ldexp([[0.01, 0.02, -0.7], [0.0, -0.03, -0.9]], power)
        o = np.tile([0.125, 0.0625, 3.0 * 2.0**-1060], (2, 1))
        found = cast_by_culling(numbers, endless(o, d), "brute-force")
        expected = [float(Fraction(3) / 2**1060 / -Fraction(float(z))) for z in d[:, 2]]
        assert found.t.tolist() == pytest.approx(expected, rel=1e-14, abs=0.0)

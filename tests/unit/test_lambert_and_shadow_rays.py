"""The judge's radiance against the textbook, and Mitsuba's shadow rays against its constants."""

import math
from typing import Any

import numpy as np
import pytest
from aimed_rays import direction
from places import scene_of

from mitsuba_ref.error_model import lambert
from mitsuba_ref.error_model.bracket import Bracket
from mitsuba_ref.error_model.intersections import without_edges
from mitsuba_ref.error_model.lambert import ShadingPoints, light_contribution
from mitsuba_ref.error_model.scene_model import OUR_SIDE
from mitsuba_ref.error_model.tolerances import KU
from mitsuba_ref.reference.shared_input import own_model, packed_float32

LIGHTS = [
    {"type": "point", "position": [1.3, 2.1, 0.4], "intensity": [10, 20, 5]},
    {"type": "directional", "direction": [1, -3, 0.5], "irradiance": [1, 2, 3]},
    {"type": "ambient", "radiance": [0.1, 0.2, 0.3]},
    {"type": "ambient", "radiance": [0.01, 0.0, 0.02]},
]
MATERIALS = {"one": {"reflectance": [0.5, 0.25, 0.75]}, "both": {"reflectance": [0.2, 0.9, 0.4], "two_sided": True}}
SCENE = scene_of(*({"type": "sphere", "material": name} for name in MATERIALS), lights=LIGHTS, materials=MATERIALS)
COUNT = 600
SHAPE = np.arange(COUNT) % 2  # which of the materials a point has
REFLECTANCE = np.array([material["reflectance"] for material in MATERIALS.values()])[SHAPE]


def units(rng: np.random.Generator) -> np.ndarray:
    return direction(rng, COUNT)


def hits(p: Any, d: Any, sh_n: Any, p_error: float, sh_error: float) -> ShadingPoints:
    flat, none = np.zeros(COUNT), np.zeros(COUNT, bool)
    errors = np.full(COUNT, sh_error)
    at = without_edges(flat, flat, sh_n, errors, ~none, ~none, np.full(COUNT, p_error), sh_n, flat)
    return ShadingPoints(p, d, at, REFLECTANCE, SHAPE == 1)


def some(rng: np.random.Generator, p_error: float = 0.0, sh_error: float = 0.0) -> ShadingPoints:
    return hits(rng.uniform(-1.0, 1.0, (COUNT, 3)), 3.0 * units(rng), units(rng), p_error, sh_error)


def radiance(light: dict[str, Any], material: dict[str, Any], p: Any, d: Any, n: Any) -> list[float]:
    """By hand, for one point: reflectance / pi * cosine * irradiance, 0 on the unlit side."""
    if light["type"] == "point":
        way = [a - b for a, b in zip(light["position"], p, strict=True)]
        away = math.hypot(*way)
        arriving = [i / away**2 for i in light["intensity"]]
    else:
        way, away = [-c for c in light["direction"]], math.hypot(*light["direction"])
        arriving = light["irradiance"]
    cosine = math.fsum(a * b for a, b in zip(way, n, strict=True)) / away
    facing = -math.fsum(a * b for a, b in zip(d, n, strict=True))
    if facing < 0.0 and material.get("two_sided"):
        cosine, facing = -cosine, -facing
    if cosine <= 0.0 or facing <= 0.0:
        return [0.0, 0.0, 0.0]
    return [r / math.pi * cosine * e for r, e in zip(material["reflectance"], arriving, strict=True)]


@pytest.mark.parametrize("light", [0, 1], ids=["point", "directional"])
def test_radiance_is_that_of_the_textbook(light):
    hit = some(np.random.default_rng([140, light]))
    found = light_contribution(SCENE.lights[light], hit, KU)
    materials = list(MATERIALS.values())
    expected = np.array(
        [radiance(LIGHTS[light], materials[i % 2], hit.p[i], hit.d[i], hit.at.sh_n[i]) for i in range(COUNT)]
    )
    assert np.allclose(found.radiance, expected, rtol=1e-14, atol=0.0)
    assert 0.3 < np.mean(expected[:, 0] > 0.0) < 0.7
    assert found.reach[0] == (1.0, np.inf)[light]


@pytest.mark.parametrize("light", [0, 1], ids=["point", "directional"])
@pytest.mark.parametrize("error", [1e-6, 1e-4, 1e-2])
def test_the_bound_holds_for_points_and_normals_that_are_off_by_theirs(light, error):
    """And is not far from what happens: some point uses more than half of it."""
    rng = np.random.default_rng([141, light])
    hit = some(rng, error, error)
    found = light_contribution(SCENE.lights[light], hit, KU)
    used = np.zeros(COUNT)
    for _ in range(10):
        n = hit.at.sh_n + error * units(rng)
        moved = hits(hit.p + error * units(rng), hit.d, n, 0.0, 0.0)
        change = np.abs(light_contribution(SCENE.lights[light], moved, KU).radiance - found.radiance)
        sure = ~found.doubtful  # where either side may be seen, the judge tries both
        with np.errstate(invalid="ignore"):
            share = np.where(change[sure] == 0.0, 0.0, change[sure] / found.error[sure]).max(axis=1)
        assert share.max() <= 1.0
        used[sure] = np.maximum(used[sure], share)
    assert used.max() > 0.5


@pytest.mark.parametrize(
    ("n", "d", "p_error", "error", "doubtful"),
    [
        ((1.0, 0.0, -0.25 - KU), (-1.0, 0.0, 0.0), 0.0, 0.25 + KU, False),  # behind by exactly its error
        ((1.0, 0.0, -0.25 - 2.0 * KU), (-1.0, 0.0, 0.0), 0.0, 0.0, False),
        ((0.25 + KU, 0.0, -1.0), (-1.0, 0.0, 0.0), 0.0, 0.25 + KU, True),  # from the side by exactly its error
        ((0.25 + 2.0 * KU, 0.0, -1.0), (-1.0, 0.0, 0.0), 0.0, 0.0, False),
        ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.25, math.inf, False),  # its direction is off by 1/2
        ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.125, (1.5 + KU) / 0.5625 - 1.0 + KU, False),
    ],
)
def test_the_bound_at_its_limits(n, d, p_error, error, doubtful):
    """A light of flux pi at a distance of 1, above; sh_error is 1/4."""
    light = SCENE.lights[0].model_copy(update={"position": (0.0, 0.0, 1.0), "intensity": (math.pi,) * 3})
    hit = hits(np.zeros((COUNT, 3)), np.tile(d, (COUNT, 1)), np.tile(n, (COUNT, 1)), p_error, 0.25)
    white = hit._replace(reflectance=np.ones((COUNT, 3)), two_sided=np.zeros(COUNT, bool))
    found = light_contribution(light, white, KU)
    assert np.all(found.error == pytest.approx(error, rel=1e-14)) and (found.doubtful == doubtful).all()


def test_what_lies_well_beyond_the_start_is_certain_to_shadow_ours():
    """A sphere around all points, and the light outside."""
    hit, around = some(np.random.default_rng(143)), scene_of({"type": "sphere", "radius": 2.1})
    bracket = Bracket(own_model(packed_float32(around)), OUR_SIDE)
    lit = light_contribution(SCENE.lights[0], hit, KU)
    assert lambert.our_shadows(bracket, hit, lit, np.full(COUNT, -1))[1].all()


def test_mitsubas_shadow_rays_start_off_the_surface_and_stop_short_of_the_light():
    rng = np.random.default_rng(142)
    hit, normals = some(rng), units(rng)
    point, sun = (light_contribution(SCENE.lights[i], hit, KU) for i in (0, 1))
    p = hit.p + 1e-6 * units(rng)
    near, far = (lambert.reference_shadow_rays(hit, light, p, normals) for light in (point, sun))
    for rays, way in ((near, np.array(LIGHTS[0]["position"]) - p), (far, sun.to_light)):
        height = np.sum((rays.o - p) * normals, axis=1)
        assert np.allclose(np.abs(height), (1.0 + np.abs(p).max(axis=1)) * 8.940697e-05, rtol=1e-6)
        assert np.array_equal(np.sign(height), np.sign(np.sum(way * normals, axis=1)))
    assert np.allclose(near.o + near.d, LIGHTS[0]["position"], rtol=0.0, atol=1e-14)
    assert np.allclose(near.t_max, 1.0 - 8.940697e-04, rtol=1e-9) and np.isposinf(far.t_max).all()
    assert np.allclose(far.d, -np.array([1, -3, 0.5]) / math.sqrt(10.25), rtol=1e-15)

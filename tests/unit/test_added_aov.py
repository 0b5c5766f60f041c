"""A registered AOV of a plug-in renders like the built-in ones, in films, arrays and brute force."""

import math

import numpy as np
import pytest

import caster
from caster.aovs import AOVS, BY_NAME, KERNELS, Aov, register
from caster.jit import decorators
from caster.kernels.protocol import Vec3
from caster.kernels.surface.per_hit import NEEDED_FIELDS, Hit, per_hit
from caster.rendering.hits import RayHits
from caster.rendering.images import trace_film


def slope(hit: Hit) -> tuple[float, float]:
    """The cosine between ray and normal, and t, from a ray of length 1."""
    n, d = hit.normal, hit.d
    return n[0] * d[0] + n[1] * d[1] + n[2] * d[2], hit.t


def shape_in_light(hit: Hit) -> Vec3:
    return hit.radiance[0] * hit.albedo[1], hit.uv[0] + hit.position[2], 1.0 * hit.shape_id


def twice(hit: Hit) -> int:
    return 2 * hit.prim_id + 1


def aov(name, evaluate, channels, needs, dtype=np.float64, miss=0.0):
    return Aov(
        NAME=name,
        CHANNELS=tuple(f"{name}.{c}" for c in channels),
        DTYPE=dtype,
        MISS=miss,
        NEEDS=needs,
        PREVIEW="ranges",
        evaluate=evaluate,
    )


NEEDS = ("radiance", "albedo", "uv", "position", "shape_id")
ADDED = {
    "slope": aov("slope", slope, "XT", ("normal",), miss=-7.0),
    "in_light": aov("in_light", shape_in_light, "ABC", NEEDS),
    "twice": aov("twice", twice, "I", ("prim_id",), np.int32, -3),
}


HIT = Hit(
    o=(1.0, 2.0, 3.0),
    d=(2.0, -3.0, 6.0),  # 7 long
    t=0.5,
    start=0.25,
    position=(4.0, 5.0, 6.0),
    normal=(7.0, 8.0, 9.0),
    shading_normal=(10.0, 11.0, 12.0),
    uv=(13.0, 14.0),
    albedo=(15.0, 16.0, 17.0),
    radiance=(18.0, 19.0, 20.0),
    shape_id=21,
    prim_id=22,
)
VALUES = {"hit": 1.0, "depth": 3.75, "diffuse": (18.0, 19.0, 20.0)}  # others: the field of their name
MISSES = {"depth": math.inf, "shape_id": -1, "prim_id": -1}  # others: 0


@pytest.mark.parametrize("name", BY_NAME)
def test_an_aov_of_the_tree_is_a_field_of_the_hit_and_its_miss_in_every_channel(name, monkeypatch):
    monkeypatch.setattr(decorators._THREAD, "interprets", True)  # kernels whose answers no annotation states
    kernel, expected = KERNELS[name], VALUES.get(name) or getattr(HIT, name)
    channels = len(expected) if isinstance(expected, tuple) else 1
    assert per_hit(kernel, HIT) == expected and len(BY_NAME[name].CHANNELS) == channels
    assert kernel.miss == MISSES.get(name, 0) and kernel.misses == (kernel.miss,) * channels
    ids = name in ("shape_id", "prim_id")
    assert BY_NAME[name].DTYPE is (np.int32 if ids else np.float64) and type(kernel.miss) is (int if ids else float)


def test_an_aov_needs_the_fields_that_it_reads_and_no_others():
    for name, aov in BY_NAME.items():
        read = [field for field in NEEDED_FIELDS if aov.evaluate(HIT._replace(**{field: None})) is None]
        assert sorted(aov.NEEDS) == read, name


@pytest.fixture(params=ADDED, scope="module")  # kernels are compiled once for each registration
def added(request):
    register(ADDED[request.param])
    yield request.param
    AOVS.remove(BY_NAME.pop(request.param))


SHAPES = (caster.Icosphere(subdivisions=1), caster.Sphere(center=(1.5, 0, 0), radius=0.7))
LIGHTS = (caster.Point(position=(1, 2, 6), intensity=(30, 20, 10)), caster.Ambient(radiance=(0.1, 0.2, 0.3)))


def scene(camera=caster.Pinhole, shapes=SHAPES):
    seen_from = camera(eye=(0.0, 0.0, 4.0), look_at=(0.0, 0.0, 0.0))
    film = caster.Film(width=17, height=11)
    return caster.Scene(camera=seen_from, film=film, shapes=shapes, lights=LIGHTS)


def in_plain_python(a_scene, name):
    """The per-hit kernel, hit by hit, with fields from the AOVs of the tree."""
    fields = ("position", "normal", "shading_normal", "uv", "albedo", "diffuse", "shape_id", "prim_id")
    images, hits = caster.render(a_scene, fields), trace_film(a_scene)
    found = []
    for i, inside in enumerate(hits.hit):
        at = [images[field].reshape(len(hits.hit), -1)[i].tolist() for field in fields]
        o, d = tuple(hits.rays.o[i].tolist()), tuple(hits.rays.d[i].tolist())
        values = [tuple(each) if len(each) > 1 else each[0] for each in at]
        value = ADDED[name].evaluate(Hit(o, d, float(hits.nearest.t[i]), 0.0, *values))
        missed = np.broadcast_to(ADDED[name].MISS, len(ADDED[name].CHANNELS))
        found.append(np.atleast_1d(value) if inside else missed)
    return np.array(found, ADDED[name].DTYPE)


CAMERAS = {"slope": caster.Pinhole, "in_light": caster.Panorama, "twice": caster.Orthographic}


def test_an_added_aov_is_rendered_each_way(added):
    a_scene = scene(CAMERAS[added])
    expected = in_plain_python(a_scene, added)
    assert (expected != ADDED[added].MISS).any() and (expected == ADDED[added].MISS).any()
    for culling in (None, "bvh", "brute-force"):
        image = caster.render(a_scene, (added,), culling=culling)[added]
        assert np.array_equal(image.reshape(expected.shape), expected), culling
    hits = trace_film(a_scene)
    assert isinstance(hits, RayHits)
    assert np.array_equal(hits.evaluate((added,))[added].reshape(expected.shape), expected)


@pytest.mark.parametrize("shapes", [SHAPES[:1], SHAPES[1:], ()], ids=["triangles", "a sphere", "nothing"])
@pytest.mark.slow("each compiles kernels", keep=1)
def test_an_added_aov_beside_others_of_one_kind_or_none(added, shapes):
    """Films of one kind without surfaces are rendered many tiles at once."""
    a_scene = scene(shapes=shapes)
    expected = in_plain_python(a_scene, added)
    for names in ((added, "depth"), (added, *caster.rendering.images.DEFAULT_AOVS)):
        image = caster.render(a_scene, names)[added]
        assert np.array_equal(image.reshape(expected.shape), expected), names


def test_what_is_invalid_or_taken_is_refused(added):
    with pytest.raises(ValueError, match="is taken"):
        register(ADDED[added])
    for change, message in (
        ({"NEEDS": ("colour",)}, "needs .*'colour'.*; known are position, "),
        ({"DTYPE": np.float32}, "DTYPE"),
    ):
        with pytest.raises(ValueError, match=message):
            register(ADDED[added]._replace(**{"NAME": "other", "CHANNELS": ("o",)} | change))
    assert "other" not in BY_NAME

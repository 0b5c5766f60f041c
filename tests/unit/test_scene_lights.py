"""What arrives from each light, in Mitsuba's units."""

import math

import numpy as np
import pytest

from caster.cameras import Pinhole
from caster.kernels.nearest import new_rays
from caster.kernels.raster.tile import DX, OX, PIXELS, PRIM, STRIDE, T_MAX, T_MIN, UNCERTAIN, WIDTH, T, new_tile
from caster.kernels.surface.lighting import (
    SHADOW_OFFSET,
    add_ambient,
    add_light,
    incident_irradiance,
    light_direction,
    materials_in_tile,
    received_irradiance,
    shadow_ray,
    shadow_rays_in_tile,
    shadow_rays_of,
)
from caster.kernels.surface.per_hit import ALBEDO, FLUX, RADIANCE, SH_N, SIDES, N, P, new_surface_buffer
from caster.rendering.hits import Surfaces
from caster.rendering.images import render
from caster.rendering.shading import distinct_materials
from caster.scene.model import Ambient, Diffuse, Directional, Film, Point, Scene
from caster.shapes import Cylinder, Disk, Rectangle, Sphere

POINTS = [(0.0, 0.0, 0.0), (3.0, 0.0, 4.0), (1.0, 2.0, 3.0)]


def test_a_point_light_fades_with_the_squared_distance():
    light = Point(position=[0, 0, 2], intensity=[4, 8, 12]).pack()
    assert incident_irradiance(light, POINTS[0]) == ((0, 0, 1), (1, 2, 3))
    assert incident_irradiance(light, POINTS[1])[1] == pytest.approx(np.array([4, 8, 12]) / 13)
    for p in POINTS:
        assert math.hypot(*incident_irradiance(light, p)[0]) == pytest.approx(1, abs=2.0**-51)


def test_the_shadow_ray_of_a_point_light_ends_in_it():
    light = Point(position=[1, 1, 1], intensity=[1, 1, 1]).pack()
    for p in POINTS:
        d, reach = light_direction(light, p)
        assert np.array_equal(np.array(p) + np.array(d) * reach, np.ones(3))


def test_a_point_in_the_light_itself_gets_nothing_and_no_nan():
    towards, strength = incident_irradiance(Point(position=[1, 2, 3], intensity=[1, 1, 1]).pack(), POINTS[2])
    assert np.isfinite(towards).all() and strength == (0, 0, 0)


def test_a_directional_light_is_the_same_everywhere_and_never_ends():
    sun = Directional(direction=[0, -2, 0], irradiance=[1, 2, 3]).pack()
    for p in POINTS:
        assert incident_irradiance(sun, p) == ((0, 1, 0), (1, 2, 3))
        assert light_direction(sun, p) == ((0, 1, 0), math.inf)
    slanting = Directional(direction=[2, -3, -6], irradiance=[1, 2, 3]).pack()
    assert light_direction(slanting, POINTS[0])[0] == pytest.approx((-2 / 7, 3 / 7, 6 / 7), rel=1e-15)


def test_ambient_light_has_no_direction():
    with pytest.raises(NotImplementedError, match="no direction"):
        Ambient(radiance=[1, 1, 1]).pack()


SUN = Directional(direction=[0, -1, 0], irradiance=[1, 2, 4]).pack()
UP, DOWN, SLANTED = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.8, 0.0)


@pytest.mark.parametrize(
    ("normal", "ray", "two_sided", "lit"),
    [
        (UP, DOWN, False, True),
        (UP, UP, False, False),  # seen from below
        (DOWN, UP, False, False),  # from its front, which is turned away
        (DOWN, DOWN, False, False),  # from behind, where the light is
        (DOWN, DOWN, True, True),
        (DOWN, UP, True, False),
    ],
)
def test_which_side_is_lit(normal, ray, two_sided, lit):
    seen, flux = received_irradiance(SUN, POINTS[1], normal, ray, two_sided)
    assert seen == lit and flux == (1, 2, 4)


def test_slanting_light_gives_its_cosine():
    assert received_irradiance(SUN, POINTS[1], SLANTED, DOWN, False) == (True, (0.8, 1.6, 3.2))


@pytest.mark.parametrize(("normal", "side"), [(UP, 1.0), (DOWN, 1.0), ((1.0, 0.0, 0.0), 0.0)])
def test_a_shadow_ray_starts_on_the_side_of_the_light(normal, side):
    """And by how much: 64 u of what the hit's rounding scales with; from there on everything counts."""
    line = (0.0, 3.0, 0.0), (0.0, -2.0, 0.0), 1.0
    for extent, scale in ((0.0, 3.0 + 2.0 + 1.0), (6.0, 6.0), (1e6, 1e6)):
        o, d, near, reach = shadow_ray(SUN, (0.0, 1.0, 0.0), normal, *line, extent)
        off = 64 * 2.0**-53 * scale
        assert o == (0.0, 1.0 + side * off, 0.0) and d == UP and (near, reach) == (off, math.inf)


STAND = {"rotate": {"axis": [1, 0.05, 0.03], "degrees": -88.7}}
LARGE = {  # each as large as r, its surface 1.7 below the eye
    "sphere": lambda r: Sphere(center=(0, -r, 0), radius=r),
    "ellipsoid": lambda r: Sphere(to_world=[{"scale": [1.3 * r, r, 1.1 * r]}, {"translate": [0, -r, 0]}]),
    "cylinder": lambda r: Cylinder(to_world=[{"scale": [r, r, 9 * r]}, {"translate": [0, -r, -4 * r]}]),
    "disk": lambda r: Disk(to_world=[{"scale": r}, STAND]),
    "rectangle": lambda r: Rectangle(to_world=[{"scale": r}, STAND]),
}


@pytest.mark.parametrize("radius", [1e4, 6.371e6])
@pytest.mark.parametrize("shape", LARGE)
def test_a_large_shape_seen_from_nearby_does_not_shadow_itself(shape, radius):
    eye = Pinhole(eye=(0.0, 1.7, 0.0), look_at=(0.13, 1.3, -3.1), fov=63.1)
    sun = Directional(direction=(-0.31, -0.83, -0.57), irradiance=(2.0, 2.0, 2.0))
    film = Film(width=24, height=24)
    scene = Scene(camera=eye, film=film, lights=[sun], shapes=[LARGE[shape](radius)])
    images = render(scene, ("diffuse", "shading_normal"))
    lit = images.hit & (images["shading_normal"] @ np.array([0.31, 0.83, 0.57]) > 1e-3)
    assert lit.sum() > 200 and (images["diffuse"][lit] > 0.0).all()


def test_the_light_of_several_lamps_adds_up():
    lamps = [
        Point(position=(1.0, 4.0, 1.0), intensity=(4.0, 8.0, 1.0)),
        Point(position=(-2.0, 3.0, 1.5), intensity=(1.0, 2.0, 16.0)),
        Directional(direction=(0.25, -1.0, 0.5), irradiance=(1.0, 0.5, 2.0)),
        Ambient(radiance=(0.25, 0.5, 1.0)),
    ]
    about = {
        "film": Film(width=16, height=12),
        "camera": Pinhole(eye=(0.0, 2.0, 6.0), look_at=(0.0, 0.0, 0.0)),
        "shapes": [Sphere(center=(0.0, 0.5, 0.0), radius=0.75), Rectangle(to_world=LYING)],
    }
    each = [render(Scene(lights=[lamp], **about), ("diffuse",))["diffuse"] for lamp in lamps]
    together = render(Scene(lights=lamps, **about), ("diffuse",))["diffuse"]
    assert all((image > 0.0).any() for image in each)
    assert together == pytest.approx(sum(each), rel=2.0**-50)


LYING = [{"rotate": {"axis": [1, 0, 0], "degrees": -90}}, {"scale": 4}]


BOX = 130, 70, 147, 75  # of a tile
SHAPES_OF = np.array([0, 2, 1, 1, 2], np.int32)  # by primitive
REFLECTANCE = np.array([[0.1, 0.2, 0.3], [0.9, 0.8, 0.7], [0.5, 0.25, 0.0]])
TWO_SIDED = np.array([False, True, False])
EXTENTS = np.array([0.0, 1e12, 1e13])  # so large that the offset of a shadow ray is seen
LIGHTS = {
    "point": Point(position=[0.5, 3.0, -1.0], intensity=[1, 2, 4]).pack(),
    "directional": Directional(direction=[0.6, -0.8, 0.0], irradiance=[1, 2, 4]).pack(),
}


def field(tile, at, count=3):
    """(rows, columns, count) of the pixels of the box, which can be written; its first column if that is one."""
    shape, step = (count, BOX[3] - BOX[1], BOX[2] - BOX[0]), 8 * np.array([STRIDE, WIDTH, 1])
    view = np.lib.stride_tricks.as_strided(tile[int(at) :], shape, step).transpose(1, 2, 0)
    return view if count > 1 else view[..., 0]


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def a_tile_of_hits(rng):
    """(tile, surface buffer) of rays and what they hit: any primitive, or none. Numbers beside the box are 7."""
    tile, buffer = new_tile(), new_surface_buffer()
    tile[:], buffer[:] = 7.0, 7.0
    for at in (OX, DX):
        field(tile, at)[:] = rng.normal(size=(*field(tile, at).shape[:2], 3))
    shape = field(tile, T, 1).shape
    field(tile, T, 1)[:], field(tile, PRIM, 1)[:] = rng.uniform(1.0, 9.0, shape), rng.integers(-1, 5, shape)
    for at in (P, N, SH_N):
        v = rng.normal(size=(*shape, 3))
        field(buffer, at)[:] = v if at == P else unit(v)
    return tile, buffer


def beside_the_box(tile, at, number=None):
    """The numbers of a field of all other pixels; all of them set to a number, if one is given."""
    y, x = np.divmod(np.arange(PIXELS), WIDTH)
    beside = np.flatnonzero((y >= BOX[3] - BOX[1]) | (x >= BOX[2] - BOX[0])) + int(at)
    if number is not None:
        tile[beside] = number
    return tile[beside]


def lit_and_flux(light, p, n, sh_n, o, d, t, sides, extent):
    """By formula: (whether it is lit, flux, start of the shadow ray, its direction, its t_min)."""
    way = np.array(light.position) - p if hasattr(light, "position") else np.broadcast_to(light.back, p.shape)
    square = (way * way).sum(axis=-1, keepdims=True)
    arriving = np.array(light.intensity) / square if hasattr(light, "position") else np.array(light.irradiance)
    cosine = (unit(way) * sh_n).sum(axis=-1)
    faced = -(d * sh_n).sum(axis=-1)
    lit = np.where(sides, cosine * faced > 0.0, (cosine > 0.0) & (faced > 0.0))
    seen_from = np.abs(o).max(axis=-1) + t * np.linalg.norm(d, axis=-1) + np.abs(p).max(axis=-1)
    offset = SHADOW_OFFSET * np.maximum(seen_from, extent)
    start = p + (np.sign((n * way).sum(axis=-1)) * offset)[..., None] * n
    along = np.array(light.position) - start if hasattr(light, "position") else way
    return lit, np.abs(cosine)[..., None] * arriving, start, along, offset / np.linalg.norm(along, axis=-1)


@pytest.mark.parametrize("name", LIGHTS)
def test_hits_of_a_tile_are_lit_as_the_formula_states(name):
    """Materials, shadow rays and what arrives, for each pixel of the box and for none beside it."""
    light, (tile, buffer) = LIGHTS[name], a_tile_of_hits(np.random.default_rng(230))
    materials_in_tile(tile, BOX, SHAPES_OF, REFLECTANCE, TWO_SIDED, buffer)
    prim, shadow_tile = field(tile, PRIM, 1).astype(int), new_tile()
    hit, shape = prim >= 0, SHAPES_OF[np.maximum(prim, 0)]
    assert np.array_equal(field(buffer, ALBEDO)[hit], REFLECTANCE[shape[hit]])
    assert np.array_equal(field(buffer, SIDES, 1)[hit], TWO_SIDED[shape[hit]])
    assert (field(buffer, RADIANCE) == 0.0).all()
    shadow_tile[:] = 7.0
    total = np.full(1, 5)
    count = shadow_rays_in_tile(light, tile, BOX, SHAPES_OF, EXTENTS, buffer, shadow_tile, total)
    assert total[0] == 5 + count
    surface = [field(buffer, at) for at in (P, N, SH_N)]
    lit, flux, start, along, t_min = lit_and_flux(
        light, *surface, field(tile, OX), field(tile, DX), field(tile, T, 1), TWO_SIDED[shape], EXTENTS[shape]
    )
    cast = hit & lit
    assert count == cast.sum() and 10 < count < cast.size
    assert np.array_equal(field(shadow_tile, T_MAX, 1) >= 0.0, cast)
    assert (field(shadow_tile, T_MAX, 1)[cast] == (1.0 if name == "point" else math.inf)).all()
    assert (field(shadow_tile, T_MAX, 1)[~cast] == -1.0).all() and (field(shadow_tile, T, 1) == math.inf).all()
    for at, expected in ((OX, start), (DX, along), (T_MIN, t_min)):
        found = field(shadow_tile, at, 3 if expected.ndim == 3 else 1)[cast]
        assert found == pytest.approx(expected[cast], rel=1e-9, abs=0.0 if at == T_MIN else 1e-12)
    assert field(buffer, FLUX)[cast] == pytest.approx(flux[cast], rel=1e-9)
    rows = shadow_tile[int(T_MAX) : int(T_MAX) + (BOX[3] - BOX[1]) * WIDTH].reshape(-1, WIDTH)
    assert (rows[:, BOX[2] - BOX[0] :] == -1.0).all()  # whole vectors are cast

    for at, number in ((T_MAX, 1.0), (T, math.inf)):  # of an earlier tile
        beside_the_box(shadow_tile, at, number)
    rng = np.random.default_rng(231)
    shaded, unsure = rng.random((2, *cast.shape)) < 0.4
    field(shadow_tile, T, 1)[shaded], field(shadow_tile, UNCERTAIN, 1)[unsure] = 2.0, 1.0
    field(tile, UNCERTAIN, 1)[:] = 0.0
    for times in (1, 2):  # two lights of the same kind
        add_light(tile, BOX, buffer, shadow_tile)
        reached = cast & ~shaded
        expected = times * field(buffer, ALBEDO) / math.pi * field(buffer, FLUX) * reached[..., None]
        assert field(buffer, RADIANCE)[hit] == pytest.approx(expected[hit], rel=1e-9)
    assert np.array_equal(field(tile, UNCERTAIN, 1) != 0.0, reached & unsure)
    ambient = np.array([[0.1, 0.2, 0.4], [1.0, 0.0, 3.0]])
    before = field(buffer, RADIANCE).copy()
    add_ambient(tile, BOX, buffer, ambient)
    more = field(buffer, ALBEDO) * ambient.sum(axis=0) * hit[..., None]
    assert field(buffer, RADIANCE) == pytest.approx(before + more, rel=1e-9)
    for at in (ALBEDO, SIDES, FLUX, RADIANCE):
        assert (beside_the_box(buffer, at) == 7.0).all()


@pytest.mark.parametrize("name", LIGHTS)
def test_shadow_rays_of_some_rays_are_those_of_the_formula(name):
    light, rng, count = LIGHTS[name], np.random.default_rng(232), 30
    rays, out, where = new_rays(count), new_rays(9), rng.permutation(count)[:9]
    n, none = unit(rng.normal(size=(count, 3))), np.full((count, 3), np.nan)
    surfaces = Surfaces(rng.normal(size=(count, 3)), n, none, none[:, :2])
    rays.o[:], rays.d[:] = rng.normal(size=(2, count, 3))
    t, extents = rng.uniform(1.0, 9.0, count), rng.choice(EXTENTS, count)
    shadow_rays_of(light, surfaces, rays, t, extents, where, out)
    about = surfaces.p, n, n, rays.o, rays.d, t, False, extents
    _, _, start, along, t_min = (each[where] for each in lit_and_flux(light, *about))
    assert out.o == pytest.approx(start, rel=1e-9, abs=1e-12)
    assert out.d == pytest.approx(along, rel=1e-9, abs=1e-12) and out.t_min == pytest.approx(t_min, rel=1e-9, abs=0.0)
    assert (out.t_max == (1.0 if name == "point" else math.inf)).all()


def test_shapes_of_one_material_share_a_row_of_the_table():
    """Whatever the material is called, and whether it is named or the default one."""
    given = {"a": Diffuse(), "b": Diffuse(reflectance=(0.1, 0.2, 0.3)), "c": Diffuse(two_sided=True)}
    names = ["", "a", "b", "c", "b"]
    scene = Scene(
        camera=Pinhole(eye=(0, 0, 9), look_at=(0, 0, 0)),
        film=Film(width=4, height=4),
        materials=given,
        shapes=[Sphere(material=name) for name in names],
    )
    found, number = distinct_materials(scene)
    assert number.tolist() == [0, 0, 1, 2, 1] and found == [Diffuse(), given["b"], given["c"]]

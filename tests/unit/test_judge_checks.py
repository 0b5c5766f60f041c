"""Each check that is made once a scene, given one input just inside of its bound and one just outside."""

import math
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import caster
from caster.aovs import Aovs
from caster.rendering import casting, ray_tiles
from caster.scene.model import Scene
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers
from mitsuba_ref.judge import scene_checks
from mitsuba_ref.judge.checks import exr_round_trip, public_routes
from mitsuba_ref.judge.checks.exr_files import WrittenImage, check_exr_files, stored_planes
from mitsuba_ref.judge.checks.routes import _program, check_routes, route_differences
from mitsuba_ref.judge.scene_checks import (
    BRUTE_FORCE_TESTS,
    PRECISIONS,
    Shares,
    check_brute_force,
    check_camera,
    check_culling,
    check_geometry,
    check_materials,
    check_placement,
    check_render,
    check_sensor,
    worst_pixel,
)
from mitsuba_ref.judge.verdict import SceneCheck

INSIDE, OUTSIDE = 0.97, 1.03
EYE, LOOK_AT = (1.0, 2.0, 6.0), (0.0, 0.5, 0.0)
# Written out here a second time: 8 roundings of the camera, of 2 * 4 units of float64; 4 units of float32.
CAMERA_BOUND, SENSOR_BOUND = 8 * 8 * 2.0**-53, 4 * 2.0**-24
CROP = (3, 2, 11, 8)


def scene_of(*shapes, **more) -> Scene:
    shapes = shapes or (
        caster.Sphere(name="ball", center=(0, 0.4, 0)),
        caster.Disk(name="lid", to_world=[{"translate": [1, 0, 0.5]}]),
    )
    camera = caster.Pinhole(eye=EYE, look_at=LOOK_AT, up=(0, 1, 1), fov=40, near=2.5, far=50.0)
    usual = {"film": caster.Film(width=14, height=10, crop=CROP), "camera": camera}
    usual["lights"] = [caster.Point(position=(2, 5, 3), intensity=(30, 30, 30))]
    return Scene(**(usual | more), shapes=shapes)


def up_sine() -> float:
    view = np.subtract(LOOK_AT, EYE)
    view = view / np.linalg.norm(view)
    up = np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0)
    return float(np.sqrt(1.0 - (view @ up) ** 2))


# ---- what is recorded


def test_a_second_value_of_one_name_is_refused_and_the_worst_is_the_largest():
    shares = Shares()
    assert shares.worst() == ("nothing to look at", 0.0)
    for what, share in (("a", 0.5), ("b", 2.0), ("c", 1.0)):
        shares.add(what, share)
    assert shares.worst() == ("b", 2.0)
    with pytest.raises(ValueError, match="b is checked twice"):
        shares.add("b", 0.0)


@pytest.mark.parametrize("value", [0.5, 3.0, np.inf, np.nan])
def test_the_worst_pixel_is_reported_at_its_place_on_the_film(value):
    scene = scene_of()
    count, width = 48, 8
    table = {"one": np.zeros(count), "two": np.zeros(count)}
    table["one"][5], table["two"][2 * width + 3] = 0.25, value
    found = worst_pixel("name", table, np.ones(count, bool), scene)
    assert (found.name, found.what) == ("name", "two at (6, 4)")
    assert found.ratio == (np.inf if np.isnan(value) else value) and found.ok is (value == 0.5)
    among = np.arange(count) != 2 * width + 3
    assert worst_pixel("name", table, among, scene).what == "one at (8, 2)"
    assert worst_pixel("name", {}, among, scene).ratio == 0.0


# ---- camera and sensor

CAMERA_PARTS = {
    "origin": lambda rays, i: (rays.o[i], CAMERA_BOUND * max(map(abs, EYE))),
    "direction": lambda rays, i: (rays.d[i], CAMERA_BOUND),
    "near": lambda rays, i: (rays.t_min[i : i + 1], CAMERA_BOUND * rays.t_min[i]),
    "far": lambda rays, i: (rays.t_max[i : i + 1], CAMERA_BOUND * rays.t_max[i]),
}


@pytest.mark.parametrize("share", [INSIDE, OUTSIDE])
@pytest.mark.parametrize("part", CAMERA_PARTS)
def test_a_camera_ray_may_be_off_by_its_bound_and_no_more(monkeypatch, part, share):
    scene = scene_of()
    x, y = scene_checks.pixel_centers(scene)
    rays = scene_checks.reference_of_camera(scene.camera).rays(scene.camera, scene.film, x, y)
    rays = scene_checks.camera_rays(scene)._replace(o=rays.o, d=rays.d, t_min=rays.t_min, t_max=rays.t_max)
    rays = rays._replace(**{name: np.array(getattr(rays, name)) for name in ("o", "d", "t_min", "t_max")})
    values, bound = CAMERA_PARTS[part](rays, 13)
    axis = np.ones(len(values)) / np.sqrt(len(values))
    values += share * bound / up_sine() * axis
    monkeypatch.setattr(scene_checks, "camera_rays", lambda scene: rays)
    found = check_camera(scene)
    assert found.what == f"{part} at (8, 3)" and found.ratio == pytest.approx(share, abs=0.02)
    assert found.ok is (share == INSIDE)


# Film.resized, by what is done to the crop of a film of other sizes
WRONG_CROPS = {
    "last column lost": lambda old, new, crop: (*crop[:2], crop[2] - 1, crop[3]),
    "last row lost where it was cut": lambda old, new, crop: (*crop[:3], crop[3] - (crop[3] % 2)),
    "first column twice as far": lambda old, new, crop: (min(2 * crop[0], crop[2] - 1), *crop[1:]),
    "as before": lambda old, new, crop: (0, 0, *new),
    "one more": lambda old, new, crop: (*crop[:2], min(crop[2] + 1, new[0]), crop[3]),
    "only of smaller films": lambda old, new, crop: (crop[0] + (new[0] < old[0]), *crop[1:]),
}


@pytest.mark.parametrize("wrong", WRONG_CROPS)
def test_a_crop_that_is_scaled_wrongly_with_its_film_fails_camera(monkeypatch, wrong):
    """Both sides get the same film: nothing else can find it."""
    scene, right = scene_of(), caster.Film.resized
    assert check_camera(scene).ok

    def resized(film, width, height):
        found = right(film, width, height)
        if not film.crop or (width, height) == (film.width, film.height):
            return found
        x0, y0, x1, y1 = WRONG_CROPS[wrong]((film.width, film.height), (width, height), found.crop)
        return found.cropped((min(x0, x1 - 1), y0, max(x1, x0 + 1), max(y1, y0 + 1)))

    monkeypatch.setattr(caster.Film, "resized", resized)
    found = check_camera(scene)
    assert not found.ok and found.what.startswith("crop (3, 2, 11, 8) of 14 x 10 is "), found.what


def test_a_window_that_is_not_the_crop_fails_camera(monkeypatch):
    scene = scene_of()
    monkeypatch.setattr(caster.Film, "window", property(lambda film: (3, 2, 10, 8)))
    found = check_camera(scene)
    assert not found.ok and found.what == "window (3, 2, 10, 8), expected (3, 2, 11, 8)"


def test_a_number_of_rays_that_is_not_that_of_the_pixels_fails_camera(monkeypatch):
    rays = scene_checks.camera_rays(scene_of())
    monkeypatch.setattr(scene_checks, "camera_rays", lambda scene: type(rays)(*(array[1:] for array in rays)))
    found = check_camera(scene_of())
    assert not found.ok and found.what == "47 rays, the window has 48 pixels"


@pytest.mark.parametrize("crop", [(0, 0, 14, 10), (13, 9, 14, 10), (0, 4, 1, 5), (5, 0, 9, 10)])
@pytest.mark.parametrize("size", [(14, 10), (15, 11), (3, 50), (97, 7), (1, 1), (28, 20)])
def test_a_resized_crop_has_the_pixels_that_overlap_it(crop, size):
    """By a third formula: the least and largest of corners as fractions."""
    film, (width, height) = caster.Film(width=14, height=10), size
    low_x, low_y, high_x, high_y = (
        Fraction(c * n, old) for c, n, old in zip(crop, 2 * size, (14, 10, 14, 10), strict=True)
    )
    expected = (math.floor(low_x), math.floor(low_y), math.ceil(high_x), math.ceil(high_y))
    assert scene_checks._pixels_reached(film, crop, width, height) == expected
    assert film.cropped(crop).resized(width, height).crop == expected


def test_pixel_centres_are_those_of_the_window():
    x, y = scene_checks.pixel_centers(scene_of())
    assert (x[0], y[0], x[7], y[8], x[-1], y[-1]) == (3.5, 2.5, 10.5, 3.5, 10.5, 7.5) and len(x) == 48
    x, y = scene_checks.pixel_centers(scene_of(film=caster.Film(width=3, height=2)))
    assert (x.tolist(), y.tolist()) == ([0.5, 1.5, 2.5] * 2, [0.5] * 3 + [1.5] * 3)


def witness_of(scene, **change) -> SimpleNamespace:
    """Mitsuba's own rays, as ours are: they begin at the near plane, and their t_max counts from there."""
    rays = scene_checks.camera_rays(scene)
    o = rays.o + rays.t_min[:, None] * rays.d
    sensor = {"sensor_o": o, "sensor_d": rays.d.copy(), "sensor_t_max": rays.t_max - rays.t_min}
    return SimpleNamespace(answer=SimpleNamespace(**(sensor | change)))


def size_at(scene, i, along) -> float:
    return float(np.linalg.norm(EYE) + abs(along) + max(map(abs, EYE)))


@pytest.mark.parametrize("share", [INSIDE, OUTSIDE])
@pytest.mark.parametrize("part", ["direction", "origin", "near", "far"])
def test_mitsubas_sensor_may_be_off_by_its_bound_and_no_more(monkeypatch, part, share):
    scene, i = scene_of(), 13
    camera = scene_checks.reference_of_camera(scene.camera)
    fixed = replace(camera, amplification=lambda camera, film: 3.0)
    monkeypatch.setattr(scene_checks, "reference_of_camera", lambda camera: fixed)
    bound, answer = 3.0 * SENSOR_BOUND, witness_of(scene).answer
    rays = scene_checks.camera_rays(scene)
    t_min, t_max, d = float(rays.t_min[i]), float(rays.t_max[i]), rays.d[i]
    size = size_at(scene, i, t_min)
    across = np.cross(d, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    if part == "direction":
        answer.sensor_d[i] += share * bound * across
    if part == "origin":
        answer.sensor_o[i] += share * bound * size * across
    if part == "near":
        answer.sensor_o[i] += share * bound * (size + t_min) * d
        answer.sensor_t_max[i] -= share * bound * (size + t_min)
    if part == "far":
        answer.sensor_t_max[i] += share * bound * (size + t_max)
    found = check_sensor(scene, SimpleNamespace(answer=answer))
    assert found.what == f"{part} at (8, 3)" and found.ratio == pytest.approx(share, abs=0.01)
    assert found.ok is (share == INSIDE)


def test_a_sensor_without_near_and_far_is_held_to_its_line_alone():
    camera = caster.Pinhole(eye=EYE, look_at=LOOK_AT, fov=40)
    scene = scene_of(camera=camera)
    shifted = witness_of(scene)
    shifted.answer.sensor_o += 3.0 * shifted.answer.sensor_d
    assert check_sensor(scene, shifted).ok
    shifted.answer.sensor_o[5] += [0.0, 0.0, 0.01]
    assert check_sensor(scene, shifted).what == "origin at (8, 2)"


def test_missing_rays_of_the_sensor_fail_unless_mitsuba_has_no_such_camera():
    scene = scene_of()
    for name in ("sensor_o", "sensor_d", "sensor_t_max"):
        found = check_sensor(scene, witness_of(scene, **{name: None}))
        assert (found.ratio, found.what) == (np.inf, "the answer lacks its rays")
    few = witness_of(scene, sensor_d=np.zeros((3, 3)))
    assert check_sensor(scene, few).ratio == np.inf and "3 rays, we 48" in check_sensor(scene, few).what
    round_one = scene_of(camera=caster.Fisheye(eye=EYE, look_at=LOOK_AT, fov=100))
    found = check_sensor(round_one, witness_of(scene, sensor_o=None))
    assert (found.ratio, found.what) == (0.0, "Mitsuba has no fisheye camera")


# ---- shapes


@pytest.mark.parametrize("precision", PRECISIONS, ids=lambda each: each.name)
@pytest.mark.parametrize("share", [INSIDE, OUTSIDE])
def test_a_packed_number_may_be_off_by_sixteen_roundings_of_its_size(share, precision):
    unit = {"float64": 2.0**-53, "float32": 2.0**-24}[precision.name]
    given = precision.unit_roundoff, precision.smallest_normal

    def ratio(size, off, *, rounded=True, shape=(2, 3)):
        expected = np.zeros((2, 3))
        packed = np.zeros(shape)
        packed[1, 2:] = off
        return scene_checks._packing_error_ratio(ExpectedNumbers("what", packed, expected, size, rounded), *given)

    for size in (5.0, 5.0 * 2.0**60, 5.0 * 2.0**-60):
        assert ratio(size, share * 16 * unit * size) == pytest.approx(share)
    tiny = precision.smallest_normal / 1024
    least = 16 * unit * precision.smallest_normal  # some multiples of the smallest number there is
    assert (ratio(tiny, least / 2), ratio(tiny, 2 * least)) == (0.5, 2.0)
    assert ratio(tiny, least, rounded=False) > 1000.0
    assert ratio(np.inf, 1.0) == 0.0 and ratio(5.0, np.nan) == np.inf
    assert ratio(5.0, 0.0, shape=(2, 4)) == np.inf


def test_precisions_are_those_of_float64_and_float32():
    assert check_geometry(scene_of()).ok
    for precision, kind in zip(PRECISIONS, (np.float64, np.float32), strict=True):
        limits = np.finfo(kind)
        assert precision.name == kind.__name__ and precision.smallest_normal == float(limits.tiny)
        assert precision.unit_roundoff == float(limits.eps) / 2.0
        parts = precision.packing(scene_of()).parts
        assert all((array == array.astype(kind)).all() for part in parts for array in part) and len(parts) == 2


def test_a_placement_and_a_material_are_checked_at_every_shape(monkeypatch):
    ball, lid = scene_of().shapes
    plain = caster.Sphere(name="plain")
    assert check_placement(scene_of(plain)).what == "no shape has a to_world"
    scene = scene_of(plain, lid, caster.Disk(name="other", to_world=[{"scale": 2}]))
    ratios = {"lid": 0.25, "other": 7.0}
    monkeypatch.setattr(scene_checks, "transform_error_ratio", lambda shape: ratios[shape.name])
    found = check_placement(scene)
    assert (found.ratio, found.what, found.ok) == (7.0, "to_world of other", False)
    red = {"red": {"reflectance": (0.9, 0.1, 0.1)}}
    scene = scene_of(ball, caster.Disk(name="lid", material="red"), materials=red)
    assert check_materials(scene).ok
    assert check_materials(scene_of(ball, lid).model_copy(update={"shapes": ()})).what == "no shape"
    monkeypatch.setattr(Scene, "material_of", lambda self, shape: caster.Diffuse())
    found = check_materials(scene)
    assert (found.ratio, found.what) == (np.inf, "material of lid")


# ---- images: one bit of one pixel, by each route


def flipped(images: Aovs, name: str, row: int) -> Aovs:
    """The same images but for the last bit of one value."""
    copies = {each: np.array(image) for each, image in images.items()}
    rows = copies[name].reshape(images.hit.size, -1)
    bits = rows.view(f"u{rows.itemsize}")
    bits[row, -1] ^= 1
    return Aovs(copies, images.hit)


@pytest.mark.parametrize("name", ["depth", "normal", "shading_normal", "position", "shape_id", "prim_id", "diffuse"])
def test_one_other_bit_of_render_fails_culling_and_behind_a_near_plane_render(monkeypatch, name):
    scene = scene_of()
    assert check_culling(scene).ratio == 0.0 and check_render(scene).ratio == 0.0
    real, row = scene_checks.render, 27
    monkeypatch.setattr(scene_checks, "render", lambda *given: flipped(real(*given), name, row))
    found = check_culling(scene)
    assert (found.name, found.ratio, found.what) == ("culling", np.inf, "bits at (6, 5)")
    far = {"shape_id": 1, "prim_id": 1}.get(name)
    found = check_render(scene)
    assert (found.ratio == np.inf) is bool(far) and found.name == "render"


@pytest.mark.parametrize("name", ["depth", "normal", "shading_normal", "position", "shape_id", "diffuse"])
def test_render_behind_a_near_plane_is_held_to_float64(monkeypatch, name):
    """Its rays are not those that are judged: other bits pass, what float64 does not allow fails."""
    scene, row = scene_of(), 27
    real = scene_checks.render

    def spoiled(*given):
        images = real(*given)
        image = images[name].reshape(images.hit.size, -1)
        image[row, -1] = 1 - image[row, -1] if name == "shape_id" else image[row, -1] * (1.0 + 1e-9) + 1e-9
        return images

    monkeypatch.setattr(scene_checks, "render", spoiled)
    found = check_render(scene)
    assert (found.ratio, found.what) == (np.inf, "pixel at (6, 5)")
    without = scene_of(camera=caster.Pinhole(eye=EYE, look_at=LOOK_AT, fov=40))
    assert check_render(without).ratio == 0.0 and "no near plane" in check_render(without).what


@pytest.mark.parametrize("far", [5.0, 5.5])
def test_render_between_near_and_far_is_what_the_judged_rays_hit(far):
    """The far plane cuts the ball, and what is left of the rays counts from the near one."""
    camera = caster.Pinhole(eye=EYE, look_at=LOOK_AT, fov=40, near=2.5, far=far)
    scene = scene_of(camera=camera)
    hits = caster.render(scene, ("depth",)).hit.sum()
    everything = caster.render(scene_of(), ("depth",)).hit.sum()
    assert check_render(scene).ratio == 0.0 and hits < everything


def test_float64_holds_every_pixel_of_render_hits_and_misses_alike():
    scene = scene_of()
    rays = scene_checks.camera_rays(scene)
    rows = np.arange(len(rays.o))
    ours = scene_checks.render(scene, scene_checks.CHECKED_AOVS)
    assert scene_checks._within_float64(scene, ours, rows, scene_checks._segments(rays, rows)).all()
    assert 0 < ours.hit.sum() < ours.hit.size
    empty = Aovs({name: np.full_like(ours[name], np.inf if name == "depth" else -1) for name in ours}, ~ours.hit)
    right = scene_checks._within_float64(scene, empty, rows, scene_checks._segments(rays, rows))
    assert np.array_equal(right, ~ours.hit.ravel())


@pytest.mark.parametrize(("near", "far"), [(2.0, 4.0), (0.5, 5.5)])
def test_a_render_that_forgets_the_far_plane_or_moves_it_fails(monkeypatch, near, far):
    """A wall just behind the far plane, at exact distances: judged rays have the bits of those of `render`."""
    wall = caster.Rectangle(to_world=[{"scale": 8}])
    view = {"eye": (0, 0, far + near / 2), "look_at": (0, 0, 0), "width": 4, "near": near}
    shown = {"shapes": (wall,), "film": caster.Film(width=4, height=4)}
    real = scene_checks.render
    scene = caster.Scene(camera=caster.Orthographic(**view, far=far), **shown)
    assert check_render(scene).ratio == 0.0 and not real(scene, ("depth",)).hit.any()
    for wrong in (None, far + near):
        other = caster.Scene(camera=caster.Orthographic(**view, far=wrong), **shown)
        assert real(other, ("depth",)).hit.all()
        monkeypatch.setattr(scene_checks, "render", lambda _scene, names, other=other: real(other, names))
        assert check_render(scene).ratio == np.inf
    nearer = caster.Scene(camera=caster.Orthographic(**view, far=far + near), **shown)
    monkeypatch.setattr(scene_checks, "render", lambda _, names: real(scene, names))
    assert check_render(nearer).ratio == np.inf  # and one that cuts off what is there


@pytest.mark.parametrize("field", ["t", "prim"])
def test_a_ray_that_brute_force_finds_otherwise_fails(monkeypatch, field):
    scene = scene_of()
    assert check_brute_force(scene).ratio == 0.0
    real, row = scene_checks.find_nearest, 27

    def other(packed, rays, culling="bvh"):
        found = real(packed, rays, culling)
        if culling == "bvh":
            return found
        values = getattr(found, field).copy()
        values[row] += 1
        return found._replace(**{field: values})

    monkeypatch.setattr(scene_checks, "find_nearest", other)
    found = check_brute_force(scene)
    assert (found.name, found.what, found.ok) == ("brute_force", "bits at (6, 5)", False)


def test_rays_are_tried_against_every_primitive_as_far_as_there_is_time():
    for rays, prims, count in (
        (5000, 1, 5000),
        (5000, 0, 5000),
        (5000, BRUTE_FORCE_TESTS // 100, 100),
        (5000, BRUTE_FORCE_TESTS, 64),
        (40, BRUTE_FORCE_TESTS, 40),
    ):
        found = scene_checks._sampled_rays(rays, prims)
        assert len(found) == count == len(np.unique(found)) and (np.diff(found) > 0).all()
        assert found[0] >= 0 and found[-1] < rays and (count == rays or found[-1] > rays // 2)


Route = tuple[str, str]
ROUTES = {
    "depth alone": ("render", lambda names, film, options: names == ("depth",)),
    "normal alone": ("render", lambda names, film, options: names == ("normal",)),
    "depth and normal": ("render", lambda names, film, options: names == ("depth", "normal")),
    "one AOV": ("render", lambda names, film, options: len(names) == 1),
    "a pair": ("render", lambda names, film, options: len(names) == 2 and "depth" not in names),
    "one thread": ("render", lambda names, film, options: options.get("threads") == 1),
    "two threads": ("render", lambda names, film, options: options.get("threads") == 2),
    "three threads": ("render", lambda names, film, options: options.get("threads") == 3),
    "float32": ("render", lambda names, film, options: options.get("dtype") is np.float32),
    "a crop": ("render", lambda names, film, options: film.width == 40 and film.crop is not None),
    "a wide film": ("render", lambda names, film, options: max(film.width, film.height) >= 127),
}


def larger() -> Scene:
    return scene_of(film=caster.Film(width=40, height=30))


def test_all_routes_agree():
    taken = []
    assert not route_differences(larger(), lambda: taken.append(1))
    assert check_routes(larger()) == SceneCheck("routes", 0.0, f"{len(taken)} routes") and len(taken) > 30


@pytest.mark.parametrize("route", ROUTES)
def test_one_other_bit_by_any_way_to_render_fails_routes(monkeypatch, route):
    scene = larger()
    real, (_, spoils) = public_routes.render, ROUTES[route]
    spoilt = []

    def render(film, names, **options):
        images = real(film, names, **options)
        other = tuple(names) != public_routes.ALL_AOVS or options or film.film.window != scene.film.window
        if other and spoils(tuple(names), film.film, options):
            x0, y0, x1, _ = film.film.window
            row = images.hit.size - 1
            spoilt.append((names[-1], x0 + row % (x1 - x0), y0 + row // (x1 - x0)))
            return flipped(images, names[-1], row)
        return images

    monkeypatch.setattr(public_routes, "render", render)
    found = route_differences(scene)
    assert spoilt and [(each.aov, each.x, each.y, each.pixels) for each in found] == [(*s, 1) for s in spoilt]
    image = real(scene, public_routes.ALL_AOVS)
    same = [each for each in found if "width=" not in each.route and "float32" not in each.route]
    assert all(each.expected == repr(image[each.aov][each.y, each.x].tolist()) != each.got for each in same)
    check = check_routes(scene, "some.toml")
    assert check.ratio == np.inf and f"{spoilt[0][0]} at ({spoilt[0][1]}, {spoilt[0][2]})" in check.what
    assert "again: python -c" in check.what and 'load_scene("some.toml")' in check.what


@pytest.mark.parametrize(
    "field", ["t", "shape_id", "prim_id", "normal", "surface.n", "surface.p", "surface.sh_n", "surface.uv"]
)
def test_one_other_bit_of_a_field_of_hits_fails_routes(monkeypatch, field):
    real = public_routes.cast

    class Spoilt:
        def __init__(self, hits, below=""):
            self.hits, self.below = hits, below

        def __getattr__(self, name):
            path = f"{self.below}{name}"
            values = getattr(self.hits, name)
            if path == "surface":
                return Spoilt(values, "surface.")
            if path != field:
                return values
            changed = np.array(values)
            changed.reshape(len(changed), -1).view(f"u{changed.itemsize}")[0, -1] ^= 1
            return changed

    monkeypatch.setattr(public_routes, "cast", lambda *given, **limits: Spoilt(real(*given, **limits)))
    found = route_differences(larger())
    assert found and all(f").{field}" in str(each) and each.pixels == 1 for each in found)
    image = caster.render(larger(), public_routes.ALL_AOVS)
    for each in found:
        value = image[each.aov][each.y, each.x]
        assert each.expected == repr(value.tolist()) != each.got
    check = check_routes(larger(), "some.toml").what
    assert "camera_rays(scene)[:2]" in check and "print(caster.cast(scene, o, d" in check


def images_of(hit, **images) -> Aovs:
    return Aovs({name: np.array(image) for name, image in images.items()}, np.array(hit))


def test_an_image_of_another_shape_dtype_or_mask_and_every_other_pixel_differs():
    """A window at (3, 2), 8 pixels wide and 6 high."""
    scene, flat = scene_of(), np.zeros((6, 8))
    hit = flat > 0.0
    expected = images_of(hit, depth=flat, prim_id=flat.astype(np.int32), normal=np.zeros((6, 8, 3)))

    def differences(got, **more):
        return [tuple(each) for each in public_routes._compare(scene, "route", expected, got, **more)]

    assert differences(expected) == [] == differences(images_of(hit, depth=flat))
    assert differences(images_of(hit, depth=flat[:5])) == [
        ("route", "depth", 3, 2, "(6, 8) float64", "(5, 8) float64", 48)
    ]
    single = images_of(hit, depth=flat.astype(np.float32), normal=np.zeros((6, 8, 3)))
    assert differences(single) == [("route", "depth", 3, 2, "(6, 8) float64", "(6, 8) float32", 48)]
    rounded = images_of(hit, depth=flat.astype(np.float32), prim_id=flat.astype(np.int32))
    assert differences(rounded, dtype=np.float32) == []
    other = expected["normal"].copy()
    other[4, 6, 1] = other[5, 0, 2] = 0.5
    assert differences(images_of(hit, normal=other)) == [
        ("route", "normal", 9, 6, "[0.0, 0.0, 0.0]", "[0.0, 0.5, 0.0]", 2)
    ]
    masked = hit.copy()
    masked[0, 7] = True
    assert differences(images_of(masked, depth=-flat)) == [
        ("route", "mask", 10, 2, "False", "True", 1),
        ("route", "depth", 3, 2, "0.0", "-0.0", 48),
    ]
    found = str(next(public_routes._compare(scene, "route", expected, images_of(masked, depth=flat))))
    assert found == "route: mask at (10, 2) is True, expected False; 1 pixels"


def test_an_occluded_ray_that_cast_finds_free_fails_routes(monkeypatch):
    scene, real = larger(), public_routes.occluded
    for number in range(5):  # each of the limits alone
        calls = []

        def occluded(*given, number=number, calls=calls, **limits):
            calls.append((given[3], limits["t_min"]))
            found = real(*given, **limits)
            return ~found if len(calls) == number + 1 else found

        monkeypatch.setattr(public_routes, "occluded", occluded)
        (found,) = route_differences(scene)
        assert found.aov == "t" and found.pixels > 16 and f"{calls[number][0]!r}, t_min=" in found.route
        assert len(calls) == 6
    *calls, (each_max, each_min) = calls  # the last with its own limits for each ray, one of the five
    t_max, t_min = zip(*calls, strict=True)
    assert np.array_equal(np.column_stack([each_max, each_min]), np.resize(calls, (len(each_max), 2)))
    assert (t_max[0], t_min[0], t_min[1], t_min[2], t_max[3]) == (np.inf, 0.0, 0.0, 0.0, np.inf)
    assert t_max[1] == t_min[3] == np.nextafter(t_max[2], np.inf) and 0.0 < t_min[4] < t_max[4] < np.inf


@pytest.mark.parametrize("call", ["find_nearest", "find_any"])
def test_one_other_ray_of_a_fan_fails_routes(monkeypatch, call):
    """Of those from the camera and back, which are cast as many rays through one point are."""
    real, calls = getattr(public_routes, call), []

    def other(*given, always_fans):
        calls.append(always_fans)
        found = real(*given, always_fans=always_fans)
        values = found.t if call == "find_nearest" else found
        values[-1:] = np.where(values[-1:] == 0.0, 1.0, values[-1:] * 0.5) if call == "find_nearest" else ~values[-1:]
        return found if always_fans else real(*given)

    monkeypatch.setattr(public_routes, call, other)
    found = [each for each in route_differences(larger()) if each.route.startswith(call)]
    assert any(calls) and all(each.pixels == 1 for each in found)
    expected = {"find_nearest": ["depth", "t", "t"], "find_any": ["t", "t", "t"]}  # twice with limits
    assert [each.aov for each in found] == expected[call]
    check = check_routes(larger(), "some.toml").what
    assert f"print({call}(packed(scene), " in check and "import limited_rays, rays_back" in check


def test_limits_of_each_ray_that_are_not_its_own_fail_routes(monkeypatch):
    """The first one's taken for all: what a scalar gives is right."""
    for name in ("cast", "occluded"):
        real = getattr(public_routes, name)

        def first_of_all(scene, o, d, *t_max, real=real, **limits):
            return real(scene, o, d, *(np.ravel(t)[0] for t in t_max), **{k: np.ravel(t)[0] for k, t in limits.items()})

        with monkeypatch.context() as patch:
            patch.setattr(public_routes, name, first_of_all)
            (found,) = route_differences(larger())
        assert found.aov == "t" and found.route.startswith(f"caster.{name}(scene, o, d, t_min=np.resize([")
        program = _program(found.route, str(Path(__file__).resolve().parents[2] / "scenes/one-sphere.toml"))
        again = ["bash", "-c", f"{sys.executable} -c '{program}'"]
        assert subprocess.run(again, capture_output=True, check=True).stdout


def test_a_film_that_is_cast_row_by_row_is_compared(monkeypatch):
    """Some of its rows, as `cast` takes them: one other hit of them fails."""
    scene = caster.Scene(
        camera=larger().camera, film=caster.Film(width=140, height=9), shapes=(caster.Icosphere(subdivisions=2),)
    )
    assert not route_differences(scene)
    real, stored = casting.store_rays, []

    def other(tile, first, width, box, ids, nearest, uncertain):
        real(tile, first, width, box, ids, nearest, uncertain)
        nearest.prim[first + box[0]] += 1
        stored.append(box)

    monkeypatch.setattr(casting, "store_rays", other)
    found = route_differences(scene)
    assert stored and {each.aov for each in found} == {"prim_id", "shape_id"}
    assert all(each.route.startswith("find_nearest") and each.pixels == 2 for each in found)


def test_a_fan_without_margins_fails_routes(monkeypatch):
    """What is compared is cast as a fan."""
    scene = larger().model_copy(update={"shapes": (caster.Icosphere(subdivisions=2),)})
    assert not route_differences(scene)
    real = ray_tiles.fans_to
    monkeypatch.setattr(ray_tiles, "fans_to", lambda *given: [fan._replace(slack=-0.1) for fan in real(*given)])
    assert {each.route.split("(")[0] for each in route_differences(scene)} >= {"find_nearest"}


def test_what_probe_casts_is_compared_with_the_image(monkeypatch):
    scene, real = larger(), public_routes.trace_film
    asked = []

    def trace_film(one, **options):
        asked.append(one.film.crop)
        view = real(one, **options)
        return replace(view, nearest=view.nearest._replace(t=view.nearest.t * (1.0 + 2.0**-50)))

    monkeypatch.setattr(public_routes, "trace_film", trace_film)
    found = route_differences(scene)
    assert len(asked) >= 2 and all(x1 - x0 == y1 - y0 == 1 for x0, y0, x1, y1 in asked)
    hit = [each for each in found if each.aov == "depth"]
    assert all(each.route == f"caster probe SCENE {each.x} {each.y}" for each in found)
    assert {(each.x, each.y) for each in hit} <= {crop[:2] for crop in asked}


# ---- files


def written(tmp_path, images: Aovs, window=CROP, film=(14, 10)) -> WrittenImage:
    import OpenEXR

    planes = stored_planes(images)
    x0, y0, x1, y1 = window
    header = {
        "dataWindow": (np.array([x0, y0], np.int32), np.array([x1 - 1, y1 - 1], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([film[0] - 1, film[1] - 1], np.int32)),
    }
    path = tmp_path / "image.exr"
    with OpenEXR.File(header, dict(planes)) as file:
        file.write(str(path))
    return WrittenImage(path, planes, window, film)


def test_a_file_is_what_is_in_memory_or_the_difference_is_named(tmp_path):
    scene = scene_of()
    images = caster.render(scene, tuple(exr_round_trip.CHANNELS))
    good = written(tmp_path, images)
    assert check_exr_files([good]).ok and check_exr_files([good]).what == "1 files read back"

    def told(**change) -> str:
        found = check_exr_files([good, good._replace(**change)])
        assert found.name == "files" and found.ratio == np.inf and found.what.startswith("image.exr: ")
        return found.what.removeprefix("image.exr: ")

    assert told(window=(3, 2, 12, 8)).startswith("dataWindow ((3, 2), (10, 7)), expected ((3, 2), (11, 7))")
    assert told(film=(15, 10)).startswith("displayWindow ((0, 0), (13, 9))")
    planes = dict(good.planes)
    del planes["uv.U"]
    assert "uv.U" in told(planes=planes).partition("expected")[0]
    for name in good.planes:
        plane = good.planes[name].copy()
        plane.view(np.uint32)[4, 6] ^= 1
        what = told(planes={**good.planes, name: plane})
        assert what.startswith(f"{name} at (9, 6) is ") and what.endswith("; 1 pixels")
    plane = good.planes["A"].astype(np.uint32)
    assert told(planes={**good.planes, "A": plane}).startswith("A is (6, 8) float32, expected (6, 8) uint32")


def test_numbers_are_stored_as_the_page_of_channels_states():
    hit = np.array([[True, False]])
    images = Aovs(
        {
            "depth": np.array([[1e300, np.inf]]),
            "position": np.array([[[-1e300, 0.1, -np.inf], [0.0, 0.0, 0.0]]]),
            "shape_id": np.array([[7, -1]], np.int32),
        },
        hit,
    )
    planes = stored_planes(images)
    largest = np.finfo(np.float32).max
    assert planes["A"].tolist() == [[1.0, 0.0]] and planes["id.shape"].tolist() == [[7, 2**32 - 1]]
    assert planes["depth.Z"].tolist() == [[largest, np.inf]] and planes["depth.Z"].dtype == np.float32
    assert planes["position.X"][0, 0] == -largest and planes["position.Z"][0, 0] == -np.inf
    assert planes["position.Y"][0, 0] == np.float32(0.1) and planes["id.shape"].dtype == np.uint32

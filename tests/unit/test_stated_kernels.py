"""What kernels of the caster state, number by number: roots and their error bounds, projections, screen bounds, trees.

That bounds are large enough is held by tests against inputs that were moved and against the rays that meet a primitive
(test_error_bounds_of_kernels.py, test_screen_bounds.py). One that is larger than need be, or smaller by less than those
see, changes no image: it costs time, or a hit in a billion. So the numbers stand in stated_kernels.json, and one that
changes shows in its diff; `python tests/unit/test_stated_kernels.py` writes it anew.
"""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import caster
from caster.geometry.packing import Kind
from caster.geometry.packing import packed as make_packed
from caster.jit.simd import FAN_FIELDS
from caster.kernels.bvh.build import bounding_boxes
from caster.kernels.bvh.fans import NO_POINT, PRIM_FIELDS, outline, separating_plane
from caster.kernels.math.quadric_roots import (
    MAX_RANGE,
    MIN_RANGE,
    closest_approach,
    fast_outward_normal,
    outward_normal,
    quadric_roots,
    quadric_setup,
)
from caster.kernels.protocol import (
    camera_ray,
    distortion_bound,
    fast_normal,
    hull_point,
    hull_size,
    intersect,
    load,
    normal,
    normal_setup,
    prepare,
    project,
    project_bounding_sphere,
    surely_misses,
    surface,
    surface_setup,
    t_lower_bound,
    tight_sphere,
)
from caster.kernels.raster.screen_bounds import (
    PROJECTION_MARGIN,
    ScreenBounds,
    Window,
    bound_by_spheres,
    bound_distorted_triangles,
    bound_hulls,
    bound_spheres,
    bound_triangles,
    project_vertices,
)
from caster.kernels.raster.tile import LANE_FIELDS, LANE_SETUP, SURFACE_LANES, lane, new_lanes
from caster.kernels.raster.tile_casting import bounds_in_tile, row_bounds
from caster.kernels.surface.lighting import DirectionalLight, PointLight, received_irradiance, shadow_ray
from caster.kernels.triangles import barycentrics, fast_barycentrics, fast_triangle_normal
from caster.rendering.bvh_construction import bvh_of, fan_bounds, fans_to
from caster.scene.model import Scene

STATED = Path(__file__).with_name("stated_kernels.json")
# a turn without sines and cosines, whose last bits are those of a C library
TURN = {"matrix": [[0.36, 0.48, -0.8, 0], [-0.8, 0.6, 0, 0], [0.48, 0.64, 0.6, 0], [0, 0, 0, 1]]}
STRETCH = {"matrix": [[2, 0.5, 0, 1], [0, 0.75, 0.25, 2], [0.125, 0, 1.5, 3], [0, 0, 0, 1]]}
PLACE = [{"scale": 2}, TURN, {"translate": [1, 2, 3]}]
CORNERS = ((0.0, 0.0, 0.5), (4.0, 0.25, 0.0), (0.5, 3.0, 1.0))
NORMALS = ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, 0.6, 0.8))
UV = ((0.0, 0.25), (2.0, 0.0), (0.5, 1.0))
SHAPES = {
    "sphere": caster.Sphere(center=(1, 2, 3), radius=1.5),
    "ellipsoid": caster.Sphere(to_world=[STRETCH]),
    "disk": caster.Disk(to_world=PLACE),
    "stretched disk": caster.Disk(to_world=[STRETCH]),
    "cylinder": caster.Cylinder(to_world=PLACE),
    "stretched cylinder": caster.Cylinder(to_world=[STRETCH]),
    "plane": caster.Plane(point=(1, 2, 3), normal=(1, 2, 4)),
    "triangle": caster.Triangle(vertices=CORNERS),
    "smooth triangle": caster.Triangle(vertices=CORNERS, normals=NORMALS, uv=UV, to_world=PLACE),
}
POSE: dict[str, Any] = {"eye": (0.3, -0.2, 0.7), "direction": (0.2, -0.5, 0.8), "up": (0.1, 1.0, 0.0)}
CAMERAS = {
    "pinhole": caster.Pinhole(fov=80.0, principal_point=(0.1, -0.2), near=0.25, far=50.0, **POSE),
    "orthographic": caster.Orthographic(width=3.0, **POSE),
    "fisheye": caster.Fisheye(fov=180.0, **POSE),
    "wide fisheye": caster.Fisheye(fov=350.0, **POSE),
    "panorama": caster.Panorama(**POSE),
    "parabolic": caster.Parabolic(**POSE),
}
FILM = (300, 110)
TARGETS = [
    *((0.5, 0.5, 0.5), (0.1, 0.6, 0.4), (0.9, 0.2, 0.7), (0.0, 0.5, 0.5), (1.0, 1.0, 0.2)),
    *((0.3, 0.3, 0.35), (0.5, 0.5, 0.02), (2.0, 2.0, 2.0)),
]
# of rays: where they start beside the box of the shape, in boxes, and how long d is
STARTS = [
    *(((3.0, 1.0, 2.0), 1.0), ((0.25, -4.0, -19.0), 0.25), ((0.5, 0.45, 0.5), 7.0), ((-300.0, 200.0, 90.0), 1.0)),
    ((1.0, 0.5, 0.5), 3.0),
    *(((3.0, 1.0, 2.0), 1e-305), ((3.0, 1.0, 2.0), 1e-160), ((3.0, 1.0, 2.0), 1e150)),
]


def flat(value: Any) -> Iterator[float]:
    """All numbers of nested tuples and arrays; False and True as 0 and 1."""
    if isinstance(value, tuple | list):
        for each in value:
            yield from flat(each)
    elif isinstance(value, np.ndarray):
        yield from (float(x) for x in value.ravel())
    else:
        yield float(value)


def kind_of(*shapes: Any) -> Kind:
    camera = caster.Pinhole(eye=(0, 0, 9), look_at=(0, 0, 0))
    scene = Scene(film=caster.Film(width=2, height=2), camera=camera, shapes=list(shapes))
    (kind,) = make_packed(scene).kinds
    return kind


def box_of(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    """(low, high) of primitive 0, and of a plane a box about it."""
    points = np.array([hull_point(prims, 0, j) for j in range(hull_size(prims))])
    return (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.full(3, 6.0))


def intersections(name: str) -> Iterator[Any]:
    """Of rays at a shape: what was prepared, the root with its bound in several ranges, the surface where it is hit."""
    prims = kind_of(SHAPES[name]).prims
    low, high = box_of(prims)
    for start, length in STARTS:
        o = tuple((low + np.array(start) * (high - low)).tolist())
        pre = prepare(prims, load(prims, 0), o)
        yield pre
        for target in TARGETS:
            d = towards(low + np.array(target) * (high - low), o, length)
            t, error = found = intersect(prims, pre, d, 0.0, math.inf)
            yield found, surely_misses(prims, pre, d)
            wide = tuple(x - 0.01 for x in d), tuple(x + 0.01 for x in d)
            yield t_lower_bound(prims, pre, *wide)
            if 0.0 < t < math.inf and error < math.inf:
                yield intersect(prims, pre, d, t, math.inf), intersect(prims, pre, d, 0.0, 0.5 * t)
                yield surface(prims, 0, o, d, t, True), normal(prims, 0, o, d, t)
                setup = normal_setup(prims, 0, max(map(abs, o)))
                yield setup
                if length == 1.0 and setup[0]:
                    yield fast_normal(prims, setup, o, d, t)


def towards(point: np.ndarray, o: Any, length: float) -> Any:
    """A vector of that length from o to a point."""
    x, y, z = along = point - np.array(o)
    return tuple((along * (length / math.sqrt(x * x + y * y + z * z))).tolist())  # a BLAS would depend on the machine


SURE_HIT, UNDECIDED, SURE_MISS = range(3)


def undecided(name: str) -> Iterator[Any]:
    """How far aside a ray has to be turned from where it is sure to hit a shape to where it is sure to miss.

    As parts of the way between two targets: where it is no longer sure to hit, and how wide what lies between is. That
    is twice the error bounds. From far away it is a billion of the smallest steps.
    """
    prims = kind_of(SHAPES[name]).prims
    low, high = box_of(prims)
    for start in ((3e5, 1e5, 2e5), (-1e5, 2e4, 3e5), (300.0, -200.0, 90.0)):
        o = tuple((low + np.array(start) * (high - low)).tolist())
        pre = prepare(prims, load(prims, 0), o)
        for length in (1.0, 7.0, 0.03):
            for beyond in ((2.5, 0.5, 0.5), (0.5, -1.5, 0.5), (0.5, 0.5, 2.5), (0.5, 0.5, -1.5)):

                def answer(
                    part: float, beyond: Any = beyond, pre: Any = pre, o: Any = o, length: float = length
                ) -> int:
                    place = (1.0 - part) * np.array((0.4, 0.45, 0.4)) + part * np.array(beyond)
                    d = towards(low + place * (high - low), o, length)
                    t, error = intersect(prims, pre, d, 0.0, math.inf)
                    return UNDECIDED if error == math.inf else SURE_HIT if t < math.inf else SURE_MISS

                if (answer(0.0), answer(1.0)) == (SURE_HIT, SURE_MISS):
                    hit = changes_at(lambda part, answer=answer: answer(part) != SURE_HIT)
                    yield hit, changes_at(lambda part, answer=answer: answer(part) == SURE_MISS) - hit


def changes_at(test: Callable[[float], bool]) -> float:
    """Where between 0 and 1 a test becomes true, by halving: to the last bit."""
    low, high = 0.0, 1.0
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (low, middle) if test(middle) else (middle, high)
    return high


def hulls(name: str) -> Iterator[Any]:
    """Points that hold a shape, and its boxes."""
    prims = kind_of(SHAPES[name]).prims
    yield hull_size(prims), [hull_point(prims, 0, j) for j in range(hull_size(prims))]
    low, high = np.zeros((1, 3)), np.zeros((1, 3))
    if hull_size(prims):
        bounding_boxes(prims, low, high, 0, 1)
    yield low, high
    if name == "sphere":
        yield tight_sphere(prims, 0)


def projections(name: str) -> Iterator[Any]:
    """Rays of a camera, and where points and spheres around it fall on its film: ahead, aside, behind, near, far."""
    camera = CAMERAS[name].pack(*FILM)
    yield camera
    for x in (0.0, 0.5, 77.0, 150.0, 299.5, 300.0):
        for y in (0.0, 33.25, 55.0, 110.0):
            yield camera_ray(camera, x, y)
    right, up, forward = (np.array(axis) for axis in CAMERAS[name].frame)
    for ahead in (1.0, 0.3, 1e-5, -1e-5, -0.5, -3.0):
        for aside in (0.0, 0.4, -2.0, 11.0):
            for above in (0.0, 0.5):
                for size in (1.0, 1e-6, 1e130):
                    place = size * (ahead * forward + aside * right + above * up)
                    p = tuple((np.array(camera.eye) + place).tolist())
                    if size == 1.0 or (above, aside) == (0.5, 0.4):
                        yield project(camera, p)
                        for radius in (0.05, 0.3, 0.9):
                            yield project_bounding_sphere(camera, p, radius * size)
    if name not in ("pinhole", "orthographic"):
        for extent in (0.0, 0.25, 1.0, 4.0, 9.0, 1000.0):
            yield distortion_bound(camera, extent)


def scattered(cls: str) -> list[Any]:
    """Shapes of a kind around the cameras: in front, beside, behind, near and far."""
    rng = np.random.default_rng(7)
    found: list[Any] = []
    for i in range(40):
        center = (np.array(POSE["eye"]) + rng.normal(size=3) * 10.0 ** rng.uniform(-1.0, 1.0)).tolist()
        size = 10.0 ** rng.uniform(-2.5, 0.5)
        if cls == "triangle":
            corners = [(np.array(center) + size * rng.normal(size=3)).tolist() for _ in range(3)]
            found.append(caster.Triangle(vertices=corners))
        elif cls == "sphere":
            found.append(caster.Sphere(center=center, radius=size))
        else:
            turns = [TURN] * (i % 5)
            found.append(caster.Disk(to_world=[{"scale": [size, 2 * size, 1]}, *turns, {"translate": center}]))
    return found


def in_whole(span: tuple[int, int], lanes: int = 8) -> tuple[int, int]:
    """A span of pixels in whole vectors of the widest processor, as which any other's can be written."""
    return span[0] // lanes * lanes, -(-span[1] // lanes) * lanes


def screen_bounds(name: str) -> Iterator[Any]:
    """Of primitives scattered about a camera, in two windows of its film and with two slacks."""
    camera = CAMERAS[name].pack(*FILM)
    rectilinear = name in ("pinhole", "orthographic")
    for cls in ("triangle", "sphere", "disk"):
        kind = kind_of(*scattered(cls))
        prims, count = kind.prims, len(kind.ids)
        for window, slack in ((Window(0, 0, *FILM), 1e-3), (Window(40, 17, 129, 60), 0.0)):
            reach = slack, PROJECTION_MARGIN
            corners = len(prims.vertices) if cls == "triangle" else 0
            bounds = ScreenBounds(
                np.zeros((count, 4), np.int32),
                np.zeros(count),
                prims.faces if cls == "triangle" else np.zeros((0, 3), np.int32),
                np.zeros((corners, 4)),
                (0.0, 0.0, 0.0),
                0.0,
            )
            if cls == "triangle":
                project_vertices(prims.vertices, camera, window, bounds.projected, reach, 0, corners)
                bound = bound_triangles if rectilinear else bound_distorted_triangles
                args = (window, bounds, reach) if rectilinear else (prims, camera, window, bounds, reach)
                bound(*args, 0, count)
                yield bounds.projected
                for k in range(count):
                    box = (64, 16, 128, 48)
                    rect = bounds_in_tile(bounds.pixels, k, box)
                    x_start, _, x_stop, _ = bounds.pixels[k]
                    if max(x_start, box[0]) < min(x_stop, box[2]) and rect[1] < rect[3]:
                        spans = [row_bounds(bounds, k, box, rect, y) for y in (rect[1], rect[3] - 1)]
                        yield rect[1], rect[3], [in_whole(span) for span in [(rect[0], rect[2]), *spans]]
            elif rectilinear:
                by = bound_spheres if cls == "sphere" else bound_hulls
                by(prims, camera, window, bounds, reach, 0, count)
            else:
                bound_by_spheres(prims, camera, window, bounds, reach, 0, count)
            yield bounds.pixels, bounds.near


def quadrics(_: str) -> Iterator[Any]:
    """Roots, closest approaches and normals of spheres of many sizes, for inputs that are off by so much."""
    for r in (1.0, 0.01, 40.0):
        for f in ((3.0 * r, 0.5 * r, -0.25 * r), (0.25 * r, -0.125 * r, 0.5 * r), (-1e5 * r, 2e4 * r, 3e4 * r)):
            for f_error, d_error in ((0.0, 0.0), (1e-6 * r, 0.0), (0.0, 1e-7), (1e-5 * r, 1e-6)):
                setup = quadric_setup(f, r, f_error)
                yield setup
                for d in ((-1.0, -0.2, 0.1), (0.5, -0.0625, 0.25), (300.0, 20.0, -90.0), (0.0, 1.0, 0.0)):
                    yield closest_approach(setup, d, d_error), quadric_roots(setup, d, d_error)
    for r in (1.0, 0.5, 3.0, 1e-3):
        for f in ((2.0, 0.5, -0.25), (-0.25, 0.125, 0.5), (0.9, 0.0, 0.0), (0.0, 1.5, 0.1)):
            for t in (-0.5, 0.0, 1e-9, 0.75, 2.0, 40.0):
                yield (outward_normal(f, (-0.6, 0.0, 0.8), t, r), fast_outward_normal(f, (-0.6, 0.0, 0.8), t, r))
                yield outward_normal(f, (-3.0, 1.0, 0.25), t, r)
    for t in np.nextafter(2.0, [0.0, 3.0]).tolist():  # the ends of a chord that t hardly separates
        for r in (3.0, 2.5, 2.0, 1.0, 0.25):
            yield outward_normal((2.0, 0.0, 0.0), (-1.0, 0.0, 0.0), t, r)
    for axis in range(3):
        far = tuple(np.roll([MAX_RANGE * 4.0, 0.0, 0.0], axis).tolist())
        yield outward_normal(far, (-0.6, -0.1, 0.7), 1.5, 1.0)
    for size in (MIN_RANGE / 4.0, MAX_RANGE * 4.0):
        for f in ((2.0, 0.5, -0.25), (0.5, 2.0, 0.25), (0.25, 0.5, 2.0)):
            far = tuple(size * x for x in f)
            yield outward_normal(far, (-0.6, -0.1, 0.7), 1.5 * size, size)
            yield outward_normal(far, (-0.6, -0.1, 0.7), 1.5 * size, 1.0)


def triangles(_: str) -> Iterator[Any]:
    """Barycentrics and whether the fast ones are known, along each axis, also where a ray runs along the triangle."""
    for thickness in (1.0, 1e-6, 1e-13, 3e-15, 1e-15, 3e-16, 0.0):
        for axis in range(3):
            corners = [
                np.roll([x, y, 2.0 + thickness * z], axis).tolist()
                for x, y, z in ((-1.0, 0.25, 1.0), (2.0, 0.5, -1.0), (0.125, 0.375, 3.0))
            ]
            for d in ((1.0, 0.375, 2.0), (0.25, 0.0, 1.0), (1.0, 0.3125, 0.0)):
                for t in (1.0, 0.75):
                    a, b, c = (tuple(corner) for corner in corners)
                    way = tuple(np.roll(d, axis).tolist())
                    yield barycentrics(a, b, c, way, t), fast_barycentrics(a, b, c, way)
            yield fast_triangle_normal(*(tuple(corner) for corner in corners))


MESHES = {
    "torus": caster.Torus(segments=5, sides=4),
    "icosphere": caster.Icosphere(subdivisions=1),
    "heightfield": caster.Heightfield(resolution=3, waves=3),
    "teapot": caster.Teapot(subdivisions=1),
    "cube": caster.Cube(),
    "rectangle": caster.Rectangle(),
}


def meshes(name: str) -> Iterator[Any]:
    """Vertices, faces, normals and uv of a generated mesh."""
    prims = kind_of(MESHES[name]).prims
    yield prims.vertices, prims.faces, prims.normals, prims.uv


def trees(_: str) -> Iterator[Any]:
    """The tree of some spheres and of some triangles: its links, boxes and order."""
    for cls in ("triangle", "sphere"):
        yield tuple(bvh_of(kind_of(*scattered(cls), *scattered(cls)[:3])))


def fans(name: str) -> Iterator[Any]:
    """Spheres or triangles as fans see them, with the slack of roundings and with a large one."""
    kind = kind_of(*scattered(name))
    tree, lights = (bvh_of(kind), (PointLight(POSE["eye"], NO_POINT), DirectionalLight((0.6, 0.0, -0.8), NO_POINT)))
    for light in lights:
        for deviation in (0.0, 0.01):
            fan = fans_to(light, tree.center, kind.extent, deviation)[0]
            bounds = fan_bounds(kind, fan, 1)
            yield tuple(fan), tuple(bounds)
            for at in range(0, len(kind.ids), 3):
                wide, k = bounds.prims[at * PRIM_FIELDS + FAN_FIELDS], int(tree.order[at])
                yield outline(kind.prims, k, bounds.points, wide)
                yield separating_plane(kind.prims, load(kind.prims, k), fan)


def shadow_rays(_: str) -> Iterator[Any]:
    """Where rays to a light start and end, and what arrives."""
    lights = (PointLight((1.0, 5.0, 2.0), (3.0, 2.0, 1.0)), DirectionalLight((0.5, -1.0, 0.25), (1.0, 2.0, 4.0)))
    for light in lights:
        for p in ((0.0, 0.0, 0.0), (7.0, -3.0, 2.0), (1.0, 5.0, 2.0), (1e6, 5.0, 2.0)):
            for n in ((0.0, 1.0, 0.0), (0.6, -0.8, 0.0), (0.0, 0.0, 1.0)):
                for two_sided in (False, True):
                    yield received_irradiance(light, p, n, (0.1, -0.9, 0.4), two_sided)
                for extent in (0.0, 1e4):
                    yield shadow_ray(light, p, n, (4.0, 4.0, -9.0), (0.1, -0.9, 0.4), 3.5, extent)


FIELDS = {"sphere": 4, "plane": 12, "triangle": 3 * 3 + 1 + 7, "smooth triangle": 3 * 3 + 3 * 3 + 1 + 7}


@pytest.mark.parametrize("name", FIELDS)
def test_the_setup_of_a_surface_fills_its_own_fields_of_its_own_lanes(name):
    scratch = new_lanes()
    scratch[:] = np.nan
    surface_setup(kind_of(SHAPES[name]).prims, 0, lane(3), lane(6), scratch, True)
    field, at = np.divmod(np.flatnonzero(~np.isnan(scratch)), SURFACE_LANES)
    assert sorted(set(at.tolist())) == [3, 4, 5] and len(at) == 3 * FIELDS[name]
    assert field.min() == int(LANE_SETUP) // SURFACE_LANES and field.max() < LANE_FIELDS


TABLES: dict[str, tuple[Callable[[str], Iterator[Any]], tuple[str, ...]]] = {
    "intersections": (intersections, tuple(SHAPES)),
    "undecided": (undecided, tuple(shape for shape in SHAPES if shape != "plane")),
    "hulls": (hulls, tuple(SHAPES)),
    "projections": (projections, tuple(CAMERAS)),
    "screen bounds": (screen_bounds, tuple(CAMERAS)),
    "quadrics": (quadrics, ("spheres",)),
    "barycentrics": (triangles, ("triangles",)),
    "meshes": (meshes, tuple(MESHES)),
    "trees": (trees, ("both",)),
    "fans": (fans, ("sphere", "triangle")),
    "shadow rays": (shadow_rays, ("both",)),
}
CASES = [(table, name) for table, (_, names) in TABLES.items() for name in names]


def numbers_of(table: str, name: str) -> np.ndarray:
    with np.errstate(all="ignore"):
        return np.array(list(flat(list(TABLES[table][0](name)))))


@pytest.mark.parametrize(("table", "name"), CASES)
def test_kernels_state_these_numbers(table, name):
    expected = np.array([float(x) for x in json.loads(STATED.read_text(encoding="utf-8"))[table][name]])
    assert numbers_of(table, name) == pytest.approx(expected, rel=1e-9, abs=0.0, nan_ok=True)


if __name__ == "__main__":
    found = {
        table: {name: [float(f"{x:.10g}") for x in numbers_of(table, name)] for name in names}
        for table, (_, names) in TABLES.items()
    }
    STATED.write_text(json.dumps(found).replace('], "', '],\n "') + "\n", encoding="utf-8")

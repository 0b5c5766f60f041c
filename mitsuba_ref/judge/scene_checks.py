"""Checks made once a scene: the transform, packing and material of each shape, film and camera, `render` against the
judged rays."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from caster.aovs import Aovs
from caster.description.errors import SceneError
from caster.description.fields import Camera, Shape
from caster.geometry.packing import Packed, packed
from caster.geometry.world_space import as_given
from caster.rendering.casting import find_nearest
from caster.rendering.hits import trace, trace_rays
from caster.rendering.images import camera_rays, evaluate, film_window, render
from caster.scene.model import MAX_FILM_SIDE, Diffuse, Film, Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import camera_axes, no_sensor
from mitsuba_ref.error_model.bounds import aov_rows, error_over_bound, nearest_root
from mitsuba_ref.error_model.bracket import Bracket, Claims, RaySegments
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, transform_error_ratio
from mitsuba_ref.error_model.intersections import any_of_columns, dot, norm
from mitsuba_ref.error_model.lambert import ShadingPoints
from mitsuba_ref.error_model.tolerances import CAMERA_ROUNDINGS, KU, KU_OURS, TRANSFORM_ROUNDINGS
from mitsuba_ref.judge.diffuse import diffuse_within_float64
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.reference.rendering import ReferenceResult
from mitsuba_ref.reference.shared_input import SharedRays, model_of, packed_float32
from mitsuba_ref.shapes import kind_of, reference_of


class Shares:
    """Errors over their bounds by what was checked; a second value of one name would hide the first and is refused."""

    def __init__(self) -> None:
        self._shares: dict[str, float] = {}

    def add(self, what: str, share: float) -> None:
        if what in self._shares:
            raise ValueError(f"{what} is checked twice, and a verdict has room for one share of it")
        self._shares[what] = share

    def worst(self) -> tuple[str, float]:
        """The largest share and what it is of."""
        what = max(self._shares, key=lambda name: self._shares[name], default="nothing to look at")
        return what, self._shares.get(what, 0.0)


def bits_differ(a: Aovs, b: Aovs, name: str) -> np.ndarray:
    """(n,) bool: pixels where one AOV of two images has other bits."""
    rows, others = aov_rows(a, name), aov_rows(b, name)
    different = rows.view(f"u{rows.itemsize}") != others.view(f"u{rows.itemsize}")
    return different if different.ndim == 1 else any_of_columns(different)


def pixel_centers(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the window's pixel centres, row by row."""
    x0, y0, x1, y1 = scene.film.crop or (0, 0, scene.film.width, scene.film.height)
    y, x = np.meshgrid(np.arange(y0, y1) + 0.5, np.arange(x0, x1) + 0.5, indexing="ij")
    return x.ravel(), y.ravel()


def worst_pixel(name: str, shares: dict[str, np.ndarray], among: np.ndarray, scene: Scene) -> SceneCheck:
    """The largest share of all, and the pixel it is at."""
    table = np.array([np.where(among, error_over_bound(share, np.ones(1)), 0.0) for share in shares.values()])
    if not table.size:
        return SceneCheck(name, 0.0, "nothing to look at")
    part, pixel = np.unravel_index(int(np.argmax(table)), table.shape)
    x0, y0, x1, _y1 = scene.film.window
    x, y = x0 + int(pixel) % (x1 - x0), y0 + int(pixel) // (x1 - x0)
    return SceneCheck(name, float(table[part, pixel]), f"{list(shares)[int(part)]} at ({x}, {y})")


# What is checked once for each shape of a scene: where it stands, the numbers it packs to, and its material.


def check_placement(scene: Scene) -> SceneCheck:
    """Each shape's matrix against its steps, composed a second time."""
    ratios = [transform_error_ratio(shape) for shape in scene.shapes if shape.to_world]
    names = [name for name, shape in zip(scene.shape_names(), scene.shapes, strict=True) if shape.to_world]
    if not ratios:
        return SceneCheck("placement", 0.0, "no shape has a to_world")
    worst = int(np.argmax(ratios))
    return SceneCheck("placement", ratios[worst], f"to_world of {names[worst]}")


class Precision(NamedTuple):
    """How the numbers of a shape are rounded when it is packed."""

    name: str  # of NumPy's type
    packing: Callable[[Scene], Packed]
    unit_roundoff: float
    # Below it the spacing of numbers stays what it is there, and so does what a rounding may take: half of it, the
    # unit round-off of the smallest normal number.
    smallest_normal: float


PRECISIONS = (
    Precision("float64", packed, 2.0**-53, 2.0**-1022),  # what `render` casts
    Precision("float32", packed_float32, 2.0**-24, 2.0**-126),  # what is judged against the reference
)


def with_one_mesh(shape: Shape) -> Shape:
    """The same shape, whose mesh is generated once: of ten million triangles, that takes two seconds."""
    if not hasattr(shape, "mesh"):
        return shape
    copy = shape.model_copy()
    object.__setattr__(copy, "mesh", cache(shape.mesh))  # a description takes no attribute otherwise
    return copy


def check_geometry(scene: Scene) -> SceneCheck:
    """Each shape's numbers in the world, float64 and float32, against its description, worked out a second time."""
    shares = Shares()
    latest: list[tuple[Shape, Shape]] = []  # one, with its copy: meshes of others are dropped

    def described(shape: Shape) -> Shape:
        if not latest or latest[0][0] is not shape:
            latest[:] = [(shape, with_one_mesh(shape))]
        return latest[0][1]

    for precision in PRECISIONS:
        parts = precision.packing(scene).parts
        for name, shape, part in zip(scene.shape_names(), scene.shapes, parts, strict=True):
            for field in unrounded_arrays(part, precision.name):
                shares.add(f"{field} of {name} not rounded to {precision.name}", np.inf)
            for claim in reference_of(shape).expected(described(shape), part):
                share = _packing_error_ratio(claim, precision.unit_roundoff, precision.smallest_normal)
                shares.add(f"{claim.what} of {name} ({precision.name})", share)
    worst, share = shares.worst()
    return SceneCheck("geometry", share, worst)


def unrounded_arrays(part: Any, dtype: str) -> list[str]:
    """Arrays of a packed shape that hold other numbers than those of a type, which both sides have to trace.

    float64 numbers lie within the bounds of float32, so that no bound shows that they were not rounded.
    """
    derived = kind_of(part).derived
    floats = {name: array for name, array in part._asdict().items() if array.dtype.kind == "f" and name not in derived}
    with np.errstate(over="ignore"):
        return [name for name, array in floats.items() if not np.array_equal(array, array.astype(dtype))]


def _packing_error_ratio(claim: ExpectedNumbers, rounding: float, normal: float) -> float:
    """Largest error over its bound; inf where there are other numbers than expected."""
    if claim.packed.shape != np.shape(claim.expected):
        return float("inf")
    error = np.abs(claim.packed - claim.expected)
    size = np.maximum(claim.size, normal) if claim.rounded else claim.size
    bound = TRANSFORM_ROUNDINGS * rounding * np.broadcast_to(size, error.shape)
    hopeless = np.isposinf(bound)  # normals that cancel: their direction is undefined
    return float(np.where(hopeless, 0.0, error_over_bound(error, bound)).max(initial=0.0))


def check_materials(scene: Scene) -> SceneCheck:
    """Each shape's material is the one it names: Mitsuba gets what the caster looks up."""
    ratios = [
        0.0 if scene.material_of(shape) == _described_material(scene, shape) else np.inf for shape in scene.shapes
    ]
    if not ratios:
        return SceneCheck("materials", 0.0, "no shape")
    worst = int(np.argmax(ratios))
    return SceneCheck("materials", ratios[worst], f"material of {scene.shape_names()[worst]}")


def _described_material(scene: Scene, shape: Shape) -> Diffuse:
    return scene.materials[shape.material] if shape.material else Diffuse()


# `render`, which is what users get, against the way that pixels are judged.
#
# Judged rays start at the near plane and have no least t; those of `render` start in the eye. Without a near plane the
# two are the same rays, and check_culling demands the same bits. With one they are others, by the rounding of where the
# near plane is, which is as large as the last digit of the eye's coordinates. So where bits differ, `render` is held to
# its own rays, from the eye, with their least t: what the float64 bracket allows there, with no room for the move.


CHECKED_AOVS = ("depth", "normal", "shading_normal", "position", "shape_id", "diffuse", "prim_id")
RENDER_PIXELS_CHECKED = 4096  # pixels that are judged where bits may differ: a few tenths of a second


def check_render(scene: Scene) -> SceneCheck:
    """What `render` gives is what the judged rays give: the same bits, or where they cannot be, right by float64."""
    rays = camera_rays(scene)
    if not (rays.t_min > 0.0).any():
        return SceneCheck("render", 0.0, "no near plane: the rays are those that culling is checked on")
    o = rays.o + rays.t_min[:, None] * rays.d
    left = np.where(rays.t_max < 0.0, -1.0, rays.t_max - rays.t_min)
    judged = trace(scene, o, rays.d, left, rays.t_min, rounded=as_given)
    ours, moved = render(scene, CHECKED_AOVS), evaluate(judged, CHECKED_AOVS, film_window(scene))
    differs = np.any([bits_differ(ours, moved, name) for name in CHECKED_AOVS], axis=0)
    rows = np.flatnonzero(differs & (rays.t_min > 0.0))
    differing = len(rows)
    if differing:
        rows = np.random.default_rng(1).choice(rows, min(RENDER_PIXELS_CHECKED, differing), replace=False)
        differs &= rays.t_min == 0.0
        differs[rows] = ~_within_float64(scene, ours, rows, _segments(rays, rows))
    found = worst_pixel("render", {"pixel": np.where(differs, np.inf, 0.0)}, np.ones(len(o), bool), scene)
    sampled = f"; {len(rows)} of {differing} pixels with other bits looked at" if len(rows) < differing else ""
    return replace(found, what=found.what + sampled)


def _segments(rays: Any, rows: np.ndarray) -> RaySegments:
    """Some of the camera's rays."""
    return RaySegments(rays.o[rows], rays.d[rows], rays.t_min[rows], rays.t_max[rows])


def _within_float64(scene: Scene, ours: Aovs, rows: np.ndarray, rays: RaySegments) -> np.ndarray:
    """(m,) bool: geometry within float64's bracket, diffuse as the lights' definitions give it there."""
    depth, n, sh_n, p, shape, diffuse, prim = (aov_rows(ours, name)[rows] for name in CHECKED_AOVS)
    t = depth / norm(rays.d)
    model = model_of(scene, packed(scene), SharedRays(rays.o, rays.d, rays.t_max, np.zeros(len(t))))
    bracket = Bracket(model, KU_OURS, ours=True)
    claims = Claims(t, shape, n, sh_n, p, KU_OURS * t)
    found = bracket.judge(rays.o, rays.d, rays.t_max, claims, t_min=rays.t_min)
    right = found.allowed | found.open
    hit = np.flatnonzero(right & (shape >= 0))
    o, d, t, shape = rays.o[hit], rays.d[hit], t[hit], shape[hit]
    prim = model.packed.first[shape] + prim[hit]
    at = nearest_root(model.intersect(prim, o, d, KU_OURS, ours=True), t)
    right[hit] &= diffuse_within_float64(
        scene, ShadingPoints(o + t[:, None] * d, d, shape, at), prim, diffuse[hit], bracket
    )
    return right


# What is checked once a scene, beside the pixels: shapes, camera, sensor, and what `render` makes of them.


def check_camera(scene: Scene) -> SceneCheck:
    """The film's window, and our float64 rays against the camera's formula; both are worked out a second time."""
    if wrong := wrong_windows(scene):
        return SceneCheck("camera", np.inf, wrong[0])
    ours = camera_rays(scene)
    x, y = pixel_centers(scene)
    if len(ours.o) != len(x):
        return SceneCheck("camera", np.inf, f"{len(ours.o)} rays, the window has {len(x)} pixels")
    expected = reference_of_camera(scene.camera).rays(scene.camera, scene.film, x, y)
    size = float(np.abs(expected.o).max(initial=np.finfo(np.float64).tiny))
    rounding = CAMERA_ROUNDINGS * KU_OURS / _up_sine(scene.camera)
    seen = expected.t_max >= 0.0
    rim = np.zeros(len(x), bool) if reference_of_camera(scene.camera).covers_film else _on_rim(scene, x, y)
    shares = {
        "rays there are": np.where(seen == (ours.t_max >= 0.0), 0.0, np.inf),
        "origin": norm(ours.o - expected.o) / (rounding * size),
        "direction": norm(ours.d - expected.d) / rounding,
        "near": _relative(ours.t_min, expected.t_min) / rounding,
        "far": _relative(ours.t_max, expected.t_max) / rounding,
    }
    return worst_pixel("camera", shares, (seen | (ours.t_max >= 0.0)) & ~rim, scene)


Size = tuple[int, int]  # of a film: width, height


def wrong_windows(scene: Scene) -> list[str]:
    """What is wrong with the window of a scene's film, with those of films of other sizes, and with parts of it.

    A film that is resized keeps all pixels that its crop reaches into. Both sides get the same film, so that no pixel
    shows one that was lost with its last column.
    """
    film, bare = scene.film, _bare(scene)
    width, height = film.width, film.height
    x0, y0, x1, y1 = whole = film.crop or (0, 0, width, height)
    found = [] if film.window == whole else [f"window {film.window}, expected {whole}"]
    found += wrongly_resized(scene, _other_sizes(film))
    for inside in (whole, (x1 - 1, y0, x1, y1), (x0, y0, x0 + 1, y0 + 1)):
        given = bare.with_film(crop=inside).film
        if (given.width, given.height, given.crop, given.window) != (width, height, inside, inside):
            found.append(f"window {inside} of {width} x {height} is {given.window} of {given.width} x {given.height}")
    return found


def wrongly_resized(scene: Scene, sizes: Sequence[Size]) -> list[str]:
    """What is wrong with the films that `Scene.with_film` makes of a scene's film."""
    return list(_wrongly_resized(scene.film, _bare(scene), sizes))


def _wrongly_resized(film: Film, bare: Scene, sizes: Sequence[Size]) -> Iterator[str]:
    before = f"crop {film.crop} of {film.width} x {film.height}"
    for width, height in sizes:
        expected = film.crop and _pixels_reached(film, film.crop, width, height)
        try:
            given = bare.with_film(width=width, height=height).film
        except SceneError as error:
            yield f"{before} is refused for {width} x {height}: {error}"
            continue
        if (given.width, given.height, given.crop) != (width, height, expected):
            after = f"{given.crop} of {given.width} x {given.height}"
            yield f"{before} is {after}, expected {expected} of {width} x {height}"


def _bare(scene: Scene) -> Scene:
    """Film and camera alone: a copy of thousands of shapes takes its time."""
    return scene.model_copy(update={"shapes": (), "lights": (), "materials": {}, "checks": {}})


def _other_sizes(film: Film) -> list[Size]:
    """The film's own, and larger and smaller ones that few sizes divide."""
    width, height = film.width, film.height
    sizes = [(width, height), (width + 1, height + 1), (2 * width + 1, 3 * height), (7, 5), (101, 97)]
    sizes += [(max(1, width // 2), max(1, height // 3)), (max(1, width - 1), 2 * height - 1)]
    return [size for size in sizes if max(size) <= MAX_FILM_SIDE]


def _pixels_reached(film: Film, crop: Sequence[int], width: int, height: int) -> tuple[int, ...]:
    """x0, y0, x1, y1 of the pixels of a film of another size that overlap the crop of this one."""
    ends = []
    for begin, end, old, new in ((crop[0], crop[2], film.width, width), (crop[1], crop[3], film.height, height)):
        pixel = np.arange(new)
        inside = np.flatnonzero(((pixel + 1) * old > begin * new) & (pixel * old < end * new))
        ends.append((int(inside[0]), int(inside[-1]) + 1))
    (x0, x1), (y0, y1) = ends
    return x0, y0, x1, y1


def _up_sine(camera: Camera) -> float:
    """The sine of the angle between view and up: the orthobasis rounds by as much more as this is less than 1."""
    forward, up = camera_axes(camera)[2], np.array(camera.up, np.float64)
    return float(np.linalg.norm(np.cross(forward, up)) / np.linalg.norm(up))


def _on_rim(scene: Scene, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n,) bool: pixels on the edge of a round image, up to rounding, so that either side may have a ray there."""
    film, reference = scene.film, reference_of_camera(scene.camera)
    middle_x, middle_y = film.width / 2.0, film.height / 2.0
    seen = []
    for scale in (1.0 - KU_OURS, 1.0 + KU_OURS):
        rays = reference.rays(scene.camera, film, middle_x + scale * (x - middle_x), middle_y + scale * (y - middle_y))
        seen.append(rays.t_max >= 0.0)
    differs: np.ndarray = seen[0] != seen[1]
    return differs


def check_sensor(scene: Scene, witness: ReferenceResult) -> SceneCheck:
    """Our rays against those of Mitsuba's own sensor: the same line, and depth that starts on the near plane."""
    answer = witness.answer
    if answer.sensor_d is None or answer.sensor_o is None or answer.sensor_t_max is None:
        expected = reference_of_camera(scene.camera).to_xml is not no_sensor
        what = "the answer lacks its rays" if expected else f"Mitsuba has no {scene.camera.type} camera"
        return SceneCheck("sensor", np.inf if expected else 0.0, what)
    ours, reference = camera_rays(scene), reference_of_camera(scene.camera)
    o, d = answer.sensor_o.astype(np.float64), answer.sensor_d.astype(np.float64)
    if len(d) != len(ours.d):
        return SceneCheck("sensor", np.inf, f"Mitsuba gives {len(d)} rays, we {len(ours.d)}")
    bound = KU * reference.amplification(scene.camera, scene.film)
    along = dot(o - ours.o, ours.d)
    aside = norm(o - ours.o - along[:, None] * ours.d)
    size = norm(ours.o) + np.abs(along) + np.abs(scene.camera.eye).max() + getattr(scene.camera, "width", 0.0)
    shares = {"direction": norm(d - ours.d) / bound, "origin": aside / (bound * size)}
    if getattr(scene.camera, "near", 0.0) > 0.0:
        shares["near"] = np.abs(along - ours.t_min) / (bound * (size + ours.t_min))
    if getattr(scene.camera, "far", None) is not None:
        end = along + answer.sensor_t_max.astype(np.float64)
        with np.errstate(invalid="ignore"):  # a far plane at infinity is beyond every bound
            shares["far"] = np.abs(end - ours.t_max) / (bound * (size + ours.t_max))
    return worst_pixel("sensor", shares, np.ones(len(d), bool), scene)


BRUTE_FORCE_TESTS = 1 << 24  # rays times primitives that are tried without any culling


def check_culling(scene: Scene) -> SceneCheck:
    """`render`, as it is planned for this scene, against the way that pixels are judged: the same bits."""
    rays = camera_rays(scene)
    judged = trace_rays(scene, packed(scene), rays, np.zeros(len(rays.o)))
    planned, tree = render(scene, CHECKED_AOVS), evaluate(judged, CHECKED_AOVS, film_window(scene))
    differs = np.any([bits_differ(planned, tree, name) for name in CHECKED_AOVS], axis=0)
    return _same_bits("culling", differs, scene)


def check_brute_force(scene: Scene) -> SceneCheck:
    """The way that pixels are judged against every primitive there is, on a sample of rays: the same bits."""
    rays, numbers = camera_rays(scene), packed(scene)
    rows = _sampled_rays(len(rays.o), int(numbers.first[-1]))
    obvious = find_nearest(numbers, type(rays)(*(a[rows] for a in rays)), "brute-force")
    found, differs = find_nearest(numbers, rays), np.zeros(len(rays.o), bool)
    differs[rows] = (obvious.t != found.t[rows]) | (obvious.prim != found.prim[rows])
    return _same_bits("brute_force", differs, scene)


def _same_bits(name: str, differs: np.ndarray, scene: Scene) -> SceneCheck:
    """A check that allows no difference; differs: (n,) bool, of the window's pixels."""
    return worst_pixel(name, {"bits": np.where(differs, np.inf, 0.0)}, np.ones(len(differs), bool), scene)


def _sampled_rays(rays: int, prims: int) -> np.ndarray:
    """Some rays, spread by a fixed seed: at least 64, as far as there are as many."""
    count = min(rays, max(64, BRUTE_FORCE_TESTS // max(prims, 1)))
    return np.sort(np.random.default_rng(1).choice(rays, count, replace=False))


def _relative(ours: np.ndarray, expected: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        error = np.abs(ours - expected) / np.maximum(np.abs(expected), np.finfo(np.float64).tiny)
    return np.where(ours == expected, 0.0, error)

"""Depth conventions of other programs' files, inferred from their numbers: the value of a miss, what depth measures.

Nothing is guessed: a convention is applied only where the numbers fit it and no other, and it is always stated.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from caster.image.exr import NO_ID, Exr
from caster.scene.model import Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import CameraRays, camera_axes
from mitsuba_ref.error_model.tolerances import KU, NEARLY_ALL
from mitsuba_ref.exr_compare.exr_pair import Array
from mitsuba_ref.reference.shared_input import pixel_centers

DISTANCE, ALONG_Z, FROM_NEAR = "distance", "z", "near"
CONVENTION_MEANINGS = {
    DISTANCE: "the distance from the eye along the ray",
    ALONG_Z: "z along the view axis",
    FROM_NEAR: "the distance from the near plane along the ray",
}

# What renderers write where nothing is hit. No surface is at depth 0; the others are no scene's.
FLT_MAX = float(np.finfo(np.float32).max)
MISS_SENTINELS: Mapping[str, float] = {
    "0": 0.0,
    "-1": -1.0,
    "inf": np.inf,
    "1e10": float(np.float32(1e10)),
    "1e30": float(np.float32(1e30)),
    "FLT_MAX": FLT_MAX,
    "65504": 65504.0,  # the largest half
}

# Of a depth: how well two images of a scene agree under the right convention. Half floats, the coarsest that files
# have, round by 2^-11, 5e-4; distance and depth along z differ by more where a ray is 2.6 degrees off the axis or more.
CONVENTION_RTOL = 1e-3
# Choices, not bounds: what they decide is printed, and --depth overrides it. So many of the pixels that both hit have
# to show a convention, since along edges the two may hit different shapes; and any other one has to be so many times
# as far off at the median pixel.
MIN_SHARE_FITTING_CONVENTION = 0.9
DECISIVE_ERROR_RATIO = 4.0
MIN_PIXELS_HIT_IN_BOTH = 16  # pixels; with fewer, nothing is shown


class AmbiguousConvention(Exception):  # noqa: N818 - a question to the user
    """The numbers fit no convention or several; str() states which, and the option that decides."""


@dataclass(frozen=True)
class ViewRays:
    """The camera rays of an image."""

    cosine: Array  # (h, w) between the ray and the view axis
    near: Array  # (h, w) distance along the ray to the near plane

    @classmethod
    def of(cls, scene: Scene, near: float | None = None) -> "ViewRays":
        """near: of a near plane that the scene's camera has not, along the view axis."""
        x, y = pixel_centers(scene)
        rays = reference_of_camera(scene.camera).rays(scene.camera, scene.film, x, y)
        x0, y0, x1, y1 = scene.film.window
        cosine = (rays.d @ camera_axes(scene.camera)[2]) / np.linalg.norm(rays.d, axis=1)
        start = rays.t_min if near is None else near / cosine
        return cls(cosine.reshape(y1 - y0, x1 - x0), start.reshape(y1 - y0, x1 - x0))


class Misses(NamedTuple):
    """Which pixels hit nothing, and the evidence for it as text."""

    missed: Array  # (h, w) bool
    words: str
    uninformative: tuple[str, ...] = ()  # a mask that covers everything, though depth has misses


def misses_of(exr: Exr, requested: str | None = None) -> Misses:
    """Missed pixels of a file with channel depth.Z. requested: the value of a miss. Raises AmbiguousConvention."""
    depth = exr.channels["depth.Z"].astype(np.float64)
    if requested is not None:
        value = MISS_SENTINELS.get(requested, None)
        value = float(np.float32(float(requested))) if value is None else value
        return Misses(depth == value, f"a miss is depth {requested}, as given ({int((depth == value).sum())} pixels)")
    there = {name: depth == value for name, value in MISS_SENTINELS.items() if (depth == value).any()}
    by_mask = _misses_by_mask(exr)
    blind = ("A",) if by_mask is not None and there and not by_mask.missed.any() else ()
    if by_mask is not None and not blind:
        values = np.unique(depth[by_mask.missed])
        shown = f"depth {_sentinel_name(float(values[0]))}" if len(values) == 1 else "any depth"
        return Misses(by_mask.missed, f"a miss is {by_mask.words}, with {shown} ({int(by_mask.missed.sum())} pixels)")
    if len(there) > 1:
        counts = ", ".join(f"{name} ({int(rows.sum())} pixels)" for name, rows in there.items())
        raise AmbiguousConvention(
            f"depth holds {counts}: which of them is a miss? --miss {next(iter(there))}, or another"
        )
    if not there:
        return Misses(np.zeros(depth.shape, bool), "no pixel is a miss")
    ((name, rows),) = there.items()
    words = f"a miss is depth {name} ({int(rows.sum())} pixels)"
    return Misses(rows, f"{words}; A covers everything, and is left out" if blind else words, blind)


def _misses_by_mask(exr: Exr) -> Misses | None:
    if "A" in exr.channels:
        return Misses(exr.channels["A"] == 0, "A 0")
    for name in ("id.shape", "id.prim"):
        if name in exr.channels and exr.channels[name].dtype == np.uint32:
            return Misses(exr.channels[name] == NO_ID, f"no {name}")
    return None


def _sentinel_name(value: float) -> str:
    return next((name for name, known in MISS_SENTINELS.items() if known == value), f"{value:.9g}")


class Convention(NamedTuple):
    """What depth means in a file, the depths as distances, and what showed it."""

    name: str
    distance: Array
    words: str


def as_distances(depth: Array, view: ViewRays | None) -> dict[str, Array]:
    """Distance along the ray under each convention; without camera rays only the first is available."""
    found = {DISTANCE: depth}
    if view is not None:
        found[ALONG_Z] = depth / view.cosine
        if (view.near > 0.0).any():
            found[FROM_NEAR] = depth + view.near
    return found


def convention_of(
    depth: Array, hit: Array, other: Array, view: ViewRays | None, requested: str | None = None
) -> Convention:
    """The convention of depth (h, w) by known distances at pixels hit in both. Raises AmbiguousConvention."""
    distances = as_distances(depth, view)
    if requested is not None:
        if requested not in distances:
            raise AmbiguousConvention(
                f"--depth {requested} needs the camera{' with a near plane' if view else ''}: --scene SCENE"
            )
        return Convention(requested, distances[requested], f"{CONVENTION_MEANINGS[requested]}, as given")
    if hit.sum() < MIN_PIXELS_HIT_IN_BOTH:
        raise AmbiguousConvention(
            f"only {int(hit.sum())} pixels are hit in both files: give the convention by --depth distance"
        )
    with np.errstate(all="ignore"):
        off = {name: (np.abs(d - other) / np.abs(other))[hit] for name, d in distances.items()}
    share = {name: float((each <= CONVENTION_RTOL).mean()) for name, each in off.items()}
    middle = {name: float(np.median(np.where(np.isnan(each), np.inf, each))) for name, each in off.items()}
    shown = ", ".join(f"{100.0 * share[name]:.3g} % as {name}" for name in distances)
    best = min(middle, key=lambda name: middle[name])
    if share[best] < MIN_SHARE_FITTING_CONVENTION:
        reason = "no convention fits" if view is not None else "it is not; z needs a camera: --scene SCENE"
        return Convention(
            DISTANCE,
            depth,
            f"assumed to be {CONVENTION_MEANINGS[DISTANCE]}; {reason} ({shown} agree to {CONVENTION_RTOL:g})",
        )
    rivals = [name for name in distances if name != best and not middle[name] >= DECISIVE_ERROR_RATIO * middle[best]]
    apart = [name for name in rivals if (np.abs(distances[name] - distances[best]) > KU * np.abs(other))[hit].any()]
    if apart and middle[best] > 0.0:
        raise AmbiguousConvention(
            f"depth may be {' or '.join(CONVENTION_MEANINGS[name] for name in (best, *apart))}: "
            f"the numbers fit both ({shown}); "
            f"--depth {best}, or another"
        )
    return Convention(best, distances[best], f"{CONVENTION_MEANINGS[best]} ({shown} agree to {CONVENTION_RTOL:g})")


# ---- the rays of an image, from its positions

NEWTON_STEPS = 4  # that lead from the centre of a pixel to the place its ray goes through
SLOPE_STEP_PIXELS = 0.125  # over which slopes are taken


class FilmPoints(NamedTuple):
    """Where the rays to given points go through the film, in pixels of it."""

    x: Array  # (n,)
    y: Array  # (n,)
    rounding: Array  # (n,) pixels that rounding of points, origins and directions may move them
    rays: CameraRays  # through these


def film_points(scene: Scene, p: Array, x: Array, y: Array) -> FilmPoints:
    """The rays to p (n, 3), by Newton's method from film positions x, y (n,)."""

    def rays_at(x: Array, y: Array) -> CameraRays:
        return reference_of_camera(scene.camera).rays(scene.camera, scene.film, x, y)

    def beside(rays: CameraRays) -> Array:
        along = ((p - rays.o) * rays.d).sum(axis=1) / (rays.d * rays.d).sum(axis=1)
        return p - rays.o - along[:, None] * rays.d

    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            here = beside(rays_at(x, y))
            moved = (beside(rays_at(x + SLOPE_STEP_PIXELS, y)), beside(rays_at(x, y + SLOPE_STEP_PIXELS)))
            a, b = ((there - here) / SLOPE_STEP_PIXELS for there in moved)
            aa, ab, bb = ((u * v).sum(axis=1) for u, v in ((a, a), (a, b), (b, b)))
            ha, hb = ((here * v).sum(axis=1) for v in (a, b))
            area = aa * bb - ab * ab
            x, y = x - (bb * ha - ab * hb) / area, y - (aa * hb - ab * ha) / area
        rays = rays_at(x, y)
        reach = np.linalg.norm(p, axis=1) + np.linalg.norm(rays.o, axis=1)
        return FilmPoints(x, y, KU * reach / np.sqrt(np.minimum(aa, bb)), rays)


class RayShift(NamedTuple):
    """Where in their pixels rays go through; (0.5, 0.5) is the centre."""

    low: Array  # (2,) x, y
    high: Array
    common: Array | None  # (2,) the same everywhere, up to rounding; None: it is not
    words: str


def ray_shift(dx: Array, dy: Array, rounding: Array) -> RayShift:
    """Of places dx, dy (n,) in their pixels."""
    at = np.stack([dx, dy])
    low, high, middle = (v.round(4) + 0.0 for v in (at.min(axis=1), at.max(axis=1), np.median(at, axis=1)))
    same = (np.abs(at - np.median(at, axis=1)[:, None]) <= rounding).all(axis=0).mean() >= NEARLY_ALL
    if same:
        words = f"rays go through ({middle[0]:.4f}, {middle[1]:.4f}) of their pixels, the same everywhere"
        return RayShift(low, high, middle, words)
    spans = ", ".join(f"{name} {a:.4f} to {b:.4f}" for name, a, b in zip("xy", low, high, strict=True))
    return RayShift(low, high, None, f"rays go through {spans} of their pixels, not the same everywhere")

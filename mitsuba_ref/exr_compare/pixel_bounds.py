"""Pairs of EXR files with error bounds: from each pixel's conditioning where known, else plain tolerances.

An EXR file holds no primitives, so the bounds of `validate` cannot be derived here. Where the reference has `position`,
`depth` and `normal`, and the provenance has the camera, they give the conditioning of each pixel (magnitude of the
numbers, angle of incidence, curvature) and with it a first-order bound; elsewhere plain tolerances apply. The text
beside each bound says which it is.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from caster.aovs import AOVS
from caster.description.errors import SceneError
from caster.image.channels import hit_mask
from caster.image.exr import Exr
from caster.scene.model import Film, Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.error_model.intersections import Array, Rays
from mitsuba_ref.error_model.tolerances import (
    COLOR_RTOL,
    DEPTH_RTOL,
    HALF_ROUNDINGS,
    LARGEST_FIRST_ORDER_SHARE,
    NORMAL_ATOL,
    SMALLEST_HALF,
    TYPICAL_ATOL,
    U32,
    U_HALF,
    K,
    Tolerances,
)
from mitsuba_ref.reference.shared_input import pixel_centers

Bound = tuple[Array, str]  # (h, w, c), and the text that states it

# Group -> channels. Other channels are judged like colours, or exactly if uint.
LAYERS: Mapping[str, tuple[str, ...]] = {aov.NAME: aov.CHANNELS for aov in AOVS}

SCENE_JSON = "caster/scene_json"  # provenance: the scene, with its camera
SCENE_HASH = "caster/scene_sha256"  # provenance: the fingerprint of the scene and its mesh files


def stacked(exr: Exr, names: Iterable[str]) -> Array:
    """Channels of an image, (h, w, c) float64."""
    return np.stack([exr.channels[name].astype(np.float64) for name in names], -1)


def scene_in(exr: Exr) -> Scene | None:
    """Film and camera in a file's provenance; None where they are missing or unreadable."""
    try:
        record = json.loads(exr.provenance[SCENE_JSON])
        return Scene(film=Film(**record["film"]), camera=record["camera"])
    except (KeyError, TypeError, ValueError, SceneError):
        return None


def view_of(scenes: Iterable[Scene | None], shape: tuple[int, ...]) -> tuple[Scene, Rays] | None:
    """The first of these scenes whose film window has this shape, and its rays through the pixel centres."""
    for scene in scenes:
        if scene is not None and scene.camera.type != "ray":
            x0, y0, x1, y1 = scene.film.window
            if (y1 - y0, x1 - x0) == shape:
                return scene, reference_of_camera(scene.camera).rays(scene.camera, scene.film, *pixel_centers(scene))
    return None


class Conditioning(NamedTuple):
    """First-order rounding errors at each pixel of the reference, all (h, w) float64; NaN where unknown."""

    depth_error: Array  # K u S / cos, in scene units
    position_error: Array  # K u S more, across the ray, in scene units
    position: Array  # (h, w, 3)
    surface: Array  # a number for each surface, NaN on a miss


def conditioning_of(reference: Exr, hit: Array, scenes: Iterable[Scene | None]) -> Conditioning | None:
    """The conditioning of every hit pixel; None where the reference lacks channels, or no scene fits."""
    view = view_of(scenes, hit.shape)
    if view is None or not {"depth.Z", *LAYERS["position"], *LAYERS["normal"]} <= reference.channels.keys():
        return None
    t, p, n = (stacked(reference, LAYERS[name]) for name in ("depth", "position", "normal"))
    d = (view[1].d / np.linalg.norm(view[1].d, axis=1, keepdims=True)).reshape(p.shape)
    with np.errstate(all="ignore"):  # misses and NaN values end as NaN, which means unknown
        cos = np.abs((n * d).sum(-1)) / np.linalg.norm(n, axis=-1)
        reach = np.abs(p - t * d).max(-1) + t[..., 0] + np.abs(p).max(-1)
        depth = np.where(hit, K * U32 * reach / cos, np.nan)
    shape = reference.channels.get("id.shape", np.zeros(hit.shape)).astype(np.float64)
    return Conditioning(depth, depth + K * U32 * reach, p, np.where(hit, shape, np.nan))


class ExrPair(NamedTuple):
    """Two comparable images, the channels to compare, hit masks, and the reference's conditioning."""

    ours: Exr
    reference: Exr
    names: list[str]  # the channels to compare
    hit_ours: Array  # (h, w) bool; all True without a mask channel
    hit_reference: Array
    mask_channel: str  # the channel that holds the hit mask, "" if there is none
    condition: Conditioning | None

    @classmethod
    def of(cls, a: Exr, b: Exr, names: list[str]) -> ExrPair:
        hit_a, channel = hit_mask({name: a.channels[name] for name in names})
        hit_b, _ = hit_mask({name: b.channels[name] for name in names})
        if hit_a is None or hit_b is None:
            everywhere = np.ones_like(b.channels[names[0]], bool)
            return cls(a, b, names, everywhere, everywhere, "", None)
        return cls(a, b, names, hit_a, hit_b, channel, conditioning_of(b, hit_b, (scene_in(b), scene_in(a))))

    def values(self, names: Iterable[str]) -> tuple[Array, Array]:
        """Ours and the reference's, (h, w, c) float64."""
        return stacked(self.ours, names), stacked(self.reference, names)


def bound_of(pair: ExrPair, group: str, names: tuple[str, ...], tol: Tolerances) -> Bound:
    """The bound of one quantity: the given tolerance, else the derived one, else the plain one."""
    a, b = pair.values(names)
    if any(pair.reference.channels[name].dtype == np.uint32 for name in names):
        return np.zeros_like(b), "exact"
    with np.errstate(all="ignore"):  # values that are not finite are judged before any bound
        halves = _half_precision_error(pair.ours, names, a) + _half_precision_error(pair.reference, names, b)
        stored = U32 * (np.abs(a) + np.abs(b)) + halves
        find = _length_bound if group in ("depth", "position") else _surface_bound
        bound, text = find(pair, group, tol, stored, b)
        return (bound, f"{text} + half") if halves.any() and "as given" not in text else (bound, text)


def _half_precision_error(exr: Exr, names: tuple[str, ...], values: Array) -> Array:
    """Rounding error of values that were stored as halves, 0 for others."""
    half = np.array([exr.channels[name].dtype == np.float16 for name in names])
    return np.where(half, HALF_ROUNDINGS * np.maximum(U_HALF * np.abs(values), SMALLEST_HALF / 2.0), 0.0)


def _length_bound(pair: ExrPair, group: str, tol: Tolerances, stored: Array, b: Array) -> Bound:
    condition = pair.condition
    size = np.abs(b).max(-1, keepdims=True)
    if group == "position":  # a hit near the world's origin errs by as much as its ray does
        t = stacked(pair.reference, ["depth.Z"]) if "depth.Z" in pair.reference.channels else _typical_magnitude(b)
        size = np.maximum(size, np.where(np.isfinite(t), np.abs(t), 0.0))
    if tol.depth_rtol is not None:
        return np.broadcast_to(tol.depth_rtol * size, b.shape), f"{tol.depth_rtol:.3g} relative, as given"
    plain = stored + DEPTH_RTOL * size
    if condition is None:
        return plain, f"{DEPTH_RTOL:.2g} relative (per pixel with camera, depth, normal and position)"
    first_order = (condition.depth_error if group == "depth" else condition.position_error)[..., None]
    derived = np.where(first_order < LARGEST_FIRST_ORDER_SHARE * size, stored + first_order, plain)
    return derived, "K*u*S/cos" if group == "depth" else "K*u*S*(1 + 1/cos)"


def _surface_bound(pair: ExrPair, group: str, tol: Tolerances, stored: Array, b: Array) -> Bound:
    """Bound of a field over the surface, evaluated at a displaced hit: its slope times the position error is added."""
    normal, typical = group in ("normal", "shading_normal"), _typical_magnitude(b)
    scale, least = (1.0, NORMAL_ATOL) if normal else (typical, TYPICAL_ATOL * typical)
    if normal or group == "uv":
        given_rtol, given_atol, rtol = None, tol.normal_atol if normal else tol.uv_atol, 0.0
    else:
        given_rtol, given_atol, rtol = tol.color_rtol, tol.color_atol, COLOR_RTOL
    rtol, atol = rtol if given_rtol is None else given_rtol, least if given_atol is None else given_atol
    plain, text = rtol * np.abs(b) + atol, f"{rtol:.2g} relative + {atol:.2g}"
    if given_rtol is not None or given_atol is not None:
        return plain, f"{text}, as given"
    if pair.condition is None:
        return stored + plain, text
    lever = (_surface_slope(b, pair.condition) * pair.condition.position_error)[..., None]
    lever = np.where(lever < LARGEST_FIRST_ORDER_SHARE * scale, lever, 0.0)
    return stored + plain + lever, f"{text} + slope*K*u*S*(1 + 1/cos)"


def _typical_magnitude(values: Array) -> float:
    known = np.abs(values[np.isfinite(values) & (values != 0.0)])
    return float(np.median(known)) if known.size else 0.0


def _surface_slope(field: Array, condition: Conditioning) -> Array:
    """Largest |step of field| / |step of position| to the four neighbours on the same surface; (h, w).

    0 without a neighbour: a surface that is visible in a single pixel gets the plain bound.
    """
    steepest = np.zeros(field.shape[:2])
    for axis in (0, 1):
        rise = np.linalg.norm(np.diff(field, axis=axis), axis=-1)
        run = np.linalg.norm(np.diff(condition.position, axis=axis), axis=-1)
        known = (np.diff(condition.surface, axis=axis) == 0.0) & (run > 0.0) & np.isfinite(rise)
        step = np.where(known, rise / run, 0.0)
        for side in ((0, 1), (1, 0)):  # a step belongs to the pixels at both of its ends
            steepest = np.maximum(steepest, np.pad(step, [side, (0, 0)] if axis == 0 else [(0, 0), side]))
    return steepest

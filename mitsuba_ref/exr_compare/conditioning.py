"""What a reference image tells of its own numerics: how strongly a rounding shows at each pixel."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from caster.image.exr import Exr
from mitsuba_ref.error_model.intersections import K, U
from mitsuba_ref.exr_compare.exr_layers import LAYERS, Array, stacked

SCENE_JSON = "caster/scene_json"  # the provenance that names the camera


class Conditioning(NamedTuple):
    """How strongly a rounding shows at each pixel of the reference, all (h, w) float64; NaN where unknown."""

    depth: Array  # K u S / cos: depth error in scene units
    place: Array  # K u S more, across the ray: position error in scene units
    position: Array  # (h, w, 3)
    surface: Array  # a number for each surface, NaN on a miss


def camera_of(a: Exr, b: Exr) -> Mapping[str, Any]:
    """The camera of the reference's scene, of ours if the reference tells none."""
    for exr in (b, a):
        try:
            camera = json.loads(exr.provenance[SCENE_JSON])["camera"]
        except (KeyError, TypeError, ValueError):
            continue
        if isinstance(camera, dict):
            return camera
    return {}


def conditioning_of(reference: Exr, hit: Array, camera: Mapping[str, Any]) -> Conditioning | None:
    """The condition of every hit pixel, None where the reference or its camera does not tell enough."""
    if not {"depth.Z", *LAYERS["position"], *LAYERS["normal"]} <= reference.channels.keys():
        return None
    t = stacked(reference, ["depth.Z"])
    p, n = stacked(reference, LAYERS["position"]), stacked(reference, LAYERS["normal"])
    with np.errstate(all="ignore"):  # misses and planted NaN end as NaN, which is "unknown"
        d = _directions(camera, p)
        if d is None:
            return None
        cos = np.abs((n * d).sum(-1)) / np.linalg.norm(n, axis=-1)
        reach = np.abs(p - t * d).max(-1) + t[..., 0] + np.abs(p).max(-1)
        depth = np.where(hit, K * U * reach / cos, np.nan)
    shape = reference.channels.get("id.shape", np.zeros(hit.shape)).astype(np.float64)
    return Conditioning(depth, depth + K * U * reach, p, np.where(hit, shape, np.nan))


def _directions(camera: Mapping[str, Any], p: Array) -> Array | None:
    """Unit directions of the rays to p, (h, w, 3): parallel, or from the eye that all other cameras share."""
    try:
        eye = np.array(camera["eye"], np.float64)
        d = p - eye
        if camera.get("type") == "orthographic":
            along = camera.get("direction") or np.array(camera["look_at"], np.float64) - eye
            d = np.broadcast_to(np.array(along, np.float64), p.shape)
        return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))
    except (KeyError, TypeError, ValueError):
        return None  # another program's scene text

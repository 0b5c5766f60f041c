"""Two EXR files to compare: channels, hit masks, and the conditioning of each pixel of the reference."""

from __future__ import annotations

import fnmatch
import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import SceneError, suggestion
from caster.image.exr import Exr
from caster.image.exr_info import hit_mask
from mitsuba_ref.error_model.tolerances import U32, K

Array = np.ndarray

LAYERS: Mapping[str, tuple[str, ...]] = {
    "hit": ("A",),
    "depth": ("depth.Z",),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "shading_normal": ("shading_normal.X", "shading_normal.Y", "shading_normal.Z"),
    "position": ("position.X", "position.Y", "position.Z"),
    "uv": ("uv.U", "uv.V"),
    "diffuse": ("R", "G", "B"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "shape_id": ("id.shape",),
    "prim_id": ("id.prim",),
}
"""Group -> channels. Any other channel is a group of its own, judged like a colour, or exactly if uint."""


def stacked(exr: Exr, names: Iterable[str]) -> Array:
    """Channels of an image, (h, w, c) float64."""
    return np.stack([exr.channels[name].astype(np.float64) for name in names], -1)


SCENE_JSON = "caster/scene_json"  # the provenance that names the camera
SCENE_HASH = "caster/scene_sha256"  # provenance: the fingerprint of the scene and its mesh files


class Conditioning(NamedTuple):
    """First-order rounding errors at each pixel of the reference, all (h, w) float64; NaN where unknown."""

    depth_error: Array  # K u S / cos, in scene units
    position_error: Array  # K u S more, across the ray, in scene units
    position: Array  # (h, w, 3)
    surface: Array  # a number for each surface, NaN on a miss


def camera_of(a: Exr, b: Exr) -> Mapping[str, Any]:
    """The camera in the reference's provenance, else in ours; {} if neither has one."""
    for exr in (b, a):
        try:
            camera = json.loads(exr.provenance[SCENE_JSON])["camera"]
        except (KeyError, TypeError, ValueError):
            continue
        if isinstance(camera, dict):
            return camera
    return {}


def conditioning_of(reference: Exr, hit: Array, camera: Mapping[str, Any]) -> Conditioning | None:
    """The condition of every hit pixel, None where the reference lacks channels or a camera."""
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
        depth = np.where(hit, K * U32 * reach / cos, np.nan)
    shape = reference.channels.get("id.shape", np.zeros(hit.shape)).astype(np.float64)
    return Conditioning(depth, depth + K * U32 * reach, p, np.where(hit, shape, np.nan))


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


class ExrPair(NamedTuple):
    """Two comparable images, the channels to compare, hit masks, and the reference's conditioning."""

    ours: Exr
    reference: Exr
    names: list[str]  # the channels to compare
    hit_ours: Array  # (h, w) bool; all True without a mask channel
    hit_reference: Array
    mask_channel: str  # channel that holds the hit mask, "" if there is none
    condition: Conditioning | None

    @classmethod
    def of(cls, a: Exr, b: Exr, names: list[str]) -> ExrPair:
        hit_a, channel_a = hit_mask({name: a.channels[name] for name in names})
        hit_b, _ = hit_mask({name: b.channels[name] for name in names})
        if hit_a is None or hit_b is None:
            everywhere = np.ones(size_of(b)[::-1], bool)
            return cls(a, b, names, everywhere, everywhere, "", None)
        return cls(a, b, names, hit_a, hit_b, channel_a, conditioning_of(b, hit_b, camera_of(a, b)))

    def values(self, names: Iterable[str]) -> tuple[Array, Array]:
        """Ours and the reference's, (h, w, c) float64."""
        return stacked(self.ours, names), stacked(self.reference, names)

    @property
    def same_mask(self) -> Array:
        """(h, w) bool: where both images hit or both miss."""
        return np.asarray(self.hit_ours == self.hit_reference)


def ignored_channels(a: Exr, b: Exr, patterns: Iterable[str]) -> tuple[str, ...]:
    """The channels that --ignore patterns name. Raises SceneError for a pattern that names none."""
    names = sorted(a.channels.keys() | b.channels.keys())
    found: set[str] = set()
    for pattern in patterns:
        matches = [n for n in names if n in LAYERS.get(pattern, ()) or fnmatch.fnmatchcase(n, pattern)]
        if not matches:
            hint = suggestion(pattern, [*LAYERS, *names])
            has = ", ".join(names)
            raise SceneError(f"--ignore {pattern}: neither file has such a channel{hint}; they have {has}")
        found.update(matches)
    return tuple(sorted(found))


def incompatibilities(a: Exr, b: Exr, left_out: Iterable[str], *, other_scene: bool) -> list[str]:
    """Why two images cannot be compared, a sentence each; none if they can."""
    scenes = [] if other_scene else _scene_mismatch(a, b)
    return [*scenes, *_window_mismatch(a, b), *_channel_mismatch(a, b, set(left_out))]


def _scene_mismatch(a: Exr, b: Exr) -> list[str]:
    """An old reference of a scene that has changed since proves nothing about it."""
    hashes = {exr.provenance.get(SCENE_HASH) for exr in (a, b)} - {None}
    if len(hashes) < 2:
        return []
    return [f"the files are of different scenes, by their attributes ({SCENE_HASH}); --other-scene compares anyway"]


def _window_mismatch(a: Exr, b: Exr) -> list[str]:
    size_a, size_b = size_of(a), size_of(b)
    if size_a != size_b:
        return [f"size: ours is {size_a[0]} x {size_a[1]}, the reference {size_b[0]} x {size_b[1]}"]
    if a.data_window != b.data_window:
        return [f"data window: ours shows pixels {a.data_window}, the reference {b.data_window}"]
    return []


def _channel_mismatch(a: Exr, b: Exr, left_out: set[str]) -> list[str]:
    found = []
    ours, reference = a.channels.keys() - left_out, b.channels.keys() - left_out
    for mine, other, whose in ((ours, reference, "ours"), (reference, ours, "the reference")):
        alone = sorted(mine - other)
        found += [f"channel {n} is in {whose} only{suggestion(n, sorted(other - mine))}" for n in alone]
    for n in sorted(ours & reference):
        if (a.channels[n].dtype == np.uint32) != (b.channels[n].dtype == np.uint32):
            kinds = (a.channels[n].dtype, b.channels[n].dtype)
            found.append(f"channel {n}: ours holds {kinds[0]}, the reference {kinds[1]}")
    if not ours & reference:
        found.append("no channel in common: nothing could be compared")
    elif found and ours ^ reference:
        found.append("to compare the rest: --ignore CHANNEL (or a pattern such as 'id.*')")
    return found


def size_of(exr: Exr) -> tuple[int, int]:
    """(width, height) of what is stored."""
    x0, y0, x1, y1 = exr.data_window
    return x1 - x0, y1 - y0

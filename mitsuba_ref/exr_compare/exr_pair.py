"""Two EXR files as one: which channels to compare, and whether they may be compared at all."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from caster.image.exr import Exr
from caster.image.exr_info import hit_mask
from caster.scene.errors import SceneError, suggestion
from mitsuba_ref.exr_compare.conditioning import Conditioning, camera_of, conditioning_of
from mitsuba_ref.exr_compare.exr_layers import LAYERS, Array, stacked


class ExrPair(NamedTuple):
    """Two comparable images, the channels to compare, and what the reference tells of each pixel."""

    ours: Exr
    reference: Exr
    names: list[str]  # the channels to compare
    hit_ours: Array  # (h, w) bool; all True where no channel tells
    hit_reference: Array
    mask_channel: str  # "" where no channel tells
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


SCENE_HASH = "caster/scene_sha256"  # provenance: the fingerprint of the scene and its mesh files


def _scene_mismatch(a: Exr, b: Exr) -> list[str]:
    """An old reference of a scene that has changed since proves nothing about it."""
    hashes = {exr.provenance.get(SCENE_HASH) for exr in (a, b)} - {None}
    if len(hashes) < 2:
        return []
    return [
        f"the files say that they show different scenes ({SCENE_HASH}); --other-scene compares all the same"
    ]


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

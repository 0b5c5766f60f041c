"""What is different between a stored reference and a fresh one, channel by channel, to the bit."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mitsuba_ref.baselines.reference_file import PREFIX, VARIANT, VERSIONS, Reference


@dataclass(frozen=True)
class Change:
    """One channel."""

    channel: str
    pixels: int  # that have other bits
    largest: float  # difference of finite values; inf where one is not finite and the other is, nan where just bits are
    x: int
    y: int  # where that is, on the film


def changes(before: Reference, now: Reference) -> tuple[Change, ...]:
    """Channels that differ, of two references of the same film window and channels."""
    found = []
    for name in sorted(now.channels):
        old, new = before.channels[name], now.channels[name]
        other = old.view(np.uint32) != new.view(np.uint32)
        if other.any():
            apart = difference(old, new, other)
            y, x = np.unravel_index(int(np.argmax(apart)), apart.shape)
            place = now.window[0] + int(x), now.window[1] + int(y)
            found.append(Change(name, int(other.sum()), float(apart[y, x]), *place))
    return tuple(found)


def difference(old: np.ndarray, new: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(h, w) how far apart; for ids, whose size means nothing, 1."""
    if new.dtype == np.uint32:
        return other.astype(np.float64)
    with np.errstate(invalid="ignore"):
        apart = np.abs(new.astype(np.float64) - old.astype(np.float64))
    return np.where(other & np.isnan(apart), np.inf, np.where(other, apart, 0.0))


def comparable(before: Reference, now: Reference) -> bool:
    """Whether the two have the same window and the same channels of the same types."""
    kinds = [{name: plane.dtype for name, plane in each.channels.items()} for each in (before, now)]
    return before.window == now.window and before.film == now.film and kinds[0] == kinds[1]


def lines(before: Reference, now: Reference) -> Iterator[str]:
    """For a terminal: versions, hit mask, channels."""
    for key in (*VERSIONS, VARIANT):
        old, new = before.about.get(key, "none"), now.about.get(key, "none")
        if old != new:
            yield f"{key.removeprefix(PREFIX).removeprefix('caster/') or key}: {old} -> {new}"
    if not comparable(before, now):
        yield f"another film or other channels: window {before.window} -> {now.window}"
        return
    old_hit, new_hit = (each.channels["A"] != 0.0 for each in (before, now))
    if (old_hit != new_hit).any():
        gone, come = int((old_hit & ~new_hit).sum()), int((new_hit & ~old_hit).sum())
        yield f"hit mask: {gone} pixels no longer hit, {come} newly hit, of {int(new_hit.sum())}"
    for change in changes(before, now):
        far = "by their ids" if change.channel.startswith("id.") else f"by at most {change.largest:.9g}"
        yield f"{change.channel}: {change.pixels} pixels differ, {far}, at ({change.x}, {change.y})"

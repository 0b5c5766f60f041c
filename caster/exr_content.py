"""What an EXR file can hold: channels of one shape, names and text of limited length, float32 or uint32."""

from collections.abc import Mapping

import numpy as np

from caster.wording import FileMissing, SceneError

Window = tuple[int, int, int, int]
"""x0, y0, x1, y1 in pixels of the full film; x1 and y1 are the first column and row outside."""

PREFIX = "caster/"
LONGEST_NAME = 255  # bytes; the library drops a longer attribute without a word


class UnreadableExr(FileMissing):
    """A file that is there but is not a whole, flat EXR picture."""


def common_shape(channels: Mapping[str, np.ndarray]) -> tuple[int, int]:
    """(height, width) of all channels. Raises SceneError for none, for another shape, for a name that cannot be."""
    if not channels:
        raise SceneError("an EXR needs at least one channel, got none")
    first = next(iter(channels))
    shape = np.shape(channels[first])
    for name, values in channels.items():
        _check_name("channel", name)
        if np.ndim(values) != 2 or np.size(values) == 0:
            raise SceneError(
                f"channel '{name}': expected a (height, width) array, got shape {np.shape(values)}"
            )
        if np.shape(values) != shape:
            raise SceneError(f"channel '{name}' has shape {np.shape(values)}, channel '{first}' has {shape}")
    return int(shape[0]), int(shape[1])


def _check_name(kind: str, name: object) -> None:
    if not isinstance(name, str) or not name or "\0" in name or len(_utf8(kind, name)) > LONGEST_NAME:
        raise SceneError(f"{kind} name {name!r:.60}: expected 1 to {LONGEST_NAME} bytes of text without NUL")


def _utf8(what: str, text: str) -> bytes:
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError as e:
        raise SceneError(f"{what}: text that is no valid Unicode cannot be stored: {text!r:.60}") from e


def checked_window(what: str, window: Window) -> Window:
    """The window in whole numbers. Raises SceneError for one without a pixel."""
    x0, y0, x1, y1 = (int(edge) for edge in window)
    if x1 <= x0 or y1 <= y0:
        raise SceneError(f"{what}: expected x0 < x1 and y0 < y1, got ({x0}, {y0}, {x1}, {y1})")
    return x0, y0, x1, y1


def attributes_of(provenance: Mapping[str, str]) -> dict[str, str]:
    """Header attributes under caster/. Raises SceneError for what is no text."""
    attributes: dict[str, str] = {}
    for key, value in sorted(provenance.items()):
        name = PREFIX + key.removeprefix(PREFIX)
        _check_name("provenance", name)
        if not isinstance(value, str) or name in attributes:
            raise SceneError(f"provenance {name!r}: expected one string, got {value!r:.60}")
        _utf8(f"provenance {name!r}", value)
        attributes[name] = value
    return attributes


def storable(name: str, values: np.ndarray, window: Window) -> np.ndarray:
    """A contiguous float32 or uint32 copy. Raises SceneError for a finite value that float32 cannot hold."""
    values = np.asarray(values)
    if values.dtype == np.uint32:
        return np.array(values, np.uint32, order="C")
    if values.dtype != bool and not np.issubdtype(values.dtype, np.floating):
        raise SceneError(f"channel '{name}': an EXR holds floats, bools or uint32, got {values.dtype}")
    with np.errstate(over="ignore"):
        narrow = np.array(values, np.float32, order="C")
    lost = np.isinf(narrow) & np.isfinite(values)
    if lost.any():
        y, x = np.argwhere(lost)[0]
        raise SceneError(
            f"channel '{name}' at pixel ({window[0] + x}, {window[1] + y}): "
            f"{float(values[y, x])!r} is beyond float32 (largest {np.finfo(np.float32).max:.9g})"
        )
    return narrow

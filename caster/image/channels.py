"""Conversion between AOVs and the channels of an EXR file, and the provenance stored in it."""

from collections.abc import Iterable, Mapping

import numpy as np

from caster import __version__
from caster.aovs import AOVS, Aovs
from caster.geometry.packing import in_words
from caster.image.exr import NO_ID, write_bands
from caster.scene.model import Scene

__all__ = ["aovs_to_channels", "hit_mask", "provenance", "write_render"]


def aovs_to_channels(aovs: Aovs) -> dict[str, np.ndarray]:
    """Channels of AOVs: name -> (h, w) float32 or uint32. The mask `A` is always among them."""
    channels = {"A": aovs.hit.astype(np.float32)}
    for aov in AOVS:
        if aov.NAME in aovs:
            image = aovs[aov.NAME]
            planes = image[..., None] if image.ndim == 2 else image
            for c, channel in enumerate(aov.CHANNELS):
                plane = planes[..., c]
                ids = np.issubdtype(plane.dtype, np.integer)
                channels[channel] = plane.astype(np.uint32) if ids else plane  # -1 becomes NO_ID
    return channels


def hit_mask(channels: Mapping[str, np.ndarray]) -> tuple[np.ndarray | None, str]:
    """The hit mask, (h, w) bool, and the channel it is derived from; (None, "") if there is none.

    By the mask channel `A`, else the ids, else depth (other renderers mark misses by other values).
    """
    if "A" in channels:
        return channels["A"] != 0, "A"
    for name in ("id.shape", "id.prim"):
        if name in channels:
            return channels[name] != NO_ID, name
    if "depth.Z" in channels:
        return channels["depth.Z"] != np.inf, "depth.Z"
    return None, ""


def channels_to_aovs(channels: Mapping[str, np.ndarray]) -> Aovs:
    """AOVs whose channels are all present, in the types of `caster.render`; `hit` is channel `A`."""
    images = {}
    for aov in AOVS:
        if all(channel in channels for channel in aov.CHANNELS):
            stored = [channels[channel] for channel in aov.CHANNELS]
            planes = [s.view(np.int32) if s.dtype == np.uint32 else s.astype(np.float64) for s in stored]  # NO_ID: -1
            images[aov.NAME] = planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)
    return Aovs(images, channels["A"] != 0)


def provenance(scene: Scene, version: str, path: str = "") -> dict[str, str]:
    """The attributes `caster/...` of an EXR file of a scene. path: the scene file, as given by the user."""
    named = {"caster/scene": path.encode(errors="replace").decode()} if path else {}
    if words := in_words(scene):
        named["caster/faces_never_hit"] = words
    return named | {
        "caster/version": version,
        "caster/scene_sha256": scene.sha256(),
        "caster/scene_json": scene.canonical_json(),
        "caster/depth": "distance from the eye along the ray, scene units; inf on a miss",
    }


def write_render(
    output: str, scene: Scene, bands: Iterable[Aovs], path: str, more: Mapping[str, str] = {}, *, threads: int = 1
) -> None:
    """Write the AOVs of a scene as an EXR file with its provenance.

    bands: as for `write_bands`. path: the scene file; more: further attributes.
    """
    film = (0, 0, scene.film.width, scene.film.height)
    attributes = {**provenance(scene, __version__, path), **more}
    write_bands(output, map(aovs_to_channels, bands), attributes, scene.film.window, film, threads)

"""Layers of EXR files: which channels belong together, and the names that other programs give them.

Mitsuba names AOVs as its user does, and adds a suffix; below are those of its documentation and of our exports.
Blender puts everything under the name of a view layer. Arnold and RenderMan write N, Nn, P, Z, with vectors as X Y Z,
x y z, or R G B. Colour images (R G B, Combined) are not read as our diffuse AOV: only their program defines them.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from caster.description.errors import SceneError, suggestion
from caster.image.exr import Exr

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


# Group -> names of the layer, whole or after a view layer and a dot; case matters only for one or two letters.
VECTORS: Mapping[str, Sequence[str]] = {
    "normal": ("geo_normal", "geometric_normal", "Ng", "Ngn"),
    "shading_normal": ("sh_normal", "Normal", "normals", "N", "Nn", "nn"),
    "position": ("Position", "P", "Pworld", "worldposition"),
}
SCALARS: Mapping[str, Sequence[str]] = {
    "depth": ("depth.T", "dd.y.T", "Depth.Z", "Depth.V", "Depth", "Z", "zdepth", "z"),
}
COLOR_CHANNELS = ("R", "G", "B")
COMPONENTS = ("XYZ", "xyz", "RGB", "rgb")


class AmbiguousChannel(Exception):  # noqa: N818 - a question to the user
    """Two channels match one of ours; str() names them, and the option that decides."""


def recognised(names: Iterable[str]) -> dict[str, str]:
    """Our channel -> the file's, for all recognised; our own names first. Raises AmbiguousChannel."""
    names = set(names)
    found = {name: name for layer in LAYERS.values() for name in layer if name in names}
    left = names - found.keys()
    for group, words in SCALARS.items():
        _take(found, group, [(each,) for each in sorted(left) if _is_called(each, words)])
    for group, words in VECTORS.items():
        layers = [layer for layer in _vectors(left) if _is_called(layer[0].rpartition(".")[0], words)]
        _take(found, group, layers)
    return found


def _take(found: dict[str, str], group: str, layers: Sequence[tuple[str, ...]]) -> None:
    """Assign the only candidate layer to a group without one."""
    ours = LAYERS[group]
    known = [tuple(found[name] for name in ours)] if ours[0] in found else []
    both = [*known, *layers]
    if len(both) > 1:
        shown = [each[0] if len(each) == 1 else each[0].rpartition(".")[0] for each in both]
        raise AmbiguousChannel(
            f"{' and '.join(shown)} may both be the {group}: --map {group}={shown[0]}, or another"
        )
    if layers:
        found.update(zip(ours, layers[0], strict=True))


def _is_called(name: str, words: Sequence[str]) -> bool:
    """Whether a name is one of these words, or ends with one after a dot."""
    for word in words:
        fold = (lambda text: text) if len(word) <= 2 else str.casefold
        if fold(name) == fold(word) or (len(word) > 2 and fold(name).endswith("." + fold(word))):
            return True
    return False


def _vectors(names: Iterable[str]) -> list[tuple[str, ...]]:
    """Triples of channels that differ only in their component."""
    names = set(names)
    layers = sorted({name.rpartition(".")[0] for name in names if "." in name})
    triples = [tuple(f"{layer}.{c}" for c in letters) for layer in layers for letters in COMPONENTS]
    return [triple for triple in triples if names.issuperset(triple)]


def mapped(options: Iterable[str], names: Iterable[str]) -> dict[str, str]:
    """Our channel -> the file's, by --map OURS=THEIRS; channels that this file lacks belong to the other file.

    OURS: a channel, or a group such as depth or normal; THEIRS then is a channel or a layer. Raises SceneError.
    """
    names, found = set(names), {}
    for option in options:
        key, equals, value = option.partition("=")
        if not (key and equals and value):
            raise SceneError(f"--map {option!r}: expected OURS=THEIRS, such as depth=ViewLayer.Depth.Z")
        ours = LAYERS.get(key) or tuple(n for layer in LAYERS.values() for n in layer if n == key)
        if not ours:
            known = [*LAYERS, *(n for layer in LAYERS.values() for n in layer)]
            raise SceneError(
                f"--map {option!r}: unknown{suggestion(key, known)}; known are {', '.join(LAYERS)}"
            )
        if len(ours) == 1:
            found.update({ours[0]: value} if value in names else {})
            continue
        letters = (*COMPONENTS, "UV")
        triples = [tuple(f"{value}.{c}" for c in each) for each in letters if len(each) == len(ours)]
        found.update(next((dict(zip(ours, t, strict=True)) for t in triples if names.issuperset(t)), {}))
    return found


def check_maps(options: Sequence[str], *files: Iterable[str]) -> None:
    """Raise SceneError for a --map that names nothing in any file."""
    everything = [set(names) for names in files]
    for option in options:
        if not any(mapped([option], names) for names in everything):
            value = option.partition("=")[2]
            names = sorted(set().union(*everything))
            raise SceneError(
                f"--map {option!r}: neither file has '{value}'{suggestion(value, names)}; they have {', '.join(names)}"
            )

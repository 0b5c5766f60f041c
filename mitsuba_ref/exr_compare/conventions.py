"""Conversion of other programs' EXR files to our channel names and depth convention.

Channels are recognised by name. What depth measures and the depth of a miss are stated by the user (`Reading`), never
inferred; every step is reported.
"""

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from caster.description.errors import SceneError, suggestion
from caster.image.channels import hit_mask
from caster.image.exr import Exr
from caster.image.exr_validation import PROVENANCE_PREFIX
from caster.scene.model import Scene
from caster.system.process import NOT_COMPARABLE
from mitsuba_ref.cameras.camera_reference import camera_axes, clip_planes
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.tolerances import NEARLY_ALL
from mitsuba_ref.exr_compare.pixel_bounds import LAYERS, scene_in, stacked, view_of
from mitsuba_ref.reference.shared_input import clip_range, model_of, shared_rays
from mitsuba_ref.subjects.subject import CastRequest, NoAnswer

DISTANCE, ALONG_Z, FROM_NEAR = "distance", "z", "near"
MEANINGS = {
    DISTANCE: "the distance from the eye along the ray",
    ALONG_Z: "z along the view axis",
    FROM_NEAR: "the distance from the near plane along the ray",
}
FLT_MAX = float(np.finfo(np.float32).max)
GEOMETRY = ("normal", "shading_normal", "position")  # groups whose values on a miss mean nothing

# Group -> names of the channel or layer, whole or, if longer than two letters, after a dot; case does not matter.
# Mitsuba names AOVs as its user does and adds a suffix: these are the names of its documentation and of our exports.
# Blender puts everything under the name of a view layer. Arnold and RenderMan write N, Nn, P, Z. Colour images (R G B)
# are not read as our diffuse AOV: only their program defines them.
NAMES: Mapping[str, Sequence[str]] = {
    "depth": ("depth.t", "dd.y.t", "depth.z", "depth.v", "depth", "z", "zdepth"),
    "normal": ("geo_normal", "geometric_normal", "ng", "ngn"),
    "shading_normal": ("sh_normal", "normal", "normals", "n", "nn"),
    "position": ("position", "p", "pworld", "worldposition"),
}
COMPONENTS = ("XYZ", "xyz", "RGB", "rgb", "UV")

# How well a depth has to fit another convention for a hint; distance and z differ by more 2.6 degrees off the axis.
HINT_RTOL = 1e-3


class Unclear(SceneError):  # noqa: N818 - a question to the user
    """A file can be read in two ways, or in none; str() says what is unclear and which option decides."""

    exit_code = NOT_COMPARABLE


@dataclass(frozen=True)
class Reading:
    """How to interpret files of other programs.

    maps: OURS=THEIRS for channels or groups. depth: distance (None), z, or near. miss: the depth of a miss, a number or
    FLT_MAX; None: a miss has alpha 0, no id, or depth inf. scene: the scene whose camera rendered the images; its near
    plane is that of the exported scene.
    """

    maps: tuple[str, ...] = ()
    depth: str | None = None
    miss: str | None = None
    scene: Scene | None = None

    def __post_init__(self) -> None:
        if self.depth not in (None, *MEANINGS):
            raise SceneError(f"--depth {self.depth!r}: expected {', '.join(MEANINGS)}")
        if self.miss is not None:
            try:
                number(self.miss)
            except ValueError as error:
                raise SceneError(
                    f"--miss {self.miss!r}: expected a number, such as 0, -1, inf, 1e10 or FLT_MAX"
                ) from error


def number(text: str) -> float:
    """The float32 value that a text states, as float64."""
    with np.errstate(over="ignore"):
        return FLT_MAX if text == "FLT_MAX" else float(np.float32(float(text)))


# ---- names


def our_names(channels: Iterable[str], maps: Iterable[str]) -> dict[str, str]:
    """Map our channel names to those of the file: by --map, else by our own names, else by those of other programs.

    Raises Unclear where two channels match one of ours.
    """
    left = set(channels)
    found = mapped(maps, left)
    left -= set(found.values())
    groups = {name.partition(".")[0] for name in found}
    own = {n: n for layer in LAYERS.values() for n in layer if n in left and n.partition(".")[0] not in groups}
    found |= own
    left -= own.keys()
    for group in (group for group in NAMES if group not in groups):
        ours = LAYERS[group]
        ends = tuple(f".{word}" for word in NAMES[group] if len(word) > 2)
        layers = [
            channels
            for name, channels in _layers(left, len(ours))
            if name.casefold() in NAMES[group] or name.casefold().endswith(ends)
        ]
        if layers and (len(layers) > 1 or ours[0] in own):
            known = [ours] if ours[0] in own else []
            shown = [each[0] if len(each) == 1 else each[0].rpartition(".")[0] for each in (*known, *layers)]
            raise Unclear(f"{' and '.join(shown)} may both be the {group}: --map {group}={shown[0]}, or another")
        found |= (pair for channels in layers for pair in zip(ours, channels, strict=True))
    return found


def _layers(names: Iterable[str], size: int) -> Iterator[tuple[str, tuple[str, ...]]]:
    """(name, channels) of each layer of this many channels, which differ only in their component, sorted."""
    names = set(names)
    if size == 1:
        yield from ((name, (name,)) for name in sorted(names))
    for letters in COMPONENTS:
        for layer in sorted({name.rpartition(".")[0] for name in names}):
            channels = tuple(f"{layer}.{c}" for c in letters)
            if len(letters) == size and names.issuperset(channels):
                yield layer, channels


def mapped(options: Iterable[str], names: Iterable[str]) -> dict[str, str]:
    """Map our channel names to those of the file by --map OURS=THEIRS, without options that name no channel of it.

    OURS: a channel, or a group such as depth or normal; THEIRS then is a channel or a layer. Raises SceneError.
    """
    names, found = set(names), dict[str, str]()
    for option in options:
        key, _, value = option.partition("=")
        if not (key and value):
            raise SceneError(f"--map {option!r}: expected OURS=THEIRS, such as depth=ViewLayer.Depth.Z")
        channels = [n for layer in LAYERS.values() for n in layer]
        ours = LAYERS.get(key) or tuple(n for n in channels if n == key)
        if not ours:
            raise SceneError(
                f"--map {option!r}: unknown{suggestion(key, [*LAYERS, *channels])}; known are {', '.join(LAYERS)}"
            )
        found |= next((zip(ours, theirs, strict=True) for n, theirs in _layers(names, len(ours)) if n == value), ())
    return found


def check_maps(options: Sequence[str], *files: Iterable[str]) -> None:
    """Raise SceneError for a --map that names nothing in any file."""
    everything = sorted(set().union(*files))
    for option in options:
        if not any(mapped([option], names) for names in files):
            value = option.partition("=")[2]
            raise SceneError(
                f"--map {option!r}: neither file has '{value}'{suggestion(value, everything)}; they have "
                f"{', '.join(everything)}"
            )


# ---- conversion


def is_ours(exr: Exr) -> bool:
    """Whether a file says that this project wrote it."""
    return any(key.startswith(PROVENANCE_PREFIX) for key in exr.provenance)


def to_our_conventions(
    exr: Exr, reading: Reading, scenes: Sequence[Scene | None] = (), kept: Container[str] = ()
) -> tuple[Exr, list[str]]:
    """Convert a file to our channel names and conventions; also returns the steps, a sentence each.

    A file with our provenance, or with our names alone, is returned unchanged, unless options of `reading` name its
    channels or it has several parts. scenes: further scenes whose camera may fit. kept: channels that stay as they are
    where nothing is known about them. Raises Unclear.
    """
    steps = [f"{len(exr.parts)} parts as one image: {', '.join(map(str, exr.parts))}"] if exr.parts else []
    maps = mapped(reading.maps, exr.channels)
    if is_ours(exr) and not maps:
        return exr, steps
    names = our_names(exr.channels, reading.maps)
    changed = [f"{theirs} is {our}" for our, theirs in names.items() if our != theirs]
    if not (changed or exr.parts or reading.depth or reading.miss):
        return exr, steps
    names = {our: theirs for our, theirs in names.items() if our not in LAYERS["diffuse"] or our in maps}
    names |= {name: name for name in exr.channels.keys() - {*names, *names.values()} if name in kept}
    steps += [f"channels: {', '.join(changed)}"] if changed else []
    if left := sorted(exr.channels.keys() - set(names.values())):
        steps.append(f"not recognised, and left out: {', '.join(left)} (--map OURS=THEIRS)")
    exr = exr._replace(channels={our: exr.channels[theirs] for our, theirs in names.items()})
    if "depth.Z" not in exr.channels:
        return exr, steps
    exr, missed, words = _with_misses(exr, reading)
    depth, scenes = stacked(exr, ["depth.Z"])[..., 0], (reading.scene, scene_in(exr), *scenes)
    meanings = distances(depth, reading, scenes)
    meaning = reading.depth or DISTANCE
    if meaning not in meanings:
        raise Unclear(f"--depth {meaning} needs a camera{' with a near plane' * (meaning == FROM_NEAR)}: --scene SCENE")
    before = exr.channels["depth.Z"].dtype
    with np.errstate(over="ignore"):  # halves stay halves, so that their bound applies
        depth = np.where(missed & (depth > -np.inf), np.inf, meanings[meaning])
        channels = exr.channels | {"depth.Z": depth.astype(before if before == np.float16 else np.float32)}
    for name, values in channels.items():
        if name.partition(".")[0] in GEOMETRY:
            channels[name] = np.where(missed & np.isfinite(values), 0, values).astype(values.dtype)
    return exr._replace(channels=channels), [*steps, words, f"depth is {MEANINGS[meaning]}"]


def _with_misses(exr: Exr, reading: Reading) -> tuple[Exr, Array, str]:
    """The file without a mask that --miss contradicts, (h, w) bool which pixels hit nothing, and how that shows."""
    channels = dict(exr.channels)
    if reading.miss is not None:
        missed, words = channels["depth.Z"] == number(reading.miss), f"depth {reading.miss}"
        if "A" in channels and not np.array_equal(channels["A"] == 0, missed):
            del channels["A"]
            words += ", and A, which differs, is left out"
    else:
        ids_as_floats = [n for n in channels if n.startswith("id.") and channels[n].dtype != np.uint32]
        hit, name = hit_mask({n: values for n, values in channels.items() if n not in ids_as_floats})
        assert hit is not None  # there is a depth
        missed, words = ~hit, {"A": "A 0", "depth.Z": "depth inf"}.get(name, f"no {name}")
    return exr._replace(channels=channels), missed, f"a miss is {words} ({int(missed.sum())} pixels)"


def distances(depth: Array, reading: Reading, scenes: Sequence[Scene | None]) -> dict[str, Array]:
    """The distance along the ray (h, w) for each quantity that depth may measure; without a camera, itself alone."""
    found, view = {DISTANCE: depth}, view_of(scenes, depth.shape)
    if view is not None:
        scene, rays = view
        cosine = ((rays.d @ camera_axes(scene.camera)[2]) / np.linalg.norm(rays.d, axis=1)).reshape(depth.shape)
        found[ALONG_Z] = depth / cosine
        exported = scene is reading.scene and hasattr(scene.camera, "near")
        start = rays.t_min.reshape(depth.shape)
        if exported:  # Mitsuba's sensors have a near plane, and its depth counts from there
            model = model_of(scene, shared_rays(scene))
            start = float(clip_planes(scene.camera, clip_range(scene, model))["near_clip"]) / cosine
        found |= {FROM_NEAR: depth + start} if (start > 0.0).any() else {}
    return found


def candidate_image(exr: Exr, request: CastRequest, reading: Reading) -> tuple[Exr, tuple[str, ...]]:
    """The image that a candidate wrote, in our names and conventions, and the steps. Raises NoAnswer."""
    try:
        check_maps(reading.maps, exr.channels)
        exr, steps = to_our_conventions(exr, replace(reading, scene=request.scene))
    except SceneError as error:
        raise NoAnswer(f"its image: {error}") from error
    return exr, tuple(steps)


def hints(exr: Exr, other: Exr, reading: Reading) -> Iterator[str]:
    """Options under which the depths of a foreign file would be those of the other one; nothing is applied."""
    if "depth.Z" not in other.channels or "depth.Z" not in exr.channels:
        return
    depth, known = (stacked(each, ["depth.Z"])[..., 0] for each in (exr, other))
    both = np.isfinite(depth) & np.isfinite(known)
    if reading.depth or not both.any():
        return
    for meaning, distance in distances(depth, reading, (reading.scene, scene_in(exr), scene_in(other))).items():
        fits = np.abs(distance[both] - known[both]) <= HINT_RTOL * np.abs(known[both])
        if meaning != DISTANCE and fits.mean() >= NEARLY_ALL:
            yield f"depth looks like {MEANINGS[meaning]}: --depth {meaning}"

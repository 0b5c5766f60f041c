"""Conversion of other programs' EXR files to our channel names and depth convention; every step is stated."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from caster.description.errors import SceneError
from caster.image.exr import Exr
from caster.image.exr_validation import PROVENANCE_PREFIX
from caster.rendering.hits import cast
from caster.scene.model import Film, Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import CameraRays, camera_axes
from mitsuba_ref.error_model.tolerances import LARGEST_RAY_SHIFT_PIXELS, U32
from mitsuba_ref.exr_compare.depth_conventions import (
    MISS_SENTINELS,
    AmbiguousConvention,
    Convention,
    RayShift,
    ViewRays,
    convention_of,
    film_points,
    misses_of,
    ray_shift,
)
from mitsuba_ref.exr_compare.exr_pair import (
    COLOR_CHANNELS,
    LAYERS,
    SCENE_JSON,
    AmbiguousChannel,
    Array,
    check_maps,
    mapped,
    recognised,
    stacked,
)
from mitsuba_ref.reference.shared_input import SharedRays, pixel_centers
from mitsuba_ref.subjects.subject import FLOAT32, Answer, CastRequest, NoAnswer, cast_ours, checked_answer

GEOMETRY = ("normal", "shading_normal", "position")  # groups whose values on a miss mean nothing


@dataclass(frozen=True)
class Reading:
    """How to interpret files of other programs, where their numbers do not decide."""

    maps: tuple[str, ...] = ()  # OURS=THEIRS
    depth: str | None = None  # distance, z or near
    miss: str | None = None  # of depth_conventions.MISS_SENTINELS, or a number
    near: float | None = None  # of the near plane that depth counts from, where the scene's camera has none
    scene: Scene | None = None  # whose camera rendered the images

    def __post_init__(self) -> None:
        if self.near is not None and not 0.0 < self.near < np.inf:
            raise SceneError(f"--near: expected a number > 0, got {self.near}")
        if self.miss is not None and self.miss not in MISS_SENTINELS:
            try:
                float(self.miss)
            except ValueError as error:
                known = ", ".join(MISS_SENTINELS)
                raise SceneError(f"--miss {self.miss!r}: expected a number, such as {known}") from error


READ_BY_NAMES = Reading()


class ConvertedFiles(NamedTuple):
    """Two files in our conventions, the steps, channels left out, and reasons why they cannot be compared."""

    ours: Exr
    reference: Exr
    stated: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()


SIDES = ("ours", "the reference")


def to_our_conventions(a: Exr, b: Exr, reading: Reading) -> ConvertedFiles:
    """Both files in our names and conventions. A file with caster/... attributes is used as it is.

    So is one with our names throughout, unless they were made of the names of its parts.
    """
    check_maps(reading.maps, a.channels, b.channels)
    stated: list[str] = []
    files, foreign = [a, b], []
    for i, exr in enumerate(files):
        stated += [f"{SIDES[i]}: {line}" for line in _describe_parts(exr)]
        mapped_names = mapped(reading.maps, exr.channels)
        if not mapped_names and _written_by_caster(exr):
            continue
        try:
            names = _channel_names(exr, mapped_names)
        except AmbiguousChannel as question:
            return ConvertedFiles(a, b, tuple(stated), reasons=(f"{SIDES[i]}: {question}",))
        changed = {ours: theirs for ours, theirs in names.items() if ours != theirs}
        names = {n: theirs for n, theirs in names.items() if n not in COLOR_CHANNELS or n in mapped_names}
        if changed or exr.parts or reading.depth or reading.miss:
            foreign.append(i)
            files[i], steps = _renamed(exr, names)
            stated += [f"{SIDES[i]}: {line}" for line in steps]
    if not foreign:
        return ConvertedFiles(a, b, tuple(stated))
    try:
        for i in foreign:
            files[i], steps = _converted(files[i], files[1 - i], reading, alone=1 - i not in foreign)
            stated += [f"{SIDES[i]}: {line}" for line in steps]
    except AmbiguousConvention as question:
        return ConvertedFiles(a, b, tuple(stated), reasons=(f"{SIDES[i]}: {question}",))
    left = sorted(files[0].channels.keys() ^ files[1].channels.keys())
    if left:
        stated.append(f"not compared, since only one file has them: {', '.join(left)}")
    return ConvertedFiles(files[0], files[1], tuple(stated), tuple(left))


def candidate_image(exr: Exr, request: CastRequest, reading: Reading = READ_BY_NAMES) -> tuple[Exr, tuple[str, ...]]:
    """What a candidate's command wrote, in our names and conventions, and the steps.

    An image with a channel depth.Z in one part is used as it is, unless the reading says otherwise. The convention of
    depth follows from our distances where the reading does not state it. Raises NoAnswer where two fit, or none.
    """
    reading = replace(reading, scene=request.scene)
    if "depth.Z" in exr.channels and not exr.parts and reading == replace(READ_BY_NAMES, scene=reading.scene):
        return exr, ()
    try:
        check_maps(reading.maps, exr.channels)
        exr, names = _renamed(exr, _channel_names(exr, mapped(reading.maps, exr.channels)))
        rays = request.rays
        t = cast_ours(request.scene, rays).nearest.t
        known = rays.start + t * np.linalg.norm(rays.d.astype(np.float64), axis=1)
        shape = next(iter(exr.channels.values())).shape if exr.channels else (0, 0)
        ours = exr._replace(channels={"depth.Z": known.astype(np.float32).reshape(shape[:2])}, provenance={})
        exr, steps = _converted(exr, ours, reading, alone=True)
    except (AmbiguousChannel, AmbiguousConvention, SceneError) as question:
        raise NoAnswer(f"its image: {question}") from question
    return exr, (*names, *steps)


def _describe_parts(exr: Exr) -> list[str]:
    """The parts of a multi-part file on one line; [] for any other."""
    return [f"{len(exr.parts)} parts as one image: {', '.join(map(str, exr.parts))}"] if exr.parts else []


def _written_by_caster(exr: Exr) -> bool:
    return any(key.startswith(PROVENANCE_PREFIX) for key in exr.provenance)


def _channel_names(exr: Exr, mapped_names: Mapping[str, str]) -> dict[str, str]:
    """Our channel -> the file's. --map overrides recognition by name, of its group and of its channel."""
    groups = {name.partition(".")[0] for name in mapped_names}
    rest = [n for n in exr.channels if n not in mapped_names.values() and n.partition(".")[0] not in groups]
    try:
        known = recognised(rest)
    except AmbiguousChannel:
        known = recognised([n for n in rest if not _mapped_elsewhere(n, mapped_names)])
    return {**{ours: theirs for ours, theirs in known.items() if ours.partition(".")[0] not in groups}, **mapped_names}


def _mapped_elsewhere(name: str, mapped_names: Mapping[str, str]) -> bool:
    """Whether --map assigns another channel to what this one would be recognised as."""
    try:
        return bool(recognised([name]).keys() & mapped_names.keys()) or _layer_mapped_elsewhere(name, mapped_names)
    except AmbiguousChannel:
        return False


def _layer_mapped_elsewhere(name: str, mapped_names: Mapping[str, str]) -> bool:
    layer = name.rpartition(".")[0]
    triple = [f"{layer}.{c}" for c in ("XYZ" if name[-1].isupper() else "xyz")]
    return bool(recognised(triple).keys() & mapped_names.keys())


def _renamed(exr: Exr, names: Mapping[str, str]) -> tuple[Exr, list[str]]:
    """The file with its recognised channels under our names, and the steps as text."""
    left = sorted(exr.channels.keys() - set(names.values()))
    changed = [f"{theirs} is {ours}" for ours, theirs in names.items() if ours != theirs]
    steps = ([f"channels: {', '.join(changed)}"] if changed else []) + (
        [f"not recognised, and left out: {', '.join(left)} (--map OURS=THEIRS)"] if left else []
    )
    return exr._replace(channels={ours: exr.channels[theirs] for ours, theirs in names.items()}), steps


def _converted(exr: Exr, other: Exr, reading: Reading, *, alone: bool) -> tuple[Exr, list[str]]:
    """Depth as distances with inf on a miss, and nothing of a surface where there is none.

    alone: the other file is ours, so its depths are distances. Raises AmbiguousConvention.
    """
    if "depth.Z" not in exr.channels:
        return exr, []
    misses = misses_of(exr, reading.miss)
    steps, channels = [misses.words], {n: a for n, a in exr.channels.items() if n not in misses.uninformative}
    depth = stacked(exr, ["depth.Z"])[..., 0]
    if "depth.Z" in other.channels and other.channels["depth.Z"].shape == depth.shape:
        if alone or reading.depth:
            found = _convention(depth, misses.missed, exr, other, reading)
            steps.append(f"depth is {found.words}")
            depth = found.distance
        else:
            steps.append("depth is used as it is: neither file states its convention (--depth)")
    number = depth > -np.inf  # what is not is a fault, wherever it is
    channels["depth.Z"] = _stored(np.where(misses.missed & number, np.inf, depth), channels["depth.Z"])
    for name, values in channels.items():
        if name.partition(".")[0] in GEOMETRY:
            channels[name] = np.where(misses.missed & np.isfinite(values), 0, values).astype(values.dtype)
    return exr._replace(channels=channels), steps


def _stored(values: Array, before: Array) -> Array:
    """Values as float32, or as half where they were half, so that the bound of halves applies."""
    with np.errstate(over="ignore"):
        return values.astype(before.dtype if before.dtype == np.float16 else np.float32)


def _convention(depth: Array, missed: Array, exr: Exr, other: Exr, reading: Reading) -> Convention:
    known = stacked(other, ["depth.Z"])[..., 0]
    hit = ~missed & np.isfinite(known) & (known > 0.0)
    return convention_of(depth, hit, known, view_of((exr, other), reading, depth.shape), reading.depth)


def view_of(files: Sequence[Exr], reading: Reading, shape: tuple[int, ...]) -> ViewRays | None:
    """Camera rays by --scene or a file's provenance; None where there is no camera, or one of another film size."""
    for found in (reading.scene, *map(scene_in, files)):
        if found is None or found.camera.type == "ray":
            continue
        near = reading.near if reading.near is not None or found is not reading.scene else near_in_xml(found)
        view = ViewRays.of(found, near)
        if view.cosine.shape == shape:
            return view
    return None


def near_in_xml(scene: Scene) -> float | None:
    """Of the scene as it is exported: Mitsuba's sensors have a near plane, and its depth counts from there."""
    from mitsuba_ref.cameras.camera_reference import clip_planes
    from mitsuba_ref.reference.shared_input import clip_range, model_of, packed_float32, shared_rays

    if not hasattr(scene.camera, "near"):
        return None
    model = model_of(scene, packed_float32(scene), shared_rays(scene))
    return float(clip_planes(scene.camera, clip_range(scene, model))["near_clip"])


def scene_in(exr: Exr) -> Scene | None:
    """Film and camera in a file's provenance; None where there are none, or unreadable ones."""
    try:
        record = json.loads(exr.provenance[SCENE_JSON])
        return Scene(film=Film(**record["film"]), camera=record["camera"])
    except (KeyError, TypeError, ValueError, SceneError):
        return None


# ---- one file, along the rays of its own

BESIDE_PIXEL = f"the position is more than {LARGEST_RAY_SHIFT_PIXELS:g} pixels beside its pixel"
POSITIONS, NORMALS = LAYERS["position"], LAYERS["normal"]


@dataclass(frozen=True)
class OwnRaysImage:
    """A subject: an image judged along the rays that its positions lie on."""

    name: str
    t: Array  # (n,) of the window's pixels
    n: Array | None
    t_rounding: Array
    beside: Array  # (n,) bool: a position that belongs to another pixel
    notes: tuple[str, ...]
    precision: str | None = None
    reads_xml: bool = False
    takes_rays: bool = False
    takes_limits: bool = False
    any_hit: bool = False

    def answer(self, request: CastRequest) -> Answer:
        """What was read. Raises NoAnswer."""
        found = checked_answer(self.t, self.n, len(self.t), precision=self.precision or FLOAT32)
        broken = dict(found.broken) | ({BESIDE_PIXEL: self.beside} if self.beside.any() else {})
        found = replace(found, t_rounding=self.t_rounding, notes=self.notes, broken=broken)
        return replace(found, own_camera=True, own_geometry=True)


def own_rays(name: str, exr: Exr, scene: Scene, reading: Reading) -> tuple[OwnRaysImage, SharedRays]:
    """The image as a subject, and its rays: through its positions, and of misses through their pixels.

    Where the rays are not the same in all pixels, a miss is judged where the centre of its pixel and the corners of
    where rays go all hit, or all miss. Raises SceneError for a file without depth and position.
    """
    exr, steps = _alone(name, exr, reading)
    try:
        misses = misses_of(exr, reading.miss)
    except AmbiguousConvention as question:
        raise SceneError(f"{name}: {question}") from question
    covered = ~misses.missed.ravel()
    x, y = pixel_centers(scene)
    if len(x) != len(covered):
        raise SceneError(f"{name}: expected {len(x)} pixels, those of the scene's film, got {len(covered)}")
    if not covered.any():
        raise SceneError(f"{name}: no pixel is hit, so that no position says where its rays go")
    p = stacked(exr, POSITIONS).reshape(-1, 3)
    found = film_points(scene, np.where(covered[:, None], p, np.nan), x, y)
    with np.errstate(invalid="ignore"):
        near = covered & (np.hypot(found.x - x, found.y - y) <= LARGEST_RAY_SHIFT_PIXELS)
    if not near.any():
        raise SceneError(f"{name}: no position is near its pixel; is --scene the scene that was rendered?")
    dx, dy = found.x - x + 0.5, found.y - y + 0.5
    shift = ray_shift(dx[near], dy[near], found.rounding[near])
    beside = (0.5, 0.5) if shift.common is None else shift.common
    places = [np.where(near, v, c - 0.5 + b) for v, c, b in zip((found.x, found.y), (x, y), beside, strict=True)]
    there = np.ones(len(x), bool) if shift.common is not None else covered | _all_alike(scene, x, y, shift)
    rays = reference_of_camera(scene.camera).rays(scene.camera, scene.film, *places)
    o, d = rays.o.astype(np.float32), rays.d.astype(np.float32)
    length = np.linalg.norm(d.astype(np.float64), axis=1)
    depth = stacked(exr, ["depth.Z"])[..., 0]
    distance, words = _distances(name, depth, covered.reshape(depth.shape), p, rays, scene, reading)
    with np.errstate(invalid="ignore"):
        t = np.where(covered, distance.ravel() / length, np.inf)
        stored = np.where(np.isfinite(t), U32 * np.abs(depth.ravel()) / length, 0.0)
    left_out = f"{int((~there).sum())} misses are not judged: rays through their pixels hit and miss"
    notes = (*steps, misses.words, words, shift.words, *([left_out] if not there.all() else []))
    t_max = np.where(there, rays.t_max, -1.0).astype(np.float32)
    shared = SharedRays(o, d, t_max, np.zeros(len(x)), rays.t_min.astype(np.float64))
    n = stacked(exr, NORMALS).reshape(-1, 3) if NORMALS[0] in exr.channels else None
    t, n, beside = (np.where(there, t, np.inf), n, covered & ~near)
    return OwnRaysImage(name, t, n, stored, beside, notes), shared


def _alone(name: str, exr: Exr, reading: Reading) -> tuple[Exr, list[str]]:
    """The file in our names, and the steps. Raises SceneError."""
    check_maps(reading.maps, exr.channels)
    try:
        exr, steps = _renamed(exr, _channel_names(exr, mapped(reading.maps, exr.channels)))
    except AmbiguousChannel as question:
        raise SceneError(f"{name}: {question}") from question
    for layer in ("depth", "position"):
        if missing := [each for each in LAYERS[layer] if each not in exr.channels]:
            raise SceneError(
                f"{name}: expected {', '.join(missing)}, or --map {layer}=THEIRS; it has {', '.join(exr.channels)}"
            )
    return exr, steps


def _all_alike(scene: Scene, x: Array, y: Array, shift: RayShift) -> Array:
    """(n,) bool: rays through the centre of a pixel and the corners of where its rays go all hit, or all miss."""
    camera = reference_of_camera(scene.camera)
    hits = []
    for place in ((0.5, 0.5), *product(*zip(shift.low, shift.high, strict=True))):
        rays = camera.rays(scene.camera, scene.film, x - 0.5 + place[0], y - 0.5 + place[1])
        t = cast(scene, rays.o, rays.d).t
        hits.append(np.isfinite(t) & (t > rays.t_min) & (t <= rays.t_max))
    alike: Array = np.all(hits, axis=0) | ~np.any(hits, axis=0)
    return alike


def _distances(
    name: str, depth: Array, hit: Array, p: Array, rays: CameraRays, scene: Scene, reading: Reading
) -> tuple[Array, str]:
    """Depth (h, w) as distance from the ray's origin, by the positions p; and in which convention it was."""
    d = np.where(hit.reshape(-1, 1), p - rays.o, rays.d)  # a position in another pixel has a ray of its own
    cosine = d @ camera_axes(scene.camera)[2] / np.linalg.norm(d, axis=1)
    start = rays.t_min if reading.near is None else reading.near / cosine
    known = np.linalg.norm(p - rays.o, axis=1).reshape(depth.shape)
    view = ViewRays(cosine.reshape(depth.shape), start.reshape(depth.shape))
    try:
        found = convention_of(depth, hit, known, view, reading.depth)
    except AmbiguousConvention as question:
        raise SceneError(f"{name}: {question}") from question
    return found.distance, f"depth is {found.words}"

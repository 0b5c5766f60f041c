"""Evidence of a judged scene: EXR images of both sides, of classes and ratios, and edges projected onto the film."""

from pathlib import Path

import numpy as np

from caster import __version__
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import write_exr
from caster.scene.model import Scene
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import camera_axes
from mitsuba_ref.judge.classification import CLASS_CODE, Judge, Judgement
from mitsuba_ref.judge.verdict import AGREE, CLASSES, FAILING

# The page of a report has one more, of pixels where the reference is wrong in no known way.
CLASS_COLORS = {
    "agree": (70, 120, 80),
    "explained": (255, 150, 0),
    "tie": (0, 200, 200),
    "reference_wrong": (200, 90, 255),
    "out_of_domain": (90, 90, 255),
    "wrong": (255, 0, 0),
    "undecided": (255, 255, 0),
}
UNLISTED_COLOR = (255, 105, 180)


def class_attributes() -> dict[str, str]:
    """EXR attributes that define the codes of a channel class.I."""
    colors = (bytes(CLASS_COLORS[name]).hex() for name in CLASSES)
    return {
        "caster/classes": ", ".join(f"{code} {name}" for code, name in enumerate(CLASSES)),
        "caster/class_colors": ", ".join(f"{code} #{color}" for code, color in enumerate(colors)),
    }


def write_images(folder: Path, name: str, judge: Judge, judgement: Judgement) -> None:
    """Write NAME.ours.exr (or .candidate.exr), NAME.reference.exr and NAME.verdict.exr. Raises OutputError."""
    scene, pair = judge.scene, judge.pair
    classified = pair.any_hit | judgement.is_class(*FAILING)
    ratio = np.max([*judgement.ratios.values()], axis=0)
    verdict = {
        "A": classified.astype(np.float32),
        "class.I": judgement.classes.astype(np.uint32),
        "ratio.Y": clipped_to_float32(ratio).astype(np.float32),
    }
    images = {
        "ours" if judge.names_prims else "candidate": {
            channel: clipped_to_float32(values) for channel, values in aovs_to_channels(pair.subject).items()
        },
        "reference": aovs_to_channels(pair.reference),
        "verdict": {channel: values.reshape(pair.shape) for channel, values in verdict.items()},
    }
    film = (0, 0, scene.film.width, scene.film.height)
    about = provenance(scene, __version__, name) | class_attributes()
    for which, channels in images.items():
        path = folder / f"{name}.{which}.exr"
        write_exr(path, channels, about, data_window=scene.film.window, display_window=film)


def clipped_to_float32(values: np.ndarray) -> np.ndarray:
    """Clip finite numbers to the range of float32: the type of the file, in which inf would mean a miss."""
    if values.dtype.kind != "f":
        return values
    largest = float(np.finfo(np.float32).max)
    return np.where(np.isfinite(values), np.clip(values, -largest, largest), values)


# ---- edges projected onto the film, for the page ----

MAX_TRIANGLES_DRAWN = 4096  # of a scene: some 60 kB
EDGE_UNITS = 64  # in a pixel, which is shown at 128 points at most
STRAIGHT_CAMERAS = ("pinhole", "orthographic")  # in whose images the edges of a triangle are straight


def film_edges(judge: Judge, judgement: Judgement) -> np.ndarray:
    """(m, 4) int32 film coordinates x, y, x, y, in units of 1 / EDGE_UNITS pixel, of the edges of triangles that are
    hit, without those that reach behind the eye.

    If these are too many, of those at pixels that do not agree. None of them for a list of rays, and for a camera that
    bends edges.
    """
    scene, packed, hit = judge.scene, judge.model.packed, judge.reference_prim
    if judge.pair.rays.is_list or scene.camera.type not in STRAIGHT_CAMERAS:
        return np.zeros((0, 4), np.int32)
    prims = np.stack([hit, judge.pair.prim]) if judge.names_prims else hit[None]
    chosen = np.unique(prims[prims >= 0])
    if len(chosen) > MAX_TRIANGLES_DRAWN:
        odd = prims[:, judgement.classes != CLASS_CODE[AGREE]]
        chosen = np.unique(odd[odd >= 0])[:MAX_TRIANGLES_DRAWN]
    kind, k = packed.kinds_of(chosen)
    found = [np.zeros((0, 4))]
    for place in np.unique(kind):
        of = packed.kinds[place].prims
        if hasattr(of, "faces"):
            ends = of.faces[k[kind == place]][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
            used, corners = np.unique(np.unique(np.sort(ends), axis=0), return_inverse=True)
            found.append(project_points(scene, of.vertices[used])[corners].reshape(-1, 4))
    flat = np.concatenate(found)
    near = np.abs(flat * EDGE_UNITS).max(axis=1, initial=0.0) <= np.iinfo(np.int32).max  # and no NaN
    return np.round(flat[near] * EDGE_UNITS).astype(np.int32)


def project_points(scene: Scene, points: np.ndarray) -> np.ndarray:
    """(n, 2) film coordinates of (n, 3) points in world space, NaN behind the eye: an affine map of coordinates in the
    view, which three rays of the camera determine."""
    camera, film = scene.camera, scene.film
    axes, parallel = camera_axes(camera), camera.type == "orthographic"
    corners = np.array([[0, 0], [film.width, 0], [0, film.height]], np.float64)
    rays = reference_of_camera(camera).rays(camera, film, *corners.T)

    def in_view(directions: np.ndarray) -> np.ndarray:
        """(n, 3): two coordinates in the view, and 1."""
        view = directions @ axes.T
        view[:, 2] = 1.0 if parallel else np.where(view[:, 2] > 0.0, view[:, 2], np.nan)
        return view / view[:, 2:]

    if parallel:
        return in_view(points) @ np.linalg.solve(in_view(rays.o), corners)
    return in_view(points - rays.o[0]) @ np.linalg.solve(in_view(rays.d), corners)

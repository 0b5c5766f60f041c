"""Evidence of a judged scene: EXR images of both sides, of classes and ratios, and edges projected onto the film."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from caster import __version__
from caster.geometry.packing import Packed
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import write_exr
from caster.scene.model import Scene
from mitsuba_ref.cameras.camera_reference import camera_axes
from mitsuba_ref.error_model.scene_model import kinds_of
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
    ratio = np.max([judgement.ratio(check) for check in judgement.names], axis=0)
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

MAX_TRIANGLES_DRAWN = 4096  # of a scene: some 200 kB
LARGEST_PIXEL_OFFSET = 0.01  # of a fitted projection from the centre of a pixel; at 128 points a pixel, one point


def film_edges(judge: Judge, judgement: Judgement) -> np.ndarray | None:
    """(m, 4) film coordinates x, y, x, y of the edges of triangles that are hit, without those that reach behind the
    eye.

    If these are too many, of those at pixels that do not agree. None if rays do not go through pixel centres of a
    rectilinear film.
    """
    to_film = film_projection(judge.scene, judge.o, judge.d)
    if to_film is None:
        return None
    hit = judge.reference_prim
    prims = np.stack([hit, judge.pair.prim]) if judge.names_prims else hit[None]
    chosen = np.unique(prims[prims >= 0])
    if len(chosen) > MAX_TRIANGLES_DRAWN:
        odd = prims[:, judgement.classes != CLASS_CODE[AGREE]]
        chosen = np.unique(odd[odd >= 0])[:MAX_TRIANGLES_DRAWN]
    flat = to_film(triangle_edges(judge.model.packed, chosen)).reshape(-1, 4)
    return flat[np.isfinite(flat).all(axis=1)].astype(np.float32)


def film_projection(scene: Scene, o: np.ndarray, d: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
    """The map of points (..., 3) to film coordinates (..., 2), NaN behind the eye; None if the film is not rectilinear.

    Fitted to the rays o, d through the centres of the pixels: an affine map of view coordinates, divided by depth in a
    perspective view.
    """
    x0, y0, x1, y1 = scene.film.window
    y, x = np.mgrid[y0:y1, x0:x1] + 0.5
    parallel = not np.ptp(d, axis=0).any()
    one_eye = parallel or not np.ptp(o, axis=0).any()
    if not hasattr(scene.camera, "up") or min(x.shape) < 2 or x.size != len(o) or not one_eye:
        return None
    axes = camera_axes(scene.camera)

    def in_view(points: np.ndarray) -> np.ndarray:
        """(..., 3) coordinates in the view, the last of them 1."""
        view = (points if parallel else points - o[0]) @ axes.T
        depth = np.where(view[..., 2:] > 0.0, view[..., 2:], np.nan)
        flat = view[..., :2] if parallel else view[..., :2] / depth
        return np.concatenate([flat, np.ones_like(depth)], axis=-1)

    known, pixels = in_view(o if parallel else o + d), np.column_stack([x.ravel(), y.ravel()])
    if not np.isfinite(known).all():
        return None
    affine = np.linalg.lstsq(known, pixels, rcond=None)[0]
    fits = np.abs(known @ affine - pixels).max() <= LARGEST_PIXEL_OFFSET
    return (lambda points: in_view(points) @ affine) if fits else None


def triangle_edges(packed: Packed, prims: np.ndarray) -> np.ndarray:
    """(m, 2, 3) edges in world space of the triangles among these primitives."""
    kind, k = kinds_of(packed, prims)
    found = [np.zeros((0, 2, 3))]
    for place in np.unique(kind):
        of = packed.kinds[place].prims
        if hasattr(of, "faces"):
            faces = of.faces[k[kind == place]]
            found.append(of.vertices[np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])])
    return np.concatenate(found)

"""Evidence of a judged scene: EXR images of both sides, of classes and ratios, and the data for its page."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from caster import __version__
from caster.aovs import Aovs
from caster.geometry.packing import Packed
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import write_exr
from caster.scene.model import Scene
from mitsuba_ref.cameras.camera_reference import camera_axes
from mitsuba_ref.error_model.bounds import aov_rows, error_over_bound
from mitsuba_ref.error_model.scene_model import kinds_of
from mitsuba_ref.judge.classification import CLASS_CODE, Judge, Judgement
from mitsuba_ref.judge.diagnosis import Diagnosis
from mitsuba_ref.judge.explanations import constant_reasons, reason
from mitsuba_ref.judge.verdict import AGREE, CLASSES, FAILING

Channels = Mapping[str, np.ndarray]

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
    classified = (pair.any_hit | judgement.is_class(*FAILING)).reshape(pair.shape)
    images = {
        "ours" if judge.names_prims else "candidate": {
            channel: clipped_to_float32(values) for channel, values in aovs_to_channels(pair.subject).items()
        },
        "reference": aovs_to_channels(pair.reference),
        "verdict": class_map(classified, judgement),
    }
    film = (0, 0, scene.film.width, scene.film.height)
    about = provenance(scene, __version__, name) | class_attributes()
    for which, channels in images.items():
        path = folder / f"{name}.{which}.exr"
        write_exr(path, channels, about, data_window=scene.film.window, display_window=film)


def class_map(classified: np.ndarray, judgement: Judgement) -> Channels:
    """Channels of NAME.verdict.exr. classified: (h, w) bool, where either side hits or the pixel fails."""
    ratio = np.max([judgement.ratio(check) for check in judgement.names], axis=0)
    return {
        "A": classified.astype(np.float32),
        "class.I": judgement.classes.reshape(classified.shape).astype(np.uint32),
        "ratio.Y": clipped_to_float32(ratio).reshape(classified.shape).astype(np.float32),
    }


def clipped_to_float32(values: np.ndarray) -> np.ndarray:
    """Clip finite numbers to the range of float32: the type of the file, in which inf would mean a miss."""
    if values.dtype.kind != "f":
        return values
    largest = float(np.finfo(np.float32).max)
    return np.where(np.isfinite(values), np.clip(values, -largest, largest), values)


# ---- for the page of a scene ----


# A ratio that is computed in two ways, here by the square root of a square, is the same up to 4 roundings.
ROUNDING = 1.0 + 4 * 2.0**-53


class LayerBound(NamedTuple):
    """The bounds of one layer, one row per pixel."""

    between: np.ndarray | None = None  # (n,) on the difference between both sides
    alone: np.ndarray | None = None  # (n,) bool: the bound of the subject at its own surface decides instead
    own: np.ndarray | None = None  # (n,) of the subject's arithmetic, on its distance from the surface of the reference


@dataclass(frozen=True)
class Evidence:
    """Both images and the findings about their pixels: some 60 MB for 256 x 256 pixels."""

    judge: Judge
    judgement: Judgement
    diagnosis: Diagnosis

    @property
    def scene(self) -> Scene:
        """The scene as it was judged."""
        return self.judge.scene

    @property
    def packed(self) -> Packed:
        return self.judge.model.packed

    @property
    def ours(self) -> Aovs:
        """The subject's AOVs, only those that it gives."""
        return self.judge.pair.subject

    @property
    def reference(self) -> Aovs:
        """Mitsuba's AOVs, at least the same ones."""
        return self.judge.pair.reference

    @cached_property
    def always(self) -> Mapping[str, str]:
        """Class -> the reason for it, if that is the same for all pixels."""
        return constant_reasons(self.judge)

    def why(self, row: int) -> str:
        """The reason for the class of one pixel."""
        return reason(self.judge, self.judgement, self._diagnosed, row)

    @cached_property
    def _diagnosed(self) -> Mapping[int, str]:
        return self.diagnosis.by_row()

    def bound(self, name: str) -> LayerBound:
        """The bounds of an AOV; none for `diffuse`, whose bound differs by light."""
        judge, pixels = self.judge, self.judge.pixels
        if not judge.names_prims:
            own = judge.bounds.own
            error = own.n_error if name == "normal" else (own.t_error + judge.answer.t_rounding) * pixels.length
            return LayerBound(own=np.where(pixels.both_hit, error, 0.0))
        bound = pixels.allowed_distance.get(name)
        if bound is None:
            return LayerBound()
        ratio = self.judgement.ratio(name)
        alone = pixels.both_hit & (ratio > error_over_bound(pixels.distance(name), bound) * ROUNDING)
        return LayerBound(np.where(pixels.both_hit, bound, 0.0), alone)

    def ids(self) -> Mapping[str, np.ndarray]:
        """`shape_reference`, `prim_reference`: (n,) shape, and primitive within it, -1 on a miss; also `shape_ours`,
        `prim_ours` for a subject that names primitives."""
        judge, pair, index = self.judge, self.judge.pair, self.packed.index_in_shape
        if not judge.names_prims:
            return {"shape_reference": pair.result.shape_id, "prim_reference": index(judge.reference_prim)}
        numbered = np.where(pair.reference.hit.ravel(), pair.result.answer.prim.astype(np.int64), -1)
        return {
            "shape_reference": aov_rows(pair.reference, "shape_id"),
            "shape_ours": aov_rows(pair.subject, "shape_id"),
            "prim_reference": numbered,
            "prim_ours": index(pair.prim),
        }

    def t(self) -> tuple[np.ndarray, np.ndarray] | None:
        """(n,) t of the subject and of the reference, in lengths of d; None if depth shows the same."""
        return None if self.judge.names_prims else (self.judge.answer.t, self.judge.result.t)

    def edges(self) -> np.ndarray | None:
        """(m, 4) film coordinates x, y, x, y of the edges of triangles that are hit; if these are too many, of those at
        pixels that do not agree. None if rays do not go through pixel centres of a rectilinear film."""
        film = film_projection(self.scene, self.judge.o, self.judge.d)
        if film is None:
            return None
        hit = self.judge.reference_prim
        prims = np.stack([hit, self.judge.pair.prim]) if self.judge.names_prims else hit[None]
        odd = prims[:, self.judgement.classes != CLASS_CODE[AGREE]]
        for chosen in (np.unique(prims[prims >= 0]), np.unique(odd[odd >= 0])):
            if len(chosen) <= MAX_TRIANGLES_DRAWN:
                break
        edges = triangle_edges(self.packed, chosen[:MAX_TRIANGLES_DRAWN])
        return film.segments(edges).astype(np.float32)


# ---- projection of edges onto the film, for the page ----

MAX_TRIANGLES_DRAWN = 4096  # of a scene: some 100 kB
LARGEST_PIXEL_OFFSET = 0.01  # of a fitted projection from the centre of a pixel; at 128 points a pixel, one point
NEAR_SHARE = 1e-6  # of the largest depth: edges end there instead of behind the camera


class FilmProjection(NamedTuple):
    """Film coordinates as an affine map of view coordinates (x, y), divided by depth in a perspective view."""

    axes: np.ndarray  # (3, 3), rows right, up, forward
    affine: np.ndarray  # (3, 2)
    eye: np.ndarray | None  # (3,) in a perspective view; None for parallel rays

    def segments(self, edges: np.ndarray) -> np.ndarray:
        """Project edges (m, 2, 3) in world space to (m, 4), leaving out those behind the eye."""
        across = (edges - (0.0 if self.eye is None else self.eye)) @ self.axes.T
        if self.eye is not None and len(across):
            near = NEAR_SHARE * np.abs(across[..., 2]).max()
            across = across[(across[..., 2] > near).any(axis=1)]
            start, end = across[:, 0].copy(), across[:, 1].copy()
            for this, other in ((start, end), (end, start)):
                behind = this[:, 2] < near
                share = (near - this[behind, 2]) / (other[behind, 2] - this[behind, 2])
                this[behind] += share[:, None] * (other[behind] - this[behind])
            across = np.stack([start, end], axis=1)
            across = across / across[..., 2:]
        flat = across[..., :2] @ self.affine[:2] + self.affine[2]
        found: np.ndarray = flat.reshape(-1, 4)
        return found[np.isfinite(found).all(axis=1)]


def film_projection(scene: Scene, o: np.ndarray, d: np.ndarray) -> FilmProjection | None:
    """The projection that maps ray i of the film's window to the centre of pixel i; None if it is not rectilinear."""
    x0, y0, x1, y1 = scene.film.window
    y, x = np.mgrid[y0:y1, x0:x1] + 0.5
    parallel = not np.ptp(d, axis=0).any()
    if (
        not hasattr(scene.camera, "up")
        or x1 - x0 < 2
        or y1 - y0 < 2
        or x.size != len(o)
        or not (parallel or not np.ptp(o, axis=0).any())
    ):
        return None
    axes = camera_axes(scene.camera)
    along = axes[2]
    if not parallel and not (d @ along > 0.0).all():
        return None
    flat = (o if parallel else d / (d @ along)[:, None]) @ axes[:2].T
    known = np.column_stack([flat, np.ones(len(flat))])
    pixels = np.column_stack([x.ravel(), y.ravel()])
    affine = np.linalg.lstsq(known, pixels, rcond=None)[0]
    if not np.abs(known @ affine - pixels).max() <= LARGEST_PIXEL_OFFSET:
        return None
    return FilmProjection(axes, affine, None if parallel else o[0])


def triangle_edges(packed: Packed, prims: np.ndarray) -> np.ndarray:
    """(m, 2, 3) edges in world space of the triangles among these primitives, each edge once."""
    kind, k = kinds_of(packed, prims)
    found = [np.zeros((0, 2, 3))]
    for place in np.unique(kind):
        of = packed.kinds[place].prims
        if hasattr(of, "faces"):
            faces = of.faces[k[kind == place]]
            pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
            found.append(of.vertices[pairs])
    ends = np.concatenate(found)
    differs = ends[:, 0] != ends[:, 1]
    first = np.argmax(differs, axis=1)[:, None]
    start, end = (np.take_along_axis(ends[:, side], first, axis=1)[:, 0] for side in (0, 1))
    ends[start > end] = ends[start > end, ::-1]  # faces may share positions without sharing vertices
    return np.unique(ends.reshape(-1, 6), axis=0).reshape(-1, 2, 3)

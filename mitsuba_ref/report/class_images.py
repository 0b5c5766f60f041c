"""EXR images of what was judged: subject, reference, class and worst ratio of every pixel; colours of the classes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from caster import __version__
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import write_exr
from mitsuba_ref.judge.classification import Judge, Judgement
from mitsuba_ref.judge.verdict import CLASSES, FAILING

Channels = Mapping[str, np.ndarray]

# The report's page has the same, and one more for unlisted cases (html/page/colors.js, which a test compares).
CLASS_COLORS = {
    "agree": (70, 120, 80),
    "explained": (255, 150, 0),
    "tie": (0, 200, 200),
    "reference_wrong": (200, 90, 255),
    "out_of_domain": (90, 90, 255),
    "wrong": (255, 0, 0),
    "undecided": (255, 255, 0),
}


def hex_color(name: str) -> str:
    """ "#467850"."""
    return f"#{bytes(CLASS_COLORS[name]).hex()}"


def class_attributes(names: Sequence[str] = CLASSES) -> dict[str, str]:
    """EXR attributes that define the codes of a channel class.I. names: of the classes in that file."""
    return {
        "caster/classes": ", ".join(f"{code} {name}" for code, name in enumerate(names)),
        "caster/class_colors": ", ".join(f"{code} {hex_color(name)}" for code, name in enumerate(CLASSES)),
    }


def write_images(folder: Path, name: str, judge: Judge, judgement: Judgement) -> None:
    """NAME.ours.exr or NAME.candidate.exr, NAME.reference.exr and NAME.verdict.exr. Raises OutputError."""
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
        "ratio.Y": clipped_to_float32(ratio).reshape(classified.shape),
    }


def clipped_to_float32(values: np.ndarray) -> np.ndarray:
    """Finite numbers beyond float32 as its largest: no file of ours holds more, and inf would mean a miss."""
    if values.dtype.kind != "f":
        return values
    largest = float(np.finfo(np.float32).max)
    return np.where(np.isfinite(values), np.clip(values, -largest, largest), values)

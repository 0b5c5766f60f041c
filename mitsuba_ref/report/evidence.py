"""Evidence of a judged scene: EXR images of both sides, of classes and of ratios."""

from pathlib import Path

import numpy as np

from caster import __version__
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import write_exr
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.classification import Judge, Judgement
from mitsuba_ref.judge.verdict import CLASSES, FAILING

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


def write_images(folder: Path, name: str, judge: Judge, judgement: Judgement) -> list[str]:
    """Write NAME.ours.exr (or .candidate.exr), NAME.reference.exr, NAME.verdict.exr; names. Raises OutputError."""
    scene = judge.scene
    classified = judge.any_hit | judgement.is_class(*FAILING)
    ratio = np.max([*judgement.ratios.values()], axis=0)
    verdict = {
        "A": classified.astype(np.float32),
        "class.I": judgement.classes.astype(np.uint32),
        "ratio.Y": clipped_to_float32(ratio).astype(np.float32),
    }
    images = {
        "ours" if judge.names_prims else "candidate": {
            channel: clipped_to_float32(values) for channel, values in aovs_to_channels(judge.subject).items()
        },
        "reference": aovs_to_channels(judge.pair.reference),
        "verdict": {channel: values.reshape(judge.shape) for channel, values in verdict.items()},
    }
    film = (0, 0, scene.film.width, scene.film.height)
    colors = (bytes(CLASS_COLORS[each]).hex() for each in CLASSES)
    about = provenance(scene, __version__, name) | {  # with the codes of the channel class.I
        "caster/classes": ", ".join(f"{code} {each}" for code, each in enumerate(CLASSES)),
        "caster/class_colors": ", ".join(f"{code} #{color}" for code, color in enumerate(colors)),
    }
    files = {f"{name}.{which}.exr": channels for which, channels in images.items()}
    for file, channels in files.items():
        write_exr(folder / file, channels, about, data_window=scene.film.window, display_window=film)
    return list(files)


def clipped_to_float32(values: Array) -> Array:
    """Clip finite numbers to the range of float32: the type of the file, in which inf would mean a miss."""
    if values.dtype.kind != "f":
        return values
    largest = float(np.finfo(np.float32).max)
    return np.where(np.isfinite(values), np.clip(values, -largest, largest), values)

"""What was judged, as files: ours, the reference's, and the class and worst ratio of every pixel."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from caster import __version__
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import write_exr
from caster.scene.model import Scene
from mitsuba_ref.judge.classification import Judgement
from mitsuba_ref.judge.verdict import FAILING
from mitsuba_ref.report import class_colors
from mitsuba_ref.subjects.ours import ImagePair

Channels = Mapping[str, np.ndarray]


def write_images(folder: Path, name: str, scene: Scene, pair: ImagePair, judgement: Judgement) -> None:
    """NAME.ours.exr, NAME.reference.exr and NAME.verdict.exr. Raises OutputError."""
    told = pair.ours.hit | pair.reference.hit | judgement.is_class(*FAILING).reshape(pair.ours.hit.shape)
    ratio = np.max([judgement.ratio(check) for check in judgement.names], axis=0)
    pictures = {
        "ours": aovs_to_channels(pair.ours),
        "reference": aovs_to_channels(pair.reference),
        "verdict": class_map(told, judgement.classes, ratio),
    }
    write_image_files(folder, name, scene, pictures, class_colors.attributes())


def class_map(told: np.ndarray, classes: np.ndarray, ratio: np.ndarray) -> Channels:
    """Channels of NAME.verdict.exr. told: (h, w) bool, where there is a class to tell of: somebody hits or it fails."""
    return {
        "A": told.astype(np.float32),
        "class.I": classes.reshape(told.shape).astype(np.uint32),
        "ratio.Y": clipped_to_float32(ratio).reshape(told.shape),
    }


def clipped_to_float32(values: np.ndarray) -> np.ndarray:
    """Finite numbers beyond float32 as its largest: no file of ours holds more, and inf would say a miss."""
    largest = float(np.finfo(np.float32).max)
    return np.where(np.isfinite(values), np.clip(values, -largest, largest), values)


def write_image_files(
    folder: Path, name: str, scene: Scene, pictures: Mapping[str, Channels], about: Mapping[str, str]
) -> None:
    """NAME.WHICH.exr for each picture, with the scene's provenance and more about it. Raises OutputError."""
    film = (0, 0, scene.film.width, scene.film.height)
    told = provenance(scene, __version__, name) | dict(about)
    for which, channels in pictures.items():
        path = folder / f"{name}.{which}.exr"
        write_exr(path, channels, told, data_window=scene.film.window, display_window=film)

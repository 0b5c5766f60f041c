"""What was judged, as files: ours, the reference's, and the class and worst ratio of every pixel."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from caster import __version__
from caster.channels import channels_of, provenance
from caster.exr import write_exr
from caster.scene import Scene
from mitsuba_ref import class_colors
from mitsuba_ref.judge import Judgement
from mitsuba_ref.pair import Pair
from mitsuba_ref.verdict import FAILING

Channels = Mapping[str, np.ndarray]


def write_pictures(folder: Path, name: str, scene: Scene, pair: Pair, judgement: Judgement) -> None:
    """NAME.ours.exr, NAME.reference.exr and NAME.verdict.exr. Raises OutputError."""
    told = pair.ours.hit | pair.reference.hit | judgement.is_class(*FAILING).reshape(pair.ours.hit.shape)
    ratio = np.max([judgement.ratio(check) for check in judgement.names], axis=0)
    pictures = {
        "ours": channels_of(pair.ours),
        "reference": channels_of(pair.reference),
        "verdict": class_map(told, judgement.classes, ratio),
    }
    write_all(folder, name, scene, pictures, class_colors.attributes())


def class_map(told: np.ndarray, classes: np.ndarray, ratio: np.ndarray) -> Channels:
    """Channels of NAME.verdict.exr. told: (h, w) bool, where there is a class to tell of: somebody hits or it fails."""
    return {
        "A": told.astype(np.float32),
        "class.I": classes.reshape(told.shape).astype(np.uint32),
        "ratio.Y": within_float32(ratio).reshape(told.shape),
    }


def within_float32(values: np.ndarray) -> np.ndarray:
    """Finite numbers beyond float32 as its largest: no file of ours holds more, and inf would say a miss."""
    largest = float(np.finfo(np.float32).max)
    return np.where(np.isfinite(values), np.clip(values, -largest, largest), values)


def write_all(
    folder: Path, name: str, scene: Scene, pictures: Mapping[str, Channels], about: Mapping[str, str]
) -> None:
    """NAME.WHICH.exr for each picture, with the scene's provenance and more about it. Raises OutputError."""
    film = (0, 0, scene.film.width, scene.film.height)
    told = provenance(scene, __version__, name) | dict(about)
    for which, channels in pictures.items():
        path = folder / f"{name}.{which}.exr"
        write_exr(path, channels, told, data_window=scene.film.window, display_window=film)

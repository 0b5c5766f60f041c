"""What was judged, as files: ours, the reference's, and the class and worst ratio of every pixel."""

from pathlib import Path

import numpy as np

from caster import __version__
from caster.channels import channels_of, provenance
from caster.exr import write_exr
from caster.scene import Scene
from mitsuba_ref import class_colors
from mitsuba_ref.judge import Judgement
from mitsuba_ref.pair import Pair
from mitsuba_ref.verdict import CLASSES


def write_pictures(folder: Path, name: str, scene: Scene, pair: Pair, judgement: Judgement) -> None:
    """NAME.ours.exr, NAME.reference.exr and NAME.verdict.exr. Raises OutputError."""
    shape = pair.ours.hit.shape
    ratio = np.max([judgement.ratio(check) for check in judgement.names], axis=0)
    verdict = {
        "A": (pair.ours.hit | pair.reference.hit).astype(np.float32),
        "class.I": judgement.classes.reshape(shape).astype(np.uint32),
        "ratio.Y": ratio.reshape(shape),
    }
    about = provenance(scene, __version__, name)
    codes = {
        "caster/classes": ", ".join(f"{code} {text}" for code, text in enumerate(CLASSES)),
        "caster/class_colors": class_colors.in_words(),
    }
    pictures = {"ours": channels_of(pair.ours), "reference": channels_of(pair.reference), "verdict": verdict}
    for which, channels in pictures.items():
        film = (0, 0, scene.film.width, scene.film.height)
        path = folder / f"{name}.{which}.exr"
        write_exr(path, channels, about | codes, data_window=scene.film.window, display_window=film)

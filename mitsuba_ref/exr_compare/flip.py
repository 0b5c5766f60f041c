"""FLIP of NVIDIA (flip-evaluator), a measure of the difference between two images that an observer sees."""

import sys
from pathlib import Path

import numpy as np

from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.reference import subprocess_runner

# In a process of its own, since the library ends the process for images that it cannot judge, such as black ones.
FLIP_PROGRAM = """
import sys
import numpy as np
import flip_evaluator
a, b = np.load(sys.argv[1]), np.load(sys.argv[2])
print(flip_evaluator.evaluate(b, a, "HDR", applyMagma=False)[1])
"""
FLIP_SECONDS = 300.0
FLIP_MISSING = "not computed; pip install flip-evaluator"


def flip(ours: np.ndarray, reference: np.ndarray) -> str:
    """The mean of FLIP for linear colours (h, w, 3), or why it is not known."""
    if not (np.isfinite(ours).all() and np.isfinite(reference).all()):
        return "not computed: a value is not finite"
    with ScratchFolder() as folder:
        paths = [str(Path(folder) / name) for name in ("ours.npy", "reference.npy")]
        for path, image in zip(paths, (ours, reference), strict=True):
            np.save(path, np.maximum(image, 0.0).astype(np.float32))
        end = subprocess_runner.run([sys.executable, "-c", FLIP_PROGRAM, *paths], FLIP_SECONDS)
    words = end.output.strip().splitlines()[-1:] or [""]
    if end.code == 0:
        return f"{float(words[0]):.4g}"
    return FLIP_MISSING if "No module named 'flip_evaluator'" in words[0] else f"not computed: {words[0]}"

"""`compare --html`: two images on the page of a report, with measures of other tools as information."""

import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import SceneError
from caster.image.exr import NO_ID
from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.exr_compare.comparison_result import FileComparison, GroupResult
from mitsuba_ref.exr_compare.pixel_bounds import ExrPair
from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.reference import subprocess_runner
from mitsuba_ref.report.html_report import (
    MAX_PIXELS,
    index_row,
    page_words,
    report_folder,
    run_facts,
    write_page,
    write_record,
)
from mitsuba_ref.report.scene_record import SIDES, image, packed

RECORD = "images"  # the name of the record of both


class Layer(NamedTuple):
    """An image of one to four channels on both sides, (h, w, c)."""

    ours: Array
    reference: Array
    ratio: Array  # (h, w) error over bound, of the worst channel
    colors: bool  # red, green and blue


def layers_of(pair: ExrPair, groups: Iterable[tuple[GroupResult, Array]]) -> dict[str, Layer]:
    """The layers of a page, the farthest beyond its bound first. groups: each with its (h, w) error over bound."""
    found = {}
    for group, ratio in groups:
        ours, reference = pair.values(group.channels)
        if pair.reference.channels[group.channels[0]].dtype == np.uint32:
            ours, reference = (np.where(values == NO_ID, -1.0, values) for values in (ours, reference))
        colors = "".join(name[-1] for name in group.channels) == "RGB"
        found[group.name] = Layer(ours, reference, ratio, colors)
    return dict(sorted(found.items(), key=lambda item: (-item[1].ratio.max(), item[0] == "hit")))


def measures(pair: ExrPair, layers: Mapping[str, Layer]) -> Iterator[tuple[str, str]]:
    """(what, value) of each layer that differs: mean squared error and largest difference where both images hit, and
    FLIP of colours."""
    x0, y0 = pair.reference.data_window[:2]
    both = (pair.hit_ours & pair.hit_reference)[..., None]
    for name, layer in layers.items():
        known = both & np.isfinite(layer.ours) & np.isfinite(layer.reference)
        with np.errstate(invalid="ignore", over="ignore"):
            apart = np.where(known, np.abs(layer.ours - layer.reference), 0.0)
            if not apart.any() and known[both[..., 0]].all():
                continue
            yield f"{name}: mean squared error", f"{(apart**2).sum() / max(known.sum(), 1):.3g}"
        y, x, _ = np.unravel_index(int(apart.argmax()), apart.shape)
        yield f"{name}: largest difference", f"{apart.max():.3g} at ({x0 + x}, {y0 + y})"
        if layer.colors:
            yield f"{name}: FLIP, mean", flip(layer.ours, layer.reference)


# ---- FLIP of NVIDIA (flip-evaluator), a measure of the difference between two images that an observer sees ----

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


def flip(ours: Array, reference: Array) -> str:
    """The mean of FLIP for linear colours (h, w, 3), or why it is not known."""
    if not (np.isfinite(ours).all() and np.isfinite(reference).all()):
        return "not computed: a value is not finite"
    with ScratchFolder() as folder:
        paths = [str(Path(folder) / name) for name in ("ours.npy", "reference.npy")]
        for path, colors in zip(paths, (ours, reference), strict=True):
            np.save(path, np.maximum(colors, 0.0).astype(np.float32))
        end = subprocess_runner.run([sys.executable, "-c", FLIP_PROGRAM, *paths], FLIP_SECONDS)
    words = end.output.strip().splitlines()[-1:] or [""]
    if end.code == 0:
        return f"{float(words[0]):.4g}"
    return FLIP_MISSING if "No module named 'flip_evaluator'" in words[0] else f"not computed: {words[0]}"


# ---- the page ----


def write_comparison(folder: Path, result: FileComparison, pair: ExrPair, layers: Mapping[str, Layer]) -> None:
    """Write index.html and its data, without loss. Raises OutputError, and SceneError for too large images."""
    count = result.width * result.height
    if count > MAX_PIXELS:
        raise SceneError(
            f"--html: {result.width} x {result.height} pixels, and a page shows at most {MAX_PIXELS}; compare a crop"
        )
    about: dict[str, Any] = {
        "window": pair.reference.data_window,
        "layers": {name: layer.ours.shape[-1] for name, layer in layers.items()},
        "facts": result.measures,
        "text": str(result),
    }
    if pair.mask_channel:
        about["hit"] = image(pair.hit_ours.ravel() + 2 * pair.hit_reference.ravel(), (result.height, result.width))

    def stored(values: Array) -> dict[str, Any]:
        with np.errstate(over="ignore"):  # ratios beyond float32
            return packed(values.astype(np.float32).reshape(count, -1))

    index, data = report_folder(folder)
    parts = {
        name: {part: stored(values) for part, values in zip(SIDES, layer[:3], strict=True)}
        for name, layer in layers.items()
    }
    write_record(data, RECORD, {"about": about, **parts})
    mark = "PASS" if result.ok else "FAIL"
    row = index_row(SceneVerdict(RECORD, ""), "") | {"ok": result.ok, "mark": mark, "failure": ""}
    run = {"names": (result.ours, result.reference), "facts": run_facts(), "summary": mark, "requested": 1}
    write_page(index, run | page_words(), [row])

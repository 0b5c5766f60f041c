"""The data of one scene on the report's page, in parts: verdict, findings of each pixel, and both images.

Images are rounded to a 255th of their range, errors to powers of 2, and shares of bounds to those of its root. The
numbers of some pixels, failing ones first, are stored without loss. Arrays are text: bytes of equal weight grouped,
deflated, in base64; mitsuba_ref/report/page/arrays.js decodes them.
"""

import base64
import zlib
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from caster.aovs import Aovs
from caster.image.image_files import encode_image
from caster.image.previews import aov_view
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.classification import CLASS_CODE, Judge, Judgement
from mitsuba_ref.judge.diagnosis import sentence_by_row
from mitsuba_ref.judge.explanations import ALIKE_REASONS, format_exact, reason
from mitsuba_ref.judge.pipeline import Seen
from mitsuba_ref.judge.verdict import AGREE, CLASSES, FAILING, REFERENCE_WRONG, WRONG

Part = dict[str, Any]
Shape = tuple[int, int]  # height, width

# ---- arrays ----

ZLIB_LEVEL = 9  # takes a tenth of a second more than the default for a scene of 256 x 256 pixels


def packed(values: Array) -> Part:
    """Pack (n,) numbers, or (n, c) channel by channel, as {"type": "f4", "z": text}, without loss."""
    flat = np.ascontiguousarray(values.T, values.dtype.newbyteorder("<")).ravel()
    planes = flat.view(np.uint8).reshape(-1, flat.itemsize).T
    text = base64.b64encode(zlib.compress(planes.tobytes(), ZLIB_LEVEL)).decode("ascii")
    return {"type": f"{values.dtype.kind}{values.itemsize}", "z": text}


def numbered(texts: Iterable[str]) -> Part:
    """{"texts": distinct texts, "words": the number of each text among them}."""
    numbers: dict[str, int] = {}
    words = [numbers.setdefault(text, len(numbers)) for text in texts]
    return {"words": packed(np.array(words, np.int32)), "texts": list(numbers)}


# ---- images, rounded ----

STEPS = 255  # of the range of an image, between the quantiles MOST
MOST = (0.01, 0.99)
LARGEST_CODE = 1 << 28  # of a number; beyond it, NaN and infinities
NAN_CODE, INF_CODE = LARGEST_CODE + 1, LARGEST_CODE + 2
STEPS_AN_OCTAVE = 2  # of shares of bounds; of errors one
LEAST_SHARE = 4  # octaves below 1: smaller shares of a bound are 0
ENTIRE = LEAST_SHARE * STEPS_AN_OCTAVE  # the code of a share of 1
NO_BOUND = 255  # the code of an infinite share
SMALLEST = 2.0**-1074  # float64 above 0
LEAST_ERROR = 5  # octaves below the 99th percentile: smaller errors are 0


CODES = {  # for the page
    "largest": LARGEST_CODE,
    "nan": NAN_CODE,
    "entire": ENTIRE,
    "octaves": LEAST_SHARE,
    "none": NO_BOUND,
}


def image(codes: Array, shape: Shape, *, smooth: bool = True) -> Part:
    """Pack (n,) or (n, c) integers, folded to be >= 0. smooth: as their differences from the plane through three
    neighbours, which are small in a smooth image and large in noise."""
    planes = codes.reshape(*shape, -1).astype(np.int64)
    if smooth:
        planes = np.diff(np.diff(planes, axis=0, prepend=0), axis=1, prepend=0)
    folded = ((planes << 1) ^ (planes >> 63)).reshape(len(codes), -1)
    about = {"height": shape[0], "width": shape[1], "plane": int(smooth)}
    return packed(folded.astype(np.min_scalar_type(folded.max(initial=0)))) | about


def value_codes(values: Array, steps: Array) -> Array:
    """(n, c) multiples of a step, one a channel."""
    with np.errstate(invalid="ignore", over="ignore"):
        most = np.where(np.isinf(values), INF_CODE, LARGEST_CODE)
        codes = np.clip(np.round(values / steps), -most, most)
    return np.where(np.isnan(values), NAN_CODE, codes).astype(np.int64)


def value_steps(values: Array) -> Array:
    """(c,) the steps of the channels of (n, c) values: a 255th of the range of most of them."""
    known = values[np.isfinite(values).all(axis=1)]
    low, high = np.quantile(known / STEPS, MOST, axis=0) if len(known) else np.zeros((2, values.shape[1]))
    steps = np.where(high > low, high - low, np.abs(high))
    return np.where(steps > 0.0, steps, 1.0)


def share_codes(shares: Array) -> Array:
    """(n,) codes of shares of bounds, rounded up: a share of 1 is ENTIRE, and more than 1 is more."""
    with np.errstate(divide="ignore", invalid="ignore"):
        codes = np.ceil(STEPS_AN_OCTAVE * (np.log2(shares) + LEAST_SHARE))
    codes = np.where(shares > 1.0, np.maximum(codes, ENTIRE + 1), codes)  # whose logarithm may round to 0
    return np.where(np.isfinite(shares), np.clip(codes, 0, NO_BOUND - 1), NO_BOUND).astype(np.uint8)


def error_codes(apart: Array) -> tuple[float, Array]:
    """(unit, (n,) codes) of the largest of each row of (n, c) differences, with its sign; the code of a unit is 1."""
    finite = np.where(np.isfinite(apart), apart, 0.0)
    error = finite[np.arange(len(finite)), np.argmax(np.abs(finite), axis=1)]
    some = np.abs(error[error != 0.0])
    unit = max(float(np.quantile(some, MOST[1])) * 2.0**-LEAST_ERROR, SMALLEST) if len(some) else 1.0
    with np.errstate(divide="ignore"):
        codes = np.maximum(np.round(np.log2(np.abs(error)) - np.log2(unit)) + 1.0, 0.0)
    return unit, (np.sign(error) * codes).astype(np.int64)


# ---- the record ----

MAX_PIXELS_WITH_REASON = 1 << 16  # of a scene, failing ones first: half a second of work
MAX_AGREEING_WITHOUT_LOSS, MAX_OTHERS_WITHOUT_LOSS = 128, 4096  # 0.2 kB each
WORST_WITHOUT_LOSS = 32
UNLISTED_CODE = len(CLASSES)  # a class of the page: the reference is wrong in no known way, which fails
SIDES = ("ours", "reference", "ratio")
FLOAT_LAYERS = ("depth", "normal", "diffuse", "shading_normal", "position", "uv")


class SceneRecord(NamedTuple):
    """The data of one scene on its page, beside its verdict: JSON except for the thumbnail."""

    about: Part
    layers: dict[str, Part]
    thumbnail: str  # PNG as a data URI


def scene_record(seen: Seen) -> SceneRecord:
    """The record of a judged scene."""
    judge, judgement = seen.judge, seen.judgement
    ours, reference = judge.subject, judge.pair.reference
    classes, shape = _classes(judgement), judge.shape
    hit = ours.hit.ravel() + 2 * reference.hit.ravel()
    others = [name for name in judgement.ratios if name not in FLOAT_LAYERS]
    rows, exact = rows_without_loss(seen, classes, hit), judgement.exact.answers
    about = {
        "window": list(judge.scene.film.window),
        "shapes": list(judge.scene.shape_names()),
        "class": image(classes, shape),
        "hit": image(hit, shape),
        "rows": packed(rows),
        "reasons": _reasons(seen, classes),
        "exact": {  # of each adjudicated pixel; t is inf on a miss, and NaN without an answer
            "rows": packed(judgement.exact.rows.astype(np.int32)),
            "t": packed(np.array([np.nan if each is None else each.distance for each in exact], np.float64)),
            **numbered(format_exact(judge.scene, judge.model.packed, each, with_t=False) for each in exact),
        },
        "shares": {name: image(share_codes(judgement.ratios[name]), shape, smooth=False) for name in others},
        "wrong_rays": [ray.what for ray in seen.wrong_rays],
    }
    layers: dict[str, Part] = {"ids": _ids(judge, rows)}
    for name in FLOAT_LAYERS:
        if name in ours and name in reference:
            ratio, sides = judgement.ratios[name], [aov_rows(each, name) for each in (ours, reference)]
            layers[name] = _images(hit, shape, *(each.reshape(len(hit), -1) for each in sides)) | {
                "ratio": image(share_codes(ratio), shape, smooth=False),
                "exact": dict(zip(SIDES, (packed(each[rows]) for each in (*sides, ratio)), strict=True)),
            }
    if "normal" in layers and layers["normal"] == layers.get("shading_normal"):
        layers["shading_normal"] = {"same": "normal"}
    return SceneRecord(about, layers, thumbnail(ours))


def rows_without_loss(seen: Seen, classes: Array, hit: Array) -> Array:
    """(m,) pixels whose numbers are stored without loss: the first of each cause, the worst of all, and some all over
    the image, of those that agree and of those that do not."""
    worst = np.max([*seen.judgement.ratios.values()], axis=0)
    chosen = [*(cause.rows[:1] for cause in seen.diagnosis), np.argsort(-worst, kind="stable")[:WORST_WITHOUT_LOSS]]
    agree = classes == CLASS_CODE[AGREE]
    for among, most in ((agree & (hit > 0), MAX_AGREEING_WITHOUT_LOSS), (~agree, MAX_OTHERS_WITHOUT_LOSS)):
        rows = np.flatnonzero(among)
        chosen.append(rows[:: max(1, -(-len(rows) // most))])
    return np.unique(np.concatenate(chosen).astype(np.int32))


def _classes(judgement: Judgement) -> Array:
    """(n,) uint8 class of each pixel; UNLISTED_CODE where the reference is wrong in no known way.

    Pixels with the symptom of wrong ones, which were not adjudicated, are wrong here.
    """
    found = judgement.classes.astype(np.uint8)
    found[judgement.not_adjudicated] = CLASS_CODE[WRONG]
    unlisted = [row for row, case in judgement.cases.items() if case is None]
    found[unlisted] = np.where(found[unlisted] == CLASS_CODE[REFERENCE_WRONG], UNLISTED_CODE, found[unlisted])
    return found


def _reasons(seen: Seen, classes: Array) -> Part:
    """The reason for the class of each pixel that does not agree, failing ones first."""
    judge, judgement, by_row = seen.judge, seen.judgement, sentence_by_row(seen.diagnosis)
    rows = np.flatnonzero(classes != CLASS_CODE[AGREE])
    fails = (judgement.is_class(*FAILING) | (classes == UNLISTED_CODE))[rows]
    explained = rows[np.argsort(~fails, kind="stable")][:MAX_PIXELS_WITH_REASON]
    return {
        "rows": packed(explained.astype(np.int32)),
        **numbered(reason(judge, judgement, by_row, int(row)) for row in explained),
        "always": {CLASSES.index(name): text for name, text in ALIKE_REASONS.items()},
    }


def _images(hit: Array, shape: Shape, ours: Array, reference: Array) -> Part:
    """Both sides, (n, c), as images, and the difference where both hit. hit: bit 1 for ours, 2 for the reference."""
    steps = value_steps(reference[hit > 1] if (hit > 1).any() else ours)
    theirs, mine = (value_codes(each, steps) * (hit & bit > 0)[:, None] for bit, each in ((2, reference), (1, ours)))
    with np.errstate(invalid="ignore", over="ignore"):
        unit, errors = error_codes(np.where((hit == 3)[:, None], ours - reference, 0.0))
    return {
        "steps": steps.tolist(),
        "reference": image(theirs, shape),
        "ours": image(mine - theirs, shape),
        "unit": unit,
        "difference": image(errors, shape, smooth=False),
    }


def _ids(judge: Judge, rows: Array) -> Part:
    """Numbers of shapes, and of primitives within them, -1 on a miss; of a candidate that names none, some of its t."""
    reference, index = judge.pair.reference, judge.model.packed.index_in_shape
    if judge.names_prims:
        numbers = {
            "shape_reference": aov_rows(reference, "shape_id"),
            "shape_ours": aov_rows(judge.subject, "shape_id"),
            "prim_reference": np.where(reference.hit.ravel(), judge.result.answer.prim.astype(np.int64), -1),
            "prim_ours": index(judge.subject_prim),
        }
        t = {}
    else:
        numbers = {"shape_reference": judge.result.shape_id, "prim_reference": index(judge.reference_prim)}
        # in lengths of d, which depth does not show
        t = {"exact": {"t_ours": packed(judge.answer.t[rows]), "t_reference": packed(judge.result.t[rows])}}
    return {name: image(each, judge.shape) for name, each in numbers.items()} | t


# ---- thumbnails ----

MAX_WIDTH, MAX_HEIGHT = 96, 72  # pixels: shown at half of that, sharp on a screen of twice the density
COLOR_BITS = 5  # of a channel: such a PNG is half as large as one with all colours


def thumbnail(aovs: Aovs) -> str:
    """A small image as a data URI: diffuse, normals if that is dark or missing, else depth."""
    from PIL import Image, ImageOps

    lit = "diffuse" in aovs and aovs["diffuse"].any()
    name = "diffuse" if lit else next((each for each in ("normal", "depth") if each in aovs), "hit")
    image = Image.fromarray(aov_view(name, aovs.hit if name == "hit" else aovs[name], aovs.hit).pixels)
    step = max(1, -(-image.width // MAX_WIDTH), -(-image.height // MAX_HEIGHT))
    small = ImageOps.posterize(image.reduce(step), COLOR_BITS)
    return "data:image/png;base64," + base64.b64encode(encode_image(np.asarray(small), "PNG")).decode("ascii")

"""The data of one scene on the report's page, in parts: verdict, findings of each pixel, and both images.

Arrays are text: bytes of equal weight grouped, deflated, in base64; lossless. mitsuba_ref/report/page/arrays.js
decodes them.
"""

import base64
import zlib
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from caster.aovs import Aovs
from caster.image.image_files import encode_image
from caster.image.previews import aov_view
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.classification import CLASS_CODE
from mitsuba_ref.judge.explanations import format_exact
from mitsuba_ref.judge.verdict import AGREE, CLASSES, FAILING, REFERENCE_WRONG
from mitsuba_ref.report.evidence import Evidence

Packed = dict[str, Any]  # {"type": "f4", "z": text}, and "delta" or "xor" for the step before

ZLIB_LEVEL = 4  # takes 0.6 of the time of the default 6, for 1.02 of the size
DROPPED_MANTISSA_BITS = 12  # of a float32 by `coarse`: a resolution of one part in 2^11 remains


def packed(values: np.ndarray, like: np.ndarray | None = None) -> Packed:
    """Pack (n,) numbers, or (n, c) channel by channel.

    like: nearly equal floats of the same shape, whose bits are XORed with these.
    """
    values = _in_a_row(values)
    bits = values.view(f"<u{values.itemsize}")
    if like is not None:  # 0 for NaN, whose bits a conversion may change
        numbers = np.where(np.isnan(like), 0.0, like).astype(values.dtype)
        return {"type": _type(values), "xor": 1, "z": _deflated(bits ^ _in_a_row(numbers).view(bits.dtype))}
    plain, delta = _deflated(bits), _deflated(np.diff(bits, prepend=bits.dtype.type(0)))
    if len(delta) < len(plain):
        return {"type": _type(values), "delta": 1, "z": delta}
    return {"type": _type(values), "z": plain}


def narrowest(values: np.ndarray) -> np.ndarray:
    """As float32 if that loses nothing, else unchanged."""
    single = rounded(values)
    return single if np.array_equal(single, values, equal_nan=True) else values


def rounded(values: np.ndarray) -> np.ndarray:
    """As float32; inf beyond its range."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def coarse(values: np.ndarray) -> np.ndarray:
    """Round shares and bounds, >= 0, up to float32 with 11 bits; NaN becomes inf.

    1 stays 1, and more than 1 stays more than 1.
    """
    single = rounded(np.where(np.isnan(values), np.inf, values))
    single = np.where(single < values, np.nextafter(single, np.float32(np.inf)), single)
    step = np.uint32((1 << DROPPED_MANTISSA_BITS) - 1)
    return ((single.view(np.uint32) + step) & ~step).view(np.float32)


def _in_a_row(values: np.ndarray) -> np.ndarray:
    """Flat array of the channels one after another, little-endian."""
    return np.ascontiguousarray(values.T, values.dtype.newbyteorder("<")).ravel()


def _type(values: np.ndarray) -> str:
    return f"{values.dtype.kind}{values.itemsize}"


def _deflated(bits: np.ndarray) -> str:
    planes = np.ascontiguousarray(bits).view(np.uint8).reshape(-1, bits.itemsize).T
    return base64.b64encode(zlib.compress(planes.tobytes(), ZLIB_LEVEL)).decode("ascii")


# ---- thumbnails ----

MAX_WIDTH, MAX_HEIGHT = 96, 72  # pixels: shown at half of that, sharp on a screen of twice the density
COLOR_STEP = 8  # of a colour: such a PNG is half as large as one with all colours


def thumbnail(aovs: Aovs) -> str:
    """A small image as a data URI: diffuse, normals if that is dark or missing, else depth."""
    lit = "diffuse" in aovs and aovs["diffuse"].any()
    name = "diffuse" if lit else next((each for each in ("normal", "depth") if each in aovs), "hit")
    pixels = aov_view(name, aovs.hit if name == "hit" else aovs[name], aovs.hit).pixels
    height, width, _ = pixels.shape
    step = max(1, -(-width // MAX_WIDTH), -(-height // MAX_HEIGHT))  # blocks of pixels become their mean
    padded = np.pad(pixels, ((0, -height % step), (0, -width % step), (0, 0)), mode="edge")
    blocks = padded.reshape(padded.shape[0] // step, step, padded.shape[1] // step, step, 3)
    small = np.minimum(COLOR_STEP * np.round(blocks.mean(axis=(1, 3)) / COLOR_STEP), 255.0).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(encode_image(small, "PNG")).decode("ascii")


MAX_PIXELS_WITH_REASON = 1 << 16  # of a scene, failing ones first: half a second of work


def numbered(texts: Iterable[str]) -> dict[str, Any]:
    """{"texts": distinct texts, "words": the number of each text among them}."""
    numbers: dict[str, int] = {}
    words = [numbers.setdefault(text, len(numbers)) for text in texts]
    return {"words": packed(np.array(words, np.int32)), "texts": list(numbers)}


def reasons(evidence: Evidence) -> dict[str, Any]:
    """Rows of pixels that are not in class `agree`, failing ones first, with a reason for each."""
    judgement = evidence.judgement
    rows = np.flatnonzero(judgement.classes != CLASS_CODE[AGREE])
    unlisted = np.array([judgement.cases.get(int(row), 0) is None for row in rows], bool)
    fails = judgement.is_class(*FAILING)[rows] | unlisted
    explained = rows[np.argsort(~fails, kind="stable")][:MAX_PIXELS_WITH_REASON]
    return {
        "rows": packed(explained.astype(np.int32)),
        **numbered(evidence.why(int(row)) for row in explained),
        "always": {CLASSES.index(name): text for name, text in evidence.always.items()},
    }


def exact_answers(evidence: Evidence) -> dict[str, Any]:
    """The exact answer of each adjudicated pixel."""
    exact = evidence.judgement.exact
    none = {False: np.inf, True: np.nan}  # by whether there is no answer at all
    t = [float(each.t) if each is not None and each.t is not None else none[each is None] for each in exact.answers]
    return {
        "rows": packed(exact.rows.astype(np.int32)),
        "t": packed(np.array(t, np.float64)),
        "share": packed(coarse(exact.ratio)),
        **numbered(format_exact(evidence.scene, evidence.packed, answer, with_t=False) for answer in exact.answers),
    }


UNLISTED_CODE = len(CLASSES)  # a class of the page: the reference is wrong in no known way, which fails

FLOAT_LAYERS = ("depth", "normal", "diffuse", "shading_normal", "position", "uv")


class SceneRecord(NamedTuple):
    """The data of one scene on its page, beside its verdict: JSON except for the thumbnail."""

    about: dict[str, Any]
    layers: dict[str, dict[str, Any]]
    thumbnail: str  # PNG as a data URI


def scene_record(evidence: Evidence) -> SceneRecord:
    """The record of a judged scene."""
    hit, judgement = evidence.ours.hit.ravel() + 2 * evidence.reference.hit.ravel(), evidence.judgement
    others = [name for name in judgement.names if name not in FLOAT_LAYERS]
    about = {
        "window": list(evidence.scene.film.window),
        "shapes": list(evidence.scene.shape_names()),
        "class": packed(classes(evidence)),
        "hit": packed(hit.astype(np.uint8)),
        "reasons": reasons(evidence),
        "exact": exact_answers(evidence),
        "shares": {name: packed(coarse(judgement.ratio(name))) for name in others},
    }
    return SceneRecord(about, dict(layers(evidence)), thumbnail(evidence.ours))


def classes(evidence: Evidence) -> np.ndarray:
    """(n,) uint8 class of each pixel; UNLISTED_CODE where the reference is wrong in no known way."""
    found = evidence.judgement.classes.astype(np.uint8)
    unlisted = [row for row, case in evidence.judgement.cases.items() if case is None]
    found[unlisted] = np.where(found[unlisted] == CLASS_CODE[REFERENCE_WRONG], UNLISTED_CODE, found[unlisted])
    return found


def layers(evidence: Evidence) -> Iterator[tuple[str, dict[str, Any]]]:
    """The layers whose AOVs both sides have."""
    judgement = evidence.judgement
    yield "ids", ids(evidence)
    worst = np.max([judgement.ratio(name) for name in judgement.names], axis=0)
    yield "ratio", {"ratio": packed(coarse(worst))}
    sides = evidence.ours, evidence.reference
    for name in FLOAT_LAYERS:
        if all(name in each for each in sides):
            yield name, values(*(aov_rows(each, name) for each in sides)) | bounds(evidence, name)
    edges = evidence.edges()
    if edges is not None:
        yield "edges", {"segments": packed(edges)}


def values(ours: np.ndarray, reference: np.ndarray) -> dict[str, Any]:
    """Both sides; ours is XORed with the reference."""
    return {"reference": packed(narrowest(reference)), "ours": packed(ours, narrowest(reference))}


def bounds(evidence: Evidence, name: str) -> dict[str, Any]:
    """Encoded error-to-bound ratios of the check `name`, and its bounds where it has any."""
    bound = evidence.bound(name)
    found = {"ratio": packed(coarse(evidence.judgement.ratio(name)))}
    if bound.between is not None:
        found["bound"] = packed(coarse(bound.between))
    if bound.alone is not None:
        found["alone"] = packed(bound.alone.astype(np.uint8))
    if bound.own is not None:
        found["own"] = packed(coarse(bound.own))
    return found


def ids(evidence: Evidence) -> dict[str, Any]:
    """Shapes and primitives of both sides, -1 on a miss; and t, if depth does not show it."""
    found = {name: packed(numbers.astype(np.int32)) for name, numbers in evidence.ids().items()}
    t = evidence.t()
    sides = {} if t is None else values(*t)
    return found | {f"t_{side}": each for side, each in sides.items()}

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
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.classification import CLASS_CODE
from mitsuba_ref.judge.explanations import format_exact
from mitsuba_ref.judge.verdict import AGREE, CLASSES, FAILING, REFERENCE_WRONG
from mitsuba_ref.oracle.oracle import ExactAnswer
from mitsuba_ref.report.evidence import Evidence

Packed = dict[str, Any]  # {"type": "f4", "z": text}, and "delta" or "xor" for the step before

ZLIB_LEVEL = 4  # takes 0.6 of the time of the default 6, for 1.02 of the size
DROPPED_MANTISSA_BITS = 12  # of a float32 by `coarse`: a resolution of one part in 2^11 remains


def packed(values: np.ndarray, like: np.ndarray | None = None) -> Packed:
    """(n,) numbers or (n, c), whose channels follow one another.

    like: nearly equal floats of the same shape, with whose bits these are XORed.
    """
    values = _in_a_row(values)
    bits = values.view(f"<u{values.itemsize}")
    if like is not None:
        return {"type": _type(values), "xor": 1, "z": _deflated(bits ^ base_bits(_in_a_row(like), values.dtype))}
    plain, delta = _deflated(bits), _deflated(np.diff(bits, prepend=bits.dtype.type(0)))
    if len(delta) < len(plain):
        return {"type": _type(values), "delta": 1, "z": delta}
    return {"type": _type(values), "z": plain}


def base_bits(like: np.ndarray, dtype: np.dtype[Any]) -> np.ndarray:
    """Bits of the same numbers in this type; 0 for NaN, whose bits a conversion may change."""
    numbers = np.where(np.isnan(like), 0.0, like).astype(dtype)
    return numbers.view(f"<u{dtype.itemsize}")


def narrowest(values: np.ndarray) -> np.ndarray:
    """The same numbers as float32, if each is one, else as they are."""
    single = rounded(values)
    return single if np.array_equal(single, values, equal_nan=True) else values


def rounded(values: np.ndarray) -> np.ndarray:
    """As float32, inf where it holds no such number."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def coarse(values: np.ndarray) -> np.ndarray:
    """Shares and bounds, >= 0, as float32 of a few digits: up to 2^-11 more than they are, never less; NaN as inf.

    1 stays 1, and what is more than 1 stays more.
    """
    single = rounded(np.where(np.isnan(values), np.inf, values))
    single = np.where(single < values, np.nextafter(single, np.float32(np.inf)), single)
    step = np.uint32((1 << DROPPED_MANTISSA_BITS) - 1)
    return ((single.view(np.uint32) + step) & ~step).view(np.float32)


def _in_a_row(values: np.ndarray) -> np.ndarray:
    """Channel after channel, little-endian."""
    return np.ascontiguousarray(values.T, values.dtype.newbyteorder("<")).ravel()


def _type(values: np.ndarray) -> str:
    return f"{values.dtype.kind}{values.itemsize}"


def _deflated(bits: np.ndarray) -> str:
    planes = np.ascontiguousarray(bits).view(np.uint8).reshape(-1, bits.itemsize).T
    return base64.b64encode(zlib.compress(planes.tobytes(), ZLIB_LEVEL)).decode("ascii")


# ---- thumbnails ----

MAX_WIDTH, MAX_HEIGHT = 96, 72  # pixels: shown at half of that, sharp on a screen of twice the density
COLOR_LEVELS = 32  # of each colour: such a PNG is half as large as one of 256
BACKGROUND = (40, 44, 52)


def thumbnail(aovs: Aovs) -> str:
    """A small image as a data URI: diffuse, normals if that is dark or missing, else depth."""
    image = _shades(aovs)
    small = _halved(np.where(aovs.hit[..., None], image, np.array(BACKGROUND) / 255.0))
    levels = np.round(np.round(small * (COLOR_LEVELS - 1)) * (255 / (COLOR_LEVELS - 1))).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(encode_image(levels, "PNG")).decode("ascii")


def _shades(aovs: Aovs) -> np.ndarray:
    """(h, w, 3) from 0 to 1."""
    if "diffuse" in aovs and aovs.hit.any():
        shown = np.nan_to_num(aovs["diffuse"], nan=0.0, posinf=0.0, neginf=0.0)
        brightest = float(np.quantile(shown[aovs.hit].max(axis=-1), 0.98))
        if brightest > 0.0:
            bright: np.ndarray = np.clip(shown / brightest, 0.0, 1.0) ** (1.0 / 2.2)
            return bright
    if "normal" in aovs:
        turned: np.ndarray = np.clip(0.5 + 0.5 * np.nan_to_num(aovs["normal"]), 0.0, 1.0)
        return turned
    return _depth_as_gray(aovs)


def _depth_as_gray(aovs: Aovs) -> np.ndarray:
    """Depth as gray, near is light."""
    depth = aovs["depth"]
    finite = depth[np.isfinite(depth)]
    near, far = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
    with np.errstate(invalid="ignore"):
        gray = np.nan_to_num(1.0 - 0.85 * (depth - near) / (far - near or 1.0), nan=0.0)
    return np.repeat(np.clip(gray, 0.0, 1.0)[..., None], 3, axis=-1)


def _halved(image: np.ndarray) -> np.ndarray:
    """Means of blocks of pixels, as large as needed to fit."""
    height, width, _ = image.shape
    step = max(1, -(-width // MAX_WIDTH), -(-height // MAX_HEIGHT))
    padded = np.pad(image, ((0, -height % step), (0, -width % step), (0, 0)), mode="edge")
    tall, wide = padded.shape[0] // step, padded.shape[1] // step
    mean: np.ndarray = padded.reshape(tall, step, wide, step, 3).mean(axis=(1, 3))
    return mean


MAX_PIXELS_WITH_REASON = 1 << 16  # of a scene, failing ones first: half a second of work


class TextTable:
    """Distinct texts, numbered."""

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}

    def number(self, text: str) -> int:
        return self.numbers.setdefault(text, len(self.numbers))

    def numbers_of(self, texts: Iterable[str]) -> np.ndarray:
        return np.array([self.number(text) for text in texts], np.int32)


def reasons(evidence: Evidence) -> dict[str, Any]:
    """Rows of pixels that are not in class `agree`, failing ones first, with a reason for each."""
    judgement = evidence.judgement
    rows = np.flatnonzero(judgement.classes != CLASS_CODE[AGREE])
    unlisted = np.array([judgement.cases.get(int(row), 0) is None for row in rows], bool)
    fails = judgement.is_class(*FAILING)[rows] | unlisted
    rows = rows[np.argsort(~fails, kind="stable")]
    explained, texts = rows[:MAX_PIXELS_WITH_REASON], TextTable()
    why = texts.numbers_of(evidence.why(int(row)) for row in explained)
    return {
        "rows": packed(explained.astype(np.int32)),
        "why": packed(why),
        "texts": list(texts.numbers),
        "always": {CLASSES.index(name): text for name, text in evidence.always.items()},
        "left_out": len(rows) - len(explained),
    }


def exact_answers(evidence: Evidence) -> dict[str, Any]:
    """The exact answer of each adjudicated pixel."""
    exact = evidence.judgement.exact
    texts = TextTable()
    words = texts.numbers_of(_answer_text(evidence, answer) for answer in exact.answers)
    return {
        "rows": packed(exact.rows.astype(np.int32)),
        "t": packed(np.array([_exact_t(answer) for answer in exact.answers], np.float64)),
        "share": packed(coarse(exact.ratio)),
        "words": packed(words),
        "texts": list(texts.numbers),
        "adjudicated": len(exact.rows),
    }


def _answer_text(evidence: Evidence, answer: ExactAnswer | None) -> str:
    return format_exact(evidence.scene, evidence.packed, answer, with_t=False)


def _exact_t(answer: ExactAnswer | None) -> float:
    """inf on a miss, NaN without an answer."""
    if answer is None:
        return np.nan
    return np.inf if answer.t is None else float(answer.t)


UNLISTED_CODE = len(CLASSES)  # a class of the page: the reference is wrong in no known way, which fails

FLOAT_LAYERS = ("depth", "normal", "diffuse", "shading_normal", "position", "uv")


class SceneRecord(NamedTuple):
    """What a page shows of one scene beside its verdict. All but the thumbnail can be written as JSON."""

    about: dict[str, Any]
    layers: dict[str, dict[str, Any]]
    thumbnail: str  # PNG as a data URI


def scene_record(evidence: Evidence, *, exact: bool) -> SceneRecord:
    """exact: both images to the bit and every bound; otherwise as float32, a third of the size."""
    hit = evidence.ours.hit.ravel() + 2 * evidence.reference.hit.ravel()
    about = {
        "window": list(evidence.scene.film.window),
        "shapes": list(evidence.scene.shape_names()),
        "exactly": exact,
        "class": packed(classes(evidence)),
        "hit": packed(hit.astype(np.uint8)),
        "reasons": reasons(evidence),
        "exact": exact_answers(evidence),
    }
    if exact:
        judgement = evidence.judgement
        others = [name for name in judgement.names if name not in FLOAT_LAYERS]
        about["shares"] = {name: packed(coarse(judgement.ratio(name))) for name in others}
    return SceneRecord(about, dict(layers(evidence, exact=exact)), thumbnail(evidence.ours))


def classes(evidence: Evidence) -> np.ndarray:
    """(n,) uint8 class of each pixel, UNLISTED_CODE among them."""
    found = evidence.judgement.classes.astype(np.uint8)
    unlisted = [row for row, case in evidence.judgement.cases.items() if case is None]
    found[unlisted] = np.where(found[unlisted] == CLASS_CODE[REFERENCE_WRONG], UNLISTED_CODE, found[unlisted])
    return found


def layers(evidence: Evidence, *, exact: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """The available layers: an AOV may be missing on either side."""
    judgement = evidence.judgement
    yield "ids", ids(evidence, exact=exact)
    worst = np.max([judgement.ratio(name) for name in judgement.names], axis=0)
    yield "ratio", {"ratio": packed(coarse(worst))}
    for name in FLOAT_LAYERS:
        if name in evidence.ours and name in evidence.reference:
            sides = values(aov_rows(evidence.ours, name), aov_rows(evidence.reference, name), exact=exact)
            yield name, sides | (bounds(evidence, name) if exact else {})
    edges = evidence.edges()
    if edges is not None:
        yield "edges", {"segments": packed(edges)}


def values(ours: np.ndarray, reference: np.ndarray, *, exact: bool) -> dict[str, Any]:
    """Both sides, ours as the XOR of the bits."""
    if exact:
        return {"reference": packed(narrowest(reference)), "ours": packed(ours, narrowest(reference))}
    return {"reference": packed(rounded(reference)), "ours": packed(rounded(ours), rounded(reference))}


def bounds(evidence: Evidence, name: str) -> dict[str, Any]:
    """Error over bound of the check of this name, and that bound, if there is one."""
    bound = evidence.bound(name)
    found = {"ratio": packed(coarse(evidence.judgement.ratio(name)))}
    if bound.between is not None:
        found["bound"] = packed(coarse(bound.between))
    if bound.alone is not None:
        found["alone"] = packed(bound.alone.astype(np.uint8))
    if bound.own is not None:
        found["own"] = packed(coarse(bound.own))
    return found


def ids(evidence: Evidence, *, exact: bool) -> dict[str, Any]:
    """Shape, and primitive within it, of both sides, -1 on a miss; and t, where depth does not determine it."""
    found = {name: packed(numbers.astype(np.int32)) for name, numbers in evidence.ids().items()}
    t = evidence.t()
    sides = {} if t is None else values(*t, exact=exact)
    return found | {f"t_{side}": each for side, each in sides.items()}

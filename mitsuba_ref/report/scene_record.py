"""The data of one scene on the report's page, in parts: verdict, findings of each pixel, and both images.

Arrays are text: bytes of equal weight grouped, deflated, in base64; lossless. mitsuba_ref/report/page/arrays.js
decodes them.
"""

import base64
import zlib
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from caster.aovs import Aovs
from caster.image.image_files import encode_image
from caster.image.previews import aov_view
from mitsuba_ref.error_model.bounds import aov_rows, error_over_bound
from mitsuba_ref.judge.classification import CLASS_CODE, Judge, Judgement
from mitsuba_ref.judge.explanations import constant_reasons, format_exact, reason
from mitsuba_ref.judge.pipeline import Seen
from mitsuba_ref.judge.verdict import AGREE, CLASSES, FAILING, REFERENCE_WRONG
from mitsuba_ref.report.evidence import film_edges

Part = dict[str, Any]

# ---- arrays ----

ZLIB_LEVEL = 4  # takes 0.6 of the time of the default 6, for 1.02 of the size
DROPPED_MANTISSA_BITS = 12  # of a float32 by `coarse`: a resolution of one part in 2^11 remains


def packed(values: np.ndarray, like: np.ndarray | None = None) -> Part:
    """Pack (n,) numbers, or (n, c) channel by channel, as {"type": "f4", "z": text}.

    "xor": 1 if the bits are XORed with those of `like`, nearly equal floats of the same shape; "delta": 1 if they are
    differences from the number before.
    """
    found = {"type": f"{values.dtype.kind}{values.itemsize}"}
    bits = _bits(values)
    if like is not None:  # 0 for NaN, whose bits a conversion may change
        base = np.where(np.isnan(like), 0.0, like).astype(values.dtype)
        return found | {"xor": 1, "z": _deflated(bits ^ _bits(base))}
    plain, delta = _deflated(bits), _deflated(np.diff(bits, prepend=bits.dtype.type(0)))
    return found | ({"delta": 1, "z": delta} if len(delta) < len(plain) else {"z": plain})


def _bits(values: np.ndarray) -> np.ndarray:
    """The bits of the channels, one after another, as little-endian integers."""
    flat = np.ascontiguousarray(values.T, values.dtype.newbyteorder("<")).ravel()
    return flat.view(f"<u{flat.itemsize}")


def _deflated(bits: np.ndarray) -> str:
    planes = np.ascontiguousarray(bits).view(np.uint8).reshape(-1, bits.itemsize).T
    return base64.b64encode(zlib.compress(planes.tobytes(), ZLIB_LEVEL)).decode("ascii")


def narrowest(values: np.ndarray) -> np.ndarray:
    """As float32 if that loses nothing, else unchanged."""
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    return single if np.array_equal(single, values, equal_nan=True) else values


def coarse(values: np.ndarray) -> np.ndarray:
    """Round ratios and bounds, >= 0, up to float32 with 11 bits; NaN becomes inf.

    1 stays 1, and more than 1 stays more than 1.
    """
    with np.errstate(over="ignore"):
        single = np.where(np.isnan(values), np.inf, values).astype(np.float32)
    single = np.where(single < values, np.nextafter(single, np.float32(np.inf)), single)
    step = np.uint32((1 << DROPPED_MANTISSA_BITS) - 1)
    return ((single.view(np.uint32) + step) & ~step).view(np.float32)


def numbered(texts: Iterable[str]) -> Part:
    """{"texts": distinct texts, "words": the number of each text among them}."""
    numbers: dict[str, int] = {}
    words = [numbers.setdefault(text, len(numbers)) for text in texts]
    return {"words": packed(np.array(words, np.int32)), "texts": list(numbers)}


# ---- the record ----

MAX_PIXELS_WITH_REASON = 1 << 16  # of a scene, failing ones first: half a second of work
UNLISTED_CODE = len(CLASSES)  # a class of the page: the reference is wrong in no known way, which fails
FLOAT_LAYERS = ("depth", "normal", "diffuse", "shading_normal", "position", "uv")
ROUNDING = 1.0 + 4 * 2.0**-53  # a ratio that is computed in two ways is the same up to 4 roundings


class SceneRecord(NamedTuple):
    """The data of one scene on its page, beside its verdict: JSON except for the thumbnail."""

    about: Part
    layers: dict[str, Part]
    thumbnail: str  # PNG as a data URI


def scene_record(seen: Seen) -> SceneRecord:
    """The record of a judged scene."""
    judge, judgement = seen.judge, seen.judgement
    ours, reference = judge.pair.subject, judge.pair.reference
    classes = _classes(judgement)
    hit = ours.hit.ravel() + 2 * reference.hit.ravel()
    others = [name for name in judgement.names if name not in FLOAT_LAYERS]
    about = {
        "window": list(judge.scene.film.window),
        "shapes": list(judge.scene.shape_names()),
        "class": packed(classes),
        "hit": packed(hit.astype(np.uint8)),
        "reasons": _reasons(seen, classes),
        "exact": _exact_answers(judge, judgement),
        "shares": {name: packed(coarse(judgement.ratio(name))) for name in others},
    }
    worst = np.max([judgement.ratio(name) for name in judgement.names], axis=0)
    layers: dict[str, Part] = {"ids": _ids(judge), "ratio": {"ratio": packed(coarse(worst))}}
    for name in FLOAT_LAYERS:
        if name in ours and name in reference:
            both = _both_sides(aov_rows(ours, name), aov_rows(reference, name))
            layers[name] = both | _bounds(judge, judgement, name)
    edges = film_edges(judge, judgement)
    if edges is not None:
        layers["edges"] = {"segments": packed(edges)}
    return SceneRecord(about, layers, thumbnail(ours))


def _classes(judgement: Judgement) -> np.ndarray:
    """(n,) uint8 class of each pixel; UNLISTED_CODE where the reference is wrong in no known way."""
    found = judgement.classes.astype(np.uint8)
    unlisted = [row for row, case in judgement.cases.items() if case is None]
    found[unlisted] = np.where(found[unlisted] == CLASS_CODE[REFERENCE_WRONG], UNLISTED_CODE, found[unlisted])
    return found


def _reasons(seen: Seen, classes: np.ndarray) -> Part:
    """The reason for the class of each pixel that does not agree, failing ones first."""
    judge, judgement, by_row = seen.judge, seen.judgement, seen.diagnosis.by_row()
    rows = np.flatnonzero(classes != CLASS_CODE[AGREE])
    fails = (judgement.is_class(*FAILING) | (classes == UNLISTED_CODE))[rows]
    explained = rows[np.argsort(~fails, kind="stable")][:MAX_PIXELS_WITH_REASON]
    return {
        "rows": packed(explained.astype(np.int32)),
        **numbered(reason(judge, judgement, by_row, int(row)) for row in explained),
        "always": {CLASSES.index(name): text for name, text in constant_reasons(judge).items()},
    }


def _exact_answers(judge: Judge, judgement: Judgement) -> Part:
    """The exact answer of each adjudicated pixel; t is inf on a miss, and NaN without an answer."""
    exact, packed_scene = judgement.exact, judge.model.packed
    t = [np.nan if each is None else np.inf if each.t is None else float(each.t) for each in exact.answers]
    return {
        "rows": packed(exact.rows.astype(np.int32)),
        "t": packed(np.array(t, np.float64)),
        "share": packed(coarse(exact.ratio)),
        **numbered(format_exact(judge.scene, packed_scene, answer, with_t=False) for answer in exact.answers),
    }


def _both_sides(ours: np.ndarray, reference: np.ndarray, prefix: str = "") -> Part:
    """Both sides; ours is XORed with the reference."""
    base = narrowest(reference)
    return {f"{prefix}reference": packed(base), f"{prefix}ours": packed(ours, base)}


def _bounds(judge: Judge, judgement: Judgement, name: str) -> Part:
    """The error-to-bound ratio of each pixel in one AOV, and its bounds; none for `diffuse`, which differ by light.

    "bound": on the difference between both sides; "alone": where the bound of the subject at its own surface decides
    instead; "own": of a candidate's arithmetic, on its distance from the surface of the reference.
    """
    pixels, ratio = judge.pixels, judgement.ratio(name)
    found = {"ratio": packed(coarse(ratio))}
    if not judge.names_prims:
        own = judge.bounds.own
        error = own.n_error if name == "normal" else (own.t_error + judge.answer.t_rounding) * pixels.length
        return found | {"own": packed(coarse(np.where(pixels.both_hit, error, 0.0)))}
    bound = pixels.allowed_distance.get(name)
    if bound is None:
        return found
    alone = pixels.both_hit & (ratio > error_over_bound(pixels.distance(name), bound) * ROUNDING)
    bound = np.where(pixels.both_hit, bound, 0.0)
    return found | {"bound": packed(coarse(bound)), "alone": packed(alone.astype(np.uint8))}


def _ids(judge: Judge) -> Part:
    """Numbers of shapes, and of primitives within them, -1 on a miss; of a candidate that names none, its t instead."""
    pair, index = judge.pair, judge.model.packed.index_in_shape
    if judge.names_prims:
        numbers = {
            "shape_reference": aov_rows(pair.reference, "shape_id"),
            "shape_ours": aov_rows(pair.subject, "shape_id"),
            "prim_reference": np.where(pair.reference.hit.ravel(), pair.result.answer.prim.astype(np.int64), -1),
            "prim_ours": index(pair.prim),
        }
        t = {}
    else:
        numbers = {"shape_reference": pair.result.shape_id, "prim_reference": index(judge.reference_prim)}
        t = _both_sides(judge.answer.t, judge.result.t, "t_")  # in lengths of d, which depth does not show
    return {name: packed(each.astype(np.int32)) for name, each in numbers.items()} | t


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

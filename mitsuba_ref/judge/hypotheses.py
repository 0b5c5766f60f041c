"""The table of mistakes: a name, a prediction of the answers of a caster that makes it, and a remedy for each.

A mistake only explains pixels that fail: it explains a wrong pixel if the subject answers as the mistake predicts.
Pixels that are right must not contradict it.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, partial
from itertools import chain, permutations, product
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Triangles
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import camera_axes
from mitsuba_ref.error_model.bounds import intersections_at, row_distance
from mitsuba_ref.error_model.bracket import RayIntersections
from mitsuba_ref.error_model.intersections import Array, Intersections, Rays, dot, norm, row_groups, unit
from mitsuba_ref.error_model.scene_model import OUR_SIDE
from mitsuba_ref.error_model.tolerances import (
    DISTINCT_RTOL,
    FIT_FACTOR,
    KU,
    KU_OURS,
    LARGEST_RESIDUAL,
    LARGEST_USEFUL_NORMAL_ERROR,
    LEAST_FLOAT32_ERROR,
    MAJORITY,
    MATCH_RTOL,
    MIN_FITTED_PIXELS,
    MORE_THAN_ROUNDING,
    NEARLY_ALL,
)
from mitsuba_ref.judge.adjudication import id_columns, sample_rows
from mitsuba_ref.judge.classification import Judge
from mitsuba_ref.reference.shared_input import described_model, pixel_centers
from mitsuba_ref.subjects.subject import FLOAT32, FLOAT64

FEW_PIXELS = 8  # of fewer, too many statements are true by chance
SCREENED_PIXELS = 96  # at which a claim about the whole image is tried first


class WrongPixels:
    """Rows of the image (m,) with the subject's answers and the exact ones there."""

    def __init__(self, judge: Judge, rows: Array, prim: Array, t: Array, at: Intersections):
        """prim, t: (m,) exact, -1 and inf on a miss; at: of these primitives, as the subject may see them."""
        self.judge, self.rows, self.prim, self.t, self.at = judge, rows, prim, t, at
        self.hit = prim >= 0
        self.o, self.d = judge.o[rows], judge.d[rows]
        self.given_hit, self.given_t = judge.hit[rows], judge.answer.t[rows]
        self.n = at.n if judge.n is None else judge.n[rows]  # the subject's
        self.t_rounding = np.broadcast_to(judge.answer.t_rounding, judge.answer.t.shape)[rows]

    def take(self, some: Array) -> "WrongPixels":
        """A subset, by mask or index."""
        return WrongPixels(self.judge, self.rows[some], self.prim[some], self.t[some], self.at.take(some))

    @cached_property
    def off(self) -> Array:
        """(m,) bool: hit, miss or t is wrong."""
        other = self.given_hit != self.hit
        if self.judge.answer.hits_only:
            return other
        wrong_t = ~(np.abs(self.given_t - self.t) <= self.at.t_error + self.t_rounding)
        return other | (self.given_hit & self.hit & wrong_t)

    def right_under(self, hit: Array, t: Array, bound: Array) -> Array:
        """(m,) bool: the subject's hit or miss and its t agree with a prediction, within FIT_FACTOR times the bound.

        A larger difference is accepted if it is at most a hundredth of the error and a ten-thousandth of t.
        """
        same: Array = self.given_hit == hit
        if self.judge.answer.hits_only:
            return same
        left = np.abs(self.given_t - t)
        error = np.where(np.isfinite(self.t), np.abs(self.given_t - self.t), np.inf)
        loose = np.minimum(LARGEST_RESIDUAL * error, MATCH_RTOL * np.abs(t))
        bound = np.where(np.isfinite(bound), FIT_FACTOR * (bound + self.t_rounding), 0.0)
        near = left <= np.maximum(bound, loose) + np.finfo(np.float64).tiny
        better = self.off & (left <= MAJORITY * error)  # of two bounds, a third of one explains nothing
        return same & (~hit | (near & (better | ~self.off)))

    @cached_property
    def roots(self) -> RayIntersections:
        """All intersections of the lines, before and behind the origins; `ray` is the place here."""
        lines = self.judge.lines.take(self.rows)
        return self.judge.bracket.possible_hits(lines._replace(t_min=np.full(len(self.rows), -np.inf)))

    @cached_property
    def columns(self) -> list[tuple[str, Array, Callable[[Array], Array]]]:
        """The numbers of shapes and primitives that the subject gives."""
        return id_columns(self.judge.answer, self.judge.model.packed)

    @property
    def named(self) -> Array:
        """(columns, m) the subject's numbers."""
        return np.array([ids[self.rows] for _, ids, _ in self.columns]).reshape(len(self.columns), len(self.rows))

    def numbers_of(self, prim: Array) -> Array:
        """(columns, r) the right numbers of primitives (r,)."""
        return np.array([number(prim) for _, _, number in self.columns]).reshape(len(self.columns), len(prim))


Predicts = Callable[[WrongPixels], Array]  # (m,) bool: the subject answers as if it made the mistake

# What a mistake claims beyond the pixels that it explains. SURFACES: nearly all right pixels agree with it. IMAGE: and
# more than a few pixels are wrong, and it explains nearly all wrong hits, not misses alone.
NOTHING, SURFACES, IMAGE = range(3)


class Mistake(NamedTuple):
    """One row of a table."""

    what: str
    remedy: str
    predicts: Predicts
    claim: int = NOTHING
    single: bool = False  # one pixel is enough: nothing is fitted, and no pixel fits by chance
    elsewhere: bool = False  # another surface is hit than the right one, whose normal is not judged


Explanation = tuple[Mistake, Array]  # and (m,) bool: the pixels that it explains


def explanations(f: WrongPixels, right: WrongPixels, table: Iterable[Mistake]) -> Iterator[Explanation]:
    """The mistakes that explain wrong pixels f, each pixel by one; right: pixels that may contradict them.

    A mistake that explains nearly all pixels comes first. The others come in the order of the table, if they explain
    most of the pixels that are left.
    """
    left = np.ones(len(f.rows), bool)
    if not len(left):
        return
    kept, tried = _kept(f, right, table), list[Explanation]()

    def explains(mistake: Mistake, fits: Array, share: float) -> bool:
        return bool(fits.sum() >= max(share, 1 if mistake.single else MIN_FITTED_PIXELS))

    for mistake, fits in kept:
        tried.append((mistake, fits))
        if explains(mistake, fits, NEARLY_ALL * len(fits)):
            tried.insert(0, tried.pop())
            break
    for mistake, fits in chain(tried, kept):
        if explains(mistake, fits & left, MAJORITY * left.sum()):
            yield mistake, fits & left
            left &= ~fits
        if not left.any():
            return


def _kept(f: WrongPixels, right: WrongPixels, table: Iterable[Mistake]) -> Iterator[Explanation]:
    """The mistakes that explain some pixels and whose claims hold: a few wrong pixels may fit one of many by chance."""
    few = f.take(sample_rows(np.arange(len(f.rows)), SCREENED_PIXELS))
    enough = len(f.rows) >= (1.0 - NEARLY_ALL) * right.hit.sum()
    groups = [right.take(each) for each in (right.hit, ~right.hit) if each.any()]
    for mistake in table:
        whole = mistake.claim == IMAGE
        if whole and not (enough and _explains_hits(few, mistake.predicts(few))):
            continue
        fits = mistake.predicts(f)
        if not fits.any() or (whole and not _explains_hits(f, fits)):
            continue
        shown = mistake.single or right.hit.any() or f.given_hit[fits].any()  # misses alone fit too many mistakes
        if mistake.claim == NOTHING or (shown and all(mistake.predicts(each).mean() >= NEARLY_ALL for each in groups)):
            yield mistake, fits


def _explains_hits(f: WrongPixels, fits: Array) -> bool:
    """Whether nearly all wrong pixels fit, and not misses alone."""
    hits = fits[f.given_hit]
    return bool(fits.mean() >= NEARLY_ALL and hits.sum() >= max(NEARLY_ALL * len(hits), MIN_FITTED_PIXELS))


# ---- hit, miss and t


def mistakes(f: WrongPixels) -> Iterator[Mistake]:
    """The table of wrong hits, misses and t, the simplest first; numbers in it are fitted to the wrong pixels f."""
    answer, is_list, camera = f.judge.answer, f.judge.rays.is_list, f.judge.scene.camera
    if is_list and not answer.hits_only:
        yield from OUT_OF_RANGE
    yield _quantity(
        "distance in place of t, which counts in lengths of d",
        "divide the distance by |d|, or leave d as it is given",
        lambda g: norm(g.d) * g.t,
        single=True,
    )
    if camera.type != "ray":
        axis = camera_axes(camera)[2]
        yield _quantity(
            "depth along z, the view axis, in place of t along the ray",
            "divide by the cosine of the ray with the view axis; of an image: --depth z",
            lambda g: unit(g.d) @ axis * g.t,
        )
    yield from _fitted_quantities(f)
    if not answer.exact_visibility:
        yield from _other_numbers(f)
    if not is_list:
        yield from _image_orders(f.judge.shape)
        yield from (_beside_centers(x, y) for x, y in product((-0.5, 0.0, 0.5), repeat=2) if x or y)
    yield from SELECTIONS
    yield from _other_rays()


OUT_OF_RANGE = (
    Mistake(
        "a hit before t_min, where the ray begins",
        "leave out hits with t <= t_min",
        lambda g: g.given_t < g.judge.t_min[g.rows],
        single=True,
        elsewhere=True,
    ),
    Mistake(
        "a hit beyond t_max, where the ray ends",
        "leave out hits with t > t_max",
        lambda g: (g.given_t > g.judge.t_max[g.rows]) & np.isfinite(g.given_t),
        single=True,
        elsewhere=True,
    ),
)


def _in_float32(predicts: Predicts) -> Mistake:
    return Mistake(
        "computed in float32: right by float32's bounds, and given as float64",
        "compute in float64, or state --candidate-precision float32",
        predicts,
        single=True,
    )


def _is_rounding(error: Array, bound: Array) -> Array:
    """(m,) bool: errors within the bounds of a rounding, if these are nearly all, and most are as large as it makes."""
    ratio = np.abs(error) / bound
    fits = ratio <= 1.0
    return fits & bool(fits.mean() >= NEARLY_ALL and np.median(ratio[fits]) >= LEAST_FLOAT32_ERROR)


def _is_rounding_of_t(g: WrongPixels, bound: Array) -> Array:
    """(m,) bool: the same for t at the right surface. Rounding has both signs: of few pixels, all may have one."""
    error = np.where(g.given_hit & g.hit, g.given_t - g.t, np.inf)
    before, behind = (error < 0.0).mean(), (error > 0.0).mean()
    return _is_rounding(error, bound) & bool(min(before, behind) >= 1.0 - NEARLY_ALL or len(error) < FEW_PIXELS)


def _other_numbers(f: WrongPixels) -> Iterator[Mistake]:
    """t at the right surface, of other numbers than those that are traced, or with the rounding of others."""
    answer = f.judge.answer
    described = described_model(f.judge.scene) if f.judge.rays.is_list and answer.precision == FLOAT64 else None

    def of_described(g: WrongPixels) -> Array:
        at = intersections_at(described or g.judge.model, g.prim, g.o, g.d, g.t, OUR_SIDE)
        return g.right_under(g.hit, at.t, at.t_error) & g.hit

    def of_points(g: WrongPixels) -> Array:
        length = norm(g.d)
        rounding = answer.ku * (norm(g.o) + np.abs(g.t) * length) / length
        larger = rounding >= g.at.t_error / MORE_THAN_ROUNDING  # than the rounding of t itself
        return (larger & _is_rounding_of_t(g, rounding + g.at.t_error + g.t_rounding)) | ~(g.hit | g.given_hit)

    if described and of_described(f).mean() > MAJORITY:  # the others differ by less than rounding
        yield Mistake(
            "hits of the scene file's own numbers; the judge traces them rounded to float32",
            "compute hits of the scene that `mitsuba-ref export --toml` writes, and judge with that",
            of_described,
            single=True,
        )
        return
    yield Mistake(
        "t is computed from absolute coordinates: of a hit point, (p - o) . d / d . d, or a plane, N . p = c",
        "return the t of the intersection, from differences to the ray's origin",
        of_points,
        # where few are wrong, the others show it, too
        SURFACES if len(f.rows) < (1.0 - NEARLY_ALL) * f.judge.hit.sum() else NOTHING,
        single=True,
    )
    if answer.precision == FLOAT64:
        yield _in_float32(lambda g: _is_rounding_of_t(g, g.at.t_error * (KU / KU_OURS) + g.t_rounding))


def _quantity(what: str, remedy: str, values: Predicts, claim: int = NOTHING, *, single: bool = False) -> Mistake:
    """Another quantity, (m,) values, in place of t; their error is in proportion to t's."""

    def predicts(g: WrongPixels) -> Array:
        t = values(g)
        return g.right_under(g.hit, t, g.at.t_error * np.abs(t / g.t))

    return Mistake(what, remedy, predicts, claim, single)


def _fitted_quantities(f: WrongPixels) -> Iterator[Mistake]:
    """t plus or times a constant, or on moved surfaces, fitted to all pixels; and 1 / t.

    None of the first three is named unless it leaves much less of the errors than the others.
    """
    some = f.given_hit & f.hit & np.isfinite(f.given_t)
    if some.sum() < MIN_FITTED_PIXELS:
        return
    g = f.take(some)
    error = g.given_t - g.t
    offset, more, shift = (float(np.median(each)) for each in (error, error / g.t, error * dot(g.at.n, g.d)))
    sign = "+" if more > 0.0 else "-"
    factor = f"(1 {sign} {abs(more):.3g})" if abs(more) < DISTINCT_RTOL else f"{1.0 + more:.7g}"
    fitted: tuple[tuple[str, str, Predicts], ...] = (
        (
            f"t is {abs(offset):.3g} too {'large' if offset > 0 else 'small'} everywhere, a constant",
            f"leave out the offset (an epsilon?) of {offset:.3g}",
            lambda h: h.t + offset,
        ),
        (
            f"t is {factor} times what it should be",
            "look for a wrong unit, a scale or a length that is not 1",
            lambda h: h.t + more * h.t,
        )
        if more != -1.0
        else ("t is 0, whatever is hit", "return the t of what is ahead", lambda h: 0.0 * h.t),
        (
            f"each surface is moved along its normal by {shift:.3g}",
            "use points and vertices as they are given",
            lambda h: h.t + shift / dot(h.at.n, h.d),
        ),
    )
    bound = g.at.t_error + g.t_rounding + g.judge.answer.ku * np.abs(g.t)
    left = [np.median(np.abs(g.given_t - fit(g)) / bound) for _, _, fit in fitted]
    best, second = np.argsort(left)[:2]
    if left[second] > MORE_THAN_ROUNDING and left[best] <= MAJORITY * left[second]:
        what, remedy, fit = fitted[best]
        yield _quantity(what, remedy, fit, SURFACES)
    yield _quantity("1 / t in place of t", "return t itself", lambda h: np.reciprocal(h.t))


# ---- pixels in other places


def _image_orders(shape: tuple[int, int]) -> Iterator[Mistake]:
    """The whole image in another order: Mitsuba's answers at other pixels."""
    pixels = np.arange(shape[0] * shape[1]).reshape(shape)
    yield _reordered("the image is mirrored, left for right", "turn the sign of x", pixels[:, ::-1])
    yield _reordered("the image is upside down", "row 0 is the top one: turn the sign of y", pixels[::-1])
    yield _reordered("the image is turned by half a turn", "turn the signs of x and y", pixels[::-1, ::-1])
    for source in (pixels.ravel(order="F"), np.argsort(pixels.ravel(order="F"))):  # the same if the image is square
        yield _reordered("the image is transposed, x for y", "rows come first: index y * width + x", source)
    for y, x in list(product((0, 1, -1), repeat=2))[1:]:
        what = f"the image is moved by a whole pixel: {x:+d} to the right, {y:+d} down"
        yield _reordered(what, "look for an index that counts from 1", np.roll(pixels, (y, x), (0, 1)))


def _reordered(what: str, remedy: str, source: Array) -> Mistake:
    """source: for each pixel, the pixel whose answer the subject gives."""

    def predicts(g: WrongPixels) -> Array:
        result, sources = g.judge.result, source.ravel()[g.rows]
        t, t_error = result.t.astype(np.float64), g.judge.at.t_error
        return g.right_under(result.hit[sources], t[sources], t_error[sources])

    return Mistake(what, remedy, predicts, IMAGE, elsewhere=True)


# ---- other rays


def _right_among(g: WrongPixels, roots: RayIntersections, *, last: bool = False) -> Array:
    """(m,) bool: the subject gives the first (or last) of the roots, or a miss if there is none."""
    ray, t, bound, sign = roots.ray, roots.at.t, roots.at.t_error, -1.0 if last else 1.0
    ahead = (t > g.judge.t_min[g.rows][ray]) & (t <= g.judge.t_max[g.rows][ray])
    certain = ahead & roots.at.certain
    first = np.full(len(g.rows), np.inf)
    np.minimum.at(first, ray[certain], sign * t[certain])
    in_turn = sign * t <= first[ray] + bound
    matches = ahead & in_turn & g.take(ray).right_under(np.ones(len(t), bool), t, bound)
    found = ~g.given_hit
    found[ray[ahead]] = False  # at an edge, no root is certain, and a miss may be another mistake
    found[ray[matches]] = True
    return found


Lines = Callable[[WrongPixels], tuple[Array, Array]]  # (o, d) of the rays that are cast


def _recast(what: str, remedy: str, lines: Lines) -> Mistake:
    """The first hits along other rays."""

    def predicts(g: WrongPixels) -> Array:
        along = Rays(*lines(g), np.zeros(len(g.rows)), g.judge.t_max[g.rows])
        return _right_among(g, g.judge.bracket.possible_hits(along))

    return Mistake(what, remedy, predicts, IMAGE, elsewhere=True)


def _beside_centers(x: float, y: float) -> Mistake:
    """Rays through another place of all pixels, x to the right and y down."""

    def lines(g: WrongPixels) -> tuple[Array, Array]:
        scene = g.judge.scene
        places = (center[g.rows] + step for center, step in zip(pixel_centers(scene), (x, y), strict=True))
        rays = reference_of_camera(scene.camera).rays(scene.camera, scene.film, *places)
        return rays.o + rays.t_min[:, None] * rays.d, rays.d

    return _recast(
        f"rays beside the pixel centres, by ({x:+.2f}, {y:+.2f}) of a pixel to the right and down",
        "the centre of pixel (x, y) is at (x + 0.5, y + 0.5)",
        lines,
    )


SAME = np.eye(3)


def _mapped(what: str, remedy: str, o: Array, d: Array) -> Mistake:
    """Origins and directions multiplied by matrices (3, 3) from the right."""
    return _recast(what, remedy, lambda g: (g.o @ o, g.d @ d))


def _other_rays() -> Iterator[Mistake]:
    yield _mapped("the directions are reversed: -d in place of d", "turn the sign of d", SAME, -SAME)
    for name, sign in zip("xyz", 1.0 - 2.0 * SAME, strict=True):
        turned, remedy = SAME * sign, f"use the same axes for rays and scene: turn the sign of {name}"
        yield _mapped(f"the {name} axis of directions is turned round", f"turn the sign of d.{name}", SAME, turned)
        yield _mapped(f"the {name} axis is turned round, of another handedness", remedy, turned, turned)
    for order in list(permutations(range(3)))[1:]:
        what = f"are exchanged: ({', '.join('xyz'[i] for i in order)}) in place of (x, y, z)"
        remedy = "use the same axes for rays and scene (y up or z up?)"
        yield _mapped(f"the axes of directions {what}", remedy, SAME, SAME[:, order])
        yield _mapped(f"the axes of rays {what}", remedy, SAME[:, order], SAME[:, order])
    yield _mapped("the rays' origin is taken for (0, 0, 0)", "subtract, or add, the ray's origin", 0.0 * SAME, SAME)
    for scale in (0.001, 0.01, 0.0254, 0.1, 0.5, 2.0, 10.0, 100.0, 1000.0):
        yield _mapped(
            f"the scene is {scale:g} times as large as it should be",
            "use vertices in the units of the rays",
            SAME / scale,
            SAME / scale,
        )


# ---- the wrong one of several hits


def _least(roots: RayIntersections, t: Array) -> Array:
    """(r,) the smallest t, (r,), of the same ray and primitive."""
    pair = row_groups(np.column_stack([roots.ray, roots.prim]))
    smallest = np.full(len(pair), np.inf)
    np.minimum.at(smallest, pair, t)
    return smallest[pair]


def _is_first_ahead(g: WrongPixels) -> Array:
    """(r,) bool: the first root of its primitive that is ahead of the origin."""
    t = g.roots.at.t
    ahead = np.where(t > g.judge.t_min[g.rows][g.roots.ray], t, np.inf)
    return np.isfinite(ahead) & (t == _least(g.roots, ahead))


def _is_last_prim(g: WrongPixels) -> Array:
    """(r,) bool: the same, of the primitive with the largest number on its ray."""
    kept = _is_first_ahead(g)
    last = np.full(len(g.rows), -1)
    np.maximum.at(last, g.roots.ray[kept], g.roots.prim[kept])
    return kept & (g.roots.prim == last[g.roots.ray])


def _is_tried_first(g: WrongPixels) -> Array:
    """(r,) bool: the first root of its primitive, or one whose first root is not behind the origin."""
    first = _least(g.roots, g.roots.at.t)
    return (g.roots.at.t == first) | (first >= 0.0)


def _selection(what: str, remedy: str, kept: Predicts, *, last: bool = False, single: bool = False) -> Mistake:
    """A caster that considers only some intersections. kept: (r,) bool of the roots of its pixels."""

    def predicts(g: WrongPixels) -> Array:
        return _right_among(g, g.roots.take(kept(g)), last=last) & (g.hit | ~g.given_hit)

    return Mistake(what, remedy, predicts, SURFACES, single, elsewhere=True)


def _culled(what: str, sign: float) -> Mistake:
    """A caster that skips surfaces with sign n . d >= 0."""
    return _selection(
        what,
        "hit both sides: no test of the sign of the determinant or of n . d",
        lambda g: sign * dot(g.roots.at.n, g.d[g.roots.ray]) < 0.0,
    )


SELECTIONS = (
    _selection(
        "another root of the surface that is hit first, such as the far one",
        "take the smaller root that is ahead of the origin",
        lambda g: g.roots.at.t == -_least(g.roots, -g.roots.at.t),
        single=True,
    ),
    _selection(
        "missed: the surface's first root is behind the ray's origin, and the second one was not tried",
        "where the first root is not ahead, try the second",
        _is_tried_first,
        single=True,
    ),
    _culled("back faces are culled: surfaces seen from behind are missed", 1.0),
    _culled("front faces are culled: surfaces seen from the front are missed", -1.0),
    _selection(
        "the last surface in the order of the scene in place of the nearest",
        "keep a hit only where its t is smaller than that of the last one kept",
        _is_last_prim,
    ),
    _selection(
        "the last surface along the ray in place of the first",
        "keep the hit with the smallest t",
        _is_first_ahead,
        last=True,
    ),
)


# ---- numbers of shapes and primitives


def id_mistakes(f: WrongPixels) -> Iterator[Mistake]:
    """The table of wrong numbers at right surfaces."""
    hit, columns = f.judge.hit, f.columns
    count = np.unique([ids[hit] for _, ids, _ in columns], axis=1).shape[1]
    if count * MIN_FITTED_PIXELS <= len(np.unique(f.prim)):
        who = "the same primitive is" if count == 1 else f"no more than {count} primitives are"
        yield Mistake(
            f"{who} named at all {hit.sum()} hits",
            "return the number of the primitive in the order of the scene, or leave the column out",
            lambda g: g.hit,
        )
    kinds: list[tuple[str, Callable[[int, WrongPixels], Array]]] = [
        (f"{name}'s number", partial(_is_off_in_column, place)) for place, (name, *_) in enumerate(columns)
    ]
    kinds = [kinds[-1], ("primitive's number in the scene", _is_off_in_scene), *kinds[:-1]]
    steps = [
        Mistake(
            f"the {what} is off by one ({step:+d})",
            f"numbers count from 0: {cure} 1",
            partial(predicts, step),
            SURFACES,
        )
        for step, cure in ((1, "subtract"), (-1, "add"))
        for what, predicts in kinds
    ]
    yield from sorted(steps, key=lambda mistake: -mistake.predicts(f).sum())  # several may explain nearly all
    yield Mistake(
        f"the {columns[-1][0]}'s number is that of another surface along the ray, t that of the first",
        "keep the number together with the smallest t",
        _names_another_hit,
    )


def _is_off_in_column(place: int, step: int, g: WrongPixels) -> Array:
    """(m,) bool: one column has the right number plus `step`."""
    off: Array = g.named[place] == g.numbers_of(g.prim)[place] + step
    return off


def _is_off_in_scene(step: int, g: WrongPixels) -> Array:
    """(m,) bool: the primitive is named that is `step` behind the right one in the scene, or none after the last."""
    other = np.where(g.prim + step < g.judge.model.packed.first[-1], g.prim + step, -1)
    off: Array = (g.named == g.numbers_of(other)).all(axis=0)
    return off


def _names_another_hit(g: WrongPixels) -> Array:
    """(m,) bool: the same ray hits the named primitive at another t."""
    ray, at = g.roots.ray, g.roots.at
    other = np.abs(at.t - g.t[ray]) > g.at.t_error[ray] + at.t_error
    other &= (g.named[:, ray] == g.numbers_of(g.roots.prim)).all(axis=0)
    found = np.zeros(len(g.rows), bool)
    found[ray[other]] = True
    return found


# ---- normals


def has_wrong_normal(f: WrongPixels) -> Array:
    """(m,) bool."""
    if f.judge.n is None:
        return np.zeros(len(f.rows), bool)
    return ~(row_distance(f.n, f.at.n) <= np.minimum(f.at.n_error, LARGEST_USEFUL_NORMAL_ERROR))


def _normal(what: str, remedy: str, predicted: Predicts, claim: int = NOTHING, *, single: bool = False) -> Mistake:
    """Other normals, predicted (m, 3), in place of the right ones. Unless `single`, those must not be all alike."""

    def predicts(g: WrongPixels) -> Array:
        n = predicted(g)
        fits: Array = row_distance(g.n, n) <= MATCH_RTOL
        fits &= (row_distance(n, g.at.n) > DISTINCT_RTOL) | ~has_wrong_normal(g)
        some = g.at.n[fits]
        return fits & (single or bool(len(some) and np.ptp(some, axis=0).max() > DISTINCT_RTOL))

    return Mistake(what, remedy, predicts, claim, single)


def _mapped_normal(what: str, remedy: str, matrix: Array) -> Mistake:
    """Normals multiplied by a matrix (3, 3) from the right."""
    return _normal(what, remedy, lambda g: g.at.n @ matrix)


def normal_mistakes(f: WrongPixels) -> Iterator[Mistake]:
    """The table of wrong normals at right surfaces, the simplest first."""
    yield from SINGLE_NORMALS
    if f.judge.scene.camera.type != "ray":
        axes = np.asarray(camera_axes(f.judge.scene.camera)).T
        for signs in product((1.0, -1.0), repeat=3):
            yield _mapped_normal(
                "the normal is in the camera's axes in place of the world's",
                "turn it by the camera's matrix",
                axes * signs,
            )
    yield from _other_normals()
    if f.judge.answer.precision == FLOAT32:
        yield Mistake(
            "the normal is computed from corners minus the ray's origin, and lost digits there",
            "compute it from the edges of the face, or in float64",
            _is_of_corners_seen_from_the_origin,
        )
    elif not f.judge.answer.exact_visibility:
        yield _in_float32(lambda g: _is_rounding(row_distance(g.n, g.at.n), g.at.n_error * (KU / KU_OURS)))


SINGLE_NORMALS = (
    _normal(
        "the normal is turned towards the ray; geometric normals point outside, whoever looks",
        "do not turn normals by the sign of n . d",
        lambda g: np.where((dot(g.at.n, g.d) > 0.0)[:, None], -g.at.n, g.at.n),
        SURFACES,
        single=True,
    ),
    _normal("the normal is turned round", "turn its sign: normals point outside", lambda g: -g.at.n, single=True),
    _normal(
        "the interpolated normal in place of the geometric one",
        "return the normal of the face, the cross product of its edges",
        lambda g: g.at.sh_n,
        single=True,
    ),
)


def _other_normals() -> Iterator[Mistake]:
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        if order != (0, 1, 2) or len(set(signs)) > 1:
            names = ", ".join("-"[: s < 0] + "xyz"[i] for i, s in zip(order, signs, strict=True))
            yield _mapped_normal(
                f"the normal's axes are permuted or signed: ({names}) in place of (x, y, z)",
                "use the same axes for normals and scene",
                SAME[:, order] * signs,
            )
    yield _normal(
        "the normal is stored as a colour, (n + 1) / 2", "return n itself, from -1 to 1", lambda g: unit(g.at.n + 1.0)
    )
    yield _normal(
        "the position in place of the normal", "subtract the centre", lambda g: unit(g.o + g.t[:, None] * g.d)
    )
    yield _normal(
        "one normal everywhere", "compute it for each hit", lambda g: np.broadcast_to(np.median(g.n, axis=0), g.n.shape)
    )


def _is_of_corners_seen_from_the_origin(g: WrongPixels) -> Array:
    """(m,) bool: normals of triangles, right but for the rounding of corner - o to float32."""
    corners = triangle_corners(g.judge, g.prim)
    seen = (corners.astype(np.float32) - g.o.astype(np.float32)[:, None]).astype(np.float64)
    left, error = row_distance(g.n, unit(area_vectors(seen))), row_distance(g.n, g.at.n)
    return (left <= FIT_FACTOR * g.at.n_error) & (left < MAJORITY * error)


def triangle_corners(judge: Judge, prim: Array) -> Array:
    """(m, 3, 3) corners of primitives; NaN for those that are no triangles."""
    packed = judge.model.packed
    corners = np.full((len(prim), 3, 3), np.nan)
    place, k = packed.kinds_of(prim)
    for number, kind in enumerate(packed.kinds):
        if isinstance(kind.prims, Triangles):
            rows = np.flatnonzero((place == number) & (prim >= 0))
            corners[rows] = kind.prims.vertices[kind.prims.faces[k[rows]]]
    return corners


def area_vectors(corners: Array) -> Array:
    """(m, 3) normals of triangles (m, 3, 3), twice as long as their area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def range_text(sizes: Array) -> str:
    """From the smallest to the largest."""
    low, high = f"{sizes.min():.2g}", f"{sizes.max():.2g}"
    return low if low == high else f"{low} to {high}"

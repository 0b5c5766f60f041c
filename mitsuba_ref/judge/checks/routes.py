"""Every public route to a pixel gives the same bits: sets of AOVs, threads, dtypes, crops, films, cast, probe.

What is compared with the reference is one image: all AOVs, by the planned culling. Whatever else users may call has
to give the bits of that image, or, on films of other sizes, those of the camera's rays cast one by one. Which routes
are taken is drawn from a seed that depends on geometry and film alone, so that a scene costs a tenth of its judgement.
"""

import zlib
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from caster import cast, occluded
from caster.aovs import AOVS, Aovs
from caster.geometry.packing import packed
from caster.rendering.casting import Culling
from caster.rendering.hits import trace_rays
from caster.rendering.images import camera_rays, evaluate, film_window, render, trace_film
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.checks import OURS, check
from mitsuba_ref.judge.checks.knife_edges import content_seed
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.shapes.targets import Rng

ALL_AOVS = tuple(aov.NAME for aov in AOVS)
# What most users render: always compared.
USUAL_SETS = (("depth", "normal"), ("normal",), ("depth",))

# What is rendered beside the whole film is small beside it: a share of its pixels, within limits.
CROPS, SETS_OF_CROPS = 3, 10
CROP_SHARE, CROP_SIDES = 8, (3, 48)  # pixels: each side is at most the root of that share
FILM_SHARE = 8
SMALL_FILM, FILM_SIZES = (4096, (1, 3))  # pixels; films of other sizes for a film smaller than that, and for others
TILE_WIDTHS = (1, 2)  # of 128 pixels, that a film is as wide as, or one narrower or wider
MAX_ROWS = 7  # pixels of the other side of such a film
BRUTE_FORCE_TESTS = 1 << 17  # rays times primitives that are tried without any culling
SAMPLE_SHARE, SAMPLED_PIXELS = (
    4,
    (16, 256),
)  # pixels: that share, within limits; cast one by one, half of them at edges
LIMITS = 3  # pairs of t_min and t_max, each of a call of its own
PROBED_PIXELS = 2


class RouteDifference(NamedTuple):
    """One route with other bits than the image: the first pixel of one AOV, and how many there are."""

    route: str  # as a call in Python
    aov: str
    x: int
    y: int
    expected: str
    got: str
    pixels: int

    def __str__(self) -> str:
        return (
            f"{self.route}: {self.aov} at ({self.x}, {self.y}) is {self.got}, expected {self.expected}; "
            f"{self.pixels} pixels"
        )


class Route(NamedTuple):
    """What one route gives and has to give, by AOV: arrays of one row a pixel."""

    call: str
    film: Scene
    expected: dict[str, np.ndarray]
    got: dict[str, np.ndarray]
    rows: np.ndarray | None = None  # of the film's window; None: all of them

    def difference(self) -> RouteDifference | None:
        """The first AOV with other bits, another shape or dtype."""
        x0, y0, x1, _ = self.film.film.window
        for name, got in self.got.items():
            a, b = np.ascontiguousarray(self.expected[name]), np.ascontiguousarray(got)
            if (a.shape, a.dtype) != (b.shape, b.dtype):
                return RouteDifference(self.call, name, x0, y0, f"{a.shape} {a.dtype}", f"{b.shape} {b.dtype}", len(a))
            if not len(a):
                continue
            one, two = (values.reshape(len(a), -1).view(np.uint8) for values in (a, b))
            bad = np.flatnonzero((one != two).any(axis=1))
            if len(bad):
                first = int(bad[0])
                row = first if self.rows is None else int(self.rows[first])
                x, y = x0 + row % (x1 - x0), y0 + row // (x1 - x0)
                return RouteDifference(self.call, name, x, y, _text(a[first]), _text(b[first]), len(bad))
        return None


@check(of=(OURS,), scope="window", camera=True, thorough=True)
def check_routes(scene: Scene) -> SceneCheck:
    """A sample of routes, the same for the same scene; infinite for one that differs, with its call, AOV and pixel."""
    taken = 0

    def count() -> None:
        nonlocal taken
        taken += 1

    for found in route_differences(scene, count)[:1]:
        return SceneCheck("routes", np.inf, str(found))
    return SceneCheck("routes", 0.0, f"{taken} routes")


@np.errstate(all="ignore")  # of kernels in plain Python
def route_differences(scene: Scene, on_route: Callable[[], None] = lambda: None) -> list[RouteDifference]:
    """Routes with other bits. on_route: called before each route."""
    found = []
    for route in _routes(scene):
        on_route()
        found.append(route.difference())
    return [each for each in found if each is not None]


def _routes(scene: Scene) -> Iterator[Route]:
    rng = np.random.default_rng(_seed(scene))
    whole = render(scene, ALL_AOVS)
    edges = np.flatnonzero(_beside_another(whole))
    yield from _other_sets(scene, rng, whole)
    yield from _crops(scene, rng, whole, edges)
    yield from _other_films(scene, rng)
    yield from _ray_by_ray(scene, rng, whole, edges)
    yield from _probed(scene, rng, whole, edges)


def _seed(scene: Scene) -> int:
    film = scene.film
    return zlib.crc32(repr((film.width, film.height, film.crop, scene.camera)).encode(), content_seed(packed(scene)))


def _text(value: Any) -> str:
    return repr(np.asarray(value).tolist())


# ---- images


def _image(film: Scene, call: str, expected: Aovs, got: Aovs, dtype: type[np.floating] = np.float64) -> Route:
    """Every AOV that `got` has, and the mask; expected is rounded to `dtype`, as the route is documented to."""

    def rounded(name: str) -> np.ndarray:
        rows = aov_rows(expected, name)
        return rows.astype(dtype) if rows.dtype.kind == "f" else rows

    before = {"mask": expected.hit.ravel()} | {name: rounded(name) for name in got}
    return Route(call, film, before, {"mask": got.hit.ravel()} | {name: aov_rows(got, name) for name in got})


def _cut(whole: Aovs, part: tuple[slice, slice]) -> Aovs:
    return Aovs({name: whole[name][part] for name in whole}, whole.hit[part])


def _call(
    aovs: Sequence[str], crop: Sequence[int] | None = None, size: tuple[int, int] | None = None, **options: Any
) -> str:
    film = [f"width={size[0]}, height={size[1]}"] if size else []
    film += [f"crop={tuple(int(n) for n in crop)}"] if crop is not None else []
    scene = f"scene.with_film({', '.join(film)})" if film else "scene"
    texts = {key: f"np.{value.__name__}" if isinstance(value, type) else repr(value) for key, value in options.items()}
    words = "".join(f", {key}={text}" for key, text in texts.items())
    return f"caster.render({scene}, {tuple(aovs)!r}{words})"


def _sets(rng: Rng, count: int) -> list[tuple[str, ...]]:
    """Single AOVs and pairs, in random order."""
    alone: list[tuple[str, ...]] = [(name,) for name in ALL_AOVS if (name,) not in USUAL_SETS]
    pairs: list[tuple[str, ...]] = [*combinations(ALL_AOVS, 2)]
    rng.shuffle(alone)
    rng.shuffle(pairs)
    return [names for two in zip(alone, pairs, strict=False) for names in two][:count]


def _other_sets(scene: Scene, rng: Rng, whole: Aovs) -> Iterator[Route]:
    """Other AOVs and numbers of threads, of the whole film."""
    threads = rng.permutation([1, 2, 3]).tolist()
    for i, names in enumerate([*USUAL_SETS, *_sets(rng, 2)]):
        options = {"threads": threads[i % 3]}
        yield _image(scene, _call(names, **options), whole, render(scene, names, **options))


def _crops(scene: Scene, rng: Rng, whole: Aovs, edges: np.ndarray) -> Iterator[Route]:
    """Random windows are what is cut out of the whole, whatever is asked of them."""
    x0, y0, x1, y1 = scene.film.window
    sets = [*USUAL_SETS[:2], *_sets(rng, SETS_OF_CROPS)]
    side = int(np.clip((whole.hit.size // CROP_SHARE) ** 0.5, *CROP_SIDES))
    share = -(-len(sets) // CROPS)
    for number in range(CROPS):
        pixel = int(rng.choice(edges)) if len(edges) else int(rng.integers(whole.hit.size))
        left, right = _around(rng, pixel % (x1 - x0), x1 - x0, side)
        top, bottom = _around(rng, pixel // (x1 - x0), y1 - y0, side)
        crop = (x0 + left, y0 + top, x0 + right, y0 + bottom)
        part, cut = scene.with_film(crop=crop), _cut(whole, (slice(top, bottom), slice(left, right)))
        yield _image(part, _call(ALL_AOVS, crop), cut, render(part, ALL_AOVS))
        options: dict[str, Any] = {"dtype": np.float32, "threads": int(rng.integers(1, 4))}
        yield _image(part, _call(ALL_AOVS, crop, **options), cut, render(part, ALL_AOVS, **options), np.float32)
        for names in sets[number * share : (number + 1) * share]:
            yield _image(part, _call(names, crop, threads=1), cut, render(part, names, threads=1))


def _around(rng: Rng, at: int, length: int, most: int) -> tuple[int, int]:
    """A random interval that holds `at`."""
    side = int(rng.integers(1, min(most, length) + 1))
    start = int(rng.integers(max(0, at - side + 1), min(at, length - side) + 1))
    return start, start + side


def _other_films(scene: Scene, rng: Rng) -> Iterator[Route]:
    """Films as wide as tiles, or one pixel off, and portraits: `render` is the camera's rays, cast by any culling."""
    numbers = packed(scene)
    x0, y0, x1, y1 = scene.film.window
    rows = int(np.clip((x1 - x0) * (y1 - y0) // (FILM_SHARE * 128), 1, MAX_ROWS))
    small = (x1 - x0) * (y1 - y0) < SMALL_FILM
    for i in range(FILM_SIZES[not small]):
        long = 128 * int(rng.choice(TILE_WIDTHS[: 2 - small])) + int(rng.integers(-1, 2) if small else i - 1)
        short = int(rng.integers(1, rows + 1))
        size = (short, long) if rng.random() < 0.25 else (long, short)
        crop = (0, 0, *size)
        film = scene.with_film(width=size[0], height=size[1], crop=crop)
        rays = camera_rays(film)
        expected = evaluate(trace_rays(film, numbers, rays, np.zeros(len(rays.o))), ALL_AOVS, film_window(film))
        for names in (ALL_AOVS, USUAL_SETS[0]):
            yield _image(film, _call(names, crop, size), expected, render(film, names))
        if not small and len(rays.o) * int(numbers.first[-1]) <= BRUTE_FORCE_TESTS:
            culling = _CULLINGS[i % 2]
            image = render(film, ALL_AOVS, culling=culling)
            yield _image(film, _call(ALL_AOVS, crop, size, culling=culling), expected, image)


_CULLINGS: tuple[Culling, ...] = ("brute-force", "bvh")


def _probed(scene: Scene, rng: Rng, whole: Aovs, edges: np.ndarray) -> Iterator[Route]:
    """What `caster probe` casts, at a few pixels."""
    x0, y0, x1, _ = scene.film.window
    pixels = rng.permutation(_some_pixels(rng, whole, edges, 4 * PROBED_PIXELS))[:PROBED_PIXELS]
    for row in pixels.tolist():
        x, y = row % (x1 - x0), row // (x1 - x0)
        one = scene.with_film(crop=(x0 + x, y0 + y, x0 + x + 1, y0 + y + 1))
        image = evaluate(trace_film(one, threads=1), ALL_AOVS, film_window(one))
        cut = _cut(whole, (slice(y, y + 1), slice(x, x + 1)))
        yield _image(one, f"caster probe SCENE {x0 + x} {y0 + y}", cut, image)


# ---- rays, one by one


def _beside_another(whole: Aovs) -> np.ndarray:
    """(h, w) bool: pixels whose left or upper neighbour hits another primitive."""
    ids = whole["shape_id"].astype(np.int64) * 2**32 + whole["prim_id"]
    edges = np.zeros(ids.shape, bool)
    edges[:, 1:] |= ids[:, 1:] != ids[:, :-1]
    edges[1:] |= ids[1:] != ids[:-1]
    return edges


def _some_pixels(rng: Rng, whole: Aovs, edges: np.ndarray, count: int) -> np.ndarray:
    """Up to half of them at edges, where uncertain pixels are; the others anywhere."""
    chosen = rng.permutation(edges)[: count // 2]
    anywhere = rng.integers(whole.hit.size, size=count - len(chosen))
    return np.unique(np.concatenate([chosen, anywhere])).astype(int)


def _lengths(d: np.ndarray) -> np.ndarray:
    return np.sqrt(d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2])


def _ray_by_ray(scene: Scene, rng: Rng, whole: Aovs, edges: np.ndarray) -> Iterator[Route]:
    """`cast`, its Hits and `occluded` at some pixels: the values of the image, and of each other."""
    rays = camera_rays(scene)
    count = int(np.clip(len(rays.o) // SAMPLE_SHARE, *SAMPLED_PIXELS))
    rows = _some_pixels(rng, whole, edges, count)
    rows = rows[rays.t_max[rows] >= 0.0]
    if not len(rows):
        return
    limits, member = np.unique(np.column_stack([rays.t_min[rows], rays.t_max[rows]]), axis=0, return_inverse=True)
    order = np.argsort(-np.bincount(member.ravel()))[:LIMITS]
    for number in order.tolist():
        some, (t_min, t_max) = rows[member.ravel() == number], limits[number].tolist()
        yield from _hits(scene, rays.o[some], rays.d[some], (t_min, t_max), some, whole)
    o, d, every = rays.o[rows], rays.d[rows], np.array(list(_limits(rng, aov_rows(whole, "depth")[rows])))
    alone = [cast(scene, o, d, t_min=low, t_max=high).t for low, high in every.tolist()]
    for (t_min, t_max), t in zip(every.tolist(), alone, strict=True):
        blocked = occluded(scene, o, d, t_max, t_min=t_min)
        call = f"caster.occluded(scene, o, d, {t_max!r}, t_min={t_min!r})"
        yield Route(call, scene, {"t": np.isfinite(t)}, {"t": blocked}, rows)
    # Limits of which each ray has its own: what each gets where all have that.
    low, high = (np.resize(column, len(rows)) for column in every.T)
    expected = np.choose(np.arange(len(rows)) % len(every), alone)
    ends = zip(("in", "ax"), every.T, strict=True)
    arrays = ", ".join(f"t_m{end}=np.resize({column.tolist()}, len(o))" for end, column in ends)
    together = cast(scene, o, d, t_min=low, t_max=high).t
    yield Route(f"caster.cast(scene, o, d, {arrays}).t", scene, {"t": expected}, {"t": together}, rows)
    blocked = occluded(scene, o, d, high, t_min=low)
    call = f"caster.occluded(scene, o, d, {arrays})"
    yield Route(call, scene, {"t": np.isfinite(expected)}, {"t": blocked}, rows)


def _limits(rng: Rng, depth: np.ndarray) -> Iterator[tuple[float, float]]:
    """None, and around one hit: excluded, just reached, beyond."""
    yield 0.0, np.inf
    finite = np.sort(depth[np.isfinite(depth) & (depth > 0.0)])
    if len(finite):
        t = float(rng.choice(finite))
        yield 0.0, t
        yield 0.0, float(np.nextafter(t, 0.0))
        yield t, np.inf
        yield float(finite[len(finite) // 4]), float(finite[3 * len(finite) // 4])


def _hits(
    scene: Scene, o: np.ndarray, d: np.ndarray, limits: tuple[float, float], rows: np.ndarray, whole: Aovs
) -> Iterator[Route]:
    """Fields of Hits; the normal of a call of its own, since it may be found without the others."""
    t_min, t_max = limits
    route = f"caster.cast(scene, o, d, t_min={t_min!r}, t_max={t_max!r})"
    hits = cast(scene, o, d, t_min=t_min, t_max=t_max)
    normal = cast(scene, o, d, t_min=t_min, t_max=t_max).normal
    surface = hits.surface
    for field, name, values in (
        ("shape_id", "shape_id", hits.shape_id),
        ("prim_id", "prim_id", hits.prim_id),
        ("normal", "normal", normal),
        ("surface.n", "normal", surface.n),
        ("surface.p", "position", surface.p),
        ("surface.sh_n", "shading_normal", surface.sh_n),
        ("surface.uv", "uv", surface.uv),
        ("t", "depth", hits.t * _lengths(d)),
    ):
        yield Route(f"{route}.{field}", scene, {name: aov_rows(whole, name)[rows]}, {name: values}, rows)

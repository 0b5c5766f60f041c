"""Every public route to a pixel gives the same bits: sets of AOVs, threads, dtypes, crops, films, cast, probe, fans.

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
from caster.rendering.casting import Culling, find_any, find_nearest
from caster.rendering.hits import trace_rays
from caster.rendering.images import camera_rays, evaluate, film_window, render, trace_film
from caster.rendering.ray_fans import SAMPLED_RAYS, find_rows
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.checks import OURS, check
from mitsuba_ref.judge.checks.knife_edges import content_seed
from mitsuba_ref.judge.checks.render import bits_differ
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
FAN_ROWS = 4  # of a film, at least, that are cast as rows: fewer are not seen to be some
MIN_FAN_RAYS = 64  # of a sample of fewer it is not seen what they have in common
MAX_FAN_PRIMITIVES = 1 << 20  # 50 bytes each, for a sample of rays


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


@check(of=(OURS,), scope="window", camera=True, thorough=True)
def check_routes(scene: Scene, path: str = "") -> SceneCheck:
    """A sample of routes, the same for the same scene; infinite for one that differs, with AOV, pixel and a command."""
    taken = 0

    def count() -> None:
        nonlocal taken
        taken += 1

    for found in route_differences(scene, count)[:1]:
        again = f"; again: python -c '{_program(found.route, path)}'" if path else ""
        return SceneCheck("routes", np.inf, f"{found}{again}")
    return SceneCheck("routes", 0.0, f"{taken} routes")


def _program(route: str, path: str) -> str:
    """The route as a program. o, d: of all pixels, of which the route took some."""
    if route.startswith("caster probe"):
        x, y = route.split()[-2:]
        return f'from caster.__main__ import main; main(["probe", "{path}", "{x}", "{y}"])'
    rays = (
        ""
        if "(scene, o, d" not in route
        else ("from caster.rendering.images import camera_rays; o, d = camera_rays(scene)[:2]; ")
    )
    if route.startswith("find_"):
        rays = (
            "from caster.geometry.packing import packed; from caster.rendering.images import camera_rays; "
            "from caster.rendering.casting import find_any, find_nearest; "
            f"from {__name__} import limited_rays, rays_back; "
        )
    head = f'import caster, numpy as np; from numpy import inf; scene = caster.load_scene("{path}")'
    return f"{head}; {rays}print({route})".replace("'", '"')


@np.errstate(all="ignore")  # of kernels in plain Python
def route_differences(scene: Scene, on_route: Callable[[], None] = lambda: None) -> list[RouteDifference]:
    """Routes with other bits. on_route: called before each route."""
    return list(_differences(scene, on_route))


def _differences(scene: Scene, on_route: Callable[[], None]) -> Iterator[RouteDifference]:
    rng = np.random.default_rng(_seed(scene))
    whole = render(scene, ALL_AOVS)
    edges = np.flatnonzero(_beside_another(whole))
    for routes in (
        _other_sets(scene, rng, whole),
        _crops(scene, rng, whole, edges),
        _other_films(scene, rng),
        _ray_by_ray(scene, rng, whole, edges),
        _probed(scene, rng, whole, edges),
        _as_fans(scene, rng, whole, edges),
    ):
        for found in routes:
            on_route()
            yield from found


def _seed(scene: Scene) -> int:
    film = scene.film
    return zlib.crc32(repr((film.width, film.height, film.crop, scene.camera)).encode(), content_seed(packed(scene)))


# ---- images


Found = Iterator[Iterator[RouteDifference]]


def _compare(
    scene: Scene, route: str, expected: Aovs, got: Aovs, dtype: type[np.floating] = np.float64
) -> Iterator[RouteDifference]:
    """Of every AOV that `got` has, and of the mask; expected is rounded to `dtype`, as the route is documented to."""
    x0, y0, x1, _ = scene.film.window
    masks = Aovs({"mask": expected.hit}, expected.hit), Aovs({"mask": got.hit}, got.hit)
    rounded = Aovs({name: _rounded(expected[name], dtype) for name in got}, expected.hit)
    for name, a, b in [("mask", *masks), *((name, rounded, got) for name in got)]:
        one, two = a[name], b[name]
        if one.shape != two.shape or one.dtype != two.dtype:
            before, after = (f"{image.shape} {image.dtype}" for image in (one, two))
            yield RouteDifference(route, name, x0, y0, before, after, one.size)
            continue
        rows = np.flatnonzero(bits_differ(a, b, name))
        if len(rows):
            before, after = (_text(aov_rows(image, name)[rows[0]]) for image in (a, b))
            x, y = x0 + int(rows[0]) % (x1 - x0), y0 + int(rows[0]) // (x1 - x0)
            yield RouteDifference(route, name, x, y, before, after, len(rows))


def _rounded(image: np.ndarray, dtype: type[np.floating]) -> np.ndarray:
    if image.dtype.kind != "f":
        return image
    with np.errstate(over="ignore", under="ignore"):
        return image.astype(dtype)


def _text(value: Any) -> str:
    return repr(np.asarray(value).tolist())


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


def _other_sets(scene: Scene, rng: Rng, whole: Aovs) -> Found:
    """Other AOVs, numbers of threads and dtypes, of the whole film."""
    threads = rng.permutation([1, 2, 3]).tolist()
    for i, names in enumerate([*USUAL_SETS, *_sets(rng, 2)]):
        options = {"threads": threads[i % 3]}
        yield _compare(scene, _call(names, **options), whole, render(scene, names, **options))


def _crops(scene: Scene, rng: Rng, whole: Aovs, edges: np.ndarray) -> Found:
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
        part = scene.with_film(crop=crop)
        cut = Aovs(
            {name: np.ascontiguousarray(whole[name][top:bottom, left:right]) for name in whole},
            whole.hit[top:bottom, left:right],
        )
        yield _compare(part, _call(ALL_AOVS, crop), cut, render(part, ALL_AOVS))
        options: dict[str, Any] = {"dtype": np.float32, "threads": int(rng.integers(1, 4))}
        image = render(part, ALL_AOVS, **options)
        yield _compare(part, _call(ALL_AOVS, crop, **options), cut, image, np.float32)
        for names in sets[number * share : (number + 1) * share]:
            yield _compare(part, _call(names, crop, threads=1), cut, render(part, names, threads=1))


def _around(rng: Rng, at: int, length: int, most: int) -> tuple[int, int]:
    """A random interval that holds `at`."""
    side = int(rng.integers(1, min(most, length) + 1))
    start = int(rng.integers(max(0, at - side + 1), min(at, length - side) + 1))
    return start, start + side


def _other_films(scene: Scene, rng: Rng) -> Found:
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
        view = trace_rays(film, numbers, rays, np.zeros(len(rays.o)))
        expected = evaluate(view, ALL_AOVS, film_window(film))
        for names in (ALL_AOVS, USUAL_SETS[0]):
            yield _compare(film, _call(names, crop, size), expected, render(film, names))
        if not small and rays.o.shape[0] * int(numbers.first[-1]) <= BRUTE_FORCE_TESTS:
            culling = _CULLINGS[i % 2]
            image = render(film, ALL_AOVS, culling=culling)
            yield _compare(film, _call(ALL_AOVS, crop, size, culling=culling), expected, image)


_CULLINGS: tuple[Culling, ...] = ("brute-force", "bvh")


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


def _ray_by_ray(scene: Scene, rng: Rng, whole: Aovs, edges: np.ndarray) -> Found:
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
        yield _hits_differences(scene, rays.o[some], rays.d[some], (t_min, t_max), some, whole)
    o, d, every = rays.o[rows], rays.d[rows], np.array(list(_limits(rng, aov_rows(whole, "depth")[rows])))
    for t_min, t_max in every.tolist():
        blocked = occluded(scene, o, d, t_max, t_min=t_min)
        hit = np.isfinite(cast(scene, o, d, t_min=t_min, t_max=t_max).t)
        route = f"caster.occluded(scene, o, d, {t_max!r}, t_min={t_min!r})"
        yield _rows_differ(scene, route, "t", hit, blocked, rows)
    yield from _own_limits(scene, (o, d), every, rows)


def _own_limits(scene: Scene, lines: tuple[np.ndarray, np.ndarray], limits: np.ndarray, rows: np.ndarray) -> Found:
    """Limits (m, 2) of which each ray has its own: what each gets where all have that."""
    t_min, t_max = (np.resize(column, len(rows)) for column in limits.T)
    alone = [cast(scene, *lines, t_min=low, t_max=high).t for low, high in limits.tolist()]
    expected = np.choose(np.arange(len(rows)) % len(limits), alone)
    words = (
        f"t_m{end}=np.resize({column.tolist()}, len(o))" for end, column in zip(("in", "ax"), limits.T, strict=True)
    )
    arrays = ", ".join(words)
    together = cast(scene, *lines, t_min=t_min, t_max=t_max).t
    yield _rows_differ(scene, f"caster.cast(scene, o, d, {arrays}).t", "t", expected, together, rows)
    blocked = occluded(scene, *lines, t_max, t_min=t_min)
    yield _rows_differ(scene, f"caster.occluded(scene, o, d, {arrays})", "t", np.isfinite(expected), blocked, rows)


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


def _hits_differences(
    scene: Scene, o: np.ndarray, d: np.ndarray, limits: tuple[float, float], rows: np.ndarray, whole: Aovs
) -> Iterator[RouteDifference]:
    """Fields of Hits, each of a call of its own where one field may be found without the others."""
    t_min, t_max = limits
    route = f"caster.cast(scene, o, d, t_min={t_min!r}, t_max={t_max!r})"
    hits = cast(scene, o, d, t_min=t_min, t_max=t_max)
    normal = cast(scene, o, d, t_min=t_min, t_max=t_max).normal
    surface = hits.surface
    length = np.sqrt(d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2])
    fields = {
        "shape_id": ("shape_id", hits.shape_id),
        "prim_id": ("prim_id", hits.prim_id),
        "normal": ("normal", normal),
        "surface.n": ("normal", surface.n),
        "surface.p": ("position", surface.p),
        "surface.sh_n": ("shading_normal", surface.sh_n),
        "surface.uv": ("uv", surface.uv),
    }
    for field, (name, values) in fields.items():
        yield from _rows_differ(scene, f"{route}.{field}", name, aov_rows(whole, name)[rows], values, rows)
    t = hits.t * length
    yield from _rows_differ(scene, f"{route}.t", "depth", aov_rows(whole, "depth")[rows], t, rows)


def _as_fans(scene: Scene, rng: Rng, whole: Aovs, edges: np.ndarray) -> Found:
    """Rays that start at one point as `cast` takes many of them, in any order and row by row, and those back to it."""
    rays, numbers = camera_rays(scene), packed(scene)
    count = int(np.clip(len(rays.o) // SAMPLE_SHARE, *SAMPLED_PIXELS))
    rows = rng.permutation(_some_pixels(rng, whole, edges, count))
    rows = rows[rays.t_max[rows] >= 0.0]
    from_one_point = len(rows) >= MIN_FAN_RAYS and (rays.o[rows] == rays.o[rows[0]]).all()
    if not from_one_point or int(numbers.first[-1]) > MAX_FAN_PRIMITIVES:
        return
    height, width = whole.hit.shape
    high = min(height, max(FAN_ROWS, count // width))
    first = int(rng.integers(height - high + 1)) * width
    for some in (np.arange(first, first + high * width), rows):
        part = type(rays)(*(a[some] for a in rays))
        if some is rows or find_rows(part) is not None:
            found = find_nearest(numbers, part, always_fans=True)
            yield _fan_differences(scene, part.d, found, some, whole)
    for strays in (0, 2):
        limited = _limited(part, found.t, strays)
        slow, fan = (find_nearest(numbers, limited, always_fans=fans) for fans in (False, True))
        route = f"find_nearest(packed(scene), limited_rays(scene, {strays}), always_fans=True)"
        yield _rows_differ(scene, route, "t", slow.t, fan.t, rows)
        yield _rows_differ(scene, route, "prim_id", slow.prim, fan.prim, rows)
        blocked, soon = (find_any(numbers, limited, always_fans=fans) for fans in (False, True))
        route = f"find_any(packed(scene), limited_rays(scene, {strays}), always_fans=True)"
        yield _rows_differ(scene, route, "t", blocked, soon, rows)
    back, hit = _rays_back(rays, found.t, rows)
    if len(hit) >= MIN_FAN_RAYS:
        free, fast = (find_any(numbers, back, always_fans=fans) for fans in (False, True))
        route = "find_any(packed(scene), rays_back(scene), always_fans=True)"
        yield _rows_differ(scene, route, "t", free, fast, hit)


def _fan_differences(
    scene: Scene, d: np.ndarray, found: Any, rows: np.ndarray, whole: Aovs
) -> Iterator[RouteDifference]:
    """Nearest hits of some of the camera's rays, cast as a fan."""
    numbers = packed(scene)
    route = "find_nearest(packed(scene), camera_rays(scene), always_fans=True)"
    length = np.sqrt(d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2])
    for name, values in (
        ("depth", found.t * length),
        ("shape_id", numbers.shape_of(found.prim)),
        ("prim_id", numbers.index_in_shape(found.prim)),
    ):
        yield from _rows_differ(scene, route, name, aov_rows(whole, name)[rows], values, rows)


def _rays_back(rays: Any, t: np.ndarray, rows: np.ndarray) -> tuple[Any, np.ndarray]:
    """(rays from the hits at t of camera rays `rows` to where these start, the rows that hit)."""
    with np.errstate(all="ignore"):
        o = rays.o[rows] + t[:, None] * rays.d[rows]
        d = rays.o[rows] - o
    hit = np.isfinite(d).all(axis=1) & d.any(axis=1)
    count = int(hit.sum())
    return type(rays)(o[hit], d[hit], np.zeros(count), np.ones(count)), rows[hit]


def _limited(rays: Any, t: np.ndarray, strays: int) -> Any:
    """These rays from the first quarter of the hits to the last; some that hit start elsewhere, and have no limits.

    None of those is of the sample, at equal distances, in which `cast` looks for a common origin.
    """
    hits = np.sort(t[np.isfinite(t)])
    low, high = (float(hits[len(hits) // 4]), float(hits[3 * len(hits) // 4])) if len(hits) else (0.0, np.inf)
    count, o = len(t), rays.o.copy()
    t_min, t_max = np.full(count, low), np.full(count, high)
    sampled = np.linspace(0, count - 1, SAMPLED_RAYS).astype(int)
    astray = np.setdiff1d(np.flatnonzero(np.isfinite(t)), sampled)[:strays]
    o[astray] += 0.5 * low * rays.d[astray]
    t_min[astray], t_max[astray] = 0.0, np.inf
    return type(rays)(o, rays.d, t_min, t_max)


def limited_rays(scene: Scene, strays: int) -> Any:
    """The camera's rays with limits among their hits, `strays` of which start elsewhere than all others."""
    rays = camera_rays(scene)
    return _limited(rays, find_nearest(packed(scene), rays).t, strays)


def rays_back(scene: Scene) -> Any:
    """Rays from what the camera's rays hit to where those start: o, d, t_min 0 and t_max 1."""
    rays = camera_rays(scene)
    return _rays_back(rays, find_nearest(packed(scene), rays).t, np.arange(len(rays.o)))[0]


def _rows_differ(
    scene: Scene, route: str, name: str, expected: np.ndarray, got: np.ndarray, rows: np.ndarray
) -> Iterator[RouteDifference]:
    """One difference, at the first row with other bits; NaN is like NaN."""
    x0, y0, x1, _ = scene.film.window
    a, b = (np.ascontiguousarray(values) for values in (expected, got))
    if a.shape != b.shape or a.dtype != b.dtype:
        yield RouteDifference(route, name, x0, y0, f"{a.shape} {a.dtype}", f"{b.shape} {b.dtype}", int(a.shape[0]))
        return
    if not len(a):
        return
    bytes_a, bytes_b = (values.reshape(len(a), -1).view(np.uint8) for values in (a, b))
    bad = np.flatnonzero((bytes_a != bytes_b).any(axis=1))
    if len(bad):
        row = int(rows[bad[0]])
        x, y = x0 + row % (x1 - x0), y0 + row // (x1 - x0)
        yield RouteDifference(route, name, x, y, _text(a[bad[0]]), _text(b[bad[0]]), len(bad))


def _probed(scene: Scene, rng: Rng, whole: Aovs, edges: np.ndarray) -> Found:
    """What `caster probe` casts, at a few pixels."""
    x0, y0, x1, _ = scene.film.window
    pixels = rng.permutation(_some_pixels(rng, whole, edges, 4 * PROBED_PIXELS))[:PROBED_PIXELS]
    for row in pixels.tolist():
        x, y = x0 + row % (x1 - x0), y0 + row // (x1 - x0)
        one = scene.with_film(crop=(x, y, x + 1, y + 1))
        view = trace_film(one, threads=1)
        image = evaluate(view, ALL_AOVS, film_window(one))
        cut = Aovs(
            {name: aov_rows(whole, name)[[row]].reshape(image[name].shape) for name in image},
            whole.hit.reshape(-1)[[row]][:, None],
        )
        yield _compare(one, f"caster probe SCENE {x} {y}", cut, image)

"""Nearest hits of any rays: `cast`, `occluded`, and AOVs of what was hit."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from caster.description.errors import SceneError
from caster.geometry.packing import Packed, packed
from caster.geometry.world_space import Rounding, as_given
from caster.jit.command_list import Command
from caster.kernels.nearest import OUT_OF_RANGE, Nearest, Rays, find_invalid_ray
from caster.kernels.raster.screen_bounds import Window
from caster.kernels.raster.tile import BOX, PRIM, T_MIN, WIDTH, Box, T, load_rays, tile_rows
from caster.rendering.casting import Culling, find_any, find_nearest
from caster.rendering.rasterization import parallel_for_tiles
from caster.rendering.ray_tiles import MIN_RAYS_PER_THREAD, TileWorkspace
from caster.rendering.shading import TileShader, new_image
from caster.rendering.threads import parallel_for, unwritten_array
from caster.scene.model import Scene

__all__ = ["RayHits", "cast", "cast_any_lengths", "occluded", "trace", "trace_rays", "validated_rays"]

SMALLEST_NORMAL_FLOAT = 2.0**-1022


@dataclass(frozen=True, repr=False)
class RayHits:
    """Rays and their nearest hits in a scene. `start` is the t from which depth counts along each ray."""

    scene: Scene
    packed: Packed
    rays: Rays
    nearest: Nearest
    start: np.ndarray  # (n,) float64
    threads: int | None = None

    def __repr__(self) -> str:
        return f"{type(self).__name__}(rays: {len(self.hit)}, hit: {int(self.hit.sum())})"

    @cached_property
    def hit(self) -> NDArray[np.bool_]:
        """(n,), whether each ray hits anything."""
        return self.nearest.prim >= 0

    @cached_property
    def shape_id(self) -> NDArray[np.int32]:
        """(n,), index of the shape in the scene, -1 on a miss."""
        return self.packed.shape_of(self.nearest.prim)

    @cached_property
    def prim_id(self) -> NDArray[np.int32]:
        """(n,), index of the primitive in its shape, such as a face of a mesh, -1 on a miss."""
        return self.packed.index_in_shape(self.nearest.prim)

    @cached_property
    def surfaces(self) -> dict[str, np.ndarray]:
        """The AOVs position, normal, shading_normal and uv, computed together."""
        return self.evaluate(("position", "normal", "shading_normal", "uv"))

    @cached_property
    def normal(self) -> NDArray[np.float64]:
        """(n, 3), geometric normals, outwards, of length 1, 0 on a miss; computed without the other surface values."""
        return self.evaluate(("normal",))["normal"]

    @property
    def position(self) -> NDArray[np.float64]:
        """(n, 3), scene units, in world space, 0 on a miss."""
        return self.surfaces["position"]

    @property
    def shading_normal(self) -> NDArray[np.float64]:
        """(n, 3), normals between the vertex normals of a mesh, elsewhere geometric ones, of length 1, 0 on a miss."""
        return self.surfaces["shading_normal"]

    @property
    def uv(self) -> NDArray[np.float64]:
        """(n, 2), surface coordinates, 0 on a miss."""
        return self.surfaces["uv"]

    def evaluate(self, aovs: Sequence[str], dtype: type[np.floating] = np.float64) -> dict[str, np.ndarray]:
        """AOVs by name, (n,) or (n, c) each. The rays are shaded as pixels of a film that is WIDTH wide."""
        count = len(self.rays.t_min)
        window = Window(0, 0, WIDTH, -(-count // WIDTH))
        images = {name: new_image(name, window, dtype) for name in aovs}
        prim = self.nearest.prim
        if len(self.packed.kinds) > 1:
            prim = np.where(self.hit, self.packed.places[prim], -1)  # tiles count primitives kind by kind
        shader = TileShader(self.scene, self.packed, images, of_rays=True)

        def begin() -> list[Command]:
            workspace = TileWorkspace()
            tile = workspace.tile

            def load(box: Box) -> None:
                first, size = box[1] * WIDTH, (box[3] - box[1]) * WIDTH
                numbers = np.arange(first, first + size, dtype=np.int32)
                numbers[count - first :] = -1
                load_rays(self.rays, numbers, tile)
                for place, values in ((T, self.nearest.t), (PRIM, prim), (T_MIN, self.start)):
                    here = values[first : first + size]
                    tile[int(place) : int(place) + len(here)] = here

            return [Command(load, (BOX,)), *shader.commands(workspace)]

        rows = tile_rows(window.width, window.height, len(self.packed.kinds))
        parallel_for_tiles(begin, rows, self.threads)
        return {name: image.reshape(-1, *image.shape[2:])[:count] for name, image in images.items()}


def trace_rays(scene: Scene, packed: Packed, rays: Rays, start: np.ndarray) -> RayHits:
    """Cast rays; start (n,): the t from which depth counts."""
    return RayHits(scene, packed, rays, find_nearest(packed, rays), start)


@dataclass(frozen=True, repr=False)
class Hits(RayHits):
    """The nearest hit of each of n rays; all but t is computed on first use."""

    t: NDArray[np.float64] = field(kw_only=True)  # (n,), in lengths of d, inf on a miss (see `cast`)


def cast(scene: Scene, o: ArrayLike, d: ArrayLike, *, t_min: ArrayLike = 0.0, t_max: ArrayLike = np.inf) -> Hits:
    """Find the first surface along each ray.

    o, d: (n, 3), scene units, or (3,) for the same in all rays; d need not be of unit length, t counts in lengths of d.
    t_min < t <= t_max, numbers or (n,) each. Equal t go to the earlier shape of the scene, then to the lower prim_id. A
    hit whose t is beyond float64, as for a d below 1e-290, has t = inf like a miss: `hit` tells them apart.
    Raises SceneError if a ray is not finite or has no direction, naming the first such ray.
    Source: docs/method.md, "Exact decisions"; slabs padded after Ize (2013).
    """
    given, plain = validated_rays_with_range(o, d, t_min, t_max)
    arrays = packed(scene)
    if plain:
        rays, nearest = given, find_nearest(arrays, given)
        t = nearest.t
    else:
        rays, nearest, t = cast_any_lengths(arrays, given)
    return Hits(scene, arrays, rays, nearest, np.zeros(len(t)), t=t)


def cast_any_lengths(
    packed: Packed, given: Rays, culling: Culling = "bvh", threads: int | None = None
) -> tuple[Rays, Nearest, np.ndarray]:
    """Cast rays whose d has any length: the rays with d of about unit length, their hits, t in lengths of the given d.

    (n,) t is inf on a miss, and for a hit beyond float64.
    """
    rays, exponent = scaled_rays(given)
    nearest = find_nearest(packed, rays, culling, threads)
    with np.errstate(over="ignore", under="ignore"):
        t = np.ldexp(nearest.t, -exponent)
    short = np.flatnonzero((exponent < 0) & (nearest.t < SMALLEST_NORMAL_FLOAT))
    if len(short):  # a denormal t has lost digits; in lengths of the shorter given d it is larger
        t[short] = find_nearest(packed, given.take(short), culling, threads).t
    return rays, nearest, t


def occluded(
    scene: Scene, o: ArrayLike, d: ArrayLike, t_max: ArrayLike = np.inf, *, t_min: ArrayLike = 0.0
) -> NDArray[np.bool_]:
    """Whether anything lies on each ray with t_min < t <= t_max. (n,) bool; arguments as in `cast`.

    Faster than `cast`, since any hit ends the search.
    """
    given, plain = validated_rays_with_range(o, d, t_min, t_max)
    return find_any(packed(scene), given if plain else scaled_rays(given)[0])


def trace(
    scene: Scene, o: ArrayLike, d: ArrayLike, t_max: np.ndarray, start: np.ndarray, *, rounded: Rounding = as_given
) -> RayHits:
    """Cast rays with limits of their own, for AOVs of their hits.

    o, d: (n, 3); t_max: (n,), negative where there is no ray; start: (n,) the t from which depth counts. rounded: is
    applied to the numbers of the geometry; with world_space.as_float32 they are those of a float32 renderer.
    """
    rays = validated_rays(o, d, 0.0, np.inf)._replace(t_max=np.ascontiguousarray(t_max, np.float64))
    return trace_rays(scene, packed(scene, rounded), rays, np.asarray(start, np.float64))


def validated_rays(o: ArrayLike, d: ArrayLike, t_min: ArrayLike, t_max: ArrayLike) -> Rays:
    """(n, 3) float64 rays, or a SceneError that names the first bad one."""
    return validated_rays_with_range(o, d, t_min, t_max)[0]


def validated_rays_with_range(o: ArrayLike, d: ArrayLike, t_min: ArrayLike, t_max: ArrayLike) -> tuple[Rays, bool]:
    """`validated_rays`, and whether the squares of all directions neither overflow nor vanish."""
    origins, directions = _rows(o, "o"), _rows(d, "d")
    counts = len(origins), len(directions)
    count = counts[0] if counts[1] == 1 else counts[1]
    if counts[0] not in (1, count):
        got = f"{counts[0]} and {counts[1]}"
        raise SceneError(f"rays: o and d must have equal lengths, or one of them be a single vector, got {got}")
    origins, directions = (
        rows if len(rows) == count else np.ascontiguousarray(np.broadcast_to(rows, (count, 3)))
        for rows in (origins, directions)
    )
    start, end = _limits(t_min, "t_min", count), _limits(t_max, "t_max", count)
    if not np.all(start >= 0.0) or np.isnan(end).any():
        i = int(np.argmin((start >= 0.0) & ~np.isnan(end)))
        which = "rays" if start.strides == end.strides == (0,) else f"rays[{i}]"
        raise SceneError(f"{which}: need t_min >= 0 and a t_max, got t_min {start[i]} and t_max {end[i]}")
    found: list[int] = []
    parallel_for(
        lambda start, stop: found.append(find_invalid_ray(origins, directions, start, stop)),
        count,
        least=MIN_RAYS_PER_THREAD,
    )
    if bad := [i for i in found if i >= 0]:
        i = min(bad)
        raise SceneError(f"rays[{i}]: o and d must be finite and d not zero, got o {origins[i]} and d {directions[i]}")
    rays = Rays(origins, directions, *(unwritten_array(limits.shape, np.float64) for limits in (start, end)))
    rays.t_min[:], rays.t_max[:] = start, end
    return rays, OUT_OF_RANGE not in found


def _limits(t: ArrayLike, name: str, count: int) -> np.ndarray:
    """(count,) float64; a number is broadcast."""
    numbers = _float64(t, name)
    if numbers.shape not in ((), (count,)):
        raise SceneError(f"rays: {name} must be a number, or one for each of {count} rays, got shape {numbers.shape}")
    return np.broadcast_to(numbers, (count,))


def _float64(a: ArrayLike, name: str) -> np.ndarray:
    try:
        return np.asarray(a, np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"rays: {name} must be numbers, got {type(a).__name__}: {error}") from None


def scaled_rays(rays: Rays) -> tuple[Rays, np.ndarray]:
    """(rays with d of about unit length, k (n,)); t then counts in lengths of 2^-k d.

    The scaling is exact, and the squares of the new d neither overflow nor vanish.
    """
    exponent = np.frexp(np.abs(rays.d).max(axis=1, initial=0.0))[1]
    numbers = np.column_stack([rays.d, rays.t_min, rays.t_max])
    powers = exponent[:, None] * np.array([-1, -1, -1, 1, 1])
    with np.errstate(over="ignore", under="ignore"):
        lossless = (np.ldexp(np.ldexp(numbers, powers), -powers) == numbers).all(axis=1)
        exponent = np.where(lossless, exponent, 0)
        d = np.ldexp(rays.d, -exponent[:, None])
        t_min, t_max = (np.ldexp(t, exponent) for t in (rays.t_min, rays.t_max))
    return Rays(rays.o, d, t_min, t_max), exponent


def _rows(a: ArrayLike, name: str) -> np.ndarray:
    given = a if isinstance(a, np.ndarray) and a.dtype.kind == "f" else _float64(a, name)
    if given.shape[-1:] != (3,) or given.ndim > 2:
        raise SceneError(f"rays: {name} must have shape (n, 3) or (3,), got {given.shape}")
    given = given.reshape(-1, 3)
    if given.dtype == np.float64 and given.flags.c_contiguous:
        return given
    rows = unwritten_array(given.shape, np.float64)

    def copy(start: int, stop: int) -> None:
        rows[start:stop] = given[start:stop]

    parallel_for(copy, len(rows), least=MIN_RAYS_PER_THREAD)
    return rows

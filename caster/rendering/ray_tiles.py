"""Rays in tiles, cast at all kinds of primitives: as packets, or as fans to one light or from one point."""

import itertools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Kind, Packed
from caster.jit.command_list import Command, CommandList, Condition, bind
from caster.jit.simd import CHILDREN, LANES
from caster.kernels.bvh.build import STACK_SIZE
from caster.kernels.bvh.fans import (
    BLOCKS,
    BOX_SIZE,
    GROUPS,
    ROWS,
    Fan,
    FanBounds,
    RayGroups,
    begin_groups,
    cast_fan,
    group_rays,
)
from caster.kernels.bvh.traversal import cast_packets, cast_packets_brute_force
from caster.kernels.nearest import Rays
from caster.kernels.raster.tile import (
    COUNT,
    LINES,
    PIXELS,
    TILE_NUMBERS,
    WIDTH,
    Box,
    clear_rays,
    load_ray_range,
    new_lanes,
    new_tile,
)
from caster.kernels.surface.lighting import DirectionalLight, PointLight
from caster.kernels.surface.per_hit import new_surface_buffer
from caster.rendering.bvh_construction import boxes_along, bvh_of, fan_bounds, fans_to, uses_bvh
from caster.rendering.threads import parallel_for


class Record(NamedTuple):
    """Where the answers to the rays of a tile are written."""

    ray_range: Callable[[np.ndarray, int, int], None]  # (tile, first, stop): of rays first..stop
    # (tile, first, width, box): of a box of rays that lie in rows, `width` of them each, from ray `first` on
    window: Callable[[np.ndarray, int, int, Box], None]
    sorted_rays: Callable[[np.ndarray, np.ndarray, int, int], None]  # (tile, order, first, stop): of order[first:stop]


# To wake a second thread takes as long as so many rays, about.
MIN_RAYS_PER_THREAD = 256


def for_ray_tiles(
    cast: Callable[[int, np.ndarray], None],
    rays: Rays,
    record: Record,
    threads: int | None,
    ray_range: tuple[int, int] | None = None,
) -> None:
    """Cast rays, or a range of them, a tile at a time."""
    begin, end = ray_range or (0, len(rays.t_min))

    def work(start: int, stop: int) -> None:
        with spare_workspaces() as take:
            tile = take().tile
            for first in range(begin + start, begin + stop, PIXELS):
                number = min(PIXELS, begin + stop - first)
                load_ray_range(rays, first, first + number, tile, 0)
                clear_rays(tile, number, -(-number // LANES) * LANES)
                cast(number, tile)
                record.ray_range(tile, first, first + number)

    if end > begin:
        parallel_for(work, end - begin, threads, least=MIN_RAYS_PER_THREAD)


def kind_command(
    kind: Kind, base: int, tile: np.ndarray, any_hit: bool = False, when: Condition | None = None
) -> Command:
    """Casts the first rays of a tile at a kind."""
    if uses_bvh(kind):
        about = kind.prims, bvh_of(kind), base, 0, tile, ALL_PACKETS, new_workspace(), any_hit
        return Command(bind(cast_packets, *about, given=(3,)), (COUNT,), when)
    about_all = kind.prims, len(kind.ids), base, 0, tile, any_hit
    return Command(bind(cast_packets_brute_force, *about_all, given=(3,)), (COUNT,), when)


ALL_PACKETS = np.empty(0, np.int8)  # none is left out


def tile_caster(
    packed: Packed, any_hit: bool = False, through_tree: Callable[[Kind], bool] = uses_bvh
) -> Callable[[int, np.ndarray], None]:
    """A function that casts the first so many rays of a tile; any_hit: until they have met anything."""
    places = [(kind, base, through_tree(kind)) for kind, base in zip(packed.kinds, prim_offsets(packed), strict=True)]

    def go(count: int, tile: np.ndarray) -> None:
        workspace = new_workspace()
        for kind, base, tree in places:
            if tree:
                cast_packets(kind.prims, bvh_of(kind), base, count, tile, ALL_PACKETS, workspace, any_hit)
            else:
                cast_packets_brute_force(kind.prims, len(kind.ids), base, count, tile, any_hit)

    return go


Workspace = tuple[np.ndarray, np.ndarray, np.ndarray]


def new_workspace() -> Workspace:
    """For what a ray has yet to look at, where it enters that, and where it enters the boxes of a node."""
    return np.zeros(STACK_SIZE, np.int32), np.empty(STACK_SIZE), np.empty(CHILDREN)


# To project a primitive towards a light takes a quarter of the time of a shadow ray. Few are projected for any film.
MIN_SHADOW_RAYS_PER_PRIMITIVE = 0.25
FEW_PRIMITIVES = 1 << 14


class ShadowCaster:
    """Casts rays of tiles that end at one light, or start at one point (outward), as fans where that pays.

    Shadow rays until each has met anything (any_hit). rays: about how many there will be. deviation: as for `fans_to`.
    """

    def __init__(
        self,
        packed: Packed,
        light: PointLight | DirectionalLight,
        rays: int,
        *,
        any_hit: bool = True,
        outward: bool = False,
        deviation: float = 0.0,
    ) -> None:
        offsets = list(zip(packed.kinds, prim_offsets(packed), strict=True))
        most = max(FEW_PRIMITIVES, int(rays / MIN_SHADOW_RAYS_PER_PRIMITIVE))
        self._any_hit, self._outward = any_hit, outward
        self._kinds = [(kind, base) for kind, base in offsets if uses_bvh(kind) and len(kind.ids) <= most]
        few, many = (
            [
                (kind, base)
                for kind, base in offsets
                if uses_bvh(kind) == with_tree and (not with_tree or len(kind.ids) > most)
            ]
            for with_tree in (False, True)
        )
        self._before_fans, self._after_fans = few, many
        self._fans: list[Fan] = []
        if self._kinds:
            center = bvh_of(max(self._kinds, key=lambda it: len(it[0].ids))[0]).center
            extent = max(kind.extent for kind, _ in self._kinds)
            self._fans = fans_to(light, center, extent, deviation)
        self._bounds: dict[tuple[int, int], FanBounds] = {}
        self._lock = threading.Lock()

    @property
    def has_fans(self) -> bool:
        """Whether there is a kind whose primitives are few enough for so many rays."""
        return bool(self._fans)

    @property
    def first_fan(self) -> Fan:
        """That of most rays."""
        return self._fans[0]

    def share_in_view(self, points: np.ndarray) -> float:
        """Share of points (m, 2) of the first projection at which a tree has a box, about; 0 without points."""
        covered = np.zeros(len(points), bool)
        for kind, _ in self._kinds:
            for low, high in boxes_along(self._fans[0], bvh_of(kind)):
                covered |= ((points >= low) & (points <= high)).all(axis=1)
        return float(covered.mean()) if len(points) else 0.0

    def prepare(self, threads: int | None) -> None:
        """Find what most tiles need, on all threads."""
        for n, (kind, _) in enumerate(self._kinds):
            self._bounds[0, n] = fan_bounds(kind, self._fans[0], threads)

    def begin(self, tile: np.ndarray, groups: RayGroups) -> Callable[[int], None]:
        """What casts the first so many rays of this tile, whole rows of it."""
        row = np.zeros((1, TILE_NUMBERS), np.int64)
        commands = CommandList(self.commands(tile, groups), row)

        def go(count: int) -> None:
            row[0, COUNT], row[0, LINES] = count, count // WIDTH
            commands.run(0, 1)

        return go

    def commands(self, tile: np.ndarray, groups: RayGroups, when: Condition | None = None) -> Iterator[Command]:
        """Cast the first rays of this tile, whole rows of it; what is hit before fans ends the search for the rest."""
        yield from (kind_command(kind, base, tile, self._any_hit, when) for kind, base in self._before_fans)
        if self._fans:
            yield Command(bind(begin_groups, groups, given=()), ())
            group = bind(group_rays, self._fans[0], tile, 0, groups, self._outward, given=(2,))
            yield Command(group, (LINES,), when)
            some, others = (groups.counts, 0), (groups.counts, 1)
            for n in range(len(self._kinds)):
                yield Command(self._fan_caster(0, n, tile, groups), (), some)
            yield Command(self._other_fans(tile, groups), (COUNT,), others)
        yield from (kind_command(kind, base, tile, self._any_hit, when) for kind, base in self._after_fans)

    def _other_fans(self, tile: np.ndarray, groups: RayGroups) -> Callable[[int], None]:
        """Casts rays that the first fan does not have, by the other ones, then through the tree."""
        workspace, counts = new_workspace(), groups.counts
        casters: dict[int, tuple[Callable[[int], None], list[Callable[[], None]]]] = {}

        def go(count: int) -> None:
            for number in range(1, len(self._fans)):
                if number not in casters:
                    about = self._fans[number], tile, 0, groups, self._outward
                    kinds = [self._fan_caster(number, n, tile, groups) for n in range(len(self._kinds))]
                    casters[number] = bind(group_rays, *about, given=(2,)), kinds
                group, cast_kinds = casters[number]
                group(count // WIDTH)
                if counts[0]:
                    for cast in cast_kinds:
                        cast()
                if not counts[1]:
                    return
            for kind, base in self._kinds:
                cast_packets(kind.prims, bvh_of(kind), base, count, tile, groups.taken, workspace, self._any_hit)

        return go

    def _fan_caster(self, number: int, n: int, tile: np.ndarray, groups: RayGroups) -> Callable[[], None]:
        kind, base = self._kinds[n]
        about = kind.prims, bvh_of(kind), self._bounds_of(number, n), base, tile, groups
        return bind(cast_fan, self._fans[number], *about, self._outward, self._any_hit, given=())

    def _bounds_of(self, number: int, n: int) -> FanBounds:
        """Kind n as the fan of that number sees it, found when a tile first needs it."""
        found = self._bounds.get((number, n))
        if found is None:
            with self._lock:
                found = self._bounds.get((number, n)) or fan_bounds(self._kinds[n][0], self._fans[number], 1)
                self._bounds[number, n] = found
        return found


def new_ray_groups() -> RayGroups:
    """Room for the rays of a tile."""
    return RayGroups(
        np.zeros(BLOCKS * BOX_SIZE),
        np.zeros(GROUPS * BOX_SIZE),
        np.zeros(PIXELS // LANES, np.int64),
        np.zeros(2, np.int64),
        np.zeros(CHILDREN * ROWS, np.int64),
        np.zeros(STACK_SIZE, np.int32),
        np.zeros(STACK_SIZE),
        np.zeros(PIXELS // LANES),
    )


@dataclass(frozen=True)
class TileWorkspace:
    """Buffers of one thread: the tile it works on, and what only some AOVs need."""

    tile: np.ndarray = field(default_factory=new_tile)

    @cached_property
    def surface(self) -> np.ndarray:
        return new_surface_buffer()

    @cached_property
    def lanes(self) -> np.ndarray:
        return new_lanes()

    @cached_property
    def shadow_tile(self) -> np.ndarray:
        return new_tile()

    @cached_property
    def ray_groups(self) -> RayGroups:
        return new_ray_groups()


MAX_SPARE_WORKSPACES = 16  # 3 MB each

_SPARE_WORKSPACES: list[TileWorkspace] = []


@contextmanager
def spare_workspaces() -> Iterator[Callable[[], TileWorkspace]]:
    """Gives a function that returns a workspace, with what earlier work left in it; they are spare afterwards."""
    taken: list[TileWorkspace] = []

    def take() -> TileWorkspace:
        workspace = None
        with suppress(IndexError):
            workspace = _SPARE_WORKSPACES.pop()
        taken.append(workspace or TileWorkspace())
        return taken[-1]

    yield take
    _SPARE_WORKSPACES.extend(taken[: max(MAX_SPARE_WORKSPACES - len(_SPARE_WORKSPACES), 0)])


def prim_offsets(packed: Packed) -> list[int]:
    """Place of each kind's first primitive: they are counted kind by kind."""
    return [0, *itertools.accumulate(len(kind.ids) for kind in packed.kinds)][: len(packed.kinds)]

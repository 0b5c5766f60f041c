"""Casts tiles of rays (kernels/raster/tile.py) at primitives of all kinds: in packets, or in fans through one point."""

import itertools
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from caster.description.transform import dot_rows
from caster.geometry.packing import Kind, Packed
from caster.jit.command_list import Command, CommandList, Condition, command
from caster.jit.simd import CHILDREN, LANES
from caster.kernels.bvh.build import STACK_SIZE
from caster.kernels.bvh.fans import (
    BLOCKS,
    BOX_SIZE,
    FAN_LIMIT,
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
from caster.kernels.raster.tile import COUNT, LINES, PIXELS, TILE_NUMBERS, WIDTH, new_lanes, new_tile
from caster.kernels.surface.lighting import DirectionalLight, PointLight
from caster.kernels.surface.per_hit import SURFACE_SIZE
from caster.rendering.bvh_construction import bvh_of, fan_bounds, fans_to, uses_bvh
from caster.rendering.threads import CHUNKS_PER_THREAD, even_pieces, thread_count, unwritten_array

# Waking a second thread takes about as long as casting so many rays.
MIN_RAYS_PER_THREAD = 256

Place = tuple[Kind, int]  # a kind, and the place of its first primitive

ALL_PACKETS = np.empty(0, np.int64)  # no ray has been cast yet; has the type of RayGroups.taken


def new_workspace() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(the stack of a traversal, t where each box on it is entered, t where each box of a node is entered)."""
    return np.zeros(STACK_SIZE, np.int32), np.empty(STACK_SIZE), np.empty(CHILDREN)


# Projecting a primitive towards a light takes a quarter of the time of a shadow ray. Few primitives are always
# projected, whatever the number of rays.
MIN_SHADOW_RAYS_PER_PRIMITIVE = 0.25
FEW_PRIMITIVES = 1 << 14


class TileCaster:
    """Casts the rays of tiles at all kinds of primitives.

    any_hit: each ray stops at any hit. uses_tree: the kinds whose trees are traversed. light: where all any-hit rays
    end, or all others start; then kinds that have a tree, and few primitives for so many `rays`, are hit by fans.
    """

    def __init__(
        self,
        packed: Packed,
        *,
        any_hit: bool,
        uses_tree: Callable[[Kind], bool] = uses_bvh,
        light: PointLight | DirectionalLight | None = None,
        rays: int = 0,
    ) -> None:
        most = max(FEW_PRIMITIVES, int(rays / MIN_SHADOW_RAYS_PER_PRIMITIVE)) if light is not None else -1
        self._any_hit = any_hit
        self.fans: list[Fan] = []  # that of most rays first; none without a kind to cast at as a fan
        self._kinds: list[Place] = []  # that are cast at as fans
        self._others: list[tuple[Kind, int, bool]] = []  # and whether through their trees
        for kind, base in placed_kinds(packed):
            tree = uses_tree(kind)
            if tree and len(kind.ids) <= most:
                self._kinds.append((kind, base))
            else:
                self._others.append((kind, base, tree))
        if light is not None and self._kinds:
            center = bvh_of(max(self._kinds, key=lambda it: len(it[0].ids))[0]).center
            self.fans = fans_to(light, center, max(kind.extent for kind, _ in self._kinds))
        self._bounds: dict[tuple[int, int], FanBounds] = {}
        self._lock = threading.Lock()

    def share_in_view(self, d: np.ndarray) -> float:
        """The share of directions (n, 3) that lead, in the first fan, into boxes of a tree's root; after `prepare`."""
        fan = self.fans[0]
        x, y, depth = (dot_rows(d, np.array(axis))[:, None] for axis in (fan.across, fan.up, fan.forward))
        ahead = (depth > 0.0) & (np.maximum(np.abs(x), np.abs(y)) <= FAN_LIMIT * depth)
        depth = np.where(ahead, depth, 1.0)
        x, y, inside = x / depth, y / depth, np.zeros((len(d), CHILDREN), bool)
        for n in range(len(self._kinds)):
            # the largest x and y are negated
            left, right, low, high = self._bounds[0, n].nodes[: 4 * CHILDREN].reshape(4, CHILDREN)
            inside |= (x >= left) & (x <= -right) & (y >= low) & (y <= -high)
        return float((inside & ahead).any(axis=1).mean())

    def prepare(self, threads: int | None) -> None:
        """Project all kinds for the first fan, on all threads."""
        for n in range(len(self._kinds) if self.fans else 0):
            self._bounds_of(0, n, threads)

    def begin(self, tile: np.ndarray, groups: RayGroups) -> Callable[[int], None]:
        """Return a function that casts the first `count` rays of this tile; for fans, a multiple of WIDTH."""
        row = np.zeros((1, TILE_NUMBERS), np.int64)
        commands = CommandList(self.commands(tile, groups), row)

        def go(count: int) -> None:
            row[0, COUNT], row[0, LINES] = count, count // WIDTH
            commands.run(0, 1)

        return go

    def commands(self, tile: np.ndarray, groups: RayGroups, when: Condition | None = None) -> Iterator[Command]:
        """Cast the first rays of this tile."""
        for kind, base, tree in self._others:
            if tree:
                about = kind.prims, bvh_of(kind), base, COUNT, tile, ALL_PACKETS, new_workspace(), self._any_hit
                yield command(cast_packets, *about, when=when)
            else:
                whole = kind.prims, len(kind.ids), base, COUNT, tile, self._any_hit
                yield command(cast_packets_brute_force, *whole, when=when)
        if self.fans:
            yield command(begin_groups, groups)
            yield from self._fan_commands(0, tile, groups, when)
            yield Command(self._other_fans(tile, groups), (COUNT,), (groups.counts, 1))

    def _fan_commands(
        self, number: int, tile: np.ndarray, groups: RayGroups, when: Condition | None = None
    ) -> Iterator[Command]:
        """Cast the rays that the fan of that number takes."""
        fan = self.fans[number]
        yield command(group_rays, fan, tile, LINES, groups, not self._any_hit, when=when)
        for n, (kind, base) in enumerate(self._kinds):
            about = kind.prims, bvh_of(kind), self._bounds_of(number, n), base, tile, groups
            yield command(cast_fan, fan, *about, not self._any_hit, when=(groups.counts, 0))

    def _other_fans(self, tile: np.ndarray, groups: RayGroups) -> Callable[[int], None]:
        """A function that casts `count` rays that are not in the first fan: by other fans, then by the tree."""
        workspace, row = new_workspace(), np.zeros((1, TILE_NUMBERS), np.int64)
        lists: dict[int, CommandList] = {}  # by fan; made when first needed, since each projects all primitives

        def go(count: int) -> None:
            row[0, LINES] = count // WIDTH
            for number in range(1, len(self.fans)):
                if number not in lists:
                    lists[number] = CommandList(self._fan_commands(number, tile, groups), row)
                lists[number].run(0, 1)
                if not groups.counts[1]:
                    return
            for kind, base in self._kinds:
                cast_packets(kind.prims, bvh_of(kind), base, count, tile, groups.taken, workspace, self._any_hit)

        return go

    def _bounds_of(self, number: int, n: int, threads: int | None = 1) -> FanBounds:
        """Kind n as the fan of that number sees it, found when it is first needed."""
        with self._lock:
            if (number, n) not in self._bounds:
                self._bounds[number, n] = fan_bounds(self._kinds[n][0], self.fans[number], threads)
            return self._bounds[number, n]


Piece = tuple[int, ...]


class RayTiles(NamedTuple):
    """How an array of rays is cast tile by tile."""

    caster: TileCaster
    pieces: Sequence[Piece]  # a tile each
    # the ray at each place of a piece's tile, (m,) int32, -1 for none; m a multiple of LANES, for fans of WIDTH
    numbers: Callable[[Piece], np.ndarray]


def tiles_in_order(caster: TileCaster, rays: Rays, threads: int | None) -> RayTiles:
    """Rays of an array in their order."""
    count = len(rays.t_min)
    workers = max(1, min(thread_count(threads), count // MIN_RAYS_PER_THREAD))
    tiles = max(-(-count // PIXELS), workers * CHUNKS_PER_THREAD if workers > 1 else min(count, 1))
    return RayTiles(caster, even_pieces(count, tiles), partial(numbers_between, LANES))


def numbers_between(multiple: int, ends: Piece) -> np.ndarray:
    """The numbers from the first to the second end, with -1 appended up to a multiple of this length."""
    first, stop = ends
    return np.append(np.arange(first, stop, dtype=np.int32), np.full((first - stop) % multiple, -1, np.int32))


@dataclass(frozen=True)
class TileWorkspace:
    """Buffers of one thread, uninitialised: the tile it works on, and those that only some AOVs need."""

    tile: np.ndarray = field(default_factory=lambda: new_tile(_unwritten))

    @cached_property
    def surface(self) -> np.ndarray:
        return _unwritten(SURFACE_SIZE)

    @cached_property
    def lanes(self) -> np.ndarray:
        return new_lanes()

    @cached_property
    def shadow_tile(self) -> np.ndarray:
        return new_tile(_unwritten)

    @cached_property
    def ray_groups(self) -> RayGroups:
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


def _unwritten(size: int) -> np.ndarray:
    return unwritten_array((size,), np.float64)


def placed_kinds(packed: Packed) -> list[Place]:
    """Each kind with the place of its first primitive: they are counted kind by kind."""
    ends = itertools.accumulate(len(kind.ids) for kind in packed.kinds)
    return [(kind, end - len(kind.ids)) for kind, end in zip(packed.kinds, ends, strict=True)]

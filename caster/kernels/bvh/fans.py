"""Fans: rays through one point, projected from there.

All rays of a fan end at one point (a point light), start there (an eye: `outward`) or are parallel (a directional
light). So each ray projects to a point, and it can only hit primitives whose projections contain that point. The boxes
of the tree are projected, too. Rays are grouped: LANES neighbours are a run, 8 runs below each other a block, 8 blocks
a group. The tree is traversed once for a group; primitives that a run may hit are tested by `intersect`, as everywhere.
"""

import math
from typing import Any, NamedTuple

from caster.jit.decorators import generic_inlined, implement, inlined, jit, optional
from caster.jit.simd import CHILDREN, LANES, lowest_bit
from caster.kernels.bvh.build import LEAF_SIZE_BASE
from caster.kernels.math.lanes import (
    FAN_FIELDS,
    LARGEST_T,
    boxes_below,
    boxes_reach_lines,
    lane_max,
    lane_max_of_sums,
    lane_min,
    lanes_above,
    lanes_within_lines,
)
from caster.kernels.math.vec import TINY, U, abs_dot, dot, l1_norm, max_norm, row, scaled, sub
from caster.kernels.protocol import Vec3, intersect, load, prepare
from caster.kernels.raster.screen_bounds import edge_line
from caster.kernels.raster.tile import (
    DX,
    FAN_X,
    FAN_Y,
    HEIGHT,
    OX,
    OY,
    OZ,
    SCRATCH,
    T_ERROR,
    T_MAX,
    T_MIN,
    WIDTH,
    T,
    cast_lanes,
    get,
    lane,
    update_nearest,
)
from caster.kernels.triangles import PLANE_ERROR, Triangles, corners_of


class Fan(NamedTuple):
    """A projection through a point, or along a direction."""

    perspective: float  # 1.0: through `origin`; 0.0: along `back`
    origin: Vec3  # float64; 0 if parallel
    back: Vec3  # unit, towards the light; 0 if perspective
    # x = across . a / depth, y = up . a / depth, depth = forward . a of a point a relative to the origin; no component
    # is larger than 1. Parallel: without the division, and `forward` is one axis, away from the light.
    across: Vec3
    up: Vec3
    forward: Vec3
    reach: float  # rays that start with a larger |coordinate| do not belong to it; not less than those of the light
    slack: float  # FAN_SLACK times the largest coordinates


# Let m = reach + the largest |coordinate| of a primitive. A point P at which a ray is sure to be hit is
# - within 4 u m of the hull of the points that `hull_point` computes (build.BOX_PADDING),
# - of a ray to a point light, within u m of the line through its origin and the light, as d = light - o is rounded. Of
#   parallel rays, `across` and `up` are rounded, by u each: a ray's x moves by no more than 2 u m from o to P.
# A projected point is the exact one of a point within 8 u m of it: a rounded difference, and a product with `across`,
# `up`, `forward` of three terms. All of this together is s = 16 u m; FAN_SLACK has 8 times that.
#
# Parallel: projections are off by s, so boxes are widened by the slack. Perspective: of P in the hull, off by s along
# each axis, x is off by s (1 + |x|) / (depth of P); as the depth of the hull is more than 2 slack, that is less than
# 2 slack (1 + |x|) / (least depth), |x| the largest of the hull's. The quotients round by u |x| each, |x| <= FAN_LIMIT
# for a ray's: FAN_ROUNDING covers them. What is nearer has no such bound, and its box is found from its coordinates.
#
# a x + b y + c of the line along an edge (`edge_line`) is rounded by 8 u (|a| + |b|) times the largest coordinate of
# the projection, and so is the sign of the third corner's: below 32 u (1 + |x|) perspective, since |x| <= FAN_LIMIT for
# a ray's, or 64 u m parallel.
#
# Of rays that start at the point exactly (`outward`), the projection is that of d: numerators are off by 3 u |d|, and
# so is the depth, which is at least |d| / 3 where |x|, |y| <= FAN_LIMIT. Quotients are off by less than 40 u, less than
# FAN_ROUNDING.
FAN_SLACK = 128.0 * U
FAN_ROUNDING = 64.0 * U
FAN_LIMIT = 2.0  # largest |x|, |y| of a ray in a perspective fan: six of them, with `forward` along axes, hold all rays

# A quotient that bounds x from below is off by 3 u of itself.
QUOTIENT_ROUNDING = 1.0 - 2.0**-40

# t times the depth of d is off by 20 u of the depth of the point at t: that of d is off by 9 u of itself (see above).
DEPTH_ROUNDING = 1.0 + 2.0**-40

BOX_SIZE = FAN_FIELDS * CHILDREN
"""Numbers of a node's boxes, (5, CHILDREN): least x, -largest x, least y, -largest y and a depth.

The depth is the least one of primitives and nodes, and minus the largest one of rays. All are inf where there is
nothing."""

ROWS = 8  # runs of a block
RUNS_ACROSS = WIDTH // LANES
BLOCKS = RUNS_ACROSS * (HEIGHT // ROWS)
GROUPS = BLOCKS // CHILDREN  # 4 x 2 blocks each
BLOCKS_ACROSS, BLOCKS_DOWN = 4, 2

PRIM_FIELDS = FAN_FIELDS + 1
"""Numbers of a primitive, in the order of the tree: its box, and by how much it was widened; inf: it has no outline."""


class FanBounds(NamedTuple):
    """The projected primitives of a kind."""

    nodes: Any  # flat, BOX_SIZE numbers a node of the tree
    prims: Any  # flat, PRIM_FIELDS numbers a primitive
    points: Any  # (v, 3) float64: x, y, depth of the vertices of triangles; of other kinds (0, 3)


class RayGroups(NamedTuple):
    """The projected rays of a tile."""

    runs: Any  # flat, BOX_SIZE numbers a block
    blocks: Any  # flat, BOX_SIZE numbers a group
    taken: Any  # (runs,) int64: 1 if a run has been cast, or has no ray; runs in rows of the tile
    counts: Any  # (2,) int64: runs that belong to the fan, and that are left
    found: Any  # int64: runs in which a primitive is to be tested
    stack: Any  # int32
    depths: Any  # float64, least depth of what is on the stack
    stretch: Any  # (runs,) float64, by block: the largest depth of a d, where rays start at the fan's origin


@inlined
def project_vector(fan: Fan, a: Vec3) -> Vec3:
    """(x, y, depth) of a point relative to the fan's origin; x and y are not divided where it is behind."""
    depth = dot(fan.forward, a)
    over = depth if (fan.perspective != 0.0) & (depth > 0.0) else 1.0
    return dot(fan.across, a) / over, dot(fan.up, a) / over, depth


# ---- primitives ----


@jit
def project_along(fan: Any, points: Any, projected: Any, start: int, stop: int) -> None:
    """projected (n, 3): x, y, depth of points start..stop."""
    for i in range(start, stop):
        projected[i, 0], projected[i, 1], projected[i, 2] = project_vector(fan, sub(row(points, i), fan.origin))


@jit
def bound_hulls_along(fan: Any, corners: Any, projected: Any, order: Any, prims: Any, start: int, stop: int) -> None:
    """Boxes of the hulls order[start:stop] of projected points; corners: (n, points of a hull)."""
    for at in range(start, stop):
        if not store_prim(fan, prims, at, hull_extent(corners, projected, order[at], True)):
            store_near_prim(fan, prims, at, hull_extent(corners, projected, order[at], False))


Extent = tuple[float, float, float, float, float, float]
"""Least x, -largest x, least y, -largest y, least depth, -largest depth"""


NOTHING: Extent = math.inf, math.inf, math.inf, math.inf, math.inf, math.inf


@inlined
def hull_extent(corners: Any, projected: Any, k: int, divided: bool) -> Extent:
    """Bounds of the projected points of hull k, or of these before the division, within 2 u."""
    left, right, low, high, near, far = NOTHING
    for j in range(corners.shape[1]):
        x, y, depth = row(projected, corners[k, j])
        over = depth if (not divided) & (depth > 0.0) else 1.0
        left, right = min(left, x * over), min(right, -(x * over))
        low, high = min(low, y * over), min(high, -(y * over))
        near, far = min(near, depth), min(far, -depth)
    return left, right, low, high, near, far


@inlined
def store_prim(fan: Fan, prims: Any, at: int, box: Extent) -> bool:
    """Store a box widened by its margin; False if nothing bounds that."""
    near, wide = box[4], fan.slack
    if fan.perspective != 0.0:
        largest = max(max(-box[0], -box[1]), max(-box[2], -box[3]))
        wide = 2.0 * fan.slack / near if near > 2.0 * fan.slack else math.inf
        wide = (wide + FAN_ROUNDING) * (1.0 + largest)
    i = at * PRIM_FIELDS
    for f in range(4):
        prims[i + f] = box[f] - wide
    prims[i + 4], prims[i + 5] = near - 2.0 * fan.slack, wide
    return wide < math.inf


@inlined
def store_near_prim(fan: Fan, prims: Any, at: int, box: Extent) -> None:
    """Store the box of a primitive that reaches the origin or behind it: x >= (least numerator) / (largest depth)."""
    i, slack, deep = at * PRIM_FIELDS, 2.0 * fan.slack, -box[5] + 2.0 * fan.slack
    for f in range(4):
        ahead = box[f] - slack
        prims[i + f] = ahead / deep * QUOTIENT_ROUNDING if (ahead > 0.0) & (deep > 0.0) else -math.inf
    prims[i + 4] = -math.inf
    if deep < 0.0:  # all of it is behind
        prims[i] = math.inf


@jit
def bound_nodes_along(links: Any, bounds: Any) -> None:
    """Boxes of nodes, from those of primitives; children have larger numbers than their parents."""
    nodes, prims = bounds.nodes, bounds.prims
    for node in range(len(links) - 1, -1, -1):
        for j in range(CHILDREN):
            link = links[node, j]
            for f in range(FAN_FIELDS):
                low = math.inf
                if link >= 0:
                    low = least_of(nodes, link * BOX_SIZE + f * CHILDREN)
                else:
                    start, number = ~link // LEAF_SIZE_BASE, ~link % LEAF_SIZE_BASE
                    for at in range(start, start + number):
                        low = min(low, prims[at * PRIM_FIELDS + f])
                nodes[node * BOX_SIZE + f * CHILDREN + j] = low


# ---- rays ----


@inlined
def least_of(boxes: Any, first: int) -> float:
    """The least of CHILDREN numbers; a load of all at once would wait for the store of one."""
    least = math.inf
    for j in range(first, first + CHILDREN):
        least = min(least, boxes[j])
    return least


@inlined
def block_corner(block: int) -> int:
    """The first ray of a block, in its tile."""
    group, j = block // CHILDREN, block % CHILDREN
    across = RUNS_ACROSS // BLOCKS_ACROSS
    x = group % across * BLOCKS_ACROSS + j % BLOCKS_ACROSS
    y = group // across * BLOCKS_DOWN + j // BLOCKS_ACROSS
    return y * ROWS * WIDTH + x * LANES


@jit
def begin_groups(groups: Any) -> None:
    """Mark all runs of a tile as left."""
    groups.taken[:] = 0
    groups.counts[:] = 0


@jit
def group_rays(fan: Any, tile: Any, rows: int, groups: Any, outward: bool) -> None:
    """Take the runs of the first `rows` rows that belong to the fan and are left.

    outward: rays belong to it that start at its origin. A place without a ray gets a hit, so that nothing is cast
    there.
    """
    runs, counts = groups.runs, groups.counts
    counts[0], counts[1] = 0, 0
    for block in range(BLOCKS):
        corner = block_corner(block)
        for r in range(ROWS):
            run, into = corner // LANES + r * RUNS_ACROSS, block * BOX_SIZE + r
            for f in range(FAN_FIELDS):
                runs[into + f * CHILDREN] = math.inf
            if run < rows * RUNS_ACROSS and groups.taken[run] == 0:
                first = lane(run * LANES)
                if lane_max(tile, T_MAX + first) < 0.0:
                    groups.taken[run] = 1
                elif group_run(fan, tile, first, outward):
                    groups.taken[run] = 1
                    counts[0] += 1
                    for f in range(FAN_FIELDS):
                        runs[into + f * CHILDREN] = lane_min(tile, SCRATCH + lane(f * LANES))
                    if outward:
                        stretch = -runs[into + 4 * CHILDREN] * DEPTH_ROUNDING
                        groups.stretch[block * ROWS + r] = stretch
                        runs[into + 4 * CHILDREN] = -farthest_depth(tile, first, stretch)
                else:
                    counts[1] += 1
        for f in range(FAN_FIELDS):
            into = block // CHILDREN * BOX_SIZE + f * CHILDREN + block % CHILDREN
            groups.blocks[into] = least_of(runs, block * BOX_SIZE + f * CHILDREN)


@inlined
def farthest_depth(tile: Any, first: Any, stretch: float) -> float:
    """No nearest hit of LANES rays lies behind this depth; negative if each ray has a final hit."""
    t = min(lane_max(tile, T_MAX + first), lane_max_of_sums(tile, T + first, T_ERROR + first))
    return t * stretch if stretch > 0.0 else math.inf


@inlined
def group_run(fan: Fan, tile: Any, first: Any, outward: bool) -> bool:
    """Write the bounds of LANES rays to the tile's scratch; whether all of them belong to the fan.

    x is NaN where there is no ray. depth is that of the origin, of `outward` rays that of d.
    """
    for n in range(lane(LANES)):
        i = first + n
        o, d = get(tile, OX + i), get(tile, DX + i)
        x, y, depth = project_vector(fan, d if outward else sub(o, fan.origin))
        ray = tile[T_MAX + i] >= 0.0
        ahead = (depth > 0.0) & (abs(x) <= FAN_LIMIT) & (abs(y) <= FAN_LIMIT)
        p = fan.origin
        near = (o[0] == p[0]) & (o[1] == p[1]) & (o[2] == p[2]) if outward else max_norm(o) <= fan.reach
        fits = near & (ahead | (fan.perspective == 0.0))
        tile[T + i] = tile[T + i] if ray else -1.0
        tile[FAN_X + i], tile[FAN_Y + i] = x if ray else math.nan, y
        tile[SCRATCH + n] = x if ray else math.inf
        tile[SCRATCH + lane(LANES) + n] = -x if ray else math.inf
        tile[SCRATCH + lane(2 * LANES) + n] = y if ray else math.inf
        tile[SCRATCH + lane(3 * LANES) + n] = -y if ray else math.inf
        tile[SCRATCH + lane(4 * LANES) + n] = -depth if ray else math.inf
        tile[SCRATCH + lane(5 * LANES) + n] = 0.0 if fits | (not ray) else 1.0
    return lane_max(tile, SCRATCH + lane(5 * LANES)) == 0.0


# ---- primitives against rays ----

Outline = tuple[Vec3, Vec3, Vec3]
NO_LINE, NO_POINT = (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
NO_OUTLINE: Outline = NO_LINE, NO_LINE, NO_LINE
NO_PLANE: Outline = NO_POINT, NO_POINT, NO_POINT


@optional(generic_inlined)
def outline(prims: Any, k: int, points: Any, wide: float) -> Any:
    """Three lines (a, b, c): a ray at (x, y) misses primitive k if a x + b y + c < 0 for one of them."""
    return NO_OUTLINE


@optional(generic_inlined)
def separating_plane(prims: Any, prim: Any, fan: Fan) -> Any:
    """(p, normal, error): a ray to the light that starts above it misses the primitive (math.lanes.lanes_above)."""
    return NO_PLANE


@implement(outline, Triangles)
def _triangle_outline(prims: Any, k: int, points: Any, wide: float) -> Outline:
    p, q, r = corners_of(points, prims.faces, k)
    if wide < math.inf:
        return edge_line(p, q, r, wide), edge_line(q, r, p, wide), edge_line(r, p, q, wide)
    return NO_OUTLINE


@implement(separating_plane, Triangles)
def _triangle_plane(prims: Any, prim: Any, fan: Fan) -> Outline:
    """The triangle's plane, with the light on its positive side: n . (a - o) > 0 where a ray starts and ends.

    Its error is PLANE_ERROR. A ray to a point light ends within u m of it (FAN_SLACK); parallel rays go upwards.
    """
    a, _, _, n, spread = prim
    error = scaled(PLANE_ERROR, spread)
    ahead = sub(a, fan.origin) if fan.perspective != 0.0 else scaled(-1.0, fan.back)
    height = dot(n, ahead)
    sure = abs(height) > abs_dot(error, ahead) + fan.perspective * fan.slack * l1_norm(spread) + TINY
    side = math.copysign(1.0, height) if sure else 0.0
    return a, scaled(side, n), error


@jit
def cast_fan(fan: Any, prims: Any, tree: Any, bounds: Any, base: int, tile: Any, groups: Any, outward: bool) -> None:
    """Cast the runs that the fan has taken at a kind.

    outward: all rays start at the fan's origin, nearest hits are found, and near nodes come first; else any certain hit
    ends the search of a ray.
    """
    runs, blocks, stack, depths, found = groups.runs, groups.blocks, groups.stack, groups.depths, groups.found
    for group in range(GROUPS):
        rays = group * BOX_SIZE
        right, left = -least_of(blocks, rays + CHILDREN), -least_of(blocks, rays)
        high, low = -least_of(blocks, rays + 3 * CHILDREN), -least_of(blocks, rays + 2 * CHILDREN)
        farthest = -least_of(blocks, rays + 4 * CHILDREN)
        stack[0], depths[0] = 0, -math.inf
        top = 1 if farthest >= (0.0 if outward else -LARGEST_T) else 0
        while top > 0:
            top -= 1
            inside = stack[top]
            if depths[top] > farthest:
                continue
            if inside >= 0:
                mask = boxes_below(bounds.nodes, inside, (right, left, high, low, farthest))
                bottom = top
                while mask != 0:
                    j = lowest_bit(mask)
                    mask &= mask - 1
                    depth, at = bounds.nodes[inside * BOX_SIZE + 4 * CHILDREN + j], top
                    while outward and at > bottom and depths[at - 1] < depth:
                        stack[at], depths[at] = stack[at - 1], depths[at - 1]
                        at -= 1
                    stack[at], depths[at] = tree.links[inside, j], depth
                    top += 1
                continue
            start, number = ~inside // LEAF_SIZE_BASE, ~inside % LEAF_SIZE_BASE
            for at in range(start, start + number):
                box, i = bounds.prims, at * PRIM_FIELDS
                # of boxes that the primitive's box overlaps and that are not all in front of it
                meets = -box[i + 1], -box[i], -box[i + 3], -box[i + 2], -box[i + 4]
                mask = boxes_below(blocks, group, meets)
                if mask == 0:
                    continue
                k = tree.order[at]
                lines = outline(prims, k, bounds.points, box[i + 5])
                plane = NO_PLANE if outward else separating_plane(prims, load(prims, k), fan)
                count = 0
                while mask != 0:
                    block = group * CHILDREN + lowest_bit(mask)
                    mask &= mask - 1
                    corner = block_corner(block)
                    rows = boxes_below(runs, block, meets) & boxes_reach_lines(runs, block, lines)
                    while rows != 0:
                        r = lowest_bit(rows)
                        rows &= rows - 1
                        first = lane(corner + r * WIDTH)
                        lanes = lanes_within_lines(tile, FAN_X + first, FAN_Y + first, lines)
                        if not outward:
                            lanes &= ~lanes_above(tile, OX + first, OY + first, OZ + first, plane)
                        found[count] = block * ROWS + r
                        count += 1 if lanes != 0 else 0
                if count == 0:
                    continue
                prim, prim_number = load(prims, k), float(base + k)
                pre = prepare(prims, prim, fan.origin)
                for n in range(count):
                    block, r = found[n] // ROWS, found[n] % ROWS
                    first = lane(block_corner(block) + r * WIDTH)
                    far = block * BOX_SIZE + 4 * CHILDREN
                    if outward:
                        for x in range(first, first + lane(LANES)):
                            t, error = intersect(prims, pre, get(tile, DX + x), tile[T_MIN + x], tile[T_MAX + x])
                            update_nearest(tile, x, prim_number, t, error)
                        depth = farthest_depth(tile, first, groups.stretch[found[n]])
                        runs[far + r] = -depth if depth >= 0.0 else math.inf
                    else:
                        cast_lanes(prims, prim, prim_number, tile, first, True)
                        if lane_max_of_sums(tile, T + first, T_ERROR + first) < 0.0:  # all have met something
                            runs[far + r] = math.inf
                    blocks[rays + 4 * CHILDREN + block % CHILDREN] = least_of(runs, far)
            farthest = -least_of(blocks, rays + 4 * CHILDREN)

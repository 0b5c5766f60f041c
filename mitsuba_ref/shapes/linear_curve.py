"""Linear curves: Mitsuba's `linearcurve`, Embree's round linear curves; error model and targets."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from caster.shapes.linear_curve import LinearCurve, RoundSegments
from mitsuba_ref.error_model.defect_conditions import WIDENED_BOUNDS_FACTOR, DefectView, KnownDefect
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, expected_points
from mitsuba_ref.error_model.intersections import (
    Array,
    ErrorModel,
    Intersections,
    UvSpace,
    by_columns,
    dot,
    norm,
    position_error,
    stacked_columns,
    unit,
    without_edges,
    without_float_warnings,
)
from mitsuba_ref.error_model.tolerances import KU
from mitsuba_ref.oracle.exact_kinds import SEGMENTS as EXACT
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement, format_floats
from mitsuba_ref.shapes.shape_reference import Fields, PrimitiveReference, ShapeReference
from mitsuba_ref.shapes.sphere import unit_sphere_points
from mitsuba_ref.shapes.surface_errors import root_change
from mitsuba_ref.shapes.targets import Rng, SurfacePoints, coin_flip, random_fractions, random_length, random_point


def to_xml(out: ShapeWriter, shape: LinearCurve, part: RoundSegments) -> list[XmlElement]:
    """A text file of control points in world space, each curve after an empty line."""
    lines: list[str] = []
    for k, (start, end) in enumerate(zip(part.start, part.end, strict=True)):
        if k == 0 or (start != part.end[k - 1]).any() or part.radius[k, 0] != part.radius[k - 1, 1]:
            lines += ["", format_floats([*start, part.radius[k, 0]])]
        lines.append(format_floats([*end, part.radius[k, 1]]))
    return [out.from_file(shape, "linearcurve", "txt", "\n".join([*lines[1:], ""]).encode())]


@without_float_warnings
def intersect(prims: Any, k: Array, o: Array, d: Array, ku: float) -> tuple[Intersections, ...]:
    """Where ray i enters segment k[i]: on its cone, on the sphere at its start, on that at its end.

    Embree solves A t^2 + 2 B t + C = 0 as it stands, from h, the point of the ray that is nearest to the middle of the
    segment, relative to the start: for the cone in lengths of its axis P, with A = g d.d - (d.P)^2, g = P.P - dr^2. A
    hit on a sphere counts only where that equation has roots and A is not 0. Hits are told apart by their heights
    h.P + r dr, from 0 to g on the cone. If h is off by e, C changes by 2 g e times its distance from the axis.
    """
    a, b = by_columns(prims.start[k]), by_columns(prims.end[k])
    r0, r1 = prims.radius[k].T
    o, d = by_columns(o), by_columns(d)
    p, dr, dd = b - a, r1 - r0, dot(d, d)
    g, slope, size, length = dot(p, p) - dr * dr, dot(p, d), norm(p), norm(d)
    w, middle = size * size + dr * dr, dot(0.5 * (a + b) - o, d) / dd
    off = ku * (norm(o) + np.abs(middle) * length + norm(a) + norm(b))
    near = o + middle[:, None] * d
    h = near - a
    reach, lift = norm(h) + r0 + r1, dot(h, p) + r0 * dr
    qa, qb, qc = g * dd - slope * slope, g * dot(h, d) - slope * lift, g * (dot(h, h) - r0 * r0) - lift * lift
    qa_error, qb_error = 2.0 * ku * w * dd, w * length * (2.0 * ku * reach + off)
    qc_error = 2.0 * w * (ku * reach * reach + off * (norm(h - p * (lift / g)[:, None]) + off))
    within, cone = qb * qb - qa * qc, g > ku * w
    change = 2.0 * (np.abs(qb) + qb_error) * qb_error + (np.abs(qa) + qa_error) * qc_error + qa_error * np.abs(qc)
    root = np.sqrt(np.maximum(within, 0.0))
    t = np.where(qb >= 0.0, (-qb - root) / qa, qc / (root - qb))
    t_error = (qb_error + root_change(root, change) + np.abs(t) * qa_error) / np.maximum(np.abs(qa) - qa_error, 0.0)
    crosses, resolved = within >= -change, (within > change) & (np.abs(qa) > qa_error) & cone
    # t from the middle, its error, whether it is possible and certain: on the cone, then on the spheres
    found = [(t, t_error, crosses & cone, resolved & np.isfinite(t_error))]
    for center, r in ((a, r0), (b, r1)):
        f = near - center
        away, slide = norm(f) + r, dot(f, d)
        inside, change = slide * slide - dd * (dot(f, f) - r * r), 4.0 * dd * away * (ku * away + off)
        half = np.sqrt(np.maximum(inside, 0.0))
        error = (root_change(half, change) + length * (ku * away + off)) / dd
        possible = (crosses | ~cone) & (inside >= -change)
        found.append(((-slide - half) / dd, error, possible, resolved & (inside > change)))
    out = []
    for place, (t, t_error, possible, certain) in enumerate(found):
        height = lift + t * slope
        height_error = size * (ku * (reach + np.abs(t) * length) + off) + np.abs(slope) * t_error + ku * w
        room = (np.minimum(height, g - height), -height, height - g)[place]
        share = (np.clip(height / g, 0.0, 1.0), 0.0 * g, 0.0 * g + 1.0)[place]
        x = near + t[:, None] * d
        n = unit(x - a - share[:, None] * p)
        t_error = t_error + ku * (np.abs(middle) + np.abs(t))
        p_error = position_error(o, d, middle + t, t_error, ku) + off
        share_error = height_error / np.abs(g)
        n_error = (p_error + (size * share_error if place == 0 else 0.0)) / (r0 + share * dr) + ku
        possible, certain = possible & (room >= -height_error), certain & (room > height_error)
        uv = stacked_columns(0.0 * share, share, 0.0 * share)
        out.append(without_edges(middle + t, t_error, n, n_error, possible, certain, p_error, uv, share_error + ku))
    return tuple(out)


def describe(part: RoundSegments, k: int) -> Fields:
    ends = [part.start[k].tolist(), part.end[k].tolist()]
    return {"type": "linear_curve", "points": ends, "radii": part.radius[k].tolist()}


def expected(shape: LinearCurve, part: RoundSegments) -> Iterator[ExpectedNumbers]:
    """Both ends and radii of each segment, curve by curve. The contents of a file are checked elsewhere."""
    points, radii, counts = shape.curves()
    linear = shape.matrix[:3, :3]
    curves = [(points[i : i + n], radii[i : i + n]) for i, n in zip(np.cumsum(counts) - counts, counts, strict=True)]
    ends = np.concatenate([np.stack([p[:-1], p[1:]], axis=1) for p, _ in curves])
    scale = np.exp(np.linalg.slogdet(linear)[1] / 3.0)
    sizes = scale * np.concatenate([np.column_stack([r[:-1], r[1:]]) for _, r in curves])
    yield expected_points(shape, "ends", np.stack([part.start, part.end], axis=1), ends)
    yield ExpectedNumbers("radii", part.radius, sizes, np.linalg.cond(linear) * sizes)


def on_segments(prims: Any, k: Array, rng: Rng, sort: str) -> SurfacePoints:
    """Where cones touch spheres of the hull, those at their ends for corners and edges; half of "inside" on caps."""
    p, along, n = unit_sphere_points(rng, len(k), sort)
    share, coin = random_fractions(rng, len(k)), rng.random((len(k), 1)) < 0.5
    axis, grow = prims.end[k] - prims.start[k], np.diff(prims.radius[k], axis=1)
    cap, end = (sort == "inside") & coin, dot(n, axis)[:, None] + grow > 0.0
    share = np.where(cap | (sort in ("corner", "edge")), end, share)
    radius = prims.radius[k, :1] + share * grow
    around = unit(np.cross(axis, n))
    length = np.maximum(norm(axis), 1e-300)[:, None]
    tilt = np.clip(-grow / length, -1.0, 1.0)
    on_cone = tilt * axis / length + np.sqrt(1.0 - tilt * tilt) * np.cross(around, axis / length)
    away = np.where(cap, n, on_cone)
    along = np.where(cap, along, np.where(coin, around, np.cross(around, on_cone)))
    return SurfacePoints(prims.start[k] + share * axis + radius * norm(p)[:, None] * away, radius * along, away)


def view_segment(prims: Any, k: int, o: Array, d: Array, t: float) -> DefectView:
    """Whether the ray starts within any hull, up to its rounding and that of the origin."""
    away, axis, change = o - prims.start, prims.end - prims.start, np.diff(prims.radius, axis=1)[:, 0]
    grown = np.maximum(dot(axis, axis) - change * change, np.finfo(float).tiny)  # 0: one sphere is within the other
    share = np.clip((dot(away, axis) + prims.radius[:, 0] * change) / grown, 0.0, 1.0)
    radius = prims.radius[:, 0] + share * change
    rounding = WIDENED_BOUNDS_FACTOR * KU * (norm(o[None]) + norm(prims.start) + norm(axis) + radius)
    return DefectView(starts_inside=bool((norm(away - share[:, None] * axis) <= radius + rounding).any()))


def random_fields(rng: Rng, lattice: bool) -> Fields:
    """One curve of two to five points, or two curves, with one radius each or a common one."""
    count = int(rng.integers(2, 6))
    points = [random_point(rng, lattice) for _ in range(count)]
    out: Fields = {"points": points} | ({"counts": [2, count - 2]} if count > 3 and coin_flip(rng) else {})
    if coin_flip(rng):
        return out | {"radius": 0.5 * random_length(rng, lattice)}
    return out | {"radii": [0.5 * random_length(rng, lattice) for _ in range(count)]}


SEGMENTS = PrimitiveReference(
    RoundSegments,
    ErrorModel(intersect, EXACT, uv=UvSpace(reference=None)),
    describe,
    on_segments,
    # Embree leaves out the caps between the segments of a curve, which a ray from inside meets, and may report t = 0
    known_defects=(
        KnownDefect(
            78, "a ray that starts within a curve, whose surface Mitsuba has in part", 24, lambda m: m.starts_inside
        ),
    ),
    defect_view=view_segment,
)
REFERENCE = ShapeReference(LinearCurve, to_xml, (SEGMENTS,), expected, random_fields, drawn_for="cylinder")

"""The oracle's float64 filter never rejects a primitive that a ray hits."""

import math

import numpy as np
import pytest
from oracle_aims import KINDS, SCALES, aim, packed, triangles

from mitsuba_ref.oracle.exact_numbers import integer_rays
from mitsuba_ref.oracle.oracle import EXACT_KINDS, BoxTree, Oracle, RayColumns, slab_test

COUNT = 300


def lost(kind: str, scale: str, seed: int = 1) -> tuple[int, int, int]:
    """(pairs that meet and are sorted out, or met before `near`; pairs that meet; pairs that are sorted out)."""
    prims, o, d = aim(kind, scale, seed, COUNT)
    arithmetic = EXACT_KINDS[type(prims)]
    k, n = np.arange(COUNT), COUNT
    low, high = (corner.T for corner in arithmetic.boxes(prims))
    kept, near = slab_test(RayColumns(o.T, d.T, np.full(n, -math.inf), np.full(n, math.inf)), k, low, high)
    if arithmetic.may_intersect is not None:
        kept &= arithmetic.may_intersect(prims, k, o, d)
    wrong = meeting = 0
    for i, ray in enumerate(integer_rays(o, d)):
        met = arithmetic.intersect(arithmetic.prepare(prims, i), ray)
        first = [t for t, _ in met.roots] + [touch.first for touch in met.contacts if touch.first is not None]
        meeting += bool(first)
        wrong += any(not kept[i] or t < near[i] for t in first)
    return wrong, meeting, int(n - kept.sum())


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_sorted_out_is_not_hit(kind):
    totals = np.zeros(3, int)
    for scale in SCALES:
        found = lost(kind, scale)
        assert found[0] == 0, scale
        totals += found
    assert totals[1] >= 500 and (totals[2] >= 40 or kind == "Planes"), totals


def bumpy(rows: int, columns: int) -> np.ndarray:
    """Faces (2 rows columns, 3, 3) of a closed, bumpy ball; whole numbers of 1/64."""
    v, u = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij")
    r = 1.0 + 0.1 * np.sin(9 * u) * np.sin(7 * v)
    p = np.stack([r * np.sin(v) * np.cos(u), r * np.sin(v) * np.sin(u), r * np.cos(v)], axis=-1)
    p = np.rint(4096.0 * p)
    p[:, -1], p[0], p[-1] = p[:, 0], [0, 0, 4096.0], [0, 0, -4096.0]
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.stack([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)]).reshape(-1, 3, 3)


def rays_at(corners: np.ndarray, rng, n: int) -> tuple[np.ndarray, np.ndarray]:
    """From outside at corners, midpoints and insides, exactly; and some anywhere."""
    weights = np.array([[4, 0, 0], [2, 2, 0], [1, 1, 2]])[np.arange(n) % 3] / 4.0
    p = np.einsum("ij,ijk->ik", weights, corners[rng.integers(0, len(corners), n)])
    d = rng.integers(-4096, 4096, (n, 3)).astype(float)
    return p - 4.0 * d, d


def by_trying_all(oracle: Oracle, o, d):
    """(t, prims) without boxes and without float64."""
    (ray,) = integer_rays(o[None], d[None])
    (part,) = oracle.primitives.parts
    kind, found = part.kind, []
    for k in range(len(part.ids)):
        found += [(t, k) for t, _ in kind.intersect(kind.prepare(part.prims, k), ray).roots if t > 0]
    best = min((t for t, _ in found), default=None)
    return best, [k for t, k in found if t == best]


@pytest.mark.parametrize(("rows", "columns", "rays"), [(187, 187, 3), (24, 25, 60)])
def test_a_mesh_is_answered_as_by_trying_every_face(rows, columns, rays):
    """70,000 faces with a few rays, 1200 with more."""
    rng = np.random.default_rng(rows)
    corners = bumpy(rows, columns)
    oracle = Oracle(packed(triangles(corners)))
    o, d = rays_at(corners, rng, rays)
    answers = oracle.first_hits(o, d)
    for i, answer in enumerate(answers):
        best, prims = by_trying_all(oracle, o[i], d[i])
        assert (answer.t, [hit.prim for hit in answer.ties]) == (best, prims)
    assert sum(answer.hit for answer in answers) >= rays // 2
    assert rays < 10 or sum(len(answer.ties) > 1 for answer in answers) >= 5


def test_few_faces_are_left_for_whole_numbers():
    """Of 70,000 faces, at a ray that meets some: a handful, or an oracle that sorts out nothing would do as well."""
    corners = bumpy(187, 187)
    oracle = Oracle(packed(triangles(corners)))
    o, d = rays_at(corners, np.random.default_rng(1), 300)
    span = np.zeros(300), np.full(300, math.inf)
    left = [len(near) for near in oracle.primitives.candidates(RayColumns(o.T.copy(), d.T.copy(), *span))]
    assert len(left) == 300 and 1.0 <= np.mean(left) <= 12.0 and max(left) <= 400, (np.mean(left), max(left))


def test_a_box_tree_passes_what_its_boxes_pass():
    """Boxes that are points, planes of boxes, equal boxes, and boxes of 1e300 and 1e-300."""
    rng = np.random.default_rng(5)
    middle = np.concatenate([rng.normal(size=(500, 3)), np.zeros((40, 3)), 1e300 * rng.normal(size=(100, 3))])
    size = np.concatenate([10.0 ** rng.uniform(-300, 0, (500, 3)), np.zeros((40, 3)), np.full((100, 3), 1e299)])
    size[::7, 1] = 0.0
    low, high = middle - size, middle + size
    target = middle[rng.integers(0, 640, 400)]
    o = np.where(rng.random((400, 1)) < 0.5, rng.normal(size=(400, 3)), target)
    d = (target * 0.5 - o * 0.5) * np.where(rng.random((400, 3)) < 0.1, 0.0, 1.0)
    d[(d == 0.0).all(axis=1)] = [0.0, -0.0, 1e-320]
    rays = RayColumns(o.T.copy(), d.T.copy(), np.zeros(400), np.full(400, math.inf))
    crossings = BoxTree(low, high).crossings(rays)
    assert crossings is not None
    ray, box = (a.ravel() for a in np.indices((400, 640)))
    met, _ = slab_test(rays, ray, low[box].T, high[box].T)
    assert set(zip(crossings.ray.tolist(), crossings.box.tolist(), strict=True)) == set(
        zip(ray[met].tolist(), box[met].tolist(), strict=True)
    )
    assert met.sum() >= 400

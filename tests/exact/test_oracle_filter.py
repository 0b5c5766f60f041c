"""The oracle's boxes in float64 never reject a primitive that a ray hits."""

import math

import numpy as np
import pytest
from oracle_aims import KINDS, SCALES, aim, packed, triangles

from mitsuba_ref.oracle.boxes import BoxTree
from mitsuba_ref.oracle.exact_numbers import integer_rays
from mitsuba_ref.oracle.oracle import BOX_MARGIN, Oracle

COUNT = 300


def lost(kind: str, scale: str, seed: int = 1) -> tuple[int, int, int]:
    """(pairs that meet and are sorted out, or met before `near`; pairs that meet; pairs that are sorted out)."""
    prims, o, d = aim(kind, scale, seed, COUNT)
    (part,) = Oracle(packed(prims)).parts
    kept, near = np.zeros(COUNT, bool), np.full(COUNT, math.inf)
    for found in BoxTree(*part.kind.boxes(prims), BOX_MARGIN).crossings(o, d, -math.inf):
        own = found.ray == found.box
        kept[found.ray[own]], near[found.ray[own]] = True, found.near[own]
    wrong = meeting = 0
    for i, ray in enumerate(integer_rays(o, d)):
        first = [t for t, _ in part.intersect(i, ray)]
        meeting += bool(first)
        wrong += any(not kept[i] or t < near[i] for t in first)
    return wrong, meeting, int(COUNT - kept.sum())


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_sorted_out_is_not_hit(kind):
    totals = np.zeros(3, int)
    for scale in SCALES:
        found = lost(kind, scale)
        assert found[0] == 0, scale
        totals += found
    assert totals[1] >= 500 and (totals[2] >= 15 or kind == "Planes"), totals


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


def test_few_faces_are_left_for_whole_numbers():
    """Of 70,000 faces, at a ray that meets some: tens, or an oracle that sorts out nothing would do as well."""
    corners = bumpy(187, 187)
    oracle = Oracle(packed(triangles(corners)))
    o, d = rays_at(corners, np.random.default_rng(1), 300)
    left = [len(near) for near in oracle.candidates(o, d, np.zeros(300), np.full(300, math.inf))]
    assert len(left) == 300 and 1.0 <= np.mean(left) <= 30.0 and max(left) <= 600, (np.mean(left), max(left))

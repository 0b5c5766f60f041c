"""Newell's teapot, as finely as wanted."""

import numpy as np

from caster.mesh import Floats, Ints, Mesh, unit_rows
from caster.procedural.parameters import check_whole
from caster.procedural.teapot_patches import PARTS, patches

MAX_SUBDIVISIONS = 128  # 1,047,552 faces


def teapot(subdivisions: int) -> Mesh:
    """64 n^2 - 8 n faces for n subdivisions of each patch; z up, spout towards +x, about 6.4 by 4 by 3.15.

    subdivisions: parts along either side of a patch, 1 to 128. The normals are the exact surface's. Body,
    handle, spout and lid are open surfaces that touch or pass through each other, as published.
    Raises SceneError for anything else.
    """
    check_whole("teapot", "subdivisions", subdivisions, 1, MAX_SUBDIVISIONS)
    points, normals = _evaluate(patches(), subdivisions)
    shape = points.shape[:3]
    keys = np.concatenate([np.broadcast_to(PARTS[:, None, None, None], (*shape, 1)), points], axis=3)
    _, first, vertex = np.unique(keys.reshape(-1, 4), axis=0, return_index=True, return_inverse=True)
    faces = _faces(vertex.reshape(shape).astype(np.int32))
    return Mesh(points.reshape(-1, 3)[first], faces, unit_rows(normals.reshape(-1, 3)[first]))


def _evaluate(nets: Floats, n: int) -> tuple[Floats, Floats]:
    """Points and normals (of any length) of the patches on a grid: (p, n + 1, n + 1, 3) each."""
    at, slope = _bernstein(n)
    along_u, du = _weigh(at, nets, 1), _weigh(slope, nets, 1)
    along_v = _weigh(slope, along_u, 2)
    points = _weigh(at, along_u, 2)
    # Where a ring of control points is one point, the way around it has no length. Close by, it has the
    # direction of the mixed derivative, as dv(u) = dv(0) + u duv + ... with dv(0) = 0.
    pole = np.all(nets[:, 0] == nets[:, 0, :1], axis=(1, 2))
    along_v[pole, 0] = _weigh(slope, du, 2)[pole, 0]
    points[pole, 0] = nets[pole, 0, :1]  # weights add up to 1 only nearly, which would make it several points
    return points, np.cross(along_v, _weigh(at, du, 2))


def _bernstein(n: int) -> tuple[Floats, Floats]:
    """(n + 1, 4) weights of the control points at 0, 1/n ... 1, for the value and for a third of the slope.

    Both are mirror images of themselves to the bit: patches that run along a shared border in opposite
    directions get the same points there.
    """
    t = np.arange(n + 1) / n
    s = t[::-1]  # 1 - t, but rounded as t is
    value = np.stack([s * s * s, 3.0 * (s * s) * t, 3.0 * (t * t) * s, t * t * t], axis=1)
    slope = np.stack([-s * s, s * s - 2.0 * (s * t), 2.0 * (s * t) - t * t, t * t], axis=1)
    return value, slope


def _weigh(weights: Floats, nets: Floats, axis: int) -> Floats:
    """Sum the four control points along an axis, outer and inner pair, so that both directions sum alike."""
    p = np.moveaxis(nets, axis, 0)[:, None]
    w = weights.T.reshape(4, -1, *[1] * (nets.ndim - 1))
    total = (w[0] * p[0] + w[3] * p[3]) + (w[1] * p[1] + w[2] * p[2])
    return np.moveaxis(total, 0, axis)


def _faces(vertex: Ints) -> Ints:
    """Two triangles for each cell of (p, n + 1, n + 1) vertex numbers; one where a side is a pole."""
    here, around = vertex[:, :-1, :-1], vertex[:, :-1, 1:]
    along, opposite = vertex[:, 1:, :-1], vertex[:, 1:, 1:]
    triangles = np.stack([here, around, opposite, here, opposite, along], axis=3).reshape(-1, 3)
    flat = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    kept: Ints = triangles[~flat].astype(np.int32)
    return kept

"""Martin Newell's teapot, tessellated from 32 bicubic Bezier patches.

Source: the data set that M. E. Newell published (University of Utah, 1975; 28 patches), in the form in use
since: z up, lower than the real pot, four patches added for a bottom, 306 control points (teapot.txt).
"""

from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from caster.geometry.triangle_mesh import Floats, Mesh, grid_faces, normalize_rows
from caster.geometry.world_space import MeshShape

# The part each patch belongs to: body, handle, spout, lid, and the bottom, which closes the body. Patches of
# one part join smoothly; parts only touch.
PARTS = np.repeat([0, 1, 2, 3, 0], [12, 4, 4, 8, 4])


@cache
def patches() -> Floats:
    """(32, 4, 4, 3) control points in the published order: [patch, along u, along v, xyz].

    u runs along the profile, handle or spout and v around it; dp/dv x dp/du points outwards.
    """
    return np.loadtxt(Path(__file__).with_suffix(".txt")).reshape(32, 4, 4, 3)


def _evaluate(nets: Floats, n: int) -> tuple[Floats, Floats]:
    """Points and normals (of any length) of the patches on a grid: (p, n + 1, n + 1, 3) each."""
    # (n + 1, 4) weights of the control points at 0, 1/n ... 1, for the value and for a third of the slope. Both are
    # mirror images of themselves to the bit: patches that run along a shared border in opposite directions get the same
    # points there.
    t = np.arange(n + 1) / n
    s = t[::-1]  # 1 - t, but rounded as t is
    at = np.stack([s * s * s, 3.0 * (s * s) * t, 3.0 * (t * t) * s, t * t * t], axis=1)
    slope = np.stack([-s * s, s * s - 2.0 * (s * t), 2.0 * (s * t) - t * t, t * t], axis=1)
    along_u, du = _weigh(at, nets, 1), _weigh(slope, nets, 1)
    along_v = _weigh(slope, along_u, 2)
    points = _weigh(at, along_u, 2)
    # Where a ring of control points is one point, the way around it has no length. Close by, it has the
    # direction of the mixed derivative, as dv(u) = dv(0) + u duv + ... with dv(0) = 0.
    pole = np.all(nets[:, 0] == nets[:, 0, :1], axis=(1, 2))
    along_v[pole, 0] = _weigh(slope, du, 2)[pole, 0]
    points[pole, 0] = nets[pole, 0, :1]  # weights add up to 1 only nearly, which would make it several points
    return points, np.cross(along_v, _weigh(at, du, 2))


def _weigh(weights: Floats, nets: Floats, axis: int) -> Floats:
    """Sum the four control points along an axis, outer and inner pair, so that both directions sum alike."""
    p = np.moveaxis(nets, axis, 0)[:, None]
    w = weights.T.reshape(4, -1, *[1] * (nets.ndim - 1))
    total = (w[0] * p[0] + w[3] * p[3]) + (w[1] * p[1] + w[2] * p[2])
    return np.moveaxis(total, 0, axis)


class Teapot(MeshShape):
    """The 32 published Bezier patches, each cut into 2 subdivisions^2 triangles; z is up."""

    type: Literal["teapot"] = "teapot"
    subdivisions: Annotated[int, Field(strict=True, ge=1, le=64)] = 8

    def mesh(self) -> Mesh:
        """64 n^2 - 8 n faces for n subdivisions; z up, spout towards +x, about 6.4 by 4 by 3.15.

        The normals are the exact surface's. Body, handle, spout and lid are open surfaces that touch or pass through
        each other, as published.
        """
        points, normals = _evaluate(patches(), self.subdivisions)
        shape = points.shape[:3]
        keys = np.concatenate([np.broadcast_to(PARTS[:, None, None, None], (*shape, 1)), points], axis=3)
        _, first, vertex = np.unique(keys.reshape(-1, 4), axis=0, return_index=True, return_inverse=True)
        faces = grid_faces(vertex.reshape(shape).astype(np.int32))
        flat = (faces == np.roll(faces, 1, axis=1)).any(axis=1)  # one side of the cell is a pole
        return Mesh(points.reshape(-1, 3)[first], faces[~flat], normalize_rows(normals.reshape(-1, 3)[first]))

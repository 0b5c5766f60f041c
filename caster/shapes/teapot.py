"""Martin Newell's teapot, tessellated from 32 bicubic Bezier patches.

Source: the data set that M. E. Newell published (University of Utah, 1975; 28 patches), in the form in use
since: z up, lower than the real pot, four patches added for a bottom, 306 control points. The
tables below omit symmetric parts: surfaces of revolution are quarter turns of a profile, handle and spout are mirrored
in y.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from caster.geometry.triangle_mesh import Floats, Mesh, grid_faces, normalize_rows
from caster.geometry.world_space import MeshShape

__all__ = ["Teapot"]

DECIMALS = 6  # more than any published coordinate has: rounding to them brings back the published number

# A quarter turn has its inner control points at 0.56 of the radius beside the axes (a circle would want
# 0.5523), but for the knob's widest ring, which has 0.45 for a radius of 0.8.
BULGE = 0.56
KNOB_BULGE = 0.45 / 0.8


def _table(text: str) -> Floats:
    """Rows of numbers; a bar only separates them for the eye."""
    return np.array([line.replace("|", " ").split() for line in text.strip().splitlines()], np.float64)


# Four rings of control points each, as (radius, z), ordered from inside over the top to outside: down the body and out
# along the bottom.
RIM = _table("""
    1.4    2.4
    1.3375 2.53125
    1.4375 2.53125
    1.5    2.4
""")
BODY = _table("""
    1.5  2.4
    1.75 1.875
    2.0  1.35
    2.0  0.9
""")
FOOT = _table("""
    2.0  0.9
    2.0  0.45
    1.5  0.225
    1.5  0.15
""")
KNOB = _table("""
    0.0  3.15
    0.8  3.15
    0.0  2.85
    0.2  2.7
""")
LID = _table("""
    0.2  2.7
    0.4  2.55
    1.3  2.55
    1.3  2.4
""")
BOTTOM = _table("""
    0.0   0.0
    1.425 0.0
    1.5   0.075
    1.5   0.15
""")

# Handle and spout, one line for each ring of control points: (x, z) where it meets y = 0, facing the pot and
# facing away, and how far it reaches to each side of y = 0.
HANDLE = _table("""
    -1.6 2.025 | -1.5  2.25   | 0.3
    -2.3 2.025 | -2.5  2.25   | 0.3
    -2.7 2.025 | -3.0  2.25   | 0.3
    -2.7 1.8   | -3.0  1.8    | 0.3
    -2.7 1.575 | -3.0  1.35   | 0.3
    -2.5 1.125 | -2.65 0.9375 | 0.3
    -2.0 0.9   | -1.9  0.6    | 0.3
""")
SPOUT = _table("""
    1.7 1.425 | 1.7   0.6     | 0.66
    2.6 1.425 | 3.1   0.825   | 0.66
    2.3 2.1   | 2.4   2.025   | 0.25
    2.7 2.4   | 3.3   2.4     | 0.25
    2.8 2.475 | 3.525 2.49375 | 0.25
    2.9 2.475 | 3.45  2.5125  | 0.15
    2.8 2.4   | 3.2   2.4     | 0.15
""")

# The part each patch belongs to: body, handle, spout, lid, and the bottom, which closes the body. Patches of
# one part join smoothly; parts only touch.
PARTS = np.repeat([0, 1, 2, 3, 0], [12, 4, 4, 8, 4])


def patches() -> Floats:
    """(32, 4, 4, 3) control points in the published order: [patch, along u, along v, xyz].

    u runs along the profile, handle or spout and v around it; dp/dv x dp/du points outwards.
    """
    turned = [net for profile in (RIM, BODY, FOOT) for net in _turned(profile, -1.0)]
    bent = [net for rings in (HANDLE, SPOUT) for part in (rings[:4], rings[3:]) for net in _halves(part)]
    lid = [net for profile in (KNOB, LID) for net in _turned(profile, -1.0)]
    return np.array(turned + bent + lid + _turned(BOTTOM, 1.0))


def _turned(profile: Floats, sense: float) -> list[Floats]:
    """Revolve a profile about z: four 90-degree patches from +x, towards +y for sense 1 and -y for sense -1."""
    radius, z = profile.T
    bulge = np.array([BULGE, KNOB_BULGE if profile is KNOB else BULGE, BULGE, BULGE])
    beside, none = (radius * bulge).round(DECIMALS), np.zeros(4)
    ahead, aside = np.stack([radius, radius, beside, none], axis=1), np.stack([none, beside, radius, radius], axis=1)
    height = np.broadcast_to(z[:, None], (4, 4))
    quarters = ((ahead, aside), (-aside, ahead), (-ahead, -aside), (aside, -ahead))
    return [np.stack([x, sense * y, height], axis=-1) + 0.0 for x, y in quarters]  # + 0.0 leaves no -0.0


def _halves(rings: Floats) -> list[Floats]:
    """The half at y < 0, and its mirror image run through the other way."""
    x0, z0, x1, z1, reach = rings.T
    none = np.zeros(len(rings))
    half = np.stack([[x0, x0, x1, x1], [none, -reach, -reach, none], [z0, z0, z1, z1]]).T
    return [half, half[:, ::-1] * (1.0, -1.0, 1.0) + 0.0]


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

"""Closed forms of generated meshes: torus, icosphere, heightfield, teapot, and uv of the cube, written a second time.

A mesh that the caster generates reaches both sides of a comparison, so no pixel shows an error in it. Here its vertices
are held to the surface's formula, its normals to the gradient, and its faces to what makes the surface: which vertices
they join, that they close it, and the volume within.
"""

from collections.abc import Iterator
from random import Random
from typing import Any

import numpy as np

from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, exactly
from mitsuba_ref.error_model.intersections import norm


def edges_of(faces: np.ndarray) -> np.ndarray:
    """(m, 2) directed edges of all faces."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def closed(faces: np.ndarray, vertices: int) -> ExpectedNumbers:
    """Every directed edge once, and once in the other direction: no hole, no face twice, and one side outside."""
    return exactly("closed", unpaired_edges(faces, vertices), [0, 0])


def unpaired_edges(faces: np.ndarray, vertices: int) -> tuple[int, int]:
    """How many directed edges there are more than once, and how many without one in the other direction."""
    start, end = edges_of(faces).T
    between = np.minimum(start, end).astype(np.int64) * vertices + np.maximum(start, end)
    directed = np.sort(2 * between + (start > end))  # both directions of an edge are neighbours
    first = np.flatnonzero(np.diff(directed, prepend=-1))
    different, repeated = directed[first], np.diff(first, append=len(directed))
    paired = np.zeros(len(different), bool)
    both = different[1:] == different[:-1] + 1 - 2 * (different[:-1] & 1)
    paired[1:] |= both
    paired[:-1] |= both
    points = int((start == end).sum())  # of faces without area: such an edge is its own other direction
    return len(directed) - len(different), int(repeated[~paired].sum()) - points


def volume(vertices: np.ndarray, faces: np.ndarray, expected: float) -> ExpectedNumbers:
    """Of the body within, by the tetrahedra from the origin; of the right sign where the outside is outside."""
    a, b, c = (vertices[faces[:, j]] for j in range(3))
    terms = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    size = np.einsum("ij,ij->i", np.abs(a), _permanent(b, c)).sum() / 6.0
    return ExpectedNumbers("volume", terms.sum(), np.asarray(expected), size)


def _permanent(b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """The cross product with every minus made a plus and every number its magnitude."""
    b, c = np.abs(b), np.abs(c)
    return np.stack([b[:, i - 2] * c[:, i - 1] + b[:, i - 1] * c[:, i - 2] for i in range(3)], axis=1)


def roots_of_unity(count: int) -> np.ndarray:
    """Points of the unit circle in the complex plane, from 1 on."""
    return np.exp(2j * np.pi * np.arange(count) / count)


def expected_torus(shape: Any) -> Iterator[ExpectedNumbers]:
    """Its points lie on the quartic at equal angles, its normals along the gradient, its faces on neighbours.

    The volume between an m-gon turned around an n-gon is m n / 2 * R r^2 sin(2 pi / m) sin(2 pi / n), by Pappus.
    """
    mesh, m, n = shape.mesh(), shape.segments, shape.sides
    far, near = shape.major_radius, shape.minor_radius
    grid = mesh.vertices.reshape(m, n, 3) if len(mesh.vertices) == m * n else np.full((m, n, 3), np.nan)
    around, across = roots_of_unity(m)[:, None], roots_of_unity(n)[None, :]
    flat = (far + near * across.real) * around
    height = np.broadcast_to(near * across.imag, flat.shape)
    points = np.stack([flat.real, flat.imag, height], axis=2)
    turned = 2.0 * np.pi * (far + near)  # an angle of up to a turn is rounded on the way
    yield ExpectedNumbers("points of a torus", grid, points, np.asarray(turned))
    rho = np.hypot(grid[..., 0], grid[..., 1])
    slack = 1.0 - far / rho
    gradient = np.stack([slack * grid[..., 0], slack * grid[..., 1], grid[..., 2]], axis=2) / near
    yield ExpectedNumbers("normals of a torus", mesh.normals, gradient.reshape(-1, 3), np.asarray(turned / near))
    i, j = np.divmod(mesh.faces, n)
    apart = [(np.ptp((steps - steps[:, :1] + 1) % count, axis=1) == 1).all() for steps, count in ((i, m), (j, n))]
    yield exactly("faces of neighbours", [len(mesh.faces), *apart], [2 * m * n, 1, 1])
    yield closed(mesh.faces, m * n)
    sines = np.sin(2.0 * np.pi / m) * np.sin(2.0 * np.pi / n)
    yield volume(mesh.vertices, mesh.faces, m * n / 2.0 * far * near**2 * sines)


def expected_icosphere(shape: Any) -> Iterator[ExpectedNumbers]:
    """Twenty triangles of an icosahedron, split in four by the middles of their sides, out on the unit sphere."""
    mesh, levels = shape.mesh(), shape.subdivisions
    count = 4**levels
    yield exactly("number of faces and vertices", [len(mesh.faces), len(mesh.vertices)], [20 * count, 10 * count + 2])
    if len(mesh.faces) != 20 * count:
        return
    corners = mesh.vertices[mesh.faces].reshape(20, count, 3, 3)
    last = (count - 1) // 3  # of the quarters at a corner, at every level the same
    base = np.stack([corners[:, 0, 0], corners[:, last, 1], corners[:, 2 * last, 2]], axis=1)
    dots = np.einsum("fij,fkj->fik", base, base)
    regular = np.where(np.eye(3, dtype=bool), 1.0, 1.0 / np.sqrt(5.0))
    yield ExpectedNumbers("angles of an icosahedron", dots, np.broadcast_to(regular, dots.shape), np.ones(()))
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    sides = np.sort(np.abs(base), axis=2) * np.sqrt(1.0 + golden**2)
    yield ExpectedNumbers(
        "golden rectangles", sides, np.broadcast_to([0.0, 1.0, golden], sides.shape), np.full((), golden)
    )
    triangles = base
    for _ in range(levels):
        a, b, c = (triangles[:, j] for j in range(3))
        ab, bc, ca = (middle / norm(middle)[:, None] for middle in (a + b, b + c, c + a))
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.stack([np.stack(each, axis=1) for each in quarters], axis=1).reshape(-1, 3, 3)
    yield ExpectedNumbers("split triangles", corners, triangles.reshape(corners.shape), np.asarray(1.0 + levels))
    yield ExpectedNumbers("unit sphere", norm(mesh.vertices), np.ones(len(mesh.vertices)), np.ones(()))
    yield exactly("normals of a sphere", mesh.normals, mesh.vertices)
    yield closed(mesh.faces, len(mesh.vertices))
    outward = np.einsum("fij,fj->f", triangles, np.cross(triangles[:, 1], triangles[:, 2]))
    yield exactly("outside", np.sign(outward), np.ones(len(outward)))


def expected_heightfield(shape: Any) -> Iterator[ExpectedNumbers]:
    """Heights and slopes of the sum of waves, as parts of complex exponentials, over a square grid."""
    mesh, n = shape.mesh(), shape.resolution
    wave, phase, height = _waves(shape)
    steps = np.arange(n + 1) / n
    v, u = (axis.ravel() for axis in np.meshgrid(steps, steps, indexing="ij"))
    place = (u - 0.5) * shape.size + 1j * (v - 0.5) * shape.size
    z = np.zeros(len(place), complex)
    slope = np.zeros(len(place), complex)
    reach = shape.size * np.abs(wave) + np.abs(phase) + 1.0  # of the angle
    for k, each in enumerate(wave):
        turn = height[k] * np.exp(1j * ((place * np.conj(each)).real + phase[k]))
        z += turn
        slope += turn.real * each
    points = np.stack([place.real, place.imag, z.imag], axis=1)
    size = np.array([shape.size, shape.size, height @ reach])
    yield ExpectedNumbers("points of the waves", mesh.vertices, points, size)
    normals = np.stack([-slope.real, -slope.imag, np.ones(len(slope))], axis=1)
    yield ExpectedNumbers(
        "normals of the waves", mesh.normals, normals / norm(normals)[:, None], 1.0 + (height * np.abs(wave)) @ reach
    )
    yield exactly("uv of the waves", mesh.uv, np.stack([u, v], axis=1))
    j, i = np.divmod(mesh.faces, n + 1)
    a, b, c = (np.stack([i[:, k], j[:, k]], axis=1) for k in range(3))
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    widths = np.concatenate([np.ptp(i, axis=1), np.ptp(j, axis=1)])
    yield exactly(
        "faces of half a cell", [len(doubled), np.abs(doubled - 1).max(), np.abs(widths - 1).max()], [2 * n * n, 0, 0]
    )
    yield exactly("open at the rim alone", unpaired_edges(mesh.faces, len(place)), [0, 4 * n])


# The axes along which u and v grow from 0 to 1 on each side of the cube, as on that of Mitsuba.
CUBE_UV_AXES = {"+x": "+y-z", "-x": "+y+z", "+y": "-x-z", "-y": "+z+x", "+z": "+y+x", "-z": "-y+x"}


def expected_cube_uv(shape: Any) -> Iterator[ExpectedNumbers]:
    """Of the corners of every face, by the side that it is on: where all its corners have the same coordinate."""
    mesh = shape.mesh()
    corners = mesh.vertices[mesh.faces]
    side = np.where((corners == corners[:, :1]).all(axis=1), corners[:, 0], 0.0)
    uv = np.full((len(corners), 3, 2), np.nan)
    for name, axes in CUBE_UV_AXES.items():
        on = side @ _axis(name) == 1.0
        uv[on] = 0.5 + 0.5 * corners[on] @ np.stack([_axis(axes[:2]), _axis(axes[2:])], axis=1)
    yield exactly("uv of a cube", _uv_at_corners(mesh), uv)


def _axis(name: str) -> np.ndarray:
    """The unit vector of "+x" to "-z"."""
    axis: np.ndarray = np.eye(3)["xyz".index(name[1])] * float(f"{name[0]}1")
    return axis


def expected_rectangle_uv(shape: Any) -> Iterator[ExpectedNumbers]:
    """(0, 0) at (-1, -1), (1, 1) at (1, 1)."""
    mesh = shape.mesh()
    yield exactly("uv of a rectangle", _uv_at_corners(mesh), (mesh.vertices[mesh.faces][..., :2] + 1.0) / 2.0)


def _uv_at_corners(mesh: Any) -> np.ndarray:
    """(f, 3, 2); NaN of a mesh without."""
    uv: np.ndarray = np.full((*mesh.faces.shape, 2), np.nan) if mesh.uv is None else mesh.uv[mesh.faces]
    return uv


def _waves(shape: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(wave vectors as complex numbers, phases, heights) of the seed: 1 to 12 periods across, equally steep."""
    draw = Random(shape.seed).random
    periods = np.array([12.0 ** draw() for _ in range(shape.waves)])
    turns = np.array([[draw(), draw()] for _ in range(shape.waves)])
    wave = 2.0 * np.pi / shape.size * periods * np.exp(2j * np.pi * turns[:, 0])
    return wave, 2.0 * np.pi * turns[:, 1], shape.amplitude / periods / (1.0 / periods).sum()


# The teapot's control points as they were published: (radius, z) of what is turned around z, from inside over the top
# to the outside; of handle and spout, ring by ring, (x, z) of the side to the pot, (x, z) of the other side, and width.
RIM = ((1.4, 2.4), (1.3375, 2.53125), (1.4375, 2.53125), (1.5, 2.4))
BELLY = ((1.5, 2.4), (1.75, 1.875), (2.0, 1.35), (2.0, 0.9))
FOOT = ((2.0, 0.9), (2.0, 0.45), (1.5, 0.225), (1.5, 0.15))
KNOB = ((0.0, 3.15), (0.8, 3.15), (0.0, 2.85), (0.2, 2.7))
LID = ((0.2, 2.7), (0.4, 2.55), (1.3, 2.55), (1.3, 2.4))
BOTTOM = ((0.0, 0.0), (1.425, 0.0), (1.5, 0.075), (1.5, 0.15))
HANDLE = (
    (
        (-1.6, 2.025, -1.5, 2.25, 0.3),
        (-2.3, 2.025, -2.5, 2.25, 0.3),
        (-2.7, 2.025, -3.0, 2.25, 0.3),
        (-2.7, 1.8, -3.0, 1.8, 0.3),
    ),
    (
        (-2.7, 1.8, -3.0, 1.8, 0.3),
        (-2.7, 1.575, -3.0, 1.35, 0.3),
        (-2.5, 1.125, -2.65, 0.9375, 0.3),
        (-2.0, 0.9, -1.9, 0.6, 0.3),
    ),
)
SPOUT = (
    (
        (1.7, 1.425, 1.7, 0.6, 0.66),
        (2.6, 1.425, 3.1, 0.825, 0.66),
        (2.3, 2.1, 2.4, 2.025, 0.25),
        (2.7, 2.4, 3.3, 2.4, 0.25),
    ),
    (
        (2.7, 2.4, 3.3, 2.4, 0.25),
        (2.8, 2.475, 3.525, 2.49375, 0.25),
        (2.9, 2.475, 3.45, 2.5125, 0.15),
        (2.8, 2.4, 3.2, 2.4, 0.15),
    ),
)
KNOB_BESIDE = {(0.8, 3.15): 0.45}  # the one ring whose inner points are not at 0.56 of the radius


def teapot_nets() -> np.ndarray:
    """(32, 4, 4, 3) control points: 12 patches of the body, 4 of the handle, 4 of the spout, 8 of the lid, 4 below."""
    bent = [side for part in (*HANDLE, *SPOUT) for side in _sides_of(part)]
    body, lid = (RIM, BELLY, FOOT), (KNOB, LID)
    turned = [[net for profile in part for net in _turned(profile)] for part in (body, lid)]
    mirrored = [net * (1.0, -1.0, 1.0) for net in _turned(BOTTOM)]  # the other way round: it faces down
    return np.array([*turned[0], *bent, *turned[1], *mirrored])


def _turned(profile: Any) -> list[np.ndarray]:
    """Four quarters, clockwise seen from above."""
    rings = []
    for radius, z in profile:
        beside = KNOB_BESIDE.get((radius, z), round(0.56 * radius, 6))
        quarter = np.array([radius, radius - 1j * beside, beside - 1j * radius, -1j * radius])
        rings.append([(quarter * (-1j) ** k, z) for k in range(4)])
    return [
        np.array([np.stack([ring.real, ring.imag, np.full(4, z)], axis=1) for ring, z in (each[k] for each in rings)])
        for k in range(4)
    ]


def _sides_of(part: Any) -> list[np.ndarray]:
    """The half at y < 0, and the half at y > 0 from the other end."""
    right = np.array([[(x, 0, z), (x, -w, z), (far, -w, top), (far, 0, top)] for x, z, far, top, w in part])
    return [right, right[:, ::-1] * (1.0, -1.0, 1.0)]


def expected_teapot(shape: Any) -> Iterator[ExpectedNumbers]:
    """Every corner of every face by de Casteljau's subdivision of its patch, and the normal across both tangents."""
    mesh, n = shape.mesh(), shape.subdivisions
    nets = teapot_nets()
    t = np.arange(n + 1) / n
    points, du, dv = _de_casteljau(nets, t)
    cell = [(0, 0), (0, 1), (1, 1), (0, 0), (1, 1), (1, 0)]
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    at = np.stack([(i + a) * (n + 1) + j + b for a, b in cell], axis=2).reshape(n, n, 2, 3)
    is_pole = np.ptp(nets[:, 0], axis=(1,)).max(axis=1) == 0.0  # a first ring of one point
    kept = np.ones((32, n, n, 2), bool)
    kept[is_pole, 0, :, 0] = False  # of which two corners are the pole

    def at_corners(values: np.ndarray) -> np.ndarray:
        return values.reshape(32, -1, 3)[:, at][kept]

    given = mesh.vertices[mesh.faces]
    expected = at_corners(points)
    yield exactly("number of faces", [len(mesh.faces)], [64 * n * n - 8 * n])
    size = np.asarray(2.0 * 4.0)  # coordinates up to 4, through six means: twice the roundings of a transform
    yield ExpectedNumbers("points of the patches", given, expected, size)
    across = np.cross(dv, du)
    poles = np.zeros(points.shape[:3], bool)
    poles[is_pole, 0] = True
    across[poles] = np.sign(points[poles] - (0.0, 0.0, 1.0)) * (0.0, 0.0, 1.0)  # up on the knob, down below
    length = norm(across.reshape(-1, 3)).reshape(across.shape[:3])
    tangents = norm(du.reshape(-1, 3)) * 8.0 + norm(dv.reshape(-1, 3)) * 8.0  # each tangent is off by roundings of 8
    spread = np.where(poles, 1.0, 1.0 + tangents.reshape(length.shape) / length)[..., None]
    unit = across / length[..., None]
    spread = np.broadcast_to(spread, unit.shape)
    if given.shape == expected.shape and mesh.normals is not None:
        yield ExpectedNumbers("normals of the patches", mesh.normals[mesh.faces], at_corners(unit), at_corners(spread))


def _de_casteljau(nets: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(points, thirds of their derivatives by u and by v) of (p, 4, 4, 3) nets on a grid: (p, k, k, 3) each."""
    net = nets[:, None, None] + np.zeros((1, len(t), len(t), 1, 1, 1))
    u, v = t[:, None, None, None, None], t[None, :, None, None, None]
    for _ in range(2):
        net = (1.0 - u) * net[..., :-1, :, :] + u * net[..., 1:, :, :]
        net = (1.0 - v) * net[..., :-1, :] + v * net[..., 1:, :]
    a, b, c, d = (net[..., i, j, :] for i in range(2) for j in range(2))
    u, v = u[..., 0, 0], v[..., 0, 0]
    left, right = (1.0 - u) * a + u * c, (1.0 - u) * b + u * d
    above, below = (1.0 - v) * a + v * b, (1.0 - v) * c + v * d
    return (1.0 - v) * left + v * right, below - above, right - left

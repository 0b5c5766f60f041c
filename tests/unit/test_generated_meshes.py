"""Generated meshes against closed forms: icosphere, torus, heightfield, teapot, rectangle and cube.

A generated mesh reaches both sides of a comparison, so no pixel shows an error in it.
"""

import hashlib
import math
from collections import Counter

import numpy as np
import pytest

import caster
from caster.description.errors import SceneError
from caster.geometry.triangle_mesh import check_mesh, normalize_rows, vertex_normals
from caster.shapes.heightfield import Heightfield
from caster.shapes.icosphere import Icosphere
from caster.shapes.teapot import Teapot, patches
from caster.shapes.torus import Torus

# A handful of roundings of u = 2^-53 each in a sine, a product and a sum.
ROUNDING = 8 * 2.0**-53

MESHES = {  # with the counts of faces and of edges that one face has alone
    "icosahedron": (Icosphere(subdivisions=0).mesh(), 20, 0),
    "icosphere": (Icosphere(subdivisions=3).mesh(), 20 * 4**3, 0),
    "smallest torus": (Torus(major_radius=1.0, minor_radius=0.5, segments=3, sides=3).mesh(), 18, 0),
    "torus": (Torus(major_radius=2.0, minor_radius=0.3, segments=24, sides=17).mesh(), 2 * 24 * 17, 0),
    "one cell": (Heightfield(size=2.0, resolution=1, amplitude=0.5, waves=3, seed=7).mesh(), 2, 4),
    "heightfield": (Heightfield(size=4.0, resolution=64, amplitude=0.3, waves=8, seed=1).mesh(), 2 * 64**2, 4 * 64),
    # open are the teapot's inner rim, the lid's edge and both ends of handle and spout: 4 or 2 patches around
    "coarse teapot": (Teapot(subdivisions=3).mesh(), 64 * 3**2 - 8 * 3, 3 * 16),
    "teapot": (Teapot(subdivisions=10).mesh(), 64 * 10**2 - 8 * 10, 10 * 16),
}


def face_normals(mesh):
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return np.cross(b - a, c - a)


def signed_volume(mesh):
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return np.sum(a * np.cross(b, c)) / 6


# The axes along which u and v grow from 0 to 1 on each side of the cube, as on that of Mitsuba.
CUBE_UV_AXES = {"+x": "+y-z", "-x": "+y+z", "+y": "-x-z", "-y": "+z+x", "+z": "+y+x", "-z": "-y+x"}


def axis(name):
    """The unit vector of "+x" to "-z"."""
    return np.eye(3)["xyz".index(name[1])] * float(f"{name[0]}1")


def test_uv_of_rectangle_and_cube_run_along_the_axes_of_mitsubas_own():
    mesh = caster.Rectangle().mesh()
    assert np.array_equal(mesh.uv, (mesh.vertices[:, :2] + 1.0) / 2.0)
    mesh = caster.Cube().mesh()
    for face in mesh.faces:
        corners = mesh.vertices[face]
        (side,) = (name for name in CUBE_UV_AXES if (corners @ axis(name) == 1.0).all())
        u, v = axis(CUBE_UV_AXES[side][:2]), axis(CUBE_UV_AXES[side][2:])
        assert np.array_equal(mesh.uv[face], 0.5 + 0.5 * np.stack([corners @ u, corners @ v], axis=1))


@pytest.mark.parametrize("name", MESHES)
def test_a_generated_mesh_is_closed_but_for_its_rims_and_looks_outwards(name):
    mesh, faces, open_edges = MESHES[name]
    check_mesh(mesh, name)
    assert len(mesh.faces) == faces
    edges = Counter((int(f[k]), int(f[k - 2])) for f in mesh.faces for k in range(3))
    assert set(edges.values()) == {1} and sum((b, a) not in edges for a, b in edges) == open_edges
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert np.abs(np.linalg.norm(mesh.normals, axis=1) - 1).max() <= ROUNDING
    towards = np.einsum("ij,ikj->ik", normalize_rows(face_normals(mesh)), mesh.normals[mesh.faces])
    # at the lip of the teapot's spout, which curls within a cell, a face and its corners differ by more
    assert (towards > (-1.0 if "teapot" in name else 0.0)).all()
    if not open_edges:
        assert signed_volume(mesh) > 0 and len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)


def test_an_icosphere_comes_close_to_the_sphere():
    """Splitting halves the edges, so a face is four times nearer to the sphere."""
    for n in range(5):
        mesh = Icosphere(subdivisions=n).mesh()
        assert len(mesh.vertices) == 10 * 4**n + 2
        assert np.array_equal(mesh.normals, mesh.vertices)
    corners = MESHES["icosahedron"][0].vertices[MESHES["icosahedron"][0].faces]
    assert np.ptp(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)) < 1e-15  # which is regular
    missing = [4 / 3 * math.pi - signed_volume(Icosphere(subdivisions=n).mesh()) for n in (2, 3, 4)]
    assert missing[0] / missing[1] == pytest.approx(4, rel=0.05)
    assert missing[1] / missing[2] == pytest.approx(4, rel=0.05)


def test_vertices_and_normals_of_a_torus_satisfy_its_equation():
    major, minor = 2.0, 0.3
    mesh = Torus(major_radius=major, minor_radius=minor, segments=24, sides=17).mesh()
    x, y, z = mesh.vertices.T
    assert np.abs(np.hypot(np.hypot(x, y) - major, z) - minor).max() <= major * ROUNDING
    middle = mesh.vertices - minor * mesh.normals
    assert np.abs(np.linalg.norm(middle, axis=1) - major).max() <= major * ROUNDING
    assert np.abs(middle[:, 2]).max() <= major * ROUNDING
    sines = math.sin(2 * math.pi / 24) * math.sin(2 * math.pi / 17)
    assert signed_volume(mesh) == pytest.approx(24 * 17 / 2 * major * minor**2 * sines, rel=1e-13)  # by Pappus


# ---- heightfields

HEIGHTS_OF_SEED_7 = [-0.0273371284359051, 0.043852821948381485, 0.18399232340427396, 0.2501909393129043]


def test_a_heightfield_fills_its_square_and_keeps_within_its_amplitude():
    mesh, *_ = MESHES["heightfield"]
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert low[:2].tolist() == [-2, -2] and high[:2].tolist() == [2, 2]
    assert 0.05 < np.abs(mesh.vertices[:, 2]).max() <= 0.3
    assert np.array_equal((mesh.uv - 0.5) * 4.0, mesh.vertices[:, :2])
    assert (face_normals(mesh)[:, 2] > 0).all()
    assert len(np.unique(mesh.vertices[:, 2])) == len(mesh.vertices)


def test_the_hills_of_a_seed_are_known():
    """If this fails, every image of a heightfield has changed."""
    corner = MESHES["one cell"][0].vertices[:, 2]
    # float64 sines of arguments below 100: 100 u = 1.1e-14 each
    assert np.abs(corner - HEIGHTS_OF_SEED_7).max() <= 1e-13
    one, other = (
        Heightfield(size=4.0, resolution=16, amplitude=0.3, waves=8, seed=seed).mesh().vertices for seed in (1, 2)
    )
    assert not np.array_equal(one, other)
    flat = Heightfield(size=2.0, resolution=4, amplitude=0.0, waves=3, seed=7).mesh()
    assert not flat.vertices[:, 2].any() and np.array_equal(flat.normals, [(0, 0, 1)] * 25)


def test_normals_of_a_heightfield_are_those_of_the_surface():
    """Generated normals come closer to them at least as fast as the cells get small, here by 4."""
    errors = []
    for resolution in (128, 512):
        mesh = Heightfield(size=4.0, resolution=resolution, amplitude=0.3, waves=8, seed=1).mesh()
        generated = vertex_normals(mesh.vertices, mesh.faces).reshape(resolution + 1, resolution + 1, 3)
        exact = mesh.normals.reshape(resolution + 1, resolution + 1, 3)
        errors.append(np.abs(generated - exact)[1:-1, 1:-1].max())  # border vertices lack faces
    assert errors[1] < errors[0] / 4 and errors[1] < 1e-3


# ---- Newell's teapot


def de_casteljau(points, t):
    """A point of a Bezier curve by repeated halfway marks: (4, ...) control points."""
    while len(points) > 1:
        points = (1 - t) * points[:-1] + t * points[1:]
    return points[0]


def test_control_points_of_the_teapot_are_the_published_ones():
    """The digest is of the published list of 306 points and 32 x 16 indices, bit for bit."""
    nets = patches()
    assert nets.shape == (32, 4, 4, 3)
    digest = hashlib.sha256(nets.astype("<f8").tobytes()).hexdigest()
    assert digest == "6cf132b92494b156f99a6f30652bdad1587bd41a445f1cc45d3a6b85f7331b3b"


def test_vertices_and_normals_of_the_teapot_are_those_of_its_patches():
    """By de Casteljau's construction, which shares no formula with the weights, and by finite differences."""
    n, h = 6, 1e-6
    mesh = Teapot(subdivisions=n).mesh()
    for net in patches():
        for i in range(n + 1):
            for j in range(n + 1):
                p = de_casteljau(de_casteljau(net, i / n), j / n)
                assert np.abs(mesh.vertices - p).max(axis=1).min() <= 4 * ROUNDING
        p, half = de_casteljau(de_casteljau(net, 0.5), 0.5), de_casteljau(net, 0.5)
        du = de_casteljau(de_casteljau(net, 0.5 + h) - de_casteljau(net, 0.5 - h), 0.5)
        dv = de_casteljau(half, 0.5 + h) - de_casteljau(half, 0.5 - h)
        k = np.argmin(np.abs(mesh.vertices - p).max(axis=1))
        # a central difference errs by h^2 of the third derivative and u/h of rounding
        assert np.abs(mesh.normals[k] - normalize_rows(np.cross(dv, du)[None])[0]).max() <= 1e-8


def test_the_teapots_outside_is_outside_in_each_part():
    """The pot's axis is z; a point within handle and spout is between their rings."""
    mesh = Teapot(subdivisions=12).mesh()
    a, n = mesh.vertices[mesh.faces].mean(axis=1), face_normals(mesh)
    first = [0, *np.cumsum([2 * 12 * 12 - (12 if np.all(net[0] == net[0, 0]) else 0) for net in patches()])]
    foot = slice(first[8], first[12])
    assert (n[foot, 0] * a[foot, 0] + n[foot, 1] * a[foot, 1] > 0).all()
    for patch, side in ((12, -1), (13, 1), (16, -1), (17, 1)):  # halves at y < 0 and at y > 0
        assert np.sign(n[first[patch] : first[patch + 1], 1].sum()) == side
    assert (n[first[28] :, 2] < 0).any() and (n[first[28] :, 2] <= 0).all()  # the bottom looks down
    for tip, up in (((0, 0, 3.15), 1), ((0, 0, 0), -1)):  # the poles are one vertex with the axis as normal
        (k,) = np.flatnonzero((mesh.vertices == tip).all(axis=1))
        assert np.array_equal(mesh.normals[k], (0, 0, up)) and (mesh.faces == k).any(axis=1).sum() == 4 * 12
    mirrored = mesh.vertices * (1, -1, 1) + 0.0
    assert set(map(tuple, mesh.vertices.tolist())) == set(map(tuple, mirrored.tolist()))


# ---- rectangle and cube


@pytest.mark.parametrize(("shape", "depth"), [(caster.Rectangle, 0.0), (caster.Cube, 1.0)])
def test_rectangle_and_cube_have_corners_at_one_and_faces_that_look_outwards(shape, depth):
    mesh = shape().mesh()
    doubled, middles = face_normals(mesh), mesh.vertices[mesh.faces].mean(axis=1)
    assert (np.abs(mesh.vertices) == [1.0, 1.0, depth]).all()
    assert ((doubled * (middles + np.array([0.0, 0.0, 1.0 - depth]))).sum(axis=1) > 0.0).all()
    assert np.array_equal(0.5 * np.abs(doubled).sum(axis=0), [8.0 * depth, 8.0 * depth, 4.0 + 4.0 * depth])


# ---- parameters


@pytest.mark.parametrize(
    ("shape", "fields", "words"),
    [
        (caster.Icosphere, {"subdivisions": -1}, "icosphere: subdivisions must be >= 0, got -1"),
        (caster.Teapot, {"subdivisions": 65}, "teapot: subdivisions must be <= 64, got 65"),
        (caster.Torus, {"minor_radius": 1.0}, "torus: minor_radius must be < major_radius 1.0, got 1.0"),
    ],
)
def test_parameters_of_no_mesh_are_refused(shape, fields, words):
    with pytest.raises(SceneError, match=words):
        shape(**fields)

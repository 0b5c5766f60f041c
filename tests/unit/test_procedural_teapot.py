"""Newell's teapot."""

import hashlib
import math

import numpy as np
import pytest

from caster.description.errors import SceneError
from caster.geometry.triangle_mesh import check_mesh, normalize_rows
from caster.shapes.teapot import PARTS, patches, tessellate_teapot

# Three roundings of u = 2^-53 for a weight and three for the sum, of numbers below 4.
ROUNDING = 8 * 4 * 2.0**-53


def face_normals(mesh):
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return np.cross(b - a, c - a)


def de_casteljau(points, t):
    """A point of a Bezier curve by repeated halfway marks: (4, ...) control points."""
    while len(points) > 1:
        points = (1 - t) * points[:-1] + t * points[1:]
    return points[0]


def border_uses(mesh):
    edges = np.sort(np.stack([mesh.faces, np.roll(mesh.faces, -1, 1)], axis=2).reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def test_there_are_32_patches_of_control_points_with_the_published_extents():
    nets = patches()
    assert nets.shape == (32, 4, 4, 3) and PARTS.shape == (32,)
    assert nets.min((0, 1, 2)).tolist() == [-3, -2, 0] and nets.max((0, 1, 2)).tolist() == [3.525, 2, 3.15]
    # of the 306 published points, some are in no patch and some are listed twice
    assert len(np.unique(nets.reshape(-1, 3), axis=0)) == 290


def test_control_points_are_the_published_decimals():
    """Spot checks of each part against the published list, to the last bit."""
    nets = patches()
    assert nets[0, 0].tolist() == [[1.4, 0, 2.4], [1.4, -0.784, 2.4], [0.784, -1.4, 2.4], [0, -1.4, 2.4]]
    assert nets[6, 3].tolist() == [[-2, 0, 0.9], [-2, 1.12, 0.9], [-1.12, 2, 0.9], [0, 2, 0.9]]
    assert nets[12, 2].tolist() == [[-2.7, 0, 2.025], [-2.7, -0.3, 2.025], [-3, -0.3, 2.25], [-3, 0, 2.25]]
    assert nets[19, 3].tolist() == [[3.2, 0, 2.4], [3.2, 0.15, 2.4], [2.8, 0.15, 2.4], [2.8, 0, 2.4]]
    assert nets[20, 1].tolist() == [[0.8, 0, 3.15], [0.8, -0.45, 3.15], [0.45, -0.8, 3.15], [0, -0.8, 3.15]]
    assert nets[26, 2].tolist() == [[-1.3, 0, 2.55], [-1.3, 0.728, 2.55], [-0.728, 1.3, 2.55], [0, 1.3, 2.55]]
    assert nets[28, 1].tolist() == [[1.425, 0, 0], [1.425, 0.798, 0], [0.798, 1.425, 0], [0, 1.425, 0]]


def test_no_control_point_has_changed():
    """Taken when they were bit for bit those of the published list of 306 points and 32 x 16 indices."""
    digest = hashlib.sha256(patches().astype("<f8").tobytes()).hexdigest()
    assert digest == "6cf132b92494b156f99a6f30652bdad1587bd41a445f1cc45d3a6b85f7331b3b"


@pytest.mark.parametrize("n", [2, 3, 7, 10])  # at n = 1 handle and spout are flat
def test_faces_are_those_with_an_area(n):
    mesh = tessellate_teapot(n)
    check_mesh(mesh, "teapot")
    assert len(mesh.faces) == 64 * n * n - 8 * n
    assert (np.linalg.norm(face_normals(mesh), axis=1) > 0).all()
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))


def test_vertices_lie_on_the_patches():
    """Against de Casteljau's construction, which shares no formula with the weights."""
    n = 6
    vertices = tessellate_teapot(n).vertices
    for net in patches():
        for i in range(n + 1):
            for j in range(n + 1):
                p = de_casteljau(de_casteljau(net, i / n), j / n)
                assert np.abs(vertices - p).max(axis=1).min() <= ROUNDING


@pytest.mark.parametrize("n", [3, 7, 10])
def test_patches_of_a_part_are_joined_without_a_gap(n):
    """Open are the inner rim, the lid's edge and both ends of handle and spout: 4 or 2 patches around."""
    _, uses = border_uses(tessellate_teapot(n))
    assert uses.max() == 2
    assert np.count_nonzero(uses == 1) == n * (4 + 4 + 2 * 2 + 2 * 2)


def test_the_left_half_mirrors_the_right_half_to_the_bit():
    vertices = tessellate_teapot(7).vertices
    mirrored = vertices * (1, -1, 1) + 0.0
    assert set(map(tuple, vertices.tolist())) == set(map(tuple, mirrored.tolist()))


def test_normals_have_unit_length_and_look_outwards():
    mesh = tessellate_teapot(16)
    assert np.abs(np.linalg.norm(mesh.normals, axis=1) - 1).max() <= ROUNDING
    flat = normalize_rows(face_normals(mesh))
    # at the lip of the spout, which curls within a cell, a face and its corners differ by up to 60 degrees
    assert np.einsum("ij,ikj->ik", flat, mesh.normals[mesh.faces]).min() > 0.5


def test_outwards_is_away_from_the_inside_of_each_part():
    """The pot's and the lid's axis is z; a point within handle and spout is between their rings."""
    nets = patches()
    mesh = tessellate_teapot(12)
    a = mesh.vertices[mesh.faces].mean(axis=1)
    n = face_normals(mesh)
    first = [0, *np.cumsum([2 * 12 * 12 - (12 if np.all(net[0] == net[0, 0]) else 0) for net in nets])]
    foot = slice(first[8], first[12])
    assert (n[foot, 0] * a[foot, 0] + n[foot, 1] * a[foot, 1] > 0).all()
    for patch, inside_out in ((12, -1), (13, 1), (16, -1), (17, 1)):  # halves at y < 0 and at y > 0
        assert (np.sign(n[first[patch] : first[patch + 1], 1].sum()) == inside_out).all()
    assert (n[first[28] :, 2] < 0).any() and (n[first[28] :, 2] <= 0).all()  # the bottom looks down


@pytest.mark.parametrize(("tip", "normal"), [((0, 0, 3.15), (0, 0, 1)), ((0, 0, 0), (0, 0, -1))])
def test_the_poles_are_one_vertex_with_the_axis_as_normal(tip, normal):
    mesh = tessellate_teapot(7)
    (k,) = np.flatnonzero((mesh.vertices == tip).all(axis=1))
    assert np.array_equal(mesh.normals[k], normal)
    near = mesh.faces[(mesh.faces == k).any(axis=1)]
    assert len(near) == 4 * 7 and (mesh.normals[near] @ normal > math.cos(math.radians(40))).all()


def test_normals_are_those_of_the_surface():
    """Finite differences at the middle of each patch, which is a vertex when n is 2."""
    mesh, h = tessellate_teapot(2), 1e-6
    for net in patches():
        p = de_casteljau(de_casteljau(net, 0.5), 0.5)
        du = de_casteljau(de_casteljau(net, 0.5 + h) - de_casteljau(net, 0.5 - h), 0.5)
        along_u = de_casteljau(net, 0.5)
        dv = de_casteljau(along_u, 0.5 + h) - de_casteljau(along_u, 0.5 - h)
        expected = normalize_rows(np.cross(dv, du)[None])[0]
        k = np.argmin(np.abs(mesh.vertices - p).max(axis=1))
        # a central difference errs by h^2 of the third derivative and u/h of rounding
        assert np.abs(mesh.normals[k] - expected).max() <= 1e-8


@pytest.mark.parametrize("subdivisions", [0, -3, 129, 4.0, True])
def test_it_refuses_other_subdivisions(subdivisions):
    with pytest.raises(SceneError, match="teapot: subdivisions must be a whole number from 1 to 128, got"):
        tessellate_teapot(subdivisions)

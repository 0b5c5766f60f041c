"""Icosphere and torus: closed, facing outwards, on the surface they stand for."""

import math
from collections import Counter

import numpy as np
import pytest

from caster.description.errors import SceneError
from caster.geometry.triangle_mesh import check_mesh
from caster.shapes.icosphere import Icosphere, tessellate_icosphere
from caster.shapes.torus import Torus, tessellate_torus

# A handful of roundings of u = 2^-53 each in a sine, a product and a sum.
ROUNDING = 8 * 2.0**-53

CLOSED = {
    "icosahedron": (lambda: tessellate_icosphere(0), 20),
    "icosphere": (lambda: tessellate_icosphere(3), 20 * 4**3),
    "smallest torus": (lambda: tessellate_torus(1.0, 0.5, 3, 3), 18),
    "torus": (lambda: tessellate_torus(2.0, 0.3, 24, 17), 2 * 24 * 17),
}


@pytest.fixture(params=CLOSED)
def closed(request):
    make, faces = CLOSED[request.param]
    return make(), faces


def signed_volume(mesh):
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return np.sum(a * np.cross(b, c)) / 6


def test_it_is_a_usable_mesh_with_the_promised_faces(closed):
    mesh, faces = closed
    check_mesh(mesh, "mesh")
    assert len(mesh.faces) == faces
    assert mesh.faces.dtype == np.int32 and mesh.vertices.dtype == np.float64 and mesh.uv is None


def test_every_edge_is_run_along_once_in_each_direction(closed):
    mesh, _ = closed
    edges = Counter((int(f[k]), int(f[k - 2])) for f in mesh.faces for k in range(3))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)


def test_vertices_are_shared_and_all_in_use(closed):
    mesh, _ = closed
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))


def test_faces_look_outwards(closed):
    mesh, _ = closed
    assert signed_volume(mesh) > 0
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    towards = np.einsum("ij,ikj->ik", np.cross(b - a, c - a), mesh.normals[mesh.faces])
    assert (towards > 0).all()


def test_normals_have_unit_length(closed):
    mesh, _ = closed
    assert np.abs(np.linalg.norm(mesh.normals, axis=1) - 1).max() <= ROUNDING


@pytest.mark.parametrize("subdivisions", range(5))
def test_icosphere_counts(subdivisions):
    mesh = tessellate_icosphere(subdivisions)
    assert len(mesh.faces) == 20 * 4**subdivisions
    assert len(mesh.vertices) == 10 * 4**subdivisions + 2


def test_icosphere_normals_are_its_positions():
    mesh = tessellate_icosphere(3)
    assert np.array_equal(mesh.normals, mesh.vertices)


def test_numbers_that_are_not_given_are_those_of_the_api_page():
    for shape, made in ((Torus(), tessellate_torus(1.0, 0.3, 64, 32)), (Icosphere(), tessellate_icosphere(3))):
        mesh = shape.mesh()
        assert np.array_equal(mesh.vertices, made.vertices) and np.array_equal(mesh.faces, made.faces)


def test_icosphere_comes_close_to_the_sphere():
    """Splitting halves the edges, so a face is four times nearer to the sphere."""
    missing = [4 / 3 * math.pi - signed_volume(tessellate_icosphere(n)) for n in (2, 3, 4)]
    assert missing[0] / missing[1] == pytest.approx(4, rel=0.05)
    assert missing[1] / missing[2] == pytest.approx(4, rel=0.05)


def test_torus_vertices_and_normals_satisfy_its_equation():
    major, minor = 2.0, 0.3
    mesh = tessellate_torus(major, minor, 24, 17)
    x, y, z = mesh.vertices.T
    assert np.abs(np.hypot(np.hypot(x, y) - major, z) - minor).max() <= major * ROUNDING
    middle = mesh.vertices - minor * mesh.normals
    assert np.abs(np.linalg.norm(middle, axis=1) - major).max() <= major * ROUNDING
    assert np.abs(middle[:, 2]).max() <= major * ROUNDING


def test_torus_comes_close_to_its_volume():
    assert signed_volume(tessellate_torus(2.0, 0.3, 200, 100)) == pytest.approx(2 * math.pi**2 * 2.0 * 0.3**2, rel=2e-3)


@pytest.mark.parametrize("subdivisions", [-1, 10, 2.0, True])
def test_icosphere_refuses_other_subdivisions(subdivisions):
    with pytest.raises(SceneError, match="icosphere: subdivisions must be a whole number from 0 to 9, got"):
        tessellate_icosphere(subdivisions)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ((0.0, 0.3, 8, 8), "torus: major_radius must be a length > 0, got 0.0"),
        ((1.0, -0.3, 8, 8), "torus: minor_radius must be a length > 0, got -0.3"),
        ((1.0, math.nan, 8, 8), "torus: minor_radius must be a length > 0, got nan"),
        ((1.0, 1.0, 8, 8), r"torus: minor_radius must be smaller than major_radius \(1.0\), got 1.0"),
        ((1.0, 0.3, 2, 8), "torus: segments must be a whole number from 3 to 4096, got 2"),
        ((1.0, 0.3, 8, 5000), "torus: sides must be a whole number from 3 to 4096, got 5000"),
    ],
)
def test_torus_refuses_what_is_no_ring(parameters, words):
    with pytest.raises(SceneError, match=words):
        tessellate_torus(*parameters)

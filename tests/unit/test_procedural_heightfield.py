"""Hills from sine waves."""

import math

import numpy as np
import pytest

from caster.description.errors import SceneError
from caster.geometry.triangle_mesh import check_mesh, vertex_normals
from caster.shapes.heightfield import tessellate_heightfield

HEIGHTS_OF_SEED_7 = [-0.0273371284359051, 0.043852821948381485, 0.18399232340427396, 0.2501909393129043]


def test_resolution_256_has_more_than_100_000_triangles():
    mesh = tessellate_heightfield(4.0, 256, 0.3, 8, 1)
    check_mesh(mesh, "mesh")
    assert len(mesh.faces) == 2 * 256**2 and len(mesh.vertices) == 257**2


def test_it_fills_its_square_and_keeps_within_its_amplitude():
    mesh = tessellate_heightfield(4.0, 32, 0.3, 8, 1)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert low[:2].tolist() == [-2, -2] and high[:2].tolist() == [2, 2]
    assert 0.05 < np.abs(mesh.vertices[:, 2]).max() <= 0.3


def test_uv_runs_with_x_and_y():
    mesh = tessellate_heightfield(4.0, 8, 0.3, 3, 1)
    assert np.array_equal((mesh.uv - 0.5) * 4.0, mesh.vertices[:, :2])


def test_every_face_looks_up():
    mesh = tessellate_heightfield(4.0, 64, 0.3, 8, 1)
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_all_edges_but_the_border_are_shared():
    mesh = tessellate_heightfield(1.0, 9, 0.1, 2, 0)
    edges = np.sort(np.stack([mesh.faces, np.roll(mesh.faces, -1, 1)], axis=2).reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert uses.max() == 2 and np.count_nonzero(uses == 1) == 4 * 9


def test_no_two_vertices_are_at_one_height():
    heights = tessellate_heightfield(4.0, 64, 0.3, 8, 1).vertices[:, 2]
    assert len(np.unique(heights)) == len(heights)


def test_normals_are_those_of_the_surface():
    """Generated normals come closer to them at least as fast as the cells get small, here by 4."""
    errors = []
    for resolution in (128, 512):
        mesh = tessellate_heightfield(4.0, resolution, 0.3, 8, 1)
        generated = vertex_normals(mesh.vertices, mesh.faces).reshape(resolution + 1, resolution + 1, 3)
        exact = mesh.normals.reshape(resolution + 1, resolution + 1, 3)
        errors.append(np.abs(generated - exact)[1:-1, 1:-1].max())  # border vertices lack faces
    assert errors[1] < errors[0] / 4 and errors[1] < 1e-3


def test_a_seed_gives_the_same_hills_and_another_seed_others():
    one, same, other = (tessellate_heightfield(4.0, 16, 0.3, 8, seed).vertices for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_the_hills_of_a_seed_are_known():
    """Should this fail, every picture of a heightfield has changed."""
    corner = tessellate_heightfield(2.0, 1, 0.5, 3, 7).vertices[:, 2]
    # float64 sines of arguments below 100: 100 u = 1.1e-14 each
    assert np.abs(corner - HEIGHTS_OF_SEED_7).max() <= 1e-13


def test_no_amplitude_is_flat_ground():
    mesh = tessellate_heightfield(2.0, 4, 0.0, 3, 7)
    assert not mesh.vertices[:, 2].any() and np.array_equal(mesh.normals, [(0, 0, 1)] * 25)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ((0.0, 8, 0.1, 3, 1), "size must be a length > 0"),
        ((math.inf, 8, 0.1, 3, 1), "size must be a length > 0, got inf"),
        ((1.0, 0, 0.1, 3, 1), "resolution must be a whole number from 1 to 4096, got 0"),
        ((1.0, 5000, 0.1, 3, 1), "resolution must be"),
        ((1.0, 8, -0.1, 3, 1), "amplitude must be a length >= 0, got -0.1"),
        ((1.0, 8, 0.1, 0, 1), "waves must be a whole number from 1 to 64, got 0"),
        ((1.0, 8, 0.1, 3, -1), "seed must be a whole number >= 0, got -1"),
    ],
)
def test_it_refuses_what_makes_no_hills(parameters, words):
    with pytest.raises(SceneError, match="heightfield: " + words):
        tessellate_heightfield(*parameters)

"""Closed forms of generated meshes hold for what the caster makes, and for no mesh with one other number or face."""

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

import caster
from mitsuba_ref.judge.scene_checks import PRECISIONS, _packing_error_ratio
from mitsuba_ref.shapes import reference_of
from mitsuba_ref.shapes.generated_meshes import teapot_nets, unpaired_edges, volume

SHAPES = {
    "torus": caster.Torus(segments=5, sides=4, major_radius=2.0, minor_radius=0.5),
    "small torus": caster.Torus(segments=3, sides=3),
    "icosphere": caster.Icosphere(subdivisions=1),
    "icosahedron": caster.Icosphere(subdivisions=0),
    "heightfield": caster.Heightfield(resolution=3, size=3.0, amplitude=0.5, waves=4, seed=5),
    "square": caster.Heightfield(resolution=1, amplitude=0.0),
    "teapot": caster.Teapot(subdivisions=2),
    "coarse teapot": caster.Teapot(subdivisions=1),
}


class Made(NamedTuple):
    """A mesh as a shape generates it."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None
    uv: np.ndarray | None = None


def ratios(shape: Any, mesh: Made) -> dict[str, float]:
    """Errors over their bounds in float64, of a shape of these fields that came to this mesh."""
    fields = {name: getattr(shape, name) for name in type(shape).model_fields}
    given = SimpleNamespace(**fields, mesh=lambda: mesh)
    with np.errstate(all="ignore"):
        claims = list(reference_of(shape).closed_form(given))
        precision = PRECISIONS[0]
        return {c.what: _packing_error_ratio(c, precision.unit_roundoff, precision.smallest_normal) for c in claims}


def mesh_of(shape: Any) -> Made:
    mesh = shape.mesh()
    return Made(*(rows if rows is None else rows.copy() for rows in mesh))


CLAIMS = {
    "torus": ["points of a torus", "normals of a torus", "faces of neighbours", "closed", "volume"],
    "icosphere": [
        "number of faces and vertices", "angles of an icosahedron", "golden rectangles", "split triangles",
        "unit sphere", "normals of a sphere", "closed", "outside",
    ],
    "heightfield": [
        "points of the waves", "normals of the waves", "uv of the waves", "faces of half a cell",
        "open at the rim alone",
    ],
    "teapot": ["number of faces", "points of the patches", "normals of the patches"],
}  # fmt: skip
KIND = {"small torus": "torus", "icosahedron": "icosphere", "square": "heightfield", "coarse teapot": "teapot"}


@pytest.mark.parametrize("name", SHAPES)
def test_a_mesh_as_it_is_generated_holds_in_every_claim(name):
    found = ratios(SHAPES[name], mesh_of(SHAPES[name]))
    assert list(found) == CLAIMS[KIND.get(name, name)] and max(found.values()) < 0.7


@pytest.mark.parametrize("name", SHAPES)
def test_a_vertex_or_normal_that_is_off_by_a_billionth_is_found_wherever_it_is(name):
    mesh = mesh_of(SHAPES[name])
    rng = np.random.default_rng(1)
    used = np.unique(mesh.faces)
    for field in ("vertices", "normals"):
        for row in rng.permutation(used)[:12]:
            for axis in range(3):
                other = getattr(mesh, field).copy()
                other[row, axis] += 1e-9
                found = ratios(SHAPES[name], mesh._replace(**{field: other}))
                assert any(ratio > 1.0 for what, ratio in found.items() if what != "volume"), (field, row, axis)


FAULTS = {
    "a face less": lambda mesh: mesh._replace(faces=mesh.faces[:-1]),
    "a face twice": lambda mesh: mesh._replace(faces=np.vstack([mesh.faces, mesh.faces[:1]])),
    "a face in place of another": lambda mesh: mesh._replace(faces=np.vstack([mesh.faces[1:], mesh.faces[1:2]])),
    "a face reversed": lambda mesh: mesh._replace(faces=np.vstack([mesh.faces[:1, ::-1], mesh.faces[1:]])),
    "all faces reversed": lambda mesh: mesh._replace(faces=mesh.faces[:, ::-1]),
    "another corner": lambda mesh: mesh._replace(
        faces=np.vstack([[*mesh.faces[0, :2], np.setdiff1d(mesh.faces, mesh.faces[0])[-1]], mesh.faces[1:]])
    ),
    "corners turned by one vertex": lambda mesh: mesh._replace(faces=(mesh.faces + 1) % len(mesh.vertices)),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("name", SHAPES)
def test_faces_other_than_those_of_the_surface_are_found(name, fault):
    found = ratios(SHAPES[name], FAULTS[fault](mesh_of(SHAPES[name])))
    assert max(found.values()) > 1.0


@pytest.mark.parametrize("name", SHAPES)
def test_another_number_of_vertices_or_none_of_the_normals_is_found_or_changes_nothing(name):
    """A vertex that no face has is no part of a teapot's surface."""
    mesh = mesh_of(SHAPES[name])
    faces, *others = mesh.faces, mesh.vertices, mesh.normals, mesh.uv
    vertices, normals, uv = (each if each is None else np.vstack([each, each[:1]]) for each in others)
    more = Made(vertices, faces, normals, uv)
    found = ratios(SHAPES[name], more)
    assert (max(found.values()) > 1.0) is ("teapot" not in name)
    assert found.keys() == ratios(SHAPES[name], mesh).keys() or "number of faces and vertices" in found
    if "teapot" in name:
        assert "normals of the patches" not in ratios(SHAPES[name], mesh._replace(normals=None))
        few = ratios(SHAPES[name], mesh._replace(faces=mesh.faces[:-3]))
        assert list(few) == ["number of faces", "points of the patches"] and min(few.values()) == np.inf


WITH_UV = {
    "cube": caster.Cube(),
    "rectangle": caster.Rectangle(),
    "heightfield": caster.Heightfield(resolution=3, waves=2),
}


@pytest.mark.parametrize("name", WITH_UV)
def test_uv_are_those_of_every_corner_and_side(name):
    """One number off, two exchanged, mirrored, those of one face turned by a corner, or none at all."""
    mesh = mesh_of(WITH_UV[name])
    assert max(ratios(WITH_UV[name], mesh).values()) < 0.7
    assert mesh.uv is not None
    wrong = [mesh.uv[:, ::-1], 1.0 - mesh.uv, None]
    for row in range(len(mesh.uv)):
        for column in range(2):
            wrong.append(mesh.uv.copy())
            wrong[-1][row, column] = np.nextafter(mesh.uv[row, column], 2.0)
    for face in mesh.faces:
        wrong.append(mesh.uv.copy())
        wrong[-1][face] = mesh.uv[np.roll(face, 1)]
    for uv in wrong:
        found = ratios(WITH_UV[name], mesh._replace(uv=uv))
        assert [what for what, ratio in found.items() if ratio > 1.0] == [
            next(what for what in found if what.startswith("uv of "))
        ]


def test_the_volume_of_a_body_is_signed_and_its_size_that_of_its_terms():
    """A tetrahedron from (1, 1, 1) along the axes, of edges 2: 8 / 6."""
    vertices = np.ones((4, 3)) + 2.0 * np.vstack([np.zeros(3), np.eye(3)])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    claim = volume(vertices, faces, 8.0 / 6.0)
    assert claim.packed == pytest.approx(8.0 / 6.0) and claim.expected == 8.0 / 6.0
    assert volume(vertices, faces[:, ::-1], 1.0).packed == pytest.approx(-8.0 / 6.0)
    terms = [
        sum(a[i] * (b[i - 2] * c[i - 1] + b[i - 1] * c[i - 2]) for i in range(3)) / 6.0
        for a, b, c in (vertices[f] for f in faces)
    ]  # all coordinates are positive: each minus a plus
    assert claim.size == pytest.approx(sum(terms))


def test_unpaired_edges_are_counted_apart_where_they_are_repeated_or_open():
    square = np.array([[0, 1, 2], [0, 2, 3]])
    assert unpaired_edges(square, 4) == (0, 4)
    assert unpaired_edges(np.vstack([square, square[:, ::-1]]), 4) == (2, 0)  # the diagonal
    assert unpaired_edges(np.vstack([square, square[:1]]), 4) == (3, 6)
    assert unpaired_edges(np.vstack([square, square]), 4) == (6, 8)


def test_the_teapot_is_that_of_its_published_control_points():
    """Outline and symmetry as they are known: a pot 3.15 high and 4 wide, a handle to x = -3, a spout to 3.525."""
    nets = teapot_nets()
    assert nets.shape == (32, 4, 4, 3)
    pot, bent, lid, bottom = nets[:12], nets[12:20], nets[20:28], nets[28:]
    assert (pot.min(axis=(0, 1, 2)) == [-2.0, -2.0, 0.15]).all() and pot.max(axis=(0, 1, 2)).tolist() == [
        2.0,
        2.0,
        2.53125,
    ]
    assert bent[:4].min() == -3.0 and bent[4:].max() == 3.525 and np.abs(bent[..., 1]).max() == 0.66
    assert lid.max(axis=(0, 1, 2)).tolist() == [1.3, 1.3, 3.15] and lid[..., 2].min() == 2.4
    assert bottom[..., 2].min() == 0.0 and bottom[..., 2].max() == 0.15 and np.abs(bottom[..., :2]).max() == 1.5
    for part, mirrors in ((pot, "xy"), (bent, "y"), (lid, "xy"), (bottom, "xy")):
        points = {tuple(p) for p in np.round(part.reshape(-1, 3), 9).tolist()}
        for axis in mirrors:
            flip = [-1.0 if axis == each else 1.0 for each in "xyz"]
            assert {tuple(x * f + 0.0 for x, f in zip(p, flip, strict=True)) for p in points} == {
                tuple(x + 0.0 for x in p) for p in points
            }
    ends = nets[:, [0, 0, 3, 3], [0, 3, 0, 3]]  # each corner of a patch is one of another, but the poles
    seen = [tuple(p) for p in np.round(ends.reshape(-1, 3), 9).tolist()]
    assert min(seen.count(p) for p in seen) >= 2

"""Faces that are never hit are left out as in Embree and counted, without effect on their neighbours."""

import numpy as np
import pytest
from places import scene_of

import caster
from caster.__main__ import main
from caster.geometry.packing import pack, rejected_faces
from caster.geometry.world_space import LARGEST_COORDINATE, as_float32

QUAD = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\n"
GOOD = "f 1 2 3\nf 1 3 4\n"


def a_mesh(tmp_path, more, **fields):
    (tmp_path / "m.obj").write_text(QUAD + more + GOOD)
    shape = caster.Mesh(file=str(tmp_path / "m.obj"), **fields)
    return scene_of(shape)


def ids_across(scene):
    """prim_id along rays that pass all over the square."""
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 12), np.linspace(-0.95, 0.85, 12))
    o = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 5.0)])
    return caster.cast(scene, o, np.tile([0.0, 0.0, -1.0], (len(o), 1))).prim_id


@pytest.mark.parametrize(
    "corner",
    [
        "nan 0 0",
        "0 inf 0",
        "0 0 -1e400",
        "1e19 0 1",
        f"0 {-LARGEST_COORDINATE!r} 1",
        "3 3 0",  # on the line through corners 1 and 3
        "-1 -1 0",
    ],
)
def test_a_face_that_cannot_be_hit_is_counted_and_its_neighbours_stay(tmp_path, corner):
    for others in ("1 3",) if corner in ("3 3 0", "-1 -1 0") else ("1 3", "2 3", "2 4"):
        scene = a_mesh(tmp_path, f"v {corner}\nf {others} 5\n")
        assert rejected_faces(scene) == {"shape-0": 1}
        ids = ids_across(scene)
        assert set(ids.tolist()) == {1, 2}  # the bad face is number 0, and keeps that number
        assert np.array_equal(ids, ids_across(a_mesh(tmp_path, "f 1 1 1\n")))


def test_a_face_just_within_the_limit_is_hit(tmp_path):
    """It stands far above the square and is met first."""
    far = float(np.nextafter(LARGEST_COORDINATE, 0.0))
    scene = a_mesh(tmp_path, f"v {far!r} 0 1\nv {-far!r} 1e18 1\nv {-far!r} -1e18 1\nf 5 6 7\n")
    assert rejected_faces(scene) == {}
    assert set(ids_across(scene).tolist()) == {0}


def test_what_float32_makes_too_large_is_left_out_of_what_is_judged(tmp_path):
    """A corner is infinite in float32, so its face becomes a point."""
    (part,) = pack(a_mesh(tmp_path, "v 1e39 0 1\nf 1 3 5\n"), as_float32).parts
    assert np.isfinite(part.vertices).all() and len(set(part.faces[0].tolist())) == 1


def test_a_mesh_none_of_which_stays_finite_is_refused(tmp_path):
    (tmp_path / "m.obj").write_text("v 1e10 1e10 1e10\nv 1e11 -1e10 1e10\nv 1e10 1e10 -1e11\nf 1 2 3\n")
    shape = caster.Mesh(file=str(tmp_path / "m.obj"), to_world=({"scale": 1e305},))
    with pytest.raises(caster.SceneError, match=r"shapes\[0\] \(mesh\): must stay finite in world space"):
        caster.render(scene_of(shape))


def test_without_area_is_decided_exactly(tmp_path):
    """Three corners on one line through numbers that float64 has no room to multiply; and one a last bit off it."""
    third = 1.0 / 3.0
    a, b = (third, 2.0 * third, 4.0 * third), (7.0 * third, 14.0 * third, 28.0 * third)
    mean = [0.5 * (x + y) for x, y in zip(a, b, strict=True)]
    rows = [f"v {p[0]!r} {p[1]!r} {p[2]!r}\n" for p in (a, b, mean, (np.nextafter(mean[0], 9.0).item(), *mean[1:]))]
    assert rejected_faces(a_mesh(tmp_path, "".join(rows) + "f 5 6 7\nf 5 6 8\n")) == {"shape-0": 1}


def test_the_count_is_reported(here, capsys):
    (here / "m.obj").write_text(QUAD + "v nan 0 0\nf 1 3 5\nf 1 1 1\n" + GOOD)
    (here / "s.toml").write_text(
        '[film]\nwidth = 4\nheight = 4\n[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n'
        '[[shape]]\ntype = "mesh"\nfile = "m.obj"\n'
    )
    words = "2 of shape-0"
    assert main(["check", "s.toml"]) == 0
    assert words in capsys.readouterr().out
    assert main(["render", "s.toml", "-o", "s.exr", "--explain"]) == 0
    assert "never hit            2 faces of shape-0\n" in capsys.readouterr().out
    assert caster.read_exr("s.exr").provenance["caster/faces_never_hit"] == words

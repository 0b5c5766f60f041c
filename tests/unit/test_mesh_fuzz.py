"""Damaged mesh files give a mesh or a SceneError, and nothing else."""

import struct

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from caster.description.errors import SceneError
from caster.geometry.mesh_files.obj import parse_obj
from caster.geometry.mesh_files.ply import parse_ply
from caster.geometry.triangle_mesh import check_mesh
from caster.geometry.world_space import as_given, transform_mesh

HEADER = (
    "ply\nformat {} 1.0\ncomment x\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "property uchar red\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
ROWS = [(0.5, 0.0, 1.0, 3), (1.5, 0.0, 1.0, 4), (0.25, 1.0, 1.0, 5)]
ASCII = HEADER.format("ascii").encode() + b"0 0 1 3\n1 0 1 4\n0 1 1 5\n3 0 1 2\n4 0 1 2 0\n"
BINARY = (
    HEADER.format("binary_little_endian").encode()
    + b"".join(struct.pack("<fffB", *row) for row in ROWS)
    + struct.pack("<B3iB4i", 3, 0, 1, 2, 4, 0, 1, 2, 0)
)
OBJ = b"# x\nv 0 0 0\nv 1 0 0\nv 0 1 .5e0\nvt 0 1\nvn 0 0 1\nf 1/1/1 2//1 \\\n 3\nf -1/-1 -2 -3\n"
STRANGE = [b"-1", b"0", b"1e400", b"nan", b"9" * 5000, b"1/", b"//", b"1_0", b"\n", b"", b"\0", b"\xb2"]
FILES = [(parse_ply, ASCII), (parse_ply, BINARY), (parse_obj, OBJ)]

quick = settings(
    max_examples=150,
    deadline=None,
    derandomize=True,  # the same examples in every run
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)


def usable_or_refused(parse, data):
    """Parse; whatever passes for a mesh must be one."""
    try:
        mesh = parse(data, "damaged")
        check_mesh(mesh, "damaged")
    except SceneError as error:
        assert str(error).startswith("damaged")
        return
    assert mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
    if np.isfinite(mesh.vertices).any():  # else it is refused when it is put into place
        placed = transform_mesh(mesh, np.eye(4), as_given, face_normals=False)
        assert np.isfinite(placed.vertices).all() and np.isfinite(placed.normals).all()


def test_the_files_are_whole_before_they_are_damaged():
    for parse, data in FILES:
        assert len(parse(data, "whole").faces) >= 2


@quick
@given(st.sampled_from(FILES), st.data())
def test_truncation_anywhere_is_harmless(file, data):
    parse, whole = file
    usable_or_refused(parse, whole[: data.draw(st.integers(0, len(whole)))])


@quick
@given(st.sampled_from(FILES), st.data())
def test_changed_bytes_are_harmless(file, data):
    parse, whole = file
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    usable_or_refused(parse, bytes(damaged))


@quick
@given(st.sampled_from(FILES), st.data())
def test_words_in_the_wrong_place_are_harmless(file, data):
    parse, whole = file
    words = whole.split(b" ")
    words[data.draw(st.integers(0, len(words) - 1))] = data.draw(st.sampled_from(STRANGE))
    usable_or_refused(parse, b" ".join(words))


@quick
@given(st.sampled_from([parse_ply, parse_obj]), st.binary(max_size=60))
def test_any_bytes_are_harmless(parse, data):
    usable_or_refused(parse, data)

"""Inputs that would block, never end or need more memory than they hold are refused."""

import os

import pytest
from programs import python

from caster.description import errors, parsing
from caster.description.errors import FileMissing, SceneError
from caster.description.input_files import read_input
from caster.geometry.mesh_files import load_mesh
from caster.image.exr import read_exr
from caster.scene import model
from caster.scene.files import load_scene, scene_from_text

CAMERA = '[film]\nwidth = 8\nheight = 8\n[camera]\ntype = "orthographic"\nlook_at = [0, 0, 0]\neye = [0, 0, 5]\n'
FACES = "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n"


@pytest.fixture
def fifo(tmp_path):
    path = tmp_path / "fifo.toml"
    os.mkfifo(path)
    return path


def test_what_is_no_file_is_refused_at_once(fifo, tmp_path):
    """A FIFO would block without a writer, a device may have no end, a link may lead to itself."""
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    for name, got in (("fifo", "a FIFO"), ("zero", "a device"), ("loop", "symbolic links")):
        with pytest.raises(FileMissing, match=rf"{name}\.toml: cannot read this scene file: .*{got}"):
            load_scene(tmp_path / f"{name}.toml")
    for ending in (".obj", ".ply"):
        with pytest.raises(FileMissing, match="mesh file: expected a file, got a FIFO"):
            load_mesh(fifo.rename(fifo.with_suffix(ending)))
        fifo = fifo.with_suffix(ending)
    with pytest.raises(FileMissing, match="EXR image: expected a file, got a FIFO"):
        read_exr(fifo.rename(fifo.with_suffix(".exr")))


def test_a_file_beyond_the_limit_is_not_read(tmp_path):
    """A file without content takes no room on the disk, and would in memory."""
    with (tmp_path / "large").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(SceneError, match=r"too large: expected at most 4,096 bytes, got 1,099,511,627,776"):
        read_input(tmp_path / "large", "scene file", 4096)
    (tmp_path / "small").write_bytes(bytes(4096))
    assert len(read_input(tmp_path / "small", "scene file", 4096)) == 4096


@pytest.mark.parametrize("nested", ["[" * 900 + "]" * 900, "[" * 90_000, '{"a":' * 900 + "1" + "}" * 900])
@pytest.mark.parametrize("kind", ["json", "toml"])
def test_deep_nesting_is_an_error(kind, nested):
    given = nested if kind == "json" else f"x = {nested.replace(':', '=')}"
    with pytest.raises(SceneError, match=r"nested too deeply|not valid|must be a table|unknown key"):
        scene_from_text(given, kind)


KEYS = "".join(f"near{i} = 1\n" for i in range(3000))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ('[[shape]]\ntype = "sphere"\nradius = -1\n' * 3000, "radius must be"),
        (KEYS, "did you mean 'near'?"),
        ('[[shape]]\ntype = "sphere"\n' + KEYS, "is an unknown key"),
        ('[[shape]]\ntype = "sphere"\nname = "a"\n' * 3001, "must differ from that of shapes[0]"),
    ],
    ids=["a value", "keys of the camera", "keys of a shape", "names"],
)
def test_of_thousands_of_errors_fifty_are_described(wrong, says, monkeypatch):
    """What a message says beside the place, such as the key that was meant, takes longer than all the rest."""
    described, describe = [], errors.value_message
    for module in (errors, model):
        monkeypatch.setattr(module, "value_message", lambda *about: described.append(about) or describe(*about))
    with pytest.raises(SceneError) as found:
        scene_from_text(CAMERA + wrong)
    lines = str(found.value).splitlines()
    assert len([line for line in lines if says in line]) == parsing.MAX_ERRORS_LISTED
    assert lines[-1] == "<string>: and 2950 more"
    assert len(described) <= parsing.MAX_ERRORS_LISTED + 1  # one by the validator of the scene


@pytest.mark.parametrize(
    ("encoding", "count"),
    [
        ("ascii", 4_000_000_000),
        ("ascii", 10**17),
        ("binary_little_endian", 4_000_000_000),
        ("binary_big_endian", 10**17),
    ],
)
def test_nothing_is_allocated_for_rows_that_the_file_cannot_hold(tmp_path, encoding, count):
    header = f"ply\nformat {encoding} 1.0\nelement vertex {count}\nproperty float x\n"
    (tmp_path / "a.ply").write_text(header + FACES)
    code = (
        "import resource, sys; from caster.geometry.mesh_files import load_mesh\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30)); load_mesh(sys.argv[1])"
    )
    done = python("-c", code, tmp_path / "a.ply")
    assert done.returncode == 1 and "SceneError" in done.stderr and str(tmp_path) in done.stderr.splitlines()[-1]

"""Scene files on disk: readable formats, permitted meshes, and error messages."""

import pytest

from caster.description.errors import FileMissing, SceneError
from caster.geometry.mesh_files import load_mesh
from caster.scene.files import load_scene, scene_from_text

CAMERA = '[camera]\ntype = "panorama"\neye = [0, 0, 0]\ndirection = [0, 0, 1]\n'
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def mesh(file):
    return f"{CAMERA}[[shape]]\ntype = \"mesh\"\nfile = '{file}'\n"  # the file is in line 7


@pytest.fixture
def scenes(tmp_path):
    """tmp/scenes beside tmp/meshes, a triangle in both."""
    for name in ("scenes", "meshes"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "t.obj").write_text(TRIANGLE)
    return tmp_path / "scenes"


def load(scenes, text, **more):
    (scenes / "x.toml").write_text(text)
    return load_scene(scenes / "x.toml", **more)


def refusal(error, scenes, text, **more):
    with pytest.raises(SceneError) as caught:
        load(scenes, text, **more)
    assert type(caught.value) is error
    return str(caught.value).removeprefix(f"{scenes}/")


def test_toml_and_json_files_are_read(tmp_path):
    (tmp_path / "a.TOML").write_text(CAMERA)
    scene = load_scene(tmp_path / "a.TOML")
    (tmp_path / "a.json").write_text('{"$schema": "scene.schema.json", ' + scene.canonical_json()[1:])
    assert load_scene(str(tmp_path / "a.json")) == scene


def test_a_byte_order_mark_is_no_part_of_the_scene(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbf" + CAMERA.encode())
    assert load_scene(tmp_path / "a.toml") == scene_from_text(CAMERA)


def test_an_unknown_ending_is_an_error():
    with pytest.raises(
        SceneError, match=r"^a\.yaml: unknown scene format: expected a file ending in \.toml or \.json, or a mesh: "
    ):
        load_scene("a.yaml")


def test_bytes_that_are_no_text_are_an_error(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"[film]\n\xff")
    with pytest.raises(SceneError, match=r"a\.toml: this scene file is not UTF-8 text: byte 8 is invalid$"):
        load_scene(tmp_path / "a.toml")


def test_a_mesh_is_found_beside_the_scene_wherever_one_stands(scenes, monkeypatch):
    scene = load(scenes, mesh("t.obj"))
    monkeypatch.chdir("/")
    assert scene.shapes[0].file == str((scenes / "t.obj").resolve())
    assert len(scene.shapes[0].mesh().faces) == 1


def test_a_mesh_is_parsed_once(scenes, monkeypatch):
    times = []
    monkeypatch.setattr("caster.shapes.mesh.load_mesh", lambda path: times.append(path) or load_mesh(path))
    load(scenes, mesh("t.obj")).shapes[0].mesh()
    assert len(times) == 1


@pytest.mark.parametrize("file", ["../meshes/t.obj", "{root}/meshes/t.obj", "link.obj", "/etc/passwd"])
def test_a_mesh_out_of_reach_is_refused_with_the_way_out(scenes, file):
    (scenes / "link.obj").symlink_to(scenes.parent / "meshes" / "t.obj")
    file = file.format(root=scenes.parent)
    said = refusal(SceneError, scenes, mesh(file))
    assert said.startswith(
        "x.toml:7:1: shapes[0] (mesh): file must lie in the scene's folder, below it, or below a folder "
        "given by "
        "--mesh-dir, got "
    )
    assert ": add --mesh-dir " in said and said.endswith("| ^^^^")


def test_the_way_out_of_the_refusal_works(scenes):
    said = refusal(SceneError, scenes, mesh("../meshes/t.obj"))
    mesh_dir = said.splitlines()[0].split("--mesh-dir ")[-1]
    assert load(scenes, mesh("../meshes/t.obj"), mesh_dirs=[mesh_dir]).shapes[0].mesh().vertices.shape == (3, 3)


def test_a_missing_mesh_is_a_missing_file_at_its_line(scenes):
    said = refusal(FileMissing, scenes, mesh("no.obj"))
    assert said.startswith(
        "x.toml:7:1: shapes[0] (mesh): file cannot be used: cannot read this mesh file: No such file or directory; "
        f"tried {scenes.resolve() / 'no.obj'}: if it is elsewhere, add --mesh-dir FOLDER\n"
    )


def test_a_missing_mesh_beside_another_error_is_an_invalid_scene(scenes):
    said = refusal(SceneError, scenes, mesh("no.obj") + "[film]\nwidth = 0\n")
    assert "x.toml:7:1" in said and "x.toml:9:1" in said


@pytest.mark.parametrize("name", ["", ".", "a\\u0000b.obj", "t.txt"])
def test_a_name_of_no_mesh_is_an_error(scenes, name):
    text = mesh("T").replace("'T'", f'"{name}"')
    assert refusal(SceneError, scenes, text).startswith("x.toml:7:1: shapes[0] (mesh): file ")

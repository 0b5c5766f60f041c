"""Sphere clouds: the bits of single spheres, files, and errors."""

import numpy as np
import pytest
from places import read_back
from ply_files import ply

import caster
from caster.aovs import BY_NAME
from caster.description.errors import FileMissing, SceneError
from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32, as_given
from caster.rendering.images import render
from caster.scene.files import scene_from_text
from caster.scene.model import Scene

CAMERA = caster.Pinhole(eye=(0.3, 0.7, 6.1), look_at=(0, 0, 0), fov=40)
TURN = [{"scale": 1.3}, {"rotate": {"axis": [1, 2, 3], "degrees": 37}}, {"translate": [0.3, 0.1, -0.4]}]
PLACES = {"as it is": [], "turned": TURN, "mirrored": [{"scale": -0.7}], "stretched": [{"scale": [1, 0.8, 1.7]}, *TURN]}


def some_spheres(count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(11)
    return rng.uniform(-1.2, 1.2, (count, 3)), 10.0 ** rng.uniform(-1.5, -0.4, count)


def scene_of(shapes) -> Scene:
    return Scene(film={"width": 72, "height": 64}, camera=CAMERA, shapes=shapes)


def write_ply(path, centers, radii, kind: str = "ascii") -> str:
    """A PLY file with its properties in an unusual order, and another element in front."""
    names = ["id", "z", "x", "y"] + (["radius"] if radii is not None else [])
    columns = [np.arange(len(centers)), centers[:, 2], centers[:, 0], centers[:, 1], radii][: len(names)]
    vertices = "vertex", [f"double {name}" for name in names], np.column_stack(columns).tolist()
    path.write_bytes(ply(kind, ("camera", ["double a"], [(7.5,)]), vertices))
    return str(path)


@pytest.mark.parametrize("place", PLACES)
def test_a_cloud_has_the_bits_of_single_spheres(place):
    centers, radii = some_spheres()
    cloud = scene_of([caster.SphereCloud(centers=centers, radii=radii, to_world=PLACES[place])])
    alone = scene_of(
        [caster.Sphere(center=c, radius=r, to_world=PLACES[place]) for c, r in zip(centers, radii, strict=True)]
    )
    for rounded in (as_given, as_float32):
        for one, other in zip(pack(cloud, rounded).kinds[0].prims, pack(alone, rounded).kinds[0].prims, strict=True):
            assert one.tobytes() == other.tobytes()
    names = set(BY_NAME) - {"shape_id", "prim_id"}
    one, other = render(cloud, tuple(names | {"prim_id"})), render(alone, tuple(names | {"shape_id"}))
    assert all(one[name].tobytes() == other[name].tobytes() for name in names)
    assert np.array_equal(one["prim_id"], other["shape_id"]) and len(np.unique(one["prim_id"])) > 20


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_file_has_the_bits_of_the_same_lists(tmp_path, kind):
    centers, radii = some_spheres()
    listed = caster.SphereCloud(centers=centers, radii=radii)
    from_file = caster.SphereCloud(file=write_ply(tmp_path / "a.ply", centers, radii, kind))
    without = caster.SphereCloud(file=write_ply(tmp_path / "b.ply", centers, None, kind), radius=0.25)
    for one, other in ((listed, from_file), (caster.SphereCloud(centers=centers, radius=0.25), without)):
        for a, b in zip(one.pack(as_given), other.pack(as_given), strict=True):
            assert a.tobytes() == b.tobytes()


def test_clouds_survive_text_and_pickle(tmp_path):
    centers, radii = some_spheres(5)
    write_ply(tmp_path / "a.ply", centers, radii)
    text = (
        'camera = {type = "pinhole", eye = [0, 0, 5], look_at = [0, 0, 0]}\nshape = ['
        '{type = "spheres", file = "a.ply"}, '
        '{type = "spheres", centers = [[1, 2, "0x1.8p0"], [0.1, -0.0, 3]], radii = [1, 0.3]}]\n'
    )
    scene = scene_from_text(text, folder=tmp_path)
    assert scene.shapes[1].centers == ((1.0, 2.0, 1.5), (0.1, 0.0, 3.0))
    for again in read_back(scene, tmp_path):
        assert again == scene and again.sha256() == scene.sha256()
    before = scene.sha256()
    write_ply(tmp_path / "a.ply", centers, 2.0 * radii)
    assert scene.sha256() != before
    assert scene.shapes[0].pack(as_given).radius.tolist() == (2.0 * radii).tolist()


REFUSED = {
    "{}": "needs either file or centers, got neither",
    '{file = "a.ply", centers = [[0, 0, 0]]}': "needs either file or centers, got both",
    "{centers = []}": "centers must be a list that is not empty, got []",
    "{centers = [[0, 0, 0], [1, 2]]}": "centers[1] must be 3 numbers [x, y, z], got 2: [1, 2]",
    "{centers = [[0, 0, 0], [0, inf, 0]]}": "centers[1][1] must be a finite number, got inf",
    "{centers = [[0, 0, 0]], radii = [-1]}": "radii[0] must be > 0, got -1",
    "{centers = [[0, 0, 0]], radii = [1, 2]}": "needs as many radii as centers, got 2 radii and 1 centers",
    '{file = "a.ply", radii = [1]}': "needs as many radii as centers, got 1 radii and 0 centers",
    "{centers = [[0, 0, 0]], radii = [1], radius = 2}": "needs either radius or radii, its own or its file's, got both",
    '{file = "a.ply", radius = 2}': "needs either radius or radii, its own or its file's, got both",
    '{file = "no.ply"}': "cannot be used: cannot read this file of points",
    '{file = "a.obj"}': "PLY header: expected the line 'ply', got 'v 0 0 0",
}


@pytest.mark.parametrize("fields", REFUSED)
def test_wrong_clouds_are_refused_with_the_reason(tmp_path, fields):
    write_ply(tmp_path / "a.ply", *some_spheres(3))
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    shape = fields.replace("{", '{type = "spheres", name = "balls", ', 1).replace(", }", "}")
    text = f'shape = [{shape}]\n[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n'
    with pytest.raises(SceneError) as found:
        scene_from_text(text, origin="s.toml", folder=tmp_path)
    assert "s.toml:1:" in str(found.value) and 'shapes[0] (spheres "balls")' in str(found.value)
    assert REFUSED[fields] in str(found.value)
    assert isinstance(found.value, FileMissing) == ("no.ply" in fields)


@pytest.mark.parametrize("radius", [-0.5, 0.0])
@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_a_bad_vertex_is_named_with_its_number(tmp_path, kind, radius):
    centers, radii = some_spheres(9)
    radii[[4, 6]] = radius, np.nan
    where = write_ply(tmp_path / "a.ply", centers, radii, kind)
    line = ":17" if kind == "ascii" else ""
    with pytest.raises(SceneError) as found:
        caster.SphereCloud(file=where).spheres()
    assert str(found.value) == (
        f"{where}{line}: radius of vertex 4 must be a length > 0, got {radius:g} (2 of 9 are wrong)"
    )
    centers[7, 1] = np.inf
    where = write_ply(tmp_path / "b.ply", centers, None, kind)
    with pytest.raises(SceneError, match=r"of vertex 7 must be finite numbers, got \(.*inf.*\(1 of 9 are wrong\)"):
        caster.SphereCloud(file=where).spheres()


def test_a_file_without_vertices_is_refused(tmp_path):
    where = write_ply(tmp_path / "a.ply", np.zeros((0, 3)), np.zeros(0))
    with pytest.raises(SceneError, match="expected at least one row of an element 'vertex', got none"):
        caster.SphereCloud(file=where).spheres()

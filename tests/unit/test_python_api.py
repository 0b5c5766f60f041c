"""What a program in Python meets: meshes from arrays, attributes, copies, messages and short reprs."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from places import read_back

import caster
from caster.description.errors import SceneError

pytestmark = pytest.mark.usefixtures("warm")

CORNERS = np.array([(0.1, 0, 0), (1, 0, 0), (0, 1 / 3, 0), (0, 0, 1)])
FACES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
NORMALS = np.array([(0, 0, -1), (2, 0, 0), (0, 3, 0), (0, 0, 0.5)])
UV = np.array([(0, 0), (1, 0), (0, 1), (0.25, 0.75)])
CAMERA = caster.Pinhole(eye=(3, 2, 5), look_at=(0.3, 0.1, 0.2), fov=20)


def scene_of(*shapes):
    return caster.Scene(camera=CAMERA, film=caster.Film(width=24, height=18), shapes=shapes)


def test_a_mesh_from_arrays_is_the_mesh_of_a_file(tmp_path):
    lines = [
        f"{word} {' '.join(map(repr, row))}"
        for word, rows in (("v", CORNERS), ("vn", NORMALS))
        for row in rows.tolist()
    ]
    lines += [f"vt {u!r} {1.0 - v!r}" for u, v in UV.tolist()]
    lines += ["f " + " ".join(f"{i + 1}/{i + 1}/{i + 1}" for i in face) for face in FACES.tolist()]
    (tmp_path / "m.obj").write_text("\n".join(lines))
    more = {"to_world": [{"scale": (2, 1, 1)}, {"rotate": {"axis": (1, 2, 3), "degrees": 40}}]}
    given = scene_of(caster.Mesh(CORNERS, FACES, NORMALS, UV, **more))
    read = scene_of(caster.Mesh(file=str(tmp_path / "m.obj"), **more))
    names = ("depth", "normal", "shading_normal", "uv", "prim_id")
    one, other = (caster.render(scene, names) for scene in (given, read))
    assert one.hit.any() and all(np.array_equal(one[name], other[name]) for name in names)
    assert not np.array_equal(one.normal, one.shading_normal)


def test_a_scene_with_arrays_is_written_with_all_digits_and_loads_again():
    scene = scene_of(caster.Mesh(CORNERS, FACES, NORMALS, UV, name="pyramid"), caster.Sphere())
    caster.render(scene)  # cached data does not count
    for again in read_back(scene):
        caster.render(again)
        assert again == scene and again.sha256() == scene.sha256()
        assert np.array_equal(again.shapes[0].mesh().vertices, CORNERS)
    other = scene_of(caster.Mesh(CORNERS, FACES[:, ::-1], NORMALS, UV, name="pyramid"), caster.Sphere())
    assert other != scene and other.sha256() != scene.sha256()


def test_a_mesh_of_trimesh_keeps_its_triangles_and_uv():
    given = SimpleNamespace(vertices=CORNERS, faces=FACES, visual=SimpleNamespace(uv=UV))
    assert caster.Mesh.from_trimesh(given, name="m") == caster.Mesh(CORNERS, FACES, uv=UV, name="m")
    given.visual = SimpleNamespace()
    assert caster.Mesh.from_trimesh(given) == caster.Mesh(CORNERS, FACES)


@pytest.mark.parametrize(
    ("arrays", "fields", "says"),
    [
        ((), {}, "needs file, or vertices and faces, got none"),
        ((CORNERS, FACES), {"file": "m.obj"}, "needs either file or arrays, got file and vertices and faces"),
        ((CORNERS[:, :2], FACES), {}, r"vertices\[0\] must be 3 numbers \[x, y, z\], got 2: \[0.1, 0\]"),
        ((np.array(5.0), FACES), {}, "vertices must be a list, got 5"),
        ((CORNERS + np.inf, FACES), {}, r"vertices\[0\]\[0\] must be a finite number, got inf"),
        ((CORNERS, FACES / 2), {}, r"faces\[0\]\[0\] must be a whole number, got 0"),
        ((CORNERS, [(0, 1, 2), (0, 1, -1)]), {}, r"faces\[1\]\[2\] must be >= 0, got -1"),
        ((CORNERS, [(0, 1, 2**40)]), {}, r"faces\[0\]\[2\] must be < 2147483648, got"),
        ((CORNERS, [(0, 1, True)]), {}, r"faces\[0\]\[2\] must be a whole number, got true"),
        ((CORNERS, [(0, 1, 4)]), {}, r"face 0 must join vertices 0 to 3 \(the mesh has 4\), got \(0, 1, 4\)"),
        ((CORNERS, FACES, NORMALS[:3]), {}, "normals must have 4 rows, one a vertex, got 3"),
        ((CORNERS, FACES, 0 * NORMALS), {}, "the normal of vertex 0 must have a direction"),
        ((CORNERS, FACES), {"nme": "m"}, "nme is an unknown key, did you mean 'name'?"),
    ],
)
def test_arrays_that_are_no_mesh_are_refused_with_the_first_bad_row(arrays, fields, says):
    with pytest.raises(SceneError, match=f"^mesh: {says}"):
        caster.Mesh(*arrays, **fields)


def test_one_vector_stands_for_all_rays():
    scene = scene_of(caster.Mesh(CORNERS, FACES))
    aims = np.random.default_rng(1).uniform(-0.3, 0.6, (50, 3)) - CAMERA.eye
    hits = caster.cast(scene, CAMERA.eye, aims)
    spelt = caster.cast(scene, np.tile(CAMERA.eye, (50, 1)), aims)
    assert hits.hit.any() and not hits.hit.all()
    assert all(np.array_equal(getattr(hits, name), getattr(spelt, name)) for name in ("t", "position", "uv", "prim_id"))
    assert np.array_equal(hits.hit, caster.occluded(scene, CAMERA.eye, aims))
    origins = CAMERA.eye + np.zeros((50, 1)) * aims
    assert np.array_equal(caster.cast(scene, origins, aims[7]).t, np.full(50, hits.t[7]))
    one = caster.cast(scene, CAMERA.eye, aims[7])
    assert one.t.shape == (1,) and one.position.shape == (1, 3) and one.t[0] == hits.t[7]
    assert caster.cast(scene, CAMERA.eye, np.empty((0, 3))).t.shape == (0,)
    for o, d, says in (
        (np.zeros((2, 3)), aims, "got 2 and 50"),
        (np.zeros(2), aims, r"shape \(n, 3\) or \(3,\), got \(2,\)"),
    ):
        with pytest.raises(SceneError, match=says):
            caster.cast(scene, o, d)


def test_a_t_beyond_float64_is_infinite_and_the_hit_is_known():
    hits = caster.cast(scene_of(caster.Sphere()), (0, 0, 5), [(0, 0, -5e-324), (0, 0, -1), (0, 1, 0)])
    assert hits.t.tolist() == [np.inf, 4.0, np.inf] and hits.hit.tolist() == [True, True, False]


def test_another_camera_shares_the_packed_shapes():
    scene = scene_of(caster.Mesh(CORNERS, FACES))
    caster.render(scene)
    moved = scene.with_camera(eye=(2, 2, 2), fov=30)
    assert (moved.camera.eye, moved.camera.fov, moved.camera.look_at) == ((2, 2, 2), 30, CAMERA.look_at)
    assert moved.derived is scene.derived and moved.with_camera(CAMERA) == scene.with_camera(fov=20)
    with pytest.raises(SceneError, match="fow is an unknown key, did you mean 'fov'"):
        scene.with_camera(fow=30)


@pytest.mark.parametrize(
    ("thing", "name", "says"),
    [
        (scene_of(), "camera", r"Scene.camera: .* immutable; use a copy .*: model_copy"),
        (
            CAMERA,
            "fov",
            r"Pinhole.fov: .* immutable; use a copy with another value: model_copy\(update=\{'fov': ...\}\)",
        ),
    ],
)
def test_a_description_says_how_it_is_changed(thing, name, says):
    with pytest.raises(AttributeError, match=says):
        setattr(thing, name, None)


def test_an_aov_is_an_attribute_if_it_was_rendered():
    aovs = caster.render(scene_of(caster.Sphere()), ("depth",))
    assert aovs.depth is aovs["depth"] and pickle.loads(pickle.dumps(aovs)).hit.dtype == bool
    for name, says in (
        ("normal", r"no 'normal' among these AOVs \(depth\): render it, aovs=\('normal', ...\)"),
        ("dept", "did you mean 'depth'"),
        ("colour", r"no 'colour' among these AOVs \(depth\)$"),
    ):
        with pytest.raises(AttributeError, match=says):
            getattr(aovs, name)

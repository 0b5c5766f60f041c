"""Scene files of MIT 6.837: what they become, what is left out of them, and every error with its line."""

import random

import pytest

from caster.classroom.course_files import load_course_scene
from caster.description.errors import FileMissing, SceneError
from caster.system.process import FILE

SCENE = """
PerspectiveCamera {{ center 0 0 10 direction 0 0 -1 up 0 1 0 angle 30 }}
Lights {{ numLights 1 DirectionalLight {{ direction 0 0 -2 color 1 0.5 0 }} }}
Background {{ color 0.2 0 0.6 ambientLight 0.1 0.1 0.1 }}
Materials {{ numMaterials 2
  PhongMaterial {{ diffuseColor 1 0 0 specularColor 1 1 1
    exponent 20}}
  Material {{ diffuseColor 0 1 0 }}
}}
Group {{ numObjects {count} MaterialIndex 0 {objects} }}
"""


def read(folder, text, **options):
    (folder / "s.txt").write_text(text)
    return load_course_scene(folder / "s.txt", 20, 10, **options)


def errors(folder, text):
    """ "line:column: sentence" of each."""
    with pytest.raises(SceneError) as caught:
        read(folder, text)
    start = f"{folder / 's.txt'}:"
    return [line.removeprefix(start) for line in str(caught.value).split("\n") if line.startswith(start)]


def test_blocks_become_a_scene_of_ours(tmp_path):
    """Braces need no space, materials hold for what follows, light that our model has keeps its brightness."""
    plane = "Plane { normal 0 2 0 offset -4 }"
    objects = f"Sphere {{ center 1 2 3 radius 0.5 }} Group {{ numObjects 1 MaterialIndex 1 {plane} }}"
    objects += " Triangle { vertex0 0 0 0 vertex1 1 0 0 vertex2 0 1 0 }"
    course = read(tmp_path, SCENE.format(count=3, objects=objects))
    sphere, plane, triangle = course.scene.shapes
    assert (sphere.center, sphere.radius, sphere.material) == ((1, 2, 3), 0.5, "material-0")
    assert (plane.normal, plane.offset, plane.material) == ((0, 1, 0), -2, "material-1")  # 2 y = -4
    assert (triangle.vertices[1], triangle.material) == ((1, 0, 0), "material-1")
    assert course.scene.materials["material-0"].reflectance == (1, 0, 0)
    assert [light.type for light in course.scene.lights] == ["directional", "ambient"]
    assert course.background == [0.2, 0, 0.6]
    assert course.scene.shading.shadows is False


def test_what_our_model_lacks_is_listed_with_its_place(tmp_path):
    text = SCENE.format(count=1, objects="Sphere { center 0 0 0 radius 1 }")
    text = text.replace("DirectionalLight { direction 0 0 -2", "PointLight { position 0 0 9")
    assert [line.rpartition("s.txt:")[2] for line in read(tmp_path, text).left_out] == [
        "3:22: left out: no attenuation: point lights fall off by 1 / r^2 here; the value at r = 1 is kept",
        "6:38: left out: specularColor 1 1 1: materials are diffuse, of one colour",
        "7:5: left out: exponent 20: materials are diffuse, of one colour",
    ]


@pytest.mark.parametrize(
    ("fading", "intensity", "left_out"),
    [("falloff 4", 0.25, 0), ("attenuation 0 0 4", 0.25, 0), ("attenuation 1 0 3", 0.25, 1), ("", 1.0, 1)],
)
def test_point_lights_that_fade_as_ours_are_kept_whole(tmp_path, fading, intensity, left_out):
    text = SCENE.format(count=1, objects="Sphere { center 0 0 0 radius 1 }").replace(
        "DirectionalLight { direction 0 0 -2 color 1 0.5 0", f"PointLight {{ position 0 0 9 color 1 1 1 {fading}"
    )
    course = read(tmp_path, text)
    assert course.scene.lights[0].intensity[0] == pytest.approx(3.141592653589793 * intensity, rel=1e-15)
    assert sum("PointLight" in line or "point lights" in line for line in course.left_out) == left_out


def test_all_values_that_a_scene_refuses_are_reported_at_their_blocks(tmp_path):
    objects = """
        Sphere { center 0 0 0 radius -1 }
        Transform { Scale 1 0 1 TriangleMesh { obj_file gone.obj } }"""
    text = SCENE.format(count=2, objects=objects).replace("angle 30", "angle 300")
    assert errors(tmp_path, text) == [
        "2:1: camera (pinhole): fov must be < 180, got 300",
        "11:9: shapes[0] (sphere): radius must be > 0, got -1",
        "12:33: shapes[1] (mesh): file cannot be used: cannot read this mesh file: No such file or directory; "
        f"tried {tmp_path.resolve() / 'gone.obj'}: if it is elsewhere, add --mesh-dir FOLDER",
        "12:33: shapes[1] (mesh): to_world must be invertible, but its matrix is singular",
    ]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("radius 1", "radius 1 radius 2"), "Sphere: radius occurs twice"),
        (("Sphere {", "Sphere { 7"), "Sphere: unknown word 7 (known: center, radius)"),
        (("center 0 0 10", "center 0 0 1x"), "PerspectiveCamera: center must be 3 numbers, got '1x' after 2"),
        (("up 0 1 0", "upp 0 1 0"), "PerspectiveCamera: unknown word upp, did you mean 'up'?"),
        (("up 0 1 0", ""), "PerspectiveCamera needs 'up'"),
        (("MaterialIndex 0", "MaterialIndex 3"), "MaterialIndex 3: the scene has 2 materials, counted from 0"),
        (("Sphere { center 0 0 0 radius 1 }", "Sphere { center 0 0 0 radius 1"), "Group: its '}' is missing"),
        (("Sphere {", "Sphere"), "Sphere must be followed by '{', got 'center'"),
        (("Sphere {", "Transform { Scale 1 1 1 } Sphere {"), "Transform needs one object, got 0"),
        (("angle 30", "angle nan"), "angle must be a number, got 'nan' after 0"),
        (("Background", "} Background"), "the file: unknown word } (known: Persp"),
        (("Background", "Group { numObjects 0 } Background"), "Group occurs twice; the first is in line 4"),
        (("PerspectiveCamera { center 0 0 10 direction 0 0 -1 up 0 1 0 angle 30 }", ""), "the scene needs a block Per"),
        (("color 1 0.5 0", "color 1 0.5 -1"), "DirectionalLight: color 1 0.5 -1 must be a colour >= 0"),
    ],
)
def test_each_kind_of_error_is_found(tmp_path, change, says):
    text = SCENE.format(count=1, objects="Sphere { center 0 0 0 radius 1 }")
    assert change[0] in text
    assert any(says in error for error in errors(tmp_path, text.replace(*change, 1)))


def test_a_mesh_that_is_missing_or_out_of_reach_is_an_error(tmp_path):
    text = SCENE.format(count=1, objects="TriangleMesh { obj_file gone.obj }")
    with pytest.raises(FileMissing) as caught:
        read(tmp_path, text)
    assert caught.value.exit_code == FILE
    assert "must lie in the scene's folder" in errors(tmp_path, text.replace("gone", "../gone"))[0]


def test_whatever_the_text_errors_are_errors_of_the_scene(tmp_path):
    """No text ends in anything else: words of a valid one are lost, doubled, swapped and replaced."""
    objects = "Transform { Scale 1 2 1 Rotate { 0 1 0 30 } Matrix { 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 } "
    words = SCENE.format(count=1, objects=objects + "Sphere { center 0 0 0 radius 1 } }").split()
    strange = ["{", "}", "0", "-1", "1e400", "nan", "1_0", "\0", "Group", "Matrix", "MaterialIndex", "up", "1e308"]
    rng, valid = random.Random(5), 0
    for _ in range(400):
        text = list(words)
        for _ in range(rng.randint(1, 3)):
            i, j = rng.randrange(len(text)), rng.randrange(len(text))
            text[i : i + rng.randint(0, 1)] = rng.choice([[], [text[j]], [rng.choice(strange)], text[j : j + 9]])
        try:
            read(tmp_path, " ".join(text))
            valid += 1
        except SceneError as error:
            assert str(error).startswith(f"{tmp_path / 's.txt'}:1:")
    assert 20 < valid < 200


def test_blocks_that_are_nested_without_end_are_refused(tmp_path):
    deep = SCENE.format(count=1, objects="Transform { Scale 1 1 1 " * 20000 + "}" * 20000)
    assert any("blocks are nested deeper than 64" in error for error in errors(tmp_path, deep))

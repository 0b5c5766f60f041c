"""`caster 6837` draws what the course means: known answers for its cameras, transforms, planes, lights and pictures."""

import numpy as np
import pytest
from PIL import Image

from caster.__main__ import main
from caster.classroom.course_files import load_course_scene
from caster.classroom.course_images import depth_image, normal_image, render_course, to_bytes_truncated
from caster.description import parsing

pytestmark = pytest.mark.usefixtures("warm")

PERSPECTIVE = "PerspectiveCamera { center 0 0 10 direction 0 0 -1 up 0 1 0 angle 90 }"
ORTHOGRAPHIC = "OrthographicCamera { center 0 0 10 direction 0 0 -1 up 0 1 0.7 size 4 }"
WHITE = "Materials { numMaterials 1 Material { diffuseColor 1 1 1 } }"
SPHERE = "Sphere { center 0 0 0 radius 1 }"
TRIANGLE = "Triangle { vertex0 -9 -9 0 vertex1 9 -9 0 vertex2 0 9 0 }"


def course_of(folder, objects, camera=ORTHOGRAPHIC, rest="", size=(40, 40), **options):
    text = f"{camera} {rest} {WHITE} Group {{ numObjects 1 MaterialIndex 0 {objects} }}"
    (folder / "s.txt").write_text(text)
    return load_course_scene(folder / "s.txt", *size, **options)


def drawn(folder, *args, **options):
    return render_course(course_of(folder, *args, **options))


def box(hit):
    """First and last column, first and last row that are hit."""
    (rows,), (columns,) = np.nonzero(hit.any(axis=1)), np.nonzero(hit.any(axis=0))
    return columns[0], columns[-1], rows[0], rows[-1]


@pytest.mark.parametrize(
    ("size", "spans"), [((40, 40), (10, 29, 10, 29)), ((40, 20), (10, 29, 0, 19)), ((20, 40), (0, 19, 10, 29))]
)
def test_the_orthographic_size_is_that_of_the_longer_side(tmp_path, size, spans):
    """A disk of width 2 in a window of 4: half of it, whatever the shape of the film."""
    assert box(drawn(tmp_path, SPHERE, size=size).hit) == spans


@pytest.mark.parametrize("size", [(40, 40), (40, 20), (20, 40)])
def test_the_angle_is_in_degrees_and_spans_the_longer_side(tmp_path, size):
    """At 90 degrees, the window at distance 10 is 20 wide: a plane there is seen from -10 to 10."""
    found = drawn(tmp_path, "Plane { normal 0 0 1 offset 0 }", PERSPECTIVE, size=size)
    pixel = 20.0 / 40
    x, y = (np.arange(n) + 0.5 - n / 2 for n in size)
    expected = np.sqrt(100.0 + (pixel * x) ** 2 + (pixel * y[:, None]) ** 2)
    assert np.allclose(found.t, expected, rtol=1e-14)


def test_orthographic_rays_come_from_infinitely_far(tmp_path):
    """t is negative behind the window; a sphere around it is seen from outside."""
    camera = ORTHOGRAPHIC.replace("0 0 10", "0 0 0")
    found = drawn(tmp_path, SPHERE, camera, size=(41, 41))
    assert found.t[20, 20] == pytest.approx(-1.0, abs=1e-14)
    plane = drawn(tmp_path, "Plane { normal 0 1 1 offset 0 }", camera, size=(41, 41))
    assert plane.hit.all()
    assert plane.t[0, 20] == pytest.approx(4 * 20 / 41, abs=1e-14) and plane.t[40, 20] < -1.9


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ("Translate 1 0 0 Scale 0.5 0.5 0.5", (25, 34, 15, 24)),  # the last one acts first
        ("Scale 0.5 0.5 0.5 Translate 1 0 0", (20, 29, 15, 24)),
        ("ZRotate 90 Translate 1 0 0 UniformScale 0.5", (15, 24, 5, 14)),
        ("Rotate { 0 0 1 90 } Translate 1 0 0 UniformScale 0.5", (15, 24, 5, 14)),
        ("Translate 1 0 0 Transform { UniformScale 0.5 SPHERE }", (25, 34, 15, 24)),
        ("Matrix { 0.5 0 0 1  0 0.5 0 0  0 0 0.5 0  0 0 0 1 }", (25, 34, 15, 24)),
        ("Matrix4f { 0.5 0 0 0  0 0.5 0 0  0 0 0.5 0  1 0 0 1 }", (25, 34, 15, 24)),
        ("Scale 0.5 0.5 0.5 Matrix { 1 0 0 1  0 1 0 0  0 0 1 0  0 0 0 1 }", (25, 34, 15, 24)),
    ],
)
def test_transforms_act_in_the_order_of_the_course(tmp_path, steps, expected):
    """A sphere of radius 1, half as wide as the film; ten pixels are one unit."""
    objects = f"Transform {{ {steps.replace('SPHERE', SPHERE)} {'' if 'SPHERE' in steps else SPHERE} }}"
    assert box(drawn(tmp_path, objects).hit) == expected


def test_depth_is_grey_from_white_at_near_to_black_at_far(tmp_path):
    found = drawn(tmp_path, SPHERE, size=(41, 41))
    assert found.t[20, 20] == pytest.approx(9.0, abs=1e-14)
    for near, far, grey in [(9, 10, 255), (8, 10, 127), (9.5, 10, 255), (7, 8, 0)]:
        picture = depth_image(found, near, far)
        assert (picture[20, 20] == grey).all() or abs(int(picture[20, 20, 0]) - grey) <= 1
        assert (picture[~found.hit] == 0).all()


def test_normals_are_shown_by_their_absolute_values(tmp_path):
    found = drawn(tmp_path, "Plane { normal 0 -3 -4 offset 0 }", size=(3, 3))
    assert (normal_image(found)[1, 1] == to_bytes_truncated(np.array([0.0, 0.6, 0.8]))).all()
    assert (normal_image(drawn(tmp_path, SPHERE))[0, 0] == 0).all()


SUN = "Lights { numLights 1 DirectionalLight { direction 0 -3 -4 color 0.5 1 1 } }"
LAMP = "Lights { numLights 1 PointLight { position 0 0 7 color 0.5 1 1 } }"
FAINT = "Background { color 0.25 0.5 0.75 ambientLight 0.125 0 0 }"


def pixels_of(file):
    with Image.open(file) as image:
        return np.asarray(image.convert("RGB"))


def center(picture):
    return picture[len(picture) // 2, picture.shape[1] // 2]


def test_colours_are_diffuse_and_ambient_light_without_falloff(tmp_path):
    """The normal is +z: a light from (0, 0.6, 0.8) gives 0.8 of its colour; a lamp in front all, however far."""
    sunny = drawn(tmp_path, TRIANGLE, rest=SUN + FAINT, size=(5, 5))
    assert center(sunny.color) == pytest.approx([0.8 * 0.5 + 0.125, 0.8, 0.8], abs=1e-15)
    lamp = drawn(tmp_path, TRIANGLE, rest=LAMP, size=(5, 5))
    assert center(lamp.color) == pytest.approx([0.5, 1.0, 1.0], abs=1e-15)
    fading = drawn(tmp_path, TRIANGLE, rest=LAMP.replace("1 1 }", "1 1 attenuation 1 2 3 }"), size=(5, 5))
    assert center(fading.color) == pytest.approx(np.array([0.5, 1.0, 1.0]) / (1 + 2 * 7 + 3 * 49), rel=1e-14)


def test_the_background_is_seen_where_nothing_is_hit(tmp_path):
    found = drawn(tmp_path, SPHERE, rest=SUN + FAINT)
    assert (found.color[~found.hit] == [0.25, 0.5, 0.75]).all()


def test_backs_are_black_unless_they_are_shaded(tmp_path):
    """The same triangle, its corners the other way round."""
    back = TRIANGLE.replace("vertex0", "vertex").replace("vertex1", "vertex0").replace("vertex ", "vertex1 ")
    assert center(drawn(tmp_path, back, rest=SUN + FAINT).color).tolist() == [0, 0, 0]
    shaded = drawn(tmp_path, back, rest=SUN + FAINT, shade_back=True)
    assert center(shaded.color) == pytest.approx([0.8 * 0.5 + 0.125, 0.8, 0.8], abs=1e-15)
    assert center(shaded.normal).tolist() == [0, 0, -1]


def test_shadows_fall_where_they_are_requested(tmp_path):
    objects = "Group { numObjects 2 Plane { normal 0 0 1 offset -1 } Sphere { center 0 0 0 radius 0.5 } }"
    sun = SUN.replace("0 -3 -4", "1 0 -1")
    lit, cast = (drawn(tmp_path, objects, rest=sun, shadows=shadows).color for shadows in (False, True))
    darker = (cast < lit).any(axis=-1)
    assert 40 < darker.sum() < 200 and lit[darker].min() > 0.0 and cast[darker].max() == 0.0


def test_the_command_writes_its_images_and_lists_what_it_left_out(here, monkeypatch, capsys):
    course_of(here, SPHERE, rest=LAMP + FAINT)
    words = "-input s.txt -size 30 20 -output o.png -depth -2 12 d.tga -normals n.png"
    assert main(["6837", *words.split()]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("o.png, d.tga, n.png: 30 x 20 pixels, ") and ", t 9.0" in said.out
    assert said.err.startswith("s.txt:1:") and ": left out: no attenuation" in said.err
    expected = render_course(load_course_scene("s.txt", 30, 20))
    assert np.array_equal(pixels_of("o.png"), to_bytes_truncated(expected.color))
    assert np.array_equal(pixels_of("d.tga"), depth_image(expected, -2.0, 12.0))
    assert np.array_equal(pixels_of("n.png"), normal_image(expected))
    listed = said.err.splitlines()
    monkeypatch.setattr(parsing, "MAX_ERRORS_LISTED", len(listed) - 1)
    assert main(["6837", *words.split()]) == 0
    assert capsys.readouterr().err.splitlines() == [*listed[:-1], "s.txt: and 1 more"]


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ("-input s.txt", 2, "nothing to render: expected at least one of -output, -depth, -normals"),
        ("-input s.txt -output o.jpg", 2, "-output o.jpg: expected a name that ends in .png or .tga"),
        (
            "-input s.txt -depth 3 2 d.png",
            2,
            "-depth 3 2 d.png: expected two finite numbers NEAR < FAR, and a file name",
        ),
        ("-input gone.txt -output o.png", 4, "gone.txt: cannot read this scene file: No such file or directory"),
        ("-input s.txt -output gone/o.png", 4, "cannot write: No such file or directory"),
        ("-input s.txt -output o.png -size 0 4", 2, "-size 0 4: film: width must be >= 1, got 0"),
    ],
)
def test_wrong_use_is_reported_with_its_exit_code(here, capsys, words, code, says):
    course_of(here, SPHERE)
    assert main(["6837", *words.split()]) == code
    assert says in capsys.readouterr().err
    assert not (here / "o.png").exists()

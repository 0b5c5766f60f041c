"""Scenes built in Python, their films, and data derived from them."""

import pickle

import numpy as np
import pytest

from caster.cameras import Orthographic, Pinhole
from caster.description.errors import SceneError
from caster.geometry.packing import forget_packed, packed
from caster.geometry.world_space import as_float32, as_given
from caster.scene.model import Ambient, Check, Diffuse, Film, Point, Scene, Shading
from caster.shapes import Cube, Cylinder, Disk, Icosphere, Sphere

CAMERA = Pinhole(eye=[0, 0, 5], look_at=[0, 0, 0])


def built():
    return Scene(
        film=Film(width=8, height=6, crop=[2, 2, 5, 6]),
        camera=CAMERA,
        lights=[Point(position=[0, 3, 0], intensity=[1, 2, 3]), Ambient(radiance=[0, 0, 1])],
        materials={"red": Diffuse(reflectance=[1, 0, 0])},
        shapes=[Sphere(material="red", name="ball"), Cube(), Disk(to_world={"translate": np.ones(3)})],
        shading=Shading(shadows=False),
        checks={"depth": Check(ratio=2)},
    )


def test_python_and_file_spellings_build_the_same_scene():
    data = built().model_dump(by_alias=True, exclude_none=True)
    assert {"light", "material", "shape", "check"} < data.keys()
    assert Scene(**data) == built()
    assert Scene.model_validate(data) == built()


def test_all_errors_of_a_python_scene_come_at_once():
    with pytest.raises(SceneError) as caught:
        Scene(
            camera={"type": "pinhole", "eye": [0, 0, 0], "look_at": [0, 0, 1], "fov": 200},
            shapes=[Sphere(name="a", material="gold"), {"type": "disk", "name": "a"}, {"type": "cube", "raduis": 2}],
        )
    assert str(caught.value).splitlines() == [
        "camera (pinhole): fov must be < 180, got 200",
        "shapes[2] (cube): raduis is an unknown key",
        'shapes[0] (sphere "a"): material must be one of the materials of this scene, got "gold"; '
        "add a table [material.gold]",
        'shapes[1] (disk "a"): name must differ from that of shapes[0], got "a" again',
    ]


def test_another_film_leaves_the_rest_alone():
    scene = built()
    larger = scene.with_film(width=16, height=12)
    assert larger.film == Film(width=16, height=12, crop=[4, 4, 10, 12])
    assert larger.model_copy(update={"film": scene.film}) == scene
    assert scene.film == Film(width=8, height=6, crop=[2, 2, 5, 6])


def reached(first, end, old, new):
    """The pixels of a side of `new` that overlap the pixels from first to end of a side of `old`."""
    inside = [k for k in range(new) if (k + 1) * old > first * new and k * old < end * new]
    return inside[0], inside[-1] + 1


@pytest.mark.parametrize("size", [(8, 6), (9, 7), (17, 18), (7, 5), (101, 97), (4, 2), (1, 1), (3, 100)])
def test_a_resized_film_keeps_all_pixels_that_its_crop_reaches(size):
    film = built().with_film(width=size[0], height=size[1]).film
    x, y = reached(2, 5, 8, size[0]), reached(2, 6, 6, size[1])
    assert (film.width, film.height) == size and film.crop == film.window == (x[0], y[0], x[1], y[1])


@pytest.mark.parametrize("crop", [(0, 0, 8, 6), (7, 0, 8, 6), (0, 5, 1, 6), (2, 1, 4, 3)])
def test_the_window_of_a_film_is_its_crop(crop):
    assert built().with_film(crop=crop).film.window == crop
    assert Film(width=8, height=6).window == (0, 0, 8, 6)


def test_a_given_crop_is_checked_against_the_new_film():
    assert built().with_film(width=4, height=4, crop=(0, 0, 4, 4)).film.window == (0, 0, 4, 4)
    with pytest.raises(SceneError, match=r"film: crop must lie inside the film, x1 <= 4"):
        built().with_film(width=4, height=4, crop=(0, 0, 5, 4))
    with pytest.raises(SceneError, match=r"width must be >= 1, got 0"):
        built().with_film(width=0)


def test_what_was_computed_from_a_scene_stays_with_it_alone():
    scene = built()
    scene.derived["packed"] = object()
    assert scene == built()
    assert scene.with_film(width=9).derived is scene.derived  # derived data do not depend on the film
    assert not scene.model_copy(update={"shapes": scene.shapes[:1]}).derived
    assert not pickle.loads(pickle.dumps(scene)).derived
    assert pickle.loads(pickle.dumps(scene)) == scene


@pytest.mark.parametrize("place", [(7, 8, 9), (-7, -8, -9), (7, -9, 8)])
def test_an_extent_is_the_largest_coordinate_of_either_sign(place):
    shapes = [kind(to_world={"translate": place}) for kind in (Sphere, Icosphere, Disk, Cylinder)]
    numbers = packed(Scene(camera=CAMERA, shapes=shapes))
    for kind, of_shape in zip(numbers.kinds, numbers.shape_extents, strict=True):
        assert kind.extent == of_shape == np.abs(kind.boxes()).max()


def test_a_packing_of_so_many_primitives_or_more_is_dropped_in_one_rounding():
    scene = Scene(camera=CAMERA, shapes=[Sphere(), Sphere(), Sphere()])
    forget_packed(scene, as_given, 3)  # nothing is packed yet
    kept, other = packed(scene), packed(scene, as_float32)
    forget_packed(scene, as_given, 4)
    assert packed(scene) is kept
    forget_packed(scene, as_given, 3)
    assert packed(scene) is not kept and packed(scene, as_float32) is other
    again = packed(scene)
    forget_packed(scene, as_given, 0)
    assert packed(scene) is not again


def test_steps_are_applied_in_their_order():
    steps = [{"translate": [1, 0, 0]}, {"rotate": {"axis": [0, 0, 5], "degrees": 90}}, {"scale": [2, 3, -4]}]
    assert Cube(to_world=steps).matrix.tolist() == [[0, -2, 0, 0], [3, 0, 0, 3], [0, 0, -4, 0], [0, 0, 0, 1]]


def test_a_camera_frame_has_right_and_up_as_in_the_image():
    right, up, forward = Orthographic(eye=[1, 1, 1], direction=[0, 0, -7], up=[0.0, 2.0, 1.0]).frame
    assert (right, up, forward) == ((1, 0, 0), (0, 1, 0), (0, 0, -1))
    right, up, forward = Pinhole(eye=[1, 1, 1], look_at=[9, 1, 1]).frame
    assert (right, up, forward) == ((0, 0, 1), (0, 1, 0), (1, 0, 0))

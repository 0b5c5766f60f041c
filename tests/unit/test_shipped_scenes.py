"""The scenes that come with the project: valid, small, and together a use of everything a scene can hold."""

import functools
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from caster.aovs import BY_NAME
from caster.cameras import CAMERAS
from caster.description.fields import Description, Step
from caster.geometry.packing import pack, primitive_count
from caster.kernels.triangles import Triangles
from caster.rendering.images import render
from caster.scene.files import load_scene, scene_schema
from caster.scene.model import LIGHTS, Film, Scene, Shading
from caster.shapes import SHAPES

FOLDER = Path(__file__).resolve().parents[2] / "scenes"
SCENES = sorted(FOLDER.glob("*.toml"))
SIDE = 32  # pixels

warm_up_scenes = pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)


@functools.cache
def scene_of(path: Path) -> Scene:
    return load_scene(path)


@functools.cache
def validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(scene_schema())


def purpose_of(path: Path) -> str:
    return path.read_text(encoding="utf-8").partition("\n")[0]


def kind(description: type[Description]) -> str:
    """What scene files write in `type`."""
    return description.model_fields["type"].default


def test_at_least_24_scenes_are_shipped():
    assert len(SCENES) >= 24, f"{len(SCENES)} in {FOLDER}"


@warm_up_scenes
def test_the_first_line_is_a_comment_of_one_sentence(path):
    purpose = purpose_of(path)
    assert purpose.startswith("# ") and len(purpose.split()) > 4
    assert purpose.endswith(".") and purpose[2].isupper()
    assert len(purpose) <= 110


def test_no_two_scenes_have_the_same_purpose():
    assert len({purpose_of(path).casefold() for path in SCENES}) == len(SCENES)


@warm_up_scenes
def test_a_scene_satisfies_the_published_schema(path):
    errors = validator().iter_errors(tomllib.loads(path.read_text(encoding="utf-8")))
    assert [f"{error.json_path}: {error.message}" for error in errors] == []


@pytest.mark.parametrize("shape", SHAPES, ids=kind)
def test_every_shape_is_used(shape):
    assert any(isinstance(one, shape) for path in SCENES for one in scene_of(path).shapes)


@pytest.mark.parametrize("camera", CAMERAS, ids=kind)
def test_every_camera_is_used(camera):
    assert any(isinstance(scene_of(path).camera, camera) for path in SCENES)


@pytest.mark.parametrize("light", LIGHTS, ids=kind)
def test_every_light_is_used(light):
    assert any(isinstance(one, light) for path in SCENES for one in scene_of(path).lights)


@pytest.mark.parametrize("part", [*CAMERAS, Film, Shading], ids=lambda part: part.__name__)
def test_every_key_of_camera_film_and_shading_is_used(part):
    """So that no option goes without a comparison."""
    parts = [one for path in SCENES for one in parts_of(scene_of(path)) if isinstance(one, part)]
    aim = {"look_at", "direction", "up"}  # shared by all cameras, and no camera needs all three
    assert set(part.model_fields) - aim - {key for one in parts for key in one.model_fields_set} == set()


def parts_of(scene: Scene) -> tuple[Description, ...]:
    return scene.camera, scene.film, scene.shading


@pytest.mark.parametrize("step", Step.model_fields)
def test_every_step_of_to_world_is_used(step):
    steps = [one for path in SCENES for shape in scene_of(path).shapes for one in shape.to_world]
    assert any(getattr(one, step) is not None for one in steps)


@warm_up_scenes
def test_a_scene_shows_something_and_no_nan(path):
    scene = scene_of(path)
    aovs = render(scene.with_film(width=SIDE, height=SIDE), tuple(BY_NAME))
    assert aovs.hit.any(), f"{purpose_of(path)} no pixel of {SIDE}x{SIDE} hits anything"
    assert [name for name, image in aovs.items() if np.isnan(image).any()] == []
    assert aovs["diffuse"].max() > 0.0, "black all over: no light falls on what is seen"


def test_every_mesh_file_is_below_20_kb_and_used():
    used = {Path(shape.file) for path in SCENES for shape in scene_of(path).shapes if getattr(shape, "file", None)}
    assert {file.resolve() for file in used} == {file.resolve() for file in (FOLDER / "meshes").iterdir()}
    assert [file.name for file in used if file.stat().st_size >= 20_000] == []


def test_all_scenes_together_are_below_500_kb():
    assert sum(file.stat().st_size for file in FOLDER.rglob("*") if file.is_file()) < 500_000


def test_a_mesh_has_more_than_100000_triangles():
    assert max(largest_mesh(scene_of(path)) for path in SCENES) > 100_000


def largest_mesh(scene: Scene) -> int:
    return max((primitive_count(part) for part in pack(scene).parts if isinstance(part, Triangles)), default=0)


def test_a_scene_has_more_than_1500_spheres():
    most = max(sum(shape.type == "sphere" for shape in scene_of(path).shapes) for path in SCENES)
    assert most > 1_500

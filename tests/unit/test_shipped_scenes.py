"""Shipped scenes are valid, small and show something."""

import functools
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
from marks import each_shipped_scene
from places import SCENES, SHIPPED

from caster.aovs import BY_NAME
from caster.rendering.images import render
from caster.scene.files import load_scene, scene_schema
from caster.scene.model import Scene

SIDE = 32  # pixels


@functools.cache
def scene_of(path: Path) -> Scene:
    return load_scene(path)


@functools.cache
def validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(scene_schema())


def purpose_of(path: Path) -> str:
    return path.read_text(encoding="utf-8").partition("\n")[0]


@each_shipped_scene
def test_the_first_line_is_a_comment_of_one_sentence(path):
    purpose = purpose_of(path)
    assert purpose.startswith("# ") and len(purpose.split()) > 4
    assert purpose.endswith(".") and purpose[2].isupper()
    assert len(purpose) <= 110


@each_shipped_scene
def test_a_scene_satisfies_the_published_schema(path):
    errors = validator().iter_errors(tomllib.loads(path.read_text(encoding="utf-8")))
    assert [f"{error.json_path}: {error.message}" for error in errors] == []


@each_shipped_scene
def test_a_scene_shows_something_and_no_nan(path):
    scene = scene_of(path)
    aovs = render(scene.with_film(width=SIDE, height=SIDE), tuple(BY_NAME))
    assert aovs.hit.any(), f"{purpose_of(path)} no pixel of {SIDE}x{SIDE} hits anything"
    assert [name for name, image in aovs.items() if np.isnan(image).any()] == []
    assert aovs["diffuse"].max() > 0.0, "black all over: no light falls on what is seen"


def test_every_mesh_file_is_below_20_kb_and_used():
    used = {Path(shape.file) for path in SHIPPED for shape in scene_of(path).shapes if getattr(shape, "file", None)}
    assert {file.resolve() for file in used} == {file.resolve() for file in (SCENES / "meshes").iterdir()}
    assert [file.name for file in used if file.stat().st_size >= 20_000] == []

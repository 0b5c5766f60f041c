"""Scene files: loading and validation, a mesh file as a scene, and the JSON Schema."""

import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from caster.cameras.pinhole import Pinhole
from caster.description.errors import SceneError
from caster.description.input_files import MESH_SUFFIXES, SCENE_SUFFIXES, FileName, read_text
from caster.description.parsing import model_of_text
from caster.description.transform import sine_and_cosine
from caster.geometry.mesh_files import MeshFolders
from caster.scene.model import Ambient, Diffuse, Directional, Scene
from caster.shapes.mesh import Mesh

__all__ = ["load_scene"]


def load_scene(path: FileName, mesh_dirs: Iterable[FileName] = ()) -> Scene:
    """Read a scene file, .toml or .json, and its meshes; or a mesh file as a scene, with a camera that sees all of it.

    Meshes are found relative to the scene file, or to one of mesh_dirs; each lies in or below one of these folders.
    Raises FileMissing for a file that cannot be read, SceneError with every error and its line for the rest.
    """
    where = os.fspath(path)
    suffix = Path(where).suffix.lower()
    if suffix in MESH_SUFFIXES:
        return mesh_scene(where)
    if suffix not in SCENE_SUFFIXES:
        raise SceneError(
            f"{where}: unknown scene format: expected a file ending in {' or '.join(SCENE_SUFFIXES)}, "
            f"or a mesh: {', '.join(MESH_SUFFIXES)}"
        )
    return scene_from_text(read_text(where), suffix[1:], where, folder=Path(where).parent, mesh_dirs=mesh_dirs)


# The scene of a mesh file: the direction from the mesh to the camera (y up), the field of view in degrees, and a factor
# on the distance, which leaves a margin of a twentieth around the bounding sphere.
MESH_VIEW, MESH_FOV, MESH_MARGIN = (0.4417, 0.3571, 0.8231), 41.3, 1.05
MESH_LIGHT = (-0.2713, -0.6889, -0.6719)  # the direction of its light


def mesh_scene(path: FileName) -> Scene:
    """A mesh file as a scene: a pinhole camera that sees all of it, a directional and an ambient light.

    Raises FileMissing, SceneError for a file that is no usable mesh, and for a mesh without an extent.
    """
    where = os.path.abspath(path)
    shape = Mesh(file=where, name="mesh", material="mesh")
    try:
        mesh = shape.mesh()
    except SceneError as error:
        raise type(error)(str(error).replace(where, os.fspath(path))) from None
    corners = mesh.vertices[np.unique(mesh.faces)]
    corners = corners[np.isfinite(corners).all(axis=1)]
    low, high = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else (np.zeros(3), np.zeros(3))
    center, radius = low / 2.0 + high / 2.0, math.hypot(*(high / 2.0 - low / 2.0).tolist())
    if not 0.0 < radius < math.inf:
        raise SceneError(
            f"{os.fspath(path)}: expected a mesh with an extent, got bounds {low.tolist()} to {high.tolist()}"
        )
    distance = MESH_MARGIN * radius / sine_and_cosine(math.radians(MESH_FOV) / 2.0)[0]
    scene = Scene(
        camera=Pinhole(
            eye=tuple(center + distance * np.array(MESH_VIEW) / math.hypot(*MESH_VIEW)),
            look_at=tuple(center),
            fov=MESH_FOV,
        ),
        lights=[Directional(direction=MESH_LIGHT, irradiance=(2.5, 2.5, 2.5)), Ambient(radiance=(0.1, 0.1, 0.1))],
        materials={"mesh": Diffuse(reflectance=(0.6, 0.6, 0.6), two_sided=True)},
        shapes=[shape],
    )
    scene._folder = Path(where).resolve().parent
    return scene


def scene_from_text(
    text: str,
    kind: str = "toml",
    origin: str = "<string>",
    *,
    folder: FileName = ".",
    mesh_dirs: Iterable[FileName] = (),
) -> Scene:
    """A scene from the text of a scene file. origin: its name in errors; folder: of relative mesh paths."""
    return model_of_text(Scene, text, kind, origin, MeshFolders(Path(folder), tuple(map(Path, mesh_dirs))))


def scene_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of scene files, for editors: keys, types and ranges."""
    schema = Scene.model_json_schema(by_alias=True)
    schema["properties"]["$schema"] = {"type": "string"}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}

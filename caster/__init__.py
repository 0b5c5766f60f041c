"""A ray caster in float64: depth, normals and shading of scenes.

Public names are imported on first access, so that `import caster` loads no compiler. They include every registered
shape, camera and light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from caster.system import NOT_HERE as _NOT_HERE

if TYPE_CHECKING:
    from caster.aovs import Aovs as Aovs
    from caster.cameras import *  # noqa: F403 - a registry, whatever is in it
    from caster.description.errors import SceneError as SceneError
    from caster.image.exr import Exr as Exr
    from caster.image.exr import read_exr as read_exr
    from caster.image.exr import write_exr as write_exr
    from caster.rendering.hits import Hits as Hits
    from caster.rendering.hits import cast as cast
    from caster.rendering.hits import occluded as occluded
    from caster.rendering.images import render as render
    from caster.scene.files import load_scene as load_scene
    from caster.scene.model import Ambient as Ambient
    from caster.scene.model import Check as Check
    from caster.scene.model import Diffuse as Diffuse
    from caster.scene.model import Directional as Directional
    from caster.scene.model import Film as Film
    from caster.scene.model import Glass as Glass
    from caster.scene.model import Mirror as Mirror
    from caster.scene.model import Point as Point
    from caster.scene.model import Scene as Scene
    from caster.scene.model import Shading as Shading
    from caster.scene.textures import Bitmap as Bitmap
    from caster.scene.textures import Checkerboard as Checkerboard
    from caster.scene.textures import MeshColors as MeshColors
    from caster.shapes import *  # noqa: F403 - a registry, whatever is in it

__version__ = "0.1.0"

_HOMES = {
    "load_scene": "caster.scene.files",
    "Scene": "caster.scene.model",
    "SceneError": "caster.description.errors",
    "render": "caster.rendering.images",
    "cast": "caster.rendering.hits",
    "occluded": "caster.rendering.hits",
    "Hits": "caster.rendering.hits",
    "Aovs": "caster.aovs",
    "Exr": "caster.image.exr",
    "read_exr": "caster.image.exr",
    "write_exr": "caster.image.exr",
    "Film": "caster.scene.model",
    "Shading": "caster.scene.model",
    "Check": "caster.scene.model",
    "Diffuse": "caster.scene.model",
    "Glass": "caster.scene.model",
    "Mirror": "caster.scene.model",
    "Checkerboard": "caster.scene.textures",
    "Bitmap": "caster.scene.textures",
    "MeshColors": "caster.scene.textures",
}
_REGISTRIES = {"caster.shapes": "SHAPES", "caster.cameras": "CAMERAS", "caster.scene.model": "LIGHTS"}


if not TYPE_CHECKING:  # so that type checkers report misspelt names

    def __getattr__(name: str) -> Any:
        if _NOT_HERE and not name.startswith("__"):
            raise ImportError(_NOT_HERE)
        if name in _HOMES:
            value = getattr(import_module(_HOMES[name]), name)
        elif name == "__all__":
            value = sorted([*_HOMES, *_registered(), "__version__"])
        elif name[:1].isupper() and name in _registered():
            value = _registered()[name]
        else:
            raise AttributeError(f"module 'caster' has no attribute '{name}'")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, *_registered()})


def _registered() -> dict[str, Any]:
    return {
        entry.__name__: entry
        for module, registry in _REGISTRIES.items()
        for entry in getattr(import_module(module), registry)
    }

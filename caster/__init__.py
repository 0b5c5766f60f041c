"""A standalone ray caster: scenes in, depth, normals and shading out.

Public names are imported when they are first used, so that `import caster` loads no compiler. Shapes, cameras
and lights come from their registries: whatever is registered there can be had here.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from caster.cameras import *  # noqa: F403 - a registry, whatever is in it
    from caster.exr import read_exr as read_exr
    from caster.exr import write_exr as write_exr
    from caster.film import Check as Check
    from caster.film import Film as Film
    from caster.film import Shading as Shading
    from caster.hits import Hits as Hits
    from caster.hits import cast as cast
    from caster.hits import occluded as occluded
    from caster.lights import Ambient as Ambient
    from caster.lights import Directional as Directional
    from caster.lights import Point as Point
    from caster.materials import Diffuse as Diffuse
    from caster.rendering import render as render
    from caster.scene_files import load_scene as load_scene
    from caster.scene_model import Scene as Scene
    from caster.shapes import *  # noqa: F403 - a registry, whatever is in it
    from caster.wording import SceneError as SceneError

__version__ = "0.1.0"

_HOMES = {
    "load_scene": "caster.scene_files",
    "Scene": "caster.scene_model",
    "SceneError": "caster.wording",
    "render": "caster.rendering",
    "cast": "caster.hits",
    "occluded": "caster.hits",
    "Hits": "caster.hits",
    "read_exr": "caster.exr",
    "write_exr": "caster.exr",
    "Film": "caster.film",
    "Shading": "caster.film",
    "Check": "caster.film",
    "Diffuse": "caster.materials",
}
_REGISTRIES = {"caster.shapes": "SHAPES", "caster.cameras": "CAMERAS", "caster.lights": "LIGHTS"}


if not TYPE_CHECKING:  # a type checker is to tell misspelt names

    def __getattr__(name: str) -> Any:
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

"""Where things are in this tree, its scenes on films of any size, and scenes made of some shapes."""

import pickle
import tomllib
from pathlib import Path
from typing import Any

from caster.scene.files import load_scene, scene_from_text
from caster.scene.model import Scene

ROOT = Path(__file__).resolve().parents[1]
SCENES = ROOT / "scenes"
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SHIPPED = sorted(SCENES.glob("*.toml"))


def read_back(scene: Scene, folder: Path = ROOT) -> list[Scene]:
    """The same scene by way of TOML, of JSON and of pickle; its files are in `folder`."""
    written = {"toml": scene.to_toml(), "json": scene.canonical_json()}
    texts = [scene_from_text(text, kind, folder=folder) for kind, text in written.items()]
    return [*texts, pickle.loads(pickle.dumps(scene))]


def shipped(name: str, width: int, height: int) -> Scene:
    """A scene of scenes/ on a film of this size."""
    return load_scene(SCENES / f"{name}.toml").with_film(width=width, height=height)


def scene_of(*shapes: Any, **more: Any) -> Scene:
    """Shapes before a camera, for tests that look at no image of it."""
    return Scene(camera={"type": "pinhole", "eye": (0, 0, 9), "look_at": (0, 0, 0)}, shapes=shapes, **more)

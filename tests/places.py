"""Where things are in this tree, and its scenes on films of any size."""

from pathlib import Path

from caster.scene.files import load_scene
from caster.scene.model import Scene

ROOT = Path(__file__).resolve().parents[1]
SCENES = ROOT / "scenes"


def shipped(name: str, width: int, height: int) -> Scene:
    """A scene of scenes/ on a film of this size."""
    return load_scene(SCENES / f"{name}.toml").with_film(width=width, height=height)

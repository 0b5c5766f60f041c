"""Scenes: their model, their files, and the JSON Schema of those."""

from typing import Any

from caster.film import Check, Film, Shading
from caster.scene_files import load_scene, scene_from_text
from caster.scene_model import Scene

__all__ = ["Check", "Film", "Scene", "Shading", "load_scene", "scene_from_text", "scene_schema"]


def scene_schema() -> dict[str, Any]:
    """The JSON Schema (2020-12) of scene files, for editors. It knows keys, types and ranges."""
    schema = Scene.model_json_schema(by_alias=True)
    schema["properties"]["$schema"] = {"type": "string"}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}

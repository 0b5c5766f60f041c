"""Scene files: loading and validation, resolution of mesh paths, and the JSON Schema."""

import os
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from caster.description.errors import (
    Diagnostic,
    FileMissing,
    Model,
    SceneError,
    child_of,
    diagnostics_of,
    format_value,
    value_diagnostic,
)
from caster.description.parsing import SceneFormat, format_diagnostics, parse, read_text
from caster.description.registry import type_name
from caster.scene.model import Film, Scene
from caster.shapes import SHAPES

__all__ = ["MeshFolders", "film_pixels", "load_scene", "resolve_mesh_files"]


def _mesh_shape(kind: Any) -> Any:
    """The shape class of that `type` if it reads a mesh file, else None."""
    return next((cls for cls in SHAPES if type_name(cls) == kind and hasattr(cls, "load")), None)


class MeshFolders(NamedTuple):
    """Folders that mesh files of a scene may be in: its own, and those of --mesh-dir."""

    folder: Path
    mesh_dirs: tuple[Path, ...]

    def resolve(self, file: str) -> Path | None:
        """The absolute path, or None if it is in none of the folders. Symbolic links are resolved first."""
        path = Path(os.path.realpath(self.folder / file))  # of a link to itself as well
        allowed = (os.path.realpath(folder) for folder in (self.folder, *self.mesh_dirs))
        return path if any(path.is_relative_to(folder) for folder in allowed) else None

    def refusal(self, file: str) -> str:
        """Message for a file in none of the folders."""
        mesh_dir = os.path.dirname(os.path.normpath(self.folder / file)) or "."
        allowed = "in the scene's folder, below it, or below a folder given by --mesh-dir"
        return f"must lie {allowed}, got {format_value(file)}: add --mesh-dir {mesh_dir}"


def resolve_mesh_files(
    data: Any, reach: MeshFolders, model: Model
) -> tuple[Any, list[Diagnostic], list[Diagnostic]]:
    """Data with absolute mesh paths, diagnostics of invalid meshes, and those of missing ones.

    Each mesh is read here; its shape caches the result.
    """
    problems: list[Diagnostic] = []
    missing: list[Diagnostic] = []
    for key in ("shape", "shapes"):
        shapes = child_of(data, key)
        if isinstance(shapes, list):
            found = [
                _resolve_mesh_file(shape, (key, i, "file"), data, reach, model)
                for i, shape in enumerate(shapes)
            ]
            data = data | {key: [shape for shape, _, _ in found]}
            for _, problem, absent in found:
                (missing if absent else problems).extend(problem)
    return data, problems, missing


def _resolve_mesh_file(
    shape: Any, path: Any, data: Any, reach: MeshFolders, model: Model
) -> tuple[Any, list[Diagnostic], bool]:
    file, kind = child_of(shape, "file"), child_of(shape, "type")
    mesh_shape = _mesh_shape(kind)
    if not isinstance(file, str) or mesh_shape is None:
        return shape, [], False
    where: Path | None = None
    try:
        where = reach.resolve(file)
        if where is None:
            return shape, [value_diagnostic(path, reach.refusal(file), data, model)], False
        mesh_shape.model_construct(file=str(where)).load()
    except (SceneError, ValueError, OSError) as error:
        text = str(error).removeprefix(f"{where}: ").replace(str(where), file)
        return (
            shape,
            [value_diagnostic(path, f"cannot be used: {text}", data, model)],
            isinstance(error, FileMissing),
        )
    return shape | {"file": str(where)}, [], False


SCENE_FORMATS: dict[str, SceneFormat] = {".toml": "toml", ".json": "json"}


def load_scene(path: str | PathLike[str], mesh_dirs: Iterable[str | PathLike[str]] = ()) -> Scene:
    """Read a scene file, .toml or .json, and its meshes.

    Meshes are found relative to the scene file, in its folder, below it, or below one of mesh_dirs.
    Raises FileMissing for a file that cannot be read, SceneError with every error and its line for the rest.
    """
    where = os.fspath(path)
    kind = SCENE_FORMATS.get(Path(where).suffix.lower())
    if kind is None:
        raise SceneError(
            f"{where}: unknown scene format: expected a file ending in {' or '.join(SCENE_FORMATS)}"
        )
    return scene_from_text(read_text(where), kind, where, folder=Path(where).parent, mesh_dirs=mesh_dirs)


def film_pixels(path: str | PathLike[str], size: Sequence[int] | None = None) -> int:
    """Pixels of the window of a scene file, without reading its meshes; 1 where the file has no valid film.

    size: width and height of the film instead of the scene's own.
    """
    try:
        data, _ = parse(read_text(path), SCENE_FORMATS[Path(path).suffix.lower()], "")
        film = Film.model_validate(child_of(data, "film") or {})
        x0, y0, x1, y1 = (film.resized(*size) if size else film).window
    except (SceneError, ValidationError, MemoryError, KeyError):
        return 1
    return (x1 - x0) * (y1 - y0)


def scene_from_text(
    text: str,
    kind: SceneFormat = "toml",
    origin: str = "<string>",
    *,
    folder: str | PathLike[str] = ".",
    mesh_dirs: Iterable[str | PathLike[str]] = (),
) -> Scene:
    """A scene from the text of a scene file. origin: its name in errors; folder: of relative mesh paths."""
    data, problems = parse(text, kind, origin)
    reach = MeshFolders(Path(folder), tuple(Path(mesh_dir) for mesh_dir in mesh_dirs))
    data, unusable, missing = resolve_mesh_files(data, reach, Scene)
    problems += unusable
    try:
        scene = Scene.model_validate(data)
    except ValidationError as error:
        problems += diagnostics_of(error, data, Scene)
    if problems or missing:
        kind_of_error = SceneError if problems else FileMissing
        raise kind_of_error(format_diagnostics([*problems, *missing], text, kind, origin))
    scene._folder = reach.folder.resolve()
    return scene


def scene_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of scene files, for editors: keys, types and ranges."""
    schema = Scene.model_json_schema(by_alias=True)
    schema["properties"]["$schema"] = {"type": "string"}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}

"""Which mesh files a scene may read, and reading them."""

import os
from pathlib import Path
from typing import Any, NamedTuple

from caster.problems import Model, Problem, item_of, speak
from caster.shapes import SHAPES
from caster.wording import FileMissing, SceneError, show

FROM_FILES: dict[str, Any] = {cls.model_fields["type"].default: cls for cls in SHAPES if hasattr(cls, "load")}


class Reach(NamedTuple):
    """The folder of the scene, and further folders whose meshes it may use."""

    folder: Path
    mesh_dirs: tuple[Path, ...]

    def resolve(self, file: str) -> Path | None:
        """Where the file is, or None if that is out of reach. Links are followed before it is decided."""
        path = (self.folder / file).resolve()
        allowed = (self.folder, *self.mesh_dirs)
        return path if any(path.is_relative_to(folder.resolve()) for folder in allowed) else None

    def refusal(self, file: str) -> str:
        """What to tell about a file out of reach."""
        mesh_dir = os.path.dirname(os.path.normpath(self.folder / file)) or "."
        allowed = "in the scene's folder, below it, or below a folder given by --mesh-dir"
        return f"must lie {allowed}, got {show(file)}: add --mesh-dir {mesh_dir}"


def find_meshes(data: Any, reach: Reach, model: Model) -> tuple[Any, list[Problem], list[Problem]]:
    """Data with absolute mesh paths, (1) problems with meshes and (2) meshes that are missing.

    Each mesh is read here; its shape keeps what was read, so it is not parsed twice.
    """
    problems: list[Problem] = []
    missing: list[Problem] = []
    for key in ("shape", "shapes"):
        shapes = item_of(data, key)
        if isinstance(shapes, list):
            found = [_found(shape, (key, i, "file"), data, reach, model) for i, shape in enumerate(shapes)]
            data = data | {key: [shape for shape, _, _ in found]}
            for _, problem, absent in found:
                (missing if absent else problems).extend(problem)
    return data, problems, missing


def _found(shape: Any, path: Any, data: Any, reach: Reach, model: Model) -> tuple[Any, list[Problem], bool]:
    file, kind = item_of(shape, "file"), item_of(shape, "type")
    if not isinstance(file, str) or not isinstance(kind, str) or kind not in FROM_FILES:
        return shape, [], False
    where: Path | None = None
    try:
        where = reach.resolve(file)
        if where is None:
            return shape, [speak(path, reach.refusal(file), data, model)], False
        FROM_FILES[kind].model_construct(file=str(where)).load()
    except (SceneError, ValueError, OSError) as error:
        text = str(error).removeprefix(f"{where}: ").replace(str(where), file)
        return shape, [speak(path, f"cannot be used: {text}", data, model)], isinstance(error, FileMissing)
    return shape | {"file": str(where)}, [], False

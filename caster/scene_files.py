"""Scene files: text -> Scene, or every error with its line."""

import os
from collections.abc import Iterable
from os import PathLike
from pathlib import Path

from pydantic import ValidationError

from caster.findings import problems_of
from caster.mesh_reach import Reach, find_meshes
from caster.scene_model import Scene
from caster.scene_text import Kind, parse, report, text_of
from caster.wording import FileMissing, SceneError

KINDS: dict[str, Kind] = {".toml": "toml", ".json": "json"}


def load_scene(path: str | PathLike[str], mesh_dirs: Iterable[str | PathLike[str]] = ()) -> Scene:
    """Read a scene file, .toml or .json, and the meshes it names.

    Meshes are found relative to the scene file, in its folder, below it, or below one of mesh_dirs.
    Raises FileMissing for a file that cannot be read, SceneError with every error and its line for the rest.
    """
    where = os.fspath(path)
    kind = KINDS.get(Path(where).suffix.lower())
    if kind is None:
        raise SceneError(f"{where}: unknown scene format: expected a file ending in {' or '.join(KINDS)}")
    return scene_from_text(text_of(where), kind, where, folder=Path(where).parent, mesh_dirs=mesh_dirs)


def scene_from_text(
    text: str,
    kind: Kind = "toml",
    origin: str = "<string>",
    *,
    folder: str | PathLike[str] = ".",
    mesh_dirs: Iterable[str | PathLike[str]] = (),
) -> Scene:
    """A scene from the text of a scene file. origin: what errors call it; folder: where its meshes are."""
    data, problems = parse(text, kind, origin)
    reach = Reach(Path(folder), tuple(Path(mesh_dir) for mesh_dir in mesh_dirs))
    data, unusable, missing = find_meshes(data, reach, Scene)
    problems += unusable
    try:
        scene = Scene.model_validate(data)
    except ValidationError as error:
        problems += problems_of(error, data, Scene)
    if problems or missing:
        kind_of_error = SceneError if problems else FileMissing
        raise kind_of_error(report([*problems, *missing], text, kind, origin))
    scene._folder = reach.folder.resolve()
    return scene

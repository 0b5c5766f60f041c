"""Loading of 6.837 scene files, with every error and its line."""

from collections.abc import Iterable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from pydantic import ValidationError

from caster.classroom.grammar import FILE_START, SourceMessage
from caster.classroom.parser import Parser
from caster.classroom.scene_conversion import Falloff, SceneBuilder, build_scene_data
from caster.description.diagnostics import Diagnostic, diagnostics_of
from caster.description.errors import FileMissing, SceneError
from caster.scene.files import MeshFolders, resolve_mesh_files
from caster.scene.model import Scene
from caster.scene.text import format_excerpt, read_text

__all__ = ["load_course_scene"]


@dataclass(frozen=True)
class CourseScene:
    """A scene, and the data of the course's images that a Scene has no fields for."""

    scene: Scene  # lights: those of `colors` in the same order, then the ambient one
    background: tuple[float, ...]  # behind everything, r g b
    colors: tuple[tuple[float, ...], ...]  # of the lights, r g b
    falloffs: tuple[Falloff | None, ...]  # None: directional
    left_out: tuple[str, ...]  # "file:line:column: left out: ...", in the order of the file


def load_course_scene(
    path: str | PathLike[str],
    width: int,
    height: int,
    *,
    shade_back: bool = False,
    shadows: bool = False,
    mesh_dirs: Iterable[str | PathLike[str]] = (),
) -> CourseScene:
    """Load a scene file of the course and its meshes, which are looked up as in scene files of this project.

    width, height: of the film, in pixels. shade_back: surfaces are lit from behind as well. shadows: cast shadows.
    Raises FileMissing for a file that cannot be read, SceneError with every error and its line for the rest.
    """
    text = read_text(path)
    parser = Parser(text)
    builder = build_scene_data(parser.sections(), width, height)
    for material in builder.data["material"].values():
        material["two_sided"] = shade_back
    builder.data["shading"]["shadows"] = shadows
    folders = MeshFolders(Path(path).parent, tuple(Path(folder) for folder in mesh_dirs))
    scene, errors, missing = _scene_of(builder, folders, whole=not parser.errors)
    if bad := [*parser.errors, *builder.errors, *errors, *missing]:
        kind_of_error = FileMissing if len(missing) == len(bad) else SceneError
        raise kind_of_error(_format_errors(bad, text, str(path)))
    assert scene is not None  # or there would be faults
    left_out = tuple(
        f"{path}:{at.line}:{at.column}: left out: {what}" for at, what in _by_position(builder.left_out)
    )
    return CourseScene(scene, builder.background, tuple(builder.colors), tuple(builder.falloffs), left_out)


def _scene_of(
    builder: SceneBuilder, folders: MeshFolders, whole: bool
) -> tuple[Scene | None, list[SourceMessage], list[SourceMessage]]:
    """(the scene, faults of it, meshes that are missing). whole: False if required fields are missing already."""
    data, unusable, missing = resolve_mesh_files(builder.data, folders, Scene)
    scene, problems = None, unusable
    try:
        scene = Scene.model_validate(data)
        scene._folder = folders.folder.resolve()
    except ValidationError as error:
        found = diagnostics_of(error, data, Scene)
        problems = problems + [problem for problem in found if whole or "needs the key" not in problem.text]
    return (
        scene,
        [_with_source(builder, each) for each in problems],
        [_with_source(builder, each) for each in missing],
    )


def _with_source(builder: SceneBuilder, problem: Diagnostic) -> SourceMessage:
    path = problem.path
    while path and path not in builder.sources:
        path = path[:-1]
    return SourceMessage(builder.sources.get(path, FILE_START), problem.text)


def _by_position(errors: Iterable[SourceMessage]) -> list[SourceMessage]:
    return sorted(errors, key=lambda fault: (fault.at.line, fault.at.column))


def _format_errors(errors: Iterable[SourceMessage], text: str, origin: str) -> str:
    return "\n".join(
        format_excerpt(at.span, message, text, origin) for at, message in _by_position(dict.fromkeys(errors))
    )

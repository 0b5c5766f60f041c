"""A 6.837 scene file -> a Scene of ours and what the course has beyond it, or every error with its line."""

from collections.abc import Iterable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from pydantic import ValidationError

from caster.classroom.assembling import build
from caster.classroom.blocks import START, Fault
from caster.classroom.building import Building, Falloff
from caster.classroom.parser import Parser
from caster.findings import problems_of
from caster.mesh_reach import Reach, find_meshes
from caster.problems import Problem
from caster.scene_model import Scene
from caster.scene_text import shown, text_of
from caster.wording import FileMissing, SceneError


@dataclass(frozen=True)
class Course:
    """A scene, with what the pictures of the course need and a Scene does not have."""

    scene: Scene  # its lights: those of `colors` in their order, then the ambient one
    background: tuple[float, ...]  # behind everything, r g b
    colors: tuple[tuple[float, ...], ...]  # of the lights, r g b
    falloffs: tuple[Falloff | None, ...]  # how they fade; None: directional
    left_out: tuple[str, ...]  # "file:line:column: left out: ...", in the order of the file


def load_course_scene(
    path: str | PathLike[str],
    width: int,
    height: int,
    *,
    shade_back: bool = False,
    shadows: bool = False,
    mesh_dirs: Iterable[str | PathLike[str]] = (),
) -> Course:
    """Read a scene file of the course, and the meshes it names, which are found as in our own scene files.

    width, height: of the film, in pixels. shade_back: surfaces are lit from behind, too. shadows: cast shadows.
    Raises FileMissing for a file that cannot be read, SceneError with every error and its line for the rest.
    """
    text = text_of(path)
    parser = Parser(text)
    made = build(parser.sections(), width, height)
    for material in made.data["material"].values():
        material["two_sided"] = shade_back
    made.data["shading"]["shadows"] = shadows
    reach = Reach(Path(path).parent, tuple(Path(folder) for folder in mesh_dirs))
    scene, faults, missing = _scene_of(made, reach, whole=not parser.faults)
    if bad := [*parser.faults, *made.faults, *faults, *missing]:
        kind_of_error = FileMissing if len(missing) == len(bad) else SceneError
        raise kind_of_error(_told(bad, text, str(path)))
    assert scene is not None  # or there would be faults
    left_out = tuple(
        f"{path}:{at.line}:{at.column}: left out: {what}" for at, what in _in_order(made.left_out)
    )
    return Course(scene, made.background, tuple(made.colors), tuple(made.falloffs), left_out)


def _scene_of(made: Building, reach: Reach, whole: bool) -> tuple[Scene | None, list[Fault], list[Fault]]:
    """(the scene, faults of it, meshes that are missing). whole: False where blocks lack what they need anyway."""
    data, unusable, missing = find_meshes(made.data, reach, Scene)
    scene, problems = None, unusable
    try:
        scene = Scene.model_validate(data)
        scene._folder = reach.folder.resolve()
    except ValidationError as error:
        found = problems_of(error, data, Scene)
        problems = problems + [problem for problem in found if whole or "needs the key" not in problem.text]
    return scene, [_placed(made, each) for each in problems], [_placed(made, each) for each in missing]


def _placed(made: Building, problem: Problem) -> Fault:
    path = problem.path
    while path and path not in made.places:
        path = path[:-1]
    return Fault(made.places.get(path, START), problem.text)


def _in_order(faults: Iterable[Fault]) -> list[Fault]:
    return sorted(faults, key=lambda fault: (fault.at.line, fault.at.column))


def _told(faults: Iterable[Fault], text: str, origin: str) -> str:
    return "\n".join(shown(at.span, said, text, origin) for at, said in _in_order(dict.fromkeys(faults)))

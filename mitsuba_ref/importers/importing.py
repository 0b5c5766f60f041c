"""Mitsuba XML or MIT 6.837 text -> a Scene of ours, and a list of what was left out."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from caster.findings import problems_of
from caster.mesh_reach import Reach, find_meshes
from caster.problems import Problem
from caster.scene import Scene
from caster.wording import FileMissing, SceneError, listed
from mitsuba_ref.importers.building import Building
from mitsuba_ref.importers.emitters import add_emitter
from mitsuba_ref.importers.expanding import expand
from mitsuba_ref.importers.places import Place, Remark, told
from mitsuba_ref.importers.sensors import KINDS, add_sensor
from mitsuba_ref.importers.shapes import add_shape
from mitsuba_ref.importers.xml_nodes import Node


class Imported(NamedTuple):
    """A scene of ours, and "file:line:column: left out: ..." in the order of the file."""

    scene: Scene
    left_out: tuple[str, ...]


def import_xml(path: str, parameters: Mapping[str, str] = {}, mesh_dirs: Iterable[str] = ()) -> Imported:
    """Read Mitsuba XML with its includes and meshes. parameters: values for its $names, before its own defaults.

    Raises FileMissing for files that cannot be read, SceneError with every error and its line for the rest.
    """
    document = expand(path, parameters)
    out = Building(document)
    with np.errstate(over="ignore", invalid="ignore"):  # what comes of huge numbers is refused with the scene
        _add_all(out, path)
        scene, missing = _scene_of(out, Reach(document.folder, tuple(map(Path, mesh_dirs))))
    if scene is None or document.errors:
        kind_of_error = FileMissing if missing and not document.errors else SceneError
        raise kind_of_error(told(sorted([*document.errors, *missing]), document.texts))
    return Imported(scene, tuple(remark.line() for remark in sorted(out.left_out)))


def _add_all(out: Building, path: str) -> None:
    """The first sensor of a kind that we have, then all shapes, lights and materials."""
    document = out.document
    sensors = [node for node in document.nodes if node.tag == "sensor"]
    usable = [node for node in sensors if node.kind in KINDS]
    if usable:
        add_sensor(out, usable[0])
    else:
        there = f", got {listed((node.kind for node in sensors), 'and')}" if sensors else ""
        place = sensors[0].place if sensors else Place(path, 1, 1)
        document.errors.append(Remark(place, f"needs a sensor that we have: {listed(KINDS)}{there}"))
    _add_rest(out, usable[:1])


def _add_rest(out: Building, done: list[Node]) -> None:
    """All elements but the sensor. An area light or a material stands for itself only where a shape refers to it."""
    nodes = out.document.nodes
    for node in nodes:
        if node.tag == "shape":
            add_shape(out, node)
        elif node.tag == "emitter" and node.kind != "area":
            add_emitter(out, node)
    for node in nodes:
        if id(node) not in out.used and node not in done and node.tag not in ("shape", "alias"):
            unused = ": no shape uses it" if node.tag in ("bsdf", "emitter") else ""
            out.omit(node, f"{node.words()}{unused}")


def _scene_of(out: Building, reach: Reach) -> tuple[Scene | None, list[Remark]]:
    """(the scene, None if it is not valid; meshes that are missing). Errors go into the document."""
    if "camera" not in out.data:
        out.data["camera"] = {
            "type": "pinhole",
            "eye": [0, 0, 0],
            "direction": [0, 0, 1],
        }  # for the other errors
    data, unusable, missing = find_meshes(out.data, reach, Scene)
    scene, problems = None, unusable
    try:
        scene = Scene.model_validate(data)
        scene._folder = reach.folder.resolve()
    except ValidationError as error:
        problems = problems + problems_of(error, data, Scene)
    out.document.errors += [_placed(out, each) for each in problems]
    absent = [_placed(out, each) for each in missing]
    return (None if absent else scene), absent


def _placed(out: Building, problem: Problem) -> Remark:
    path = problem.path
    while path and path not in out.places:
        path = path[:-1]
    return Remark(out.places.get(path, Place(next(iter(out.document.texts)), 1, 1)), problem.text)

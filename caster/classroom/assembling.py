"""The blocks of a 6.837 scene, put together as the data of a scene file of ours."""

from typing import Any

from caster.classroom.blocks import Node
from caster.classroom.building import Building
from caster.classroom.grammar import CAMERAS
from caster.classroom.lights import add_lights
from caster.classroom.objects import add_materials, add_objects


def build(sections: dict[str, Node], width: int, height: int) -> Building:
    """A film of this size; the blocks have the right fields, but their values may still be wrong."""
    out = Building(data={"film": {"width": width, "height": height}, "shading": {"shadows": False}})
    if "Camera" in sections:
        _camera(out, sections["Camera"], width, height)
    add_lights(out, sections)
    add_materials(out, sections.get("Materials"))
    out.data["shape"] = []
    if "Group" in sections:
        add_objects(out, sections["Group"], [])
    return out


def _camera(out: Building, node: Node, width: int, height: int) -> None:
    """Whatever the film, the longer of its sides spans the angle or the size: the course has one crop the square."""
    camera: dict[str, Any] = {"type": "pinhole" if node.kind == CAMERAS[0] else "orthographic"}
    for ours, theirs in (("eye", "center"), ("direction", "direction"), ("up", "up")):
        out.copy(camera, ours, node, theirs, "camera")
    if "angle" in node.tried:
        out.copy(camera, "fov", node, "angle", "camera")
        camera["fov_axis"] = "larger"
    elif (size := node.get("size")) is not None:
        share = width / max(width, height)
        camera["width"] = out.put(size.numbers[0] * share, size.at, "camera", "width")
    out.data["camera"] = out.put(camera, node.at, "camera")

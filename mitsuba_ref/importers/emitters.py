"""<emitter> -> a light of ours."""

from typing import Any

import numpy as np

from mitsuba_ref.importers.building import Building
from mitsuba_ref.importers.materials import color_of
from mitsuba_ref.importers.transforms import placed, steps_of
from mitsuba_ref.importers.xml_nodes import Node

ONE = [1.0, 1.0, 1.0]  # what an emitter sends, where it says nothing
SENT = ("radiance", "intensity", "irradiance")  # what emitters call it
EXACT = ("point", "directional")  # ours are the same, also if they send nothing


def is_dark(out: Building, node: Node) -> bool:
    """Whether an emitter says that it sends nothing: without it the picture is the same."""
    said = next((child for child in map(node.named, SENT) if child is not None), None)
    color = None if said is None else color_of(out, said)
    return color is not None and not any(color)


def add_emitter(out: Building, node: Node) -> None:
    """A point, directional or constant emitter; others are told to be left out."""
    makers = {"point": _point, "directional": _directional, "constant": _constant}
    if node.kind not in EXACT and is_dark(out, node):
        out.used.add(id(node))
        return
    if node.kind not in makers:
        out.omit(node, f"{node.words()}: our lights are point, directional and ambient")
        return
    light = makers[node.kind](out, node)
    out.used.add(id(node))
    if light is not None:
        out.places["light", len(out.data["light"])] = node.place
        out.data["light"].append(light)
    out.omit_rest(node)


def _point(out: Building, node: Node) -> dict[str, Any] | None:
    matrix = placed(steps_of(out, node))
    start = (0.0, 0.0, 0.0) if matrix is None else tuple(matrix[:3, 3].tolist())
    return _with(out, node, "intensity", {"type": "point", "position": out.vector(node, "position", start)})


def _directional(out: Building, node: Node) -> dict[str, Any] | None:
    matrix = placed(steps_of(out, node))
    along = np.array([0.0, 0.0, 1.0]) if matrix is None else matrix[:3, 2]
    return _with(
        out,
        node,
        "irradiance",
        {"type": "directional", "direction": out.vector(node, "direction", tuple(along.tolist()))},
    )


def _constant(out: Building, node: Node) -> dict[str, Any] | None:
    out.remark(node, "what shapes keep from each other of its light: ours is the same everywhere")
    return _with(out, node, "radiance", {"type": "ambient"})


def _with(out: Building, node: Node, name: str, light: dict[str, Any]) -> dict[str, Any] | None:
    """The light with its colour; None, and told, where that is none of ours."""
    child = node.named(name)
    color = ONE if child is None else color_of(out, child)
    if child is not None:
        out.used.add(id(child))
    if color is None:
        out.omit(node, f"{node.words()}: its {name} is no colour of three numbers")
        return None
    return light | {name: color}

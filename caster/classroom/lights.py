"""Lights and ambientLight of a 6.837 scene."""

import math
from typing import Any

from caster.classroom.blocks import START, Fault, Node
from caster.classroom.building import BLACK, GREY, WHITE, Building, Falloff, Path
from caster.classroom.tokens import Token


def add_lights(out: Building, sections: dict[str, Node]) -> None:
    """Directional and point lights, then the ambient one. Without lights the course shows plain colours."""
    lights: list[dict[str, Any]] = []
    out.data["light"] = lights
    node, background = sections.get("Lights"), sections.get("Background")
    for each in node.children if node else []:
        path = ("light", len(lights))
        lights.append(out.put({}, each.at, *path))
        color = each.numbers("color", BLACK)
        out.colors.append(color)
        if each.kind == "DirectionalLight":
            lights[-1]["type"] = "directional"
            out.falloffs.append(None)
            out.copy(lights[-1], "direction", each, "direction", *path)
            _color(out, lights[-1], "irradiance", each, math.pi, *path)
        else:
            lights[-1]["type"] = "point"
            out.copy(lights[-1], "position", each, "position", *path)
            _fading(out, lights[-1], each, path)
    ambient, at = _ambient(out, background)
    if not lights:
        ambient = WHITE
    if any(ambient):
        path = ("light", len(lights))
        lights.append(out.put({"type": "ambient", "radiance": list(ambient)}, at, *path))


def _ambient(out: Building, node: Node | None) -> tuple[tuple[float, ...], Token]:
    if node is None:
        return BLACK, START
    out.background = node.numbers("color", GREY)
    if (cube := node.get("cubeMap")) is not None:
        out.omit(cube.at, f"{cube.words}: there are no pictures behind our scenes")
    ambient = node.get("ambientLight")
    return (BLACK, node.at) if ambient is None else (ambient.numbers, ambient.at)


def _color(
    out: Building, into: dict[str, Any], key: str, node: Node, factor: float, *path: str | int
) -> None:
    """A surface across a light of the course sends back reflectance times color, one of ours that over pi."""
    found = node.get("color")
    if found is None:
        return
    if min(found.numbers) < 0.0:  # said here, in the numbers of the file
        out.faults.append(Fault(found.at, f"{node.kind}: {found.words} must be a colour >= 0"))
    into[key] = out.put([factor * abs(c) for c in found.numbers], found.at, *path, key)


def _fading(out: Building, light: dict[str, Any], node: Node, path: Path) -> None:
    """Ours fade by 1 / r^2. Others come as bright as they are at r = 1, which is told."""
    falloff = Falloff(*node.numbers("attenuation", (1.0, 0.0, 0.0)))
    if (of_2011 := node.get("falloff")) is not None and of_2011.numbers[0] > 0.0:
        falloff = Falloff(0.0, 0.0, of_2011.numbers[0])
    at_one = sum(falloff)
    if not at_one > 0.0:
        out.faults.append(Fault(node.at, "PointLight: its attenuation must leave light at a distance of 1"))
        at_one = 1.0
    out.falloffs.append(falloff)
    _color(out, light, "intensity", node, math.pi / at_one, *path)
    if not falloff.is_ours:
        which = node.get("attenuation")
        says = which.words if which else "light that does not fade"
        out.omit(
            which.at if which else node.at,
            f"{says}: our point lights fade by 1 / r^2; it keeps what it has at r = 1",
        )

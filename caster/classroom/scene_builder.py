"""The scene description that a 6.837 scene is converted to, with its sources in the text, and its lights."""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from caster.classroom.grammar import FILE_START, Node, SourceMessage, Token

Path = tuple[str | int, ...]

WHITE, BLACK, GREY = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.5, 0.5, 0.5)


class Falloff(NamedTuple):
    """Attenuation of a point light at distance r: color / (constant + linear r + quadratic r^2)."""

    constant: float
    linear: float
    quadratic: float

    @property
    def is_inverse_square(self) -> bool:
        return self.constant == self.linear == 0.0


@dataclass
class SceneBuilder:
    """The scene description under construction, with errors and omissions."""

    data: dict[str, Any] = field(default_factory=dict)  # as in a scene file of this project
    sources: dict[Path, Token] = field(default_factory=dict)  # the token of each value of the data
    errors: list[SourceMessage] = field(default_factory=list)
    left_out: list[SourceMessage] = field(default_factory=list)
    background: tuple[float, ...] = GREY  # default of the course
    colors: list[tuple[float, ...]] = field(default_factory=list)  # of point and directional lights
    falloffs: list[Falloff | None] = field(default_factory=list)  # None: directional
    material: str = ""  # of the objects that follow

    def put(self, value: Any, at: Token, *path: str | int) -> Any:
        """Record the source of a value and return it."""
        self.sources[path] = at
        return value

    def omit(self, at: Token, text: str) -> None:
        """Record that something of the file has no counterpart."""
        self.left_out.append(SourceMessage(at, text))

    def copy(self, into: dict[str, Any], key: str, node: Node, field_name: str, *path: str | int) -> None:
        """Copy the numbers of a field into the data, if the node has it."""
        found = node.get(field_name)
        if found is not None:
            value = list(found.numbers) if len(found.numbers) > 1 else found.numbers[0]
            into[key] = self.put(value, found.at, *path, key)


# ---- lights ----


def add_lights(out: SceneBuilder, sections: dict[str, Node]) -> None:
    """Add directional and point lights, then the ambient one: white without other lights, as in the course."""
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
            _point_falloff(out, lights[-1], each, path)
    ambient, at = _ambient(out, background)
    if not lights:
        ambient = WHITE
    if any(ambient):
        path = ("light", len(lights))
        lights.append(out.put({"type": "ambient", "radiance": list(ambient)}, at, *path))


def _ambient(out: SceneBuilder, node: Node | None) -> tuple[tuple[float, ...], Token]:
    if node is None:
        return BLACK, FILE_START
    out.background = node.numbers("color", GREY)
    if (cube := node.get("cubeMap")) is not None:
        out.omit(cube.at, f"{cube.words}: no environment maps here")
    ambient = node.get("ambientLight")
    return (BLACK, node.at) if ambient is None else (ambient.numbers, ambient.at)


def _color(
    out: SceneBuilder, into: dict[str, Any], key: str, node: Node, factor: float, *path: str | int
) -> None:
    """Set the radiometric quantity of a light: the course reflects reflectance times color, here it is over pi."""
    found = node.get("color")
    if found is None:
        return
    if min(found.numbers) < 0.0:  # checked here, to report the numbers of the file
        out.errors.append(SourceMessage(found.at, f"{node.kind}: {found.words} must be a colour >= 0"))
    into[key] = out.put([factor * abs(c) for c in found.numbers], found.at, *path, key)


def _point_falloff(out: SceneBuilder, light: dict[str, Any], node: Node, path: Path) -> None:
    """Set the intensity of a point light. Any falloff but 1 / r^2 is replaced by it, equal at r = 1, and reported."""
    falloff = Falloff(*node.numbers("attenuation", (1.0, 0.0, 0.0)))
    if (of_2011 := node.get("falloff")) is not None and of_2011.numbers[0] > 0.0:
        falloff = Falloff(0.0, 0.0, of_2011.numbers[0])
    at_one = sum(falloff)
    if not at_one > 0.0:
        out.errors.append(
            SourceMessage(node.at, "PointLight: its attenuation must leave light at a distance of 1")
        )
        at_one = 1.0
    out.falloffs.append(falloff)
    _color(out, light, "intensity", node, math.pi / at_one, *path)
    if not falloff.is_inverse_square:
        which = node.get("attenuation")
        falloff_text = which.words if which else "no attenuation"
        out.omit(
            which.at if which else node.at,
            f"{falloff_text}: point lights fall off by 1 / r^2 here; the value at r = 1 is kept",
        )

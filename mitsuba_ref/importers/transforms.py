"""<transform> -> steps of a to_world of ours, which act in the order of the file as Mitsuba's do."""

import math
from typing import Any

import numpy as np

from mitsuba_ref.importers.building import Building
from mitsuba_ref.importers.xml_nodes import Node

Step = dict[str, Any]
STEPS = ("translate", "rotate", "scale", "lookat", "matrix")


def steps_of(out: Building, node: Node, name: str = "to_world") -> list[Step]:
    """The steps of that transform of an element; none where it has none."""
    transform = out.find(node, name, "transform")
    if transform is None:
        return []
    for child in transform.children:
        if child.tag not in STEPS:
            out.error(child, f"unknown step <{child.tag}> of a transform (known: {', '.join(STEPS)})")
    return [_step(out, child) for child in transform.children if child.tag in STEPS]


def _step(out: Building, node: Node) -> Step:
    if node.tag == "translate":
        return {"translate": out.xyz(node, (0.0, 0.0, 0.0))}
    if node.tag == "scale":
        return {"scale": out.xyz(node, (1.0, 1.0, 1.0))}
    if node.tag == "rotate":
        return _rotation(out.xyz(node, (0.0, 0.0, 0.0)), out.numbers(node, "angle", 1)[0])
    if node.tag == "lookat":
        up = out.numbers(node, "up", 3) if "up" in node.attributes else [0.0, 1.0, 0.0]
        return {
            "look_at": {
                "origin": out.numbers(node, "origin", 3),
                "target": out.numbers(node, "target", 3),
                "up": up,
            }
        }
    return {"matrix": _matrix(out, node)}


def _rotation(axis: list[float], degrees: float) -> Step:
    """Mitsuba takes the axis as it is: where its length is not 1 (exactly) the outcome is no rotation, but a matrix."""
    length = math.hypot(*axis)
    if length in (0.0, 1.0):  # 0 is refused with the rest of the scene
        return {"rotate": {"axis": axis, "degrees": degrees}}
    x, y, z = axis
    angle = math.radians(degrees)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    outer = np.outer(axis, axis)
    linear = math.cos(angle) * np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * outer
    return {"matrix": rows_of(linear, [0.0, 0.0, 0.0])}


def _matrix(out: Building, node: Node) -> list[list[float]]:
    """16 numbers, or 9 of the linear part, row by row."""
    count = 9 if len(node.attributes.get("value", "").replace(",", " ").split()) == 9 else 16
    found = out.numbers(node, "value", count)
    if count == 9:
        return rows_of(np.array(found).reshape(3, 3), [0.0, 0.0, 0.0])
    if len(found) != 16:
        out.error(node, "matrix: value must be 16 numbers, got 1")
        return rows_of(np.eye(3), [0.0, 0.0, 0.0])
    return [found[i : i + 4] for i in range(0, 16, 4)]


def rows_of(linear: np.ndarray, move: Any) -> list[list[float]]:
    return [*([*row, float(x)] for row, x in zip(linear.tolist(), move, strict=True)), [0.0, 0.0, 0.0, 1.0]]


def placed(steps: list[Step]) -> np.ndarray | None:
    """4x4 float64 of the steps, by caster's own composition; None where they are not valid (which is told later)."""
    from caster.shapes import Cube
    from caster.wording import SceneError

    try:
        return np.array(Cube(to_world=steps).matrix)
    except SceneError:
        return None

"""The steps of a Transform of a 6.837 scene."""

import math
from typing import Any

from caster.classroom.blocks import Field, Node
from caster.classroom.building import Building
from caster.classroom.grammar import STEPS

Step = dict[str, Any]

# The course computes in float32: an axis of unit length may be written four roundings away from it.
UNIT_ATOL = 4 * 2.0**-24

AXES = {"XRotate": (1, 0, 0), "YRotate": (0, 1, 0), "ZRotate": (0, 0, 1)}


def steps_of(out: Building, node: Node) -> list[Step]:
    """In the order they act: the last of the file first. But a matrix acts after all that stand before it."""
    steps: list[Step] = []
    for item in node.items:
        if isinstance(item, Field):
            where = len(steps) if item.name.startswith("Matrix") else 0
            steps.insert(where, _step(out, item))
    return steps


def _step(out: Building, item: Field) -> Step:
    numbers = list(item.numbers)
    if item.name in AXES:
        return {"rotate": {"axis": list(AXES[item.name]), "degrees": numbers[0]}}
    if item.name == "Rotate":
        length = math.hypot(*numbers[:3])
        if length > 0.0 and abs(length - 1.0) > UNIT_ATOL:
            text = f"the length {length:g} of the axis of {item.words}: we turn about its direction"
            out.omit(item.at, text)
        return {"rotate": {"axis": numbers[:3], "degrees": numbers[3]}}
    if item.name == "Translate":
        return {"translate": numbers}
    if item.name in ("Scale", "UniformScale"):
        return {"scale": numbers if len(numbers) == 3 else numbers[0]}
    assert item.name in STEPS
    rows = [numbers[i : i + 4] for i in range(0, 16, 4)]
    if item.name == "Matrix4f":  # of 2011, which reads it column by column
        rows = [list(column) for column in zip(*rows, strict=True)]
    return {"matrix": rows}

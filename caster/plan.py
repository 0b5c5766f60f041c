"""What a scene and the AOVs asked for need."""

from dataclasses import dataclass
from typing import Any

from caster.casting import Culling
from caster.kernels.jit import implements
from caster.kernels.protocol import project


@dataclass(frozen=True)
class Plan:
    """How the camera rays are cast, and why so."""

    culling: Culling
    reason: str


def plan(camera: Any) -> Plan:
    """The culling for a packed camera's own rays."""
    if implements(project, type(camera)):
        return Plan(
            "screen", "the camera keeps straight lines straight, so each primitive stays in its picture's box"
        )
    return Plan("bvh", "the camera bends straight lines, so rays go through a tree of boxes")

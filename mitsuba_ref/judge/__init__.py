"""The judge: compares a subject with Mitsuba and exact arithmetic and classifies every pixel.

Here is the list of its checks of a scene beside those of pixels: of whose answers, how often, and which only --thorough
makes. `validate`, the pytest plug-in and the verdict read it, and it loads nothing; report/validation.py makes them.
"""

from typing import NamedTuple

OURS, CANDIDATE = "ours", "candidate"


class Check(NamedTuple):
    """One check of a scene."""

    name: str  # in a verdict
    of: tuple[str, ...] = (OURS, CANDIDATE)
    once: bool = False  # a scene; others are made for each band of a large film
    camera: bool = False  # looks at the camera's rays: not made of a list of rays
    thorough: bool = False  # tests our caster beyond the judged film, with kernels that the film does not need


SCENE_CHECKS = (
    Check("ray_conventions", (CANDIDATE,), once=True, camera=True),
    Check("placement", once=True),
    Check("geometry", once=True),
    Check("materials", (OURS,), once=True),
    Check("camera", camera=True),
    Check("render", (OURS,), camera=True),
    Check("culling", (OURS,), camera=True),
    Check("brute_force", (OURS,), camera=True, thorough=True),
    Check("knife_edges", (OURS,), once=True),
    Check("scaling", (OURS,), once=True, thorough=True),
    Check("routes", (OURS,), camera=True, thorough=True),
    Check("mesh_files", once=True),
    Check("sensor", camera=True),
    Check("bias", (OURS,), once=True),
)
THOROUGH_CHECKS = tuple(check.name for check in SCENE_CHECKS if check.thorough)


def check_names(of: str, *, thorough: bool = True, whole_scene: bool = True, camera: bool = True) -> tuple[str, ...]:
    """Names of the checks of a subject, OURS or CANDIDATE, in their order.

    thorough: with those that only --thorough makes; whole_scene: with those that are made once a scene; camera: with
    those that look at its rays.
    """
    return tuple(
        check.name
        for check in SCENE_CHECKS
        if of in check.of
        and (thorough or not check.thorough)
        and (whole_scene or not check.once)
        and (camera or not check.camera)
    )

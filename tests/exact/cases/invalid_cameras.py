"""Cases 71, 72 and 74 to 76: cameras and films that are none, axes of any length, and rays that are none."""

import math
from collections.abc import Iterator

import numpy as np
from aimed_rays import direction

from cases.camera_truth import U
from cases.case import FLOAT64, Case, Maker, Question
from cases.refusal_check import refused
from cases.shapes import Aim, rays_at, shape_of
from caster import Film, Pinhole, Rectangle, Scene, Sphere, cast


def nowhere_to_look() -> int:
    """Of cameras and of `to_world` alike: the same point, `up` along the view, up or direction zero."""
    steps = [
        {"origin": (1, 2, 3), "target": (1, 2, 3)},
        {"origin": (0, 0, 5), "target": (0, 0, 0), "up": (0, 0, 2)},
        {"origin": (0, 0, 5), "target": (0, 0, 0), "up": (0, 0, 0)},
    ]
    count = 0
    for step in steps:
        count += refused(lambda step=step: Rectangle(to_world=[{"look_at": step}]), "to_world")
        pose = {"eye": step["origin"], "look_at": step["target"]} | {k: v for k, v in step.items() if k == "up"}
        count += refused(lambda pose=pose: Pinhole(**pose), "pinhole")
    count += refused(lambda: Pinhole(eye=(0, 0, 0), direction=(0, 0, 0)), "direction")
    return count + refused(lambda: Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0), up=(1e-30, 0, 1)), "up")


def no_film() -> int:
    count = 0
    for width, height in ((0, 1), (1, 0), (0, 0), (-1, 5)):
        name = "width" if width < 1 else "height"
        count += refused(lambda w=width, h=height: Film(width=w, height=h), name, "1")
    return count + refused(lambda: Film(width=4, height=4, crop=(2, 2, 2, 3)), "crop")


def any_axis() -> int:
    """An axis of any length turns; none of its matrices shears, stretches or mirrors."""
    make, count = Maker(74, FLOAT64), 0
    for _ in range(40):
        axis, degrees = direction(make.rng, 1)[0], make.rng.uniform(-360.0, 360.0)
        first = rotation(axis, degrees)
        for length in (1e-300, 1e-3, 3.0, 1e300):
            m = rotation(axis * length, degrees)
            assert np.abs(m.T @ m - np.eye(3)).max() <= 16 * U and np.abs(m - first).max() <= 16 * U
            assert abs(np.linalg.det(m) - 1.0) <= 16 * U
            count += 1
    assert np.abs(rotation(np.ones(3), 120.0) - [[0, 0, 1], [1, 0, 0], [0, 1, 0]]).max() <= 4 * U
    return count + refused(lambda: rotation(np.zeros(3), 5.0), "axis")


def rotation(axis: np.ndarray, degrees: float) -> np.ndarray:
    return Rectangle(to_world=[{"rotate": {"axis": axis, "degrees": degrees}}]).matrix[:3, :3]


BALL = Scene(film=Film(width=1, height=1), camera=Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0)), shapes=(Sphere(),))
GOOD = ((0.1, 0.2, 3.0), (0.0, 0.0, -1.0))


def no_numbers() -> int:
    """NaN and inf anywhere in a ray are refused with the number of the ray; so are NaN and t_min < 0 as limits."""
    count = 0
    for bad in (math.nan, math.inf, -math.inf):
        for which in range(2):
            for axis in range(3):
                rays = np.array([[GOOD[0]] * 4, [GOOD[1]] * 4])
                rays[which, 2, axis] = bad
                count += refused(lambda rays=rays: cast(BALL, *rays), "rays[2]", "finite")
    for name, value in (("t_max", math.nan), ("t_min", math.nan), ("t_min", -1.0)):
        count += refused(lambda limit={name: value}: cast(BALL, [GOOD[0]], [GOOD[1]], **limit), name)
    return count


def limits(make: Maker) -> Iterator[Question]:
    """t_max of -1, 0, the smallest number, the largest and infinite."""
    largest = float(np.finfo(make.precision.dtype).max)
    for kind in ("sphere", "cube", "disk", "plane", "cylinder"):
        for t_max, least in ((-1.0, 0), (0.0, 0), (2.0**-149, 0), (largest, 5), (math.inf, 5)):
            scene = make.scene([shape_of(kind, make.rng)])
            o, d = rays_at(make, scene.derived["packed"].parts[0], make.count(12), aim=Aim((3.0, 9.0)))
            never = () if least else ("hit",)
            yield make.ask(f"{kind}, t_max {t_max:g}", scene, o, d, t_max=t_max, never=never, hit=least)


def no_direction() -> int:
    """0 is refused; the shortest direction there is, is one."""
    count = 0
    for d in ((0.0, 0.0, 0.0), (-0.0, 0.0, -0.0)):
        count += refused(lambda d=d: cast(BALL, [GOOD[0], GOOD[0]], [GOOD[1], d]), "rays[1]", "zero")
    assert cast(BALL, [GOOD[0]], [(0.0, 0.0, -(2.0**-1074))]).shape_id[0] == 0
    return count + 1


CASES = (
    Case(
        71,
        "cameras that look nowhere",
        "refused with the line of the file",
        checks={"refused": nowhere_to_look},
        shapes="cameras, `to_world`",
    ),
    Case(
        72, "films without a pixel", "refused with the line of the file", checks={"refused": no_film}, shapes="cameras"
    ),
    Case(
        74,
        "rotation about an axis that is not of length 1",
        "the axis is brought to length 1; 0 is refused",
        checks={"matrices": any_axis},
        shapes="`to_world`",
    ),
    Case(
        75,
        "rays that are not finite, and limits of t",
        "NaN and inf are refused with the number of the ray; nothing lies before t_max <= 0",
        limits,
        {"refused": no_numbers},
    ),
    Case(
        76, "a direction of zero", "refused with the number of the ray", checks={"refused": no_direction}, shapes="rays"
    ),
)

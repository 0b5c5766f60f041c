"""<sensor> -> film and camera."""

import math
from typing import Any

import numpy as np

from mitsuba_ref.importers.building import Building
from mitsuba_ref.importers.transforms import Step, placed, steps_of
from mitsuba_ref.importers.xml_nodes import Node

KINDS = {"perspective": "pinhole", "thinlens": "pinhole", "orthographic": "orthographic"}
FILM = (768, 576)  # pixels, where a film says nothing
NEAR, FAR = 0.01, 1e4  # clip planes, where a sensor says nothing

# Mitsuba takes a sensor whose matrix scales by up to 5e-4; so much of a difference between its axes is none to it.
SAME_SCALE = 5e-4

# A film of 36 x 24 mm, whose diagonal focal lengths are for.
DIAGONAL_MM = math.hypot(36.0, 24.0)


def add_sensor(out: Building, node: Node) -> None:
    """The film, and the camera. Errors of values are told when the scene is checked as a whole."""
    out.data["film"] = _film(out, node)
    out.places["film",] = out.places["camera",] = node.place
    film = out.data["film"]
    camera: dict[str, Any] = {"type": KINDS[node.kind]}
    steps = steps_of(out, node)
    matrix = placed(steps)
    camera |= _pose(out, node, steps, np.eye(4) if matrix is None else matrix)
    near, far = out.number(node, "near_clip", NEAR), out.number(node, "far_clip", FAR)
    if node.kind == "orthographic":
        camera |= _window(out, node, np.eye(4) if matrix is None else matrix, near, far)
    else:
        camera |= {"near": near, "far": far, **_field_of_view(out, node, film["width"], film["height"])}
        shift = [out.number(node, f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
        if any(shift):
            camera["principal_point"] = shift
    if node.kind == "thinlens":
        out.remark(node, "the lens: all is sharp to a pinhole")
        out.find(node, "aperture_radius", "float", "integer")
    out.find(node, "focus_distance", "float", "integer")  # of no effect without a lens
    out.data["camera"] = camera
    out.omit_rest(node)


def _film(out: Building, node: Node) -> dict[str, Any]:
    film = next(node.all("film"), None)
    if film is None:
        return {"width": FILM[0], "height": FILM[1]}
    out.used.add(id(film))
    width, height = out.integer(film, "width", FILM[0]), out.integer(film, "height", FILM[1])
    x, y = out.integer(film, "crop_offset_x", 0), out.integer(film, "crop_offset_y", 0)
    w, h = out.integer(film, "crop_width", width - x), out.integer(film, "crop_height", height - y)
    out.omit_rest(film)
    size: dict[str, Any] = {"width": width, "height": height}
    return size if (x, y, w, h) == (0, 0, width, height) else size | {"crop": [x, y, x + w, y + h]}


def _pose(out: Building, node: Node, steps: list[Step], matrix: np.ndarray) -> dict[str, Any]:
    """Mitsuba's sensors look along +z, with +y up and +x to the left."""
    if len(steps) == 1 and "look_at" in steps[0]:
        look = steps[0]["look_at"]
        return {"eye": look["origin"], "look_at": look["target"], "up": look["up"]}
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        out.remark(node, "the mirroring of its to_world: our picture has left and right the other way round")
    eye, up, view = matrix[:3, 3], matrix[:3, 1], matrix[:3, 2]
    return {"eye": eye.tolist(), "direction": view.tolist(), "up": up.tolist()}


def _field_of_view(out: Building, node: Node, width: int, height: int) -> dict[str, Any]:
    if node.named("fov") is not None:
        return {"fov": out.number(node, "fov", 0.0), "fov_axis": out.text(node, "fov_axis", "x")}
    out.text(node, "fov_axis")
    text = out.text(node, "focal_length", "50mm").removesuffix("mm")
    try:
        focal = float(text)
    except ValueError:
        focal = math.nan
    if not 0.0 < focal < math.inf:
        out.error(node, f"focal_length must be a length > 0 in mm such as 50mm, got '{text}'")
        focal = 50.0
    return {"fov": math.degrees(2.0 * math.atan(0.5 * DIAGONAL_MM / focal)), "fov_axis": "diagonal"}


def _window(out: Building, node: Node, matrix: np.ndarray, near: float, far: float) -> dict[str, Any]:
    """The window is [-1, 1] wide until it is scaled.

    Along the view, the near plane scales, but not the way to the far one.
    """
    across, up, along = np.linalg.norm(matrix[:3, :3], axis=0)
    if abs(up - across) > SAME_SCALE * across:
        out.remark(node, f"pixels that are {up / across:g} times as high as wide: ours are square")
    return {
        "width": 2.0 * float(across),
        "near": near * float(along),
        "far": near * float(along) + far - near,
    }

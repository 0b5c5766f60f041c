"""What is checked once a scene, beside the pixels: shapes, camera, sensor, and what `render` makes of them."""

from collections.abc import Callable

import numpy as np

from caster.casting import find_nearest
from caster.fields import Camera
from caster.packing import pack
from caster.placing import as_given
from caster.rendering import camera_rays, evaluate, film_window, look_along, render
from caster.scene import Scene
from mitsuba_ref.camera_reference import axes, no_sensor
from mitsuba_ref.export import camera_reference
from mitsuba_ref.meeting import KU, KU_OURS, norm
from mitsuba_ref.reference import Witness
from mitsuba_ref.render_check import check_render
from mitsuba_ref.scene_check import SceneCheck, bits_differ, pixel_centers, worst_of
from mitsuba_ref.shape_checks import check_geometry, check_materials, check_placement


def check_camera(scene: Scene) -> SceneCheck:
    """Our rays in float64 against the camera's formula, written a second time."""
    ours = camera_rays(scene)
    x, y = pixel_centers(scene)
    expected = camera_reference(scene.camera).rays(scene.camera, scene.film, x, y)
    size = float(np.abs(expected.o).max(initial=np.finfo(np.float64).tiny))
    rounding = CAMERA_ROUNDINGS * KU_OURS / _slant_of_up(scene.camera)
    seen, rim = expected.t_max >= 0.0, _on_rim(scene, x, y)
    shares = {
        "rays there are": np.where(seen == (ours.t_max >= 0.0), 0.0, np.inf),
        "origin": norm(ours.o - expected.o) / (rounding * size),
        "direction": norm(ours.d - expected.d) / rounding,
        "near": _relative(ours.t_min, expected.t_min) / rounding,
        "far": _relative(ours.t_max, expected.t_max) / rounding,
    }
    return worst_of("camera", shares, (seen | (ours.t_max >= 0.0)) & ~rim, scene)


# A direction goes through an orthobasis (three unit vectors of 4 roundings each), a position on the film (4), a sine
# or tangent (2) of an angle of up to pi, and a length (3): 32 roundings on either side, in steps of KU_OURS, which is
# K roundings on either side.
CAMERA_ROUNDINGS = 8.0


def _slant_of_up(camera: Camera) -> float:
    """The sine of the angle between view and up: the orthobasis rounds by as much more as this is less than 1."""
    forward, up = axes(camera)[2], np.array(camera.up, np.float64)
    return float(np.linalg.norm(np.cross(forward, up)) / np.linalg.norm(up))


def _on_rim(scene: Scene, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n,) bool: pixels on the edge of a round picture, up to rounding, so that either side may have a ray there."""
    film, reference = scene.film, camera_reference(scene.camera)
    middle_x, middle_y = film.width / 2.0, film.height / 2.0
    seen = []
    for scale in (1.0 - KU_OURS, 1.0 + KU_OURS):
        rays = reference.rays(
            scene.camera, film, middle_x + scale * (x - middle_x), middle_y + scale * (y - middle_y)
        )
        seen.append(rays.t_max >= 0.0)
    differs: np.ndarray = seen[0] != seen[1]
    return differs


def check_sensor(scene: Scene, witness: Witness) -> SceneCheck:
    """Our rays against those of Mitsuba's own sensor: the same line, and depth that starts on the near plane."""
    answer = witness.answer
    if answer.sensor_d is None or answer.sensor_o is None or answer.sensor_t_max is None:
        expected = camera_reference(scene.camera).to_xml is not no_sensor
        what = "the answer lacks its rays" if expected else f"Mitsuba has no {scene.camera.type} camera"
        return SceneCheck("sensor", np.inf if expected else 0.0, what)
    ours, reference = camera_rays(scene), camera_reference(scene.camera)
    o, d = answer.sensor_o.astype(np.float64), answer.sensor_d.astype(np.float64)
    if len(d) != len(ours.d):
        return SceneCheck("sensor", np.inf, f"Mitsuba gives {len(d)} rays, we {len(ours.d)}")
    bound = KU * reference.amplification(scene.camera, scene.film)
    along = np.sum((o - ours.o) * ours.d, axis=1)
    aside = norm(o - ours.o - along[:, None] * ours.d)
    size = norm(ours.o) + np.abs(along) + np.abs(scene.camera.eye).max() + getattr(scene.camera, "width", 0.0)
    shares = {"direction": norm(d - ours.d) / bound, "origin": aside / (bound * size)}
    if getattr(scene.camera, "near", 0.0) > 0.0:
        shares["near"] = np.abs(along - ours.t_min) / (bound * (size + ours.t_min))
    if getattr(scene.camera, "far", None) is not None:
        end = along + answer.sensor_t_max.astype(np.float64)
        with np.errstate(invalid="ignore"):  # a far plane at infinity is beyond every bound
            shares["far"] = np.abs(end - ours.t_max) / (bound * (size + ours.t_max))
    return worst_of("sensor", shares, np.ones(len(d), bool), scene)


SAMPLE = 1 << 24  # rays times primitives that are tried without any culling


def check_culling(scene: Scene) -> SceneCheck:
    """`render`, as it is planned for this scene, against the way that pixels are judged, and a sample of rays against
    every primitive there is: the same bits."""
    names = ("depth", "normal", "shading_normal", "position", "shape_id", "prim_id", "diffuse")
    rays = camera_rays(scene)
    judged = look_along(scene, pack(scene, as_given), rays, np.zeros(len(rays.o)))
    planned, tree = render(scene, names), evaluate(judged, names, film_window(scene))
    differs = np.any([bits_differ(planned, tree, name) for name in names], axis=0)
    rows = _sample(len(rays.o), int(judged.packed.first[-1]))
    obvious = find_nearest(judged.packed, type(rays)(*(a[rows] for a in rays)), "everything")
    found = judged.nearest
    differs[rows] |= (obvious.t != found.t[rows]) | (obvious.prim != found.prim[rows])
    shares = {"bits": np.where(differs, np.inf, 0.0)}
    return worst_of("culling", shares, np.ones(len(differs), bool), scene)


def _sample(rays: int, prims: int) -> np.ndarray:
    """Some rays, spread by a fixed seed: at least 64, as far as there are as many."""
    count = min(rays, max(64, SAMPLE // max(prims, 1)))
    return np.sort(np.random.default_rng(1).choice(rays, count, replace=False))


def _relative(ours: np.ndarray, expected: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        error = np.abs(ours - expected) / np.maximum(np.abs(expected), np.finfo(np.float64).tiny)
    return np.where(ours == expected, 0.0, error)


CHECKS_WITHOUT_REFERENCE: tuple[Callable[[Scene], SceneCheck], ...] = (
    check_placement,
    check_geometry,
    check_materials,
    check_camera,
    check_render,
    check_culling,
)

"""Ray: no camera that Mitsuba has; the ray is handed over as it is."""

import numpy as np

from caster.cameras.ray import Ray
from caster.scene import Film
from mitsuba_ref.camera_reference import CameraRays, CameraReference


def rays(camera: Ray, film: Film, x: np.ndarray, y: np.ndarray) -> CameraRays:
    """The same ray wherever on the film."""
    count = len(x)
    o, d = (np.tile(np.array(v, np.float64), (count, 1)) for v in (camera.origin, camera.direction))
    t_max = np.inf if camera.t_max is None else camera.t_max
    return CameraRays(o, d, np.zeros(count), np.full(count, t_max))


REFERENCE = CameraReference(Ray, rays)

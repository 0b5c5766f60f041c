"""Cases 66 to 70 and 73: cameras."""

import math

import numpy as np
from aimed_rays import direction

from cases.camera_truth import U, exact_frame, in_the_picture, right_directions, turned_camera
from cases.case import FLOAT64, Case, Maker
from cases.refusal_check import refused
from cases.shapes import shape_of
from caster import Film, Pinhole, Plane, Scene, Sphere
from caster.rendering.images import camera_rays
from caster.scene.model import MAX_FILM_SIDE

FOVS = (0.001, 0.01, 0.1, 1.0, 45.0, 90.0, 120.0, 170.0, 179.0, 179.9, 179.99)

# t_min is near times the length of a direction whose part along the view is 1: a quotient, a root, some products.
PLANE_RTOL = 32 * U


def fields_of_view() -> int:
    make, count = Maker(66, FLOAT64), 0
    for fov in FOVS:
        for film in (Film(width=256, height=128), Film(width=37, height=53)):
            camera = turned_camera(make, fov=fov, look_at=(0.0, 0.0, 0.0))
            count += right_directions(camera, film)
        camera = turned_camera(make, fov=fov, look_at=(0.0, 0.0, 0.0))
        shapes = [Sphere(), Sphere(center=(0.0, 0.3, 0.0), radius=1e-4), Plane(normal=(0.1, 1.0, 0.2), offset=-2.0)]
        hit = in_the_picture(Scene(film=Film(width=12, height=9), camera=camera, shapes=shapes))
        assert hit > 5
        count += hit
    return count


def no_fields_of_view() -> int:
    return sum(
        refused(lambda fov=fov: Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0), fov=fov), "fov", "> 0 and < 180")
        for fov in (0.0, -1.0, 180.0, 200.0, math.nan, math.inf)
    )


def clipped(near: tuple[float, ...], far: tuple[float | None, ...]) -> int:
    """What is nearer than the one plane and beyond the other is not seen; depth counts from the eye all the same."""
    make, count = Maker(67, FLOAT64), 0
    for start in near:
        for end in far:
            camera = turned_camera(make, near=start, far=end, fov=50.0, look_at=(0.0, 0.0, 0.0))
            eye = np.array(camera.eye)
            view = -eye / np.linalg.norm(eye)
            places = (("sphere", 0.7), ("cube", 4.9), ("icosphere", 1.5))
            shapes = [shape_of(kind, make.rng, 0.3, eye + away * view) for kind, away in places]
            shapes.append(Sphere(center=eye + 2e4 * view, radius=5e3))
            scene = Scene(film=Film(width=16, height=16), camera=camera, shapes=shapes)
            count += in_the_picture(scene)
            rays = camera_rays(scene)
            along = rays.d @ view
            assert np.allclose(rays.t_min * along, start, rtol=PLANE_RTOL, atol=0.0)
            assert end is None or np.allclose(rays.t_max * along, end, rtol=PLANE_RTOL, atol=0.0)
    return count


def near_planes() -> int:
    return clipped((0.0, 1e-4, 0.1, 1.0, 4.99, 5.0), (None,))


def far_planes() -> int:
    """Without one, whatever is far is seen; and a far plane that is not beyond the near one is refused."""
    count = clipped((0.1,), (None, 1.0, 5.0, 1e4, 1e5))
    for away in (2e4, 1e8, 1e15):
        camera = Pinhole(eye=(0.1, 0.2, 5.0), look_at=(0, 0, 0), fov=10)
        ball = Sphere(center=(0.0, 0.0, -away), radius=0.2 * away)
        hit = in_the_picture(Scene(film=Film(width=6, height=6), camera=camera, shapes=[ball]))
        assert hit == 36
        count += hit
    for near, far in ((1.0, 1.0), (2.0, 1.0)):
        planes = {"near": near, "far": far}
        count += refused(lambda planes=planes: Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0), **planes), "near", "far")
    return count


SMALL = ((1, 1), (1, 7), (7, 1), (2, 2), (3, 3))


def small_films() -> int:
    make, count = Maker(69, FLOAT64), 0
    for width, height in SMALL:
        camera, film = turned_camera(make, look_at=(0.0, 0.0, 0.0)), Film(width=width, height=height)
        count += right_directions(camera, film)
        if width * height % 2 == 1:
            middle = camera_rays(Scene(film=film, camera=camera)).d[width * height // 2]
            forward = np.array([float(x) for x in exact_frame(camera)[2]])
            assert np.linalg.norm(middle - forward) <= 8 * U
        count += in_the_picture(Scene(film=film, camera=camera, shapes=[Sphere(radius=3.0)]))
    return count


WIDE = (4096, MAX_FILM_SIDE)


def wide_films() -> int:
    """Neighbours have different rays, each right to the last bits; what is wider is refused."""
    make, count = Maker(70, FLOAT64), 0
    for width in WIDE:
        for start in (0, width // 2 - 500, width - 1000):
            film = Film(width=width, height=3, crop=(start, 1, start + 1000, 2))
            camera = turned_camera(make, look_at=(0.0, 0.0, 0.0), fov=60.0)
            count += right_directions(camera, film, 40)
            d = camera_rays(Scene(film=film, camera=camera)).d
            assert len(np.unique(d, axis=0)) == 1000
    for side in (MAX_FILM_SIDE + 1, 2**20, 2**24):
        count += refused(lambda side=side: Film(width=side, height=1), "width", str(MAX_FILM_SIDE))
        count += refused(lambda side=side: Film(width=1, height=side), "height", str(MAX_FILM_SIDE))
    return count


def far_cameras() -> int:
    """From 10^2 to 10^8, and 10^14."""
    make, count = Maker(73, FLOAT64), 0
    for away in (1e2, 1e4, 1e6, 1e8, 1e14):
        pose = {"eye": away * direction(make.rng, 1)[0], "up": direction(make.rng, 1)[0]}
        camera = Pinhole(look_at=(0.0, 0.0, 0.0), fov=math.degrees(4.0 / away), **pose)
        shapes = [Sphere(radius=0.8), shape_of("cube", make.rng, 0.5, (0.5, 0.3, 0.2)), shape_of("disk", make.rng)]
        hit = in_the_picture(Scene(film=Film(width=14, height=14), camera=camera, shapes=shapes))
        assert hit > 5
        count += hit
    return count


CASES = (
    Case(
        66,
        "fields of view of 0.001 to 179.99 degrees",
        "directions within a few roundings of ball arithmetic; what they hit, exact; 0 and 180 are refused",
        checks={"pixels": fields_of_view, "refused": no_fields_of_view},
        shapes="cameras",
    ),
    Case(
        67,
        "near planes",
        "nothing nearer is hit, exactly; depth is measured from the eye",
        checks={"hits": near_planes},
        shapes="cameras",
    ),
    Case(
        68,
        "far planes",
        "none by default; a far plane before the near one is refused",
        checks={"hits": far_planes},
        shapes="cameras",
    ),
    Case(
        69,
        "films of 1x1, 1x7, 7x1, 2x2, 3x3",
        "directions within a few roundings of ball arithmetic",
        checks={"pixels": small_films},
        shapes="cameras",
    ),
    Case(
        70,
        "films 4096 and more pixels wide",
        "neighbouring rays differ, up to 65536; wider ones are refused",
        checks={"pixels": wide_films},
        shapes="cameras",
    ),
    Case(73, "cameras 10^2 to 10^14 away", "exact", checks={"hits": far_cameras}, shapes="cameras"),
)

"""What a camera's rays should be, by ball arithmetic, and its picture against the exact answer."""

import math
from typing import Any

import numpy as np
from aimed_rays import direction
from flint import arb, ctx

from cases.case import Maker
from cases.judging import ROUNDED
from caster import Film, Pinhole, Scene, render
from caster.rendering.images import camera_rays, trace_film
from mitsuba_ref.oracle.oracle import Oracle

U = 2.0**-53
BITS = 160  # of balls around the exact directions

# A direction is right up to its own roundings (a dozen of at most u each, of vectors no longer than it) and those of
# the place on the film: x / width and the difference from its middle, 2 u of the film's half extent over the length.
DIRECTION_US, FILM_US = 16.0, 4.0

AOVS = ("hit", "depth", "normal", "position", "prim_id", "shape_id")


def turned_camera(make: Maker, **more: Any) -> Pinhole:
    """In a random pose at about 5 from the middle."""
    eye = 5.0 * direction(make.rng, 1)[0]
    return Pinhole(**({"eye": eye, "look_at": 0.2 * make.rng.normal(size=3), "up": direction(make.rng, 1)[0]} | more))


def exact_directions(camera: Pinhole, film: Film, rows: list[int], picture: np.ndarray) -> np.ndarray:
    """(rows, 3) unit directions of pixels (x, y) of the picture, by ball arithmetic, rounded once at the end."""
    ctx.prec = BITS
    right, up, forward = exact_frame(camera)
    half_x = (arb(camera.fov) * arb.pi() / 360).tan()
    half_y = half_x * film.height / film.width
    out = []
    for i in rows:
        x, y = picture[i]
        a = (2 * (arb(float(x)) + arb(0.5)) / film.width - 1) * half_x
        b = (1 - 2 * (arb(float(y)) + arb(0.5)) / film.height) * half_y
        out.append([float(v) for v in unit([a * r + b * u + f for r, u, f in zip(right, up, forward, strict=True)])])
    return np.array(out)


def exact_frame(camera: Pinhole) -> tuple[list[arb], list[arb], list[arb]]:
    """Right, up and forward of a camera that looks at a point: right = forward x up."""
    view = [arb(b) - arb(a) for a, b in zip(camera.eye, camera.look_at, strict=True)]
    forward = unit(view)
    right = unit(crossed(forward, [arb(x) for x in camera.up]))
    return right, crossed(right, forward), forward


def crossed(a: list[arb], b: list[arb]) -> list[arb]:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def unit(v: list[arb]) -> list[arb]:
    length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
    return [x / length for x in v]


def right_directions(camera: Pinhole, film: Film, count: int = 64) -> int:
    """The camera's rays against balls; how many were looked at."""
    scene = Scene(film=film, camera=camera)
    rays = camera_rays(scene)
    x0, y0, x1, y1 = film.window
    picture = np.stack([a.ravel() for a in np.meshgrid(np.arange(x0, x1), np.arange(y0, y1))], axis=1)
    rows = np.unique(np.linspace(0, len(picture) - 1, count).astype(int)).tolist()
    exact = exact_directions(camera, film, rows, picture)
    half = math.tan(math.radians(camera.fov) / 2.0) * max(1.0, film.height / film.width)
    forward = np.array([float(x) for x in exact_frame(camera)[2]])
    length = 1.0 / (exact @ forward)
    # up lies at some angle to the view, and is known to u over the sine of it
    sine = np.linalg.norm(np.cross(forward, np.array(camera.up) / np.linalg.norm(camera.up)))
    most = U * (DIRECTION_US / sine + FILM_US * half / length)
    apart = np.linalg.norm(rays.d[rows] - exact, axis=1)
    assert (apart <= most).all(), f"{camera}: directions are off by {(apart / most).max():.3g} of their bounds"
    assert np.array_equal(rays.o, np.tile(camera.eye, (len(rays.o), 1)))
    return len(rows)


def in_the_picture(scene: Scene) -> int:
    """Every pixel against the exact answer along the camera's own ray, and its AOVs; how many were hit."""
    view, picture = trace_film(scene), render(scene, AOVS)
    rays, seen = view.rays, view.nearest
    answers = Oracle(view.packed).first_hits(rays.o, rays.d, rays.t_min, rays.t_max)
    depth = picture["depth"].ravel()
    for i, answer in enumerate(answers):
        assert seen.prim[i] == answer.prim, f"pixel {i}: {seen.prim[i]}, exactly {answer.prim}"
        assert bool(picture.hit.ravel()[i]) is answer.hit
        if answer.hit:
            assert answer.t.off(float(seen.t[i])) <= seen.error[i] * ROUNDED
            # depth is t times a length that is 1 within 16 u (vec.UNIT_SQUARE_ATOL); that and the product are rounded
            assert abs(depth[i] - seen.t[i]) <= 18 * U * seen.t[i]
        else:
            assert depth[i] == math.inf
    assert np.isfinite(picture["normal"]).all() and np.isfinite(picture["position"]).all()
    return sum(answer.hit for answer in answers)

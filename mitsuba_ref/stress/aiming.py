"""Rays that are aimed: float32 numbers, and enough hits and misses among them to tell anything."""

from collections.abc import Callable
from typing import Any

import numpy as np

from caster.cameras import Fisheye
from caster.fields import Shape
from caster.packing import pack
from caster.placing import as_float32
from caster.scene import Scene
from mitsuba_ref.stress.family import Rng

Rays = tuple[np.ndarray, np.ndarray]

CANDIDATES = 64  # rays made for each one that is kept: at the far end of a sweep few go where they were aimed
MISSES = 0.4  # share of rays that are to miss, where there are so many


def scene_of(*shapes: Shape) -> Scene:
    """A scene to hand rays to: its camera is one that Mitsuba has no sensor for, so that none is exported."""
    camera = Fisheye(eye=(0.0, 0.0, 0.0), direction=(0.0, 0.0, 1.0))
    return Scene(film={"width": 1, "height": 1}, camera=camera, shapes=shapes)


def part_of(scene: Scene, shape: int = 0) -> Any:
    """The packed arrays of one shape, of float32 values."""
    return pack(scene, as_float32).parts[shape]


def directions(rng: Rng, count: int) -> np.ndarray:
    """(count, 3) unit vectors."""
    v = rng.normal(size=(count, 3))
    return unit(v)


def unit(v: np.ndarray) -> np.ndarray:
    """Each row divided by its length."""
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def across(rng: Rng, n: np.ndarray) -> np.ndarray:
    """(m, 3) unit vectors at right angles to the rows of n, turned at random."""
    return unit(np.cross(n, directions(rng, len(n))))


def turn(rng: Rng) -> dict[str, Any]:
    """A step of to_world: any rotation, so that no coordinate is a round number."""
    return {"rotate": {"axis": directions(rng, 1)[0], "degrees": rng.uniform(20.0, 340.0)}}


def float32(a: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(a, np.float32)


def towards(o: np.ndarray, p: np.ndarray) -> Rays:
    """float32 rays from about o to p, d about of length 1: aimed from where o was rounded to."""
    start = float32(o)
    return start, float32(unit(p - start.astype(np.float64)))


def balanced(rays: Rays, inside: np.ndarray, count: int) -> Rays:
    """`count` of the candidates: misses up to their share, hits else. inside: (m,) whether a ray seems to hit.

    What seems so in float64 only chooses rays; who hits is for exact arithmetic to say.
    """
    hits, misses = np.flatnonzero(inside), np.flatnonzero(~inside)
    few = min(len(misses), max(count - len(hits), round(MISSES * count)))
    rows = np.sort(np.concatenate([hits[: count - few], misses[:few]]))
    o, d = rays
    return o[rows], d[rows]


def chosen(
    make: Callable[[int], Rays], seems_hit: Callable[[np.ndarray, np.ndarray], np.ndarray], count: int
) -> Rays:
    """Candidates by `make`, and of them `count` that hit and miss in good measure."""
    o, d = make(CANDIDATES * count)
    return balanced((o, d), seems_hit(o.astype(np.float64), d.astype(np.float64)), count)


def passes_ball(center: np.ndarray, r: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Whether rays pass a centre within r, ahead of their origin or not."""
    return lambda o, d: impact(center, o, d) < r


def impact(center: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) distance at which each ray's line passes a point."""
    v = unit(d)
    return np.linalg.norm(np.cross(center - o, v), axis=1)


def crosses_triangles(corners: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Whether lines cross any of a few triangles (k, 3, 3)."""

    def test(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        found = np.zeros(len(o), bool)
        for triangle in corners:
            a, b, c = (corner - o for corner in triangle)
            sides = [np.einsum("ij,ij->i", d, np.cross(p, q)) for p, q in ((c, b), (a, c), (b, a))]
            found |= (np.min(sides, axis=0) >= 0.0) | (np.max(sides, axis=0) <= 0.0)
        return found

    return test

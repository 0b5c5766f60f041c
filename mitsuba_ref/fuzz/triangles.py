"""Triangles that are hard to get right: around one corner, and hardly there at all."""

from typing import Any

import numpy as np

from mitsuba_ref.fuzz.setting import Rng, Setting, decades, nudged, orthogonal
from mitsuba_ref.fuzz.shapes import triangle_of

Shapes = list[dict[str, Any]]


def around_one_corner(rng: Rng, setting: Setting) -> Shapes:
    """A closed fan of 3 to 8 triangles; every other time each has written its corners down for itself, an ulp off."""
    count = int(rng.integers(3, 9))
    angles = 2.0 * np.pi * (np.arange(count) + rng.uniform(0.0, 0.8, count)) / count
    rim = np.column_stack([np.cos(angles), np.sin(angles), rng.uniform(-0.5, 0.5, count)])
    turn = np.eye(3) if setting.lattice else orthogonal(rng)
    rim, tip = in_place(rim @ turn.T, setting), in_place(np.zeros((1, 3)), setting)[0]
    faces = [np.array([tip, rim[i], rim[(i + 1) % count]]) for i in range(count)]
    if rng.random() < 0.25:
        faces = [np.where(face == 0.0, 0.0, nudged(rng, face, 1)) for face in faces]  # no denormals
    return [triangle_of(np.roll(face, int(rng.integers(3)), axis=0)) for face in faces]


def slivers(rng: Rng, setting: Setting) -> Shapes:
    """Two to six triangles, 1e-17 to 1e-1 as thin as long; some have a whole sliver, not a line, for a neighbour."""
    faces = [in_place(sliver(rng), setting) for _ in range(int(rng.integers(1, 4)))]
    for a, b, _ in list(faces):
        if rng.random() < 0.6:
            faces.append(np.array([b, a, in_place(rng.uniform(-1.0, 1.0, (1, 3)), setting)[0]]))
    return [triangle_of(face) for face in faces]


def sliver(rng: Rng) -> np.ndarray:
    """(3, 3) corners: a needle, a cap, a line, two corners in one place, or three."""
    a, b = rng.uniform(-1.0, 1.0, (2, 3))
    thin = decades(rng, 1e-17, 1e-1) * rng.normal(size=3)
    third = (a + thin, 0.5 * (a + b) + thin, a + float(rng.integers(1, 4)) / 2.0 * (b - a), b, a + thin)
    which = int(rng.integers(5))
    corners = np.array([a, b, third[which]])
    if which == 4 and rng.random() < 0.2:
        corners[:] = a
    return rng.permutation(corners)


def in_place(points: np.ndarray, setting: Setting) -> np.ndarray:
    return setting.snapped(np.array(setting.middle) + setting.size * points)

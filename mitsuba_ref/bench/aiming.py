"""Rays of float32 numbers that are aimed at edges and at silhouettes, from where the picture's rays start."""

from typing import Any

import numpy as np

from caster.packing import count
from mitsuba_ref.bench.preparing import Prepared
from mitsuba_ref.bench.scenes import unit

Rng = np.random.Generator
Rays = tuple[np.ndarray, np.ndarray]

TURNS = 8  # points tried for each that is kept: of a closed mesh, half of all faces look away


def at_edges(rng: Rng, ready: Prepared, rows: np.ndarray) -> Rays:
    """One ray for each of these rays of the picture: from where it starts, or, of parallel ones, along it.

    At a point of a triangle's edge whose face looks that way, or past a sphere's silhouette by nothing.
    """
    o = ready.o[rows].astype(np.float64)
    sizes = np.array([count(part) for part in ready.packed.parts])
    if ready.scene.camera.type == "orthographic":
        d = ready.d[rows].astype(np.float64)
        p = spots(rng, ready, sizes, o, d)
        start = (p - 4.0 * d).astype(np.float32)
        return start, d.astype(np.float32)
    p = spots(rng, ready, sizes, o, None)
    # Of length 1, as renderers make them: Mitsuba's LLVM variant is farther off on spheres along longer ones.
    return o.astype(np.float32), unit(p - o).astype(np.float32)


def spots(rng: Rng, ready: Prepared, sizes: np.ndarray, o: np.ndarray, d: np.ndarray | None) -> np.ndarray:
    """(n, 3) a place for each ray; primitives are as likely as they are many."""
    which = rng.choice(len(sizes), len(o), p=sizes / sizes.sum())
    places = np.zeros((len(o), 3))
    for shape in np.unique(which):
        rows = np.flatnonzero(which == shape)
        part = ready.packed.parts[shape]
        place = on_edges if hasattr(part, "faces") else on_silhouettes
        places[rows] = place(rng, part, o[rows], None if d is None else d[rows])
    return places


def on_edges(rng: Rng, part: Any, o: np.ndarray, d: np.ndarray | None) -> np.ndarray:
    """Places between the ends of edges, float64; of some that are tried, one of a face that looks at the ray."""
    k = rng.integers(len(part.faces), size=(TURNS, len(o)))
    corners = part.vertices[part.faces[k]]  # (turns, n, 3 corners, 3)
    n = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    way = corners[..., 0, :] - o if d is None else np.broadcast_to(d, n.shape)
    facing = np.einsum("...i,...i", n, way) < 0.0
    turn = np.argmax(facing, axis=0)  # the first, or 0 where none does
    kept = corners[turn, np.arange(len(o))]
    first = rng.integers(3, size=len(o))
    a, b = (kept[np.arange(len(o)), (first + step) % 3] for step in (0, 1))
    places: np.ndarray = a + rng.random((len(o), 1)) * (b - a)
    return places


def on_silhouettes(rng: Rng, part: Any, o: np.ndarray, d: np.ndarray | None) -> np.ndarray:
    """Where the tangents from o touch spheres, or those along d."""
    k = rng.integers(len(part.radius), size=len(o))
    center, r = part.center[k], part.radius[k][:, None]
    away = o - center
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    axis = away / distance if d is None else d
    across = np.cross(axis, rng.normal(size=axis.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    cosine = np.minimum(r / distance, 1.0) if d is None else np.zeros_like(r)  # of the angle at the centre
    places: np.ndarray = center + r * (cosine * axis + np.sqrt(1.0 - cosine**2) * across)
    return places

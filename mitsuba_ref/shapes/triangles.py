"""How far Mitsuba may be off on a triangle (docs/method.md, "Triangles")."""

from typing import Any

import numpy as np

from mitsuba_ref.meeting import KU, LARGEST_COORDINATE, Meetings, dot, norm, permanent, unit

# Where the relative error of n.d reaches this, float32 cannot tell on which side of edge-on the ray passes.
UNRESOLVABLE = 0.5


def meet(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[Meetings, ...]:
    """Ray i with triangle k[i], by its plane and its three edge functions."""
    corners = [prims.vertices[prims.faces[k, j]] for j in range(3)]
    a, b, c = (corner - o for corner in corners)
    across = np.cross(b - a, c - a)
    area = norm(across)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        edges, edge_errors = _edge_functions(a, b, c, d)
        total = edges.sum(axis=1)
        weights = edges / total[:, None]
        n = across / area[:, None]
        t = dot(n, a) / dot(n, d)
        t_error, resolvable = _t_error(n, across, area, (a, b, c), weights, t, d)
        spread = permanent(b - a, c - a)
        n_error = KU * (norm(spread) / area + 1.0)
        sign = np.sign(total)[:, None]
        possible = np.all(edges * sign >= -edge_errors, axis=1) & (area > 0.0) & _kept(corners)
        certain = np.all(edges * sign > edge_errors, axis=1) & resolvable & possible & np.isfinite(t)
        weight_errors = (edge_errors + np.abs(weights) * edge_errors.sum(axis=1)[:, None]) / np.abs(total)[:, None]
        sh_n, sh_error = _shading(prims, k, n, n_error, weights, weight_errors)
    return (Meetings(t, np.where(resolvable, t_error, np.inf), n, n_error, sh_n, sh_error, possible, certain),)


def _kept(corners: list[np.ndarray]) -> np.ndarray:
    return np.all([np.abs(corner).max(axis=1) < LARGEST_COORDINATE for corner in corners], axis=0)


def _edge_functions(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(m, 3) U, V, W = d.(b x c), ... and how far float32 may be off in each.

    Embree forms each from the difference and the sum of two corners (Pluecker), so their products round; its robust
    mode accepts |U + V + W| ulps beyond an edge on top.
    """
    pairs = ((c, b), (a, c), (b, a))
    edges = np.stack([dot(d, np.cross(p, q)) for p, q in pairs], axis=1)
    inflation = 2.0 * np.abs(edges.sum(axis=1))
    errors = [
        dot(np.abs(d), permanent(p - q, np.abs(p) + np.abs(q)) + permanent(p, q)) + inflation for p, q in pairs
    ]
    return edges, KU * np.stack(errors, axis=1)


def _t_error(
    n: np.ndarray,
    across: np.ndarray,
    area: np.ndarray,
    corners: tuple[np.ndarray, np.ndarray, np.ndarray],
    weights: np.ndarray,
    t: np.ndarray,
    d: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(bound on the error of t, whether float32 resolves the crossing at all).

    Three sources: the corners' rounding moves the plane (displacement); the normal's rounding tilts it about the
    first corner (lever); and n.d itself is only known to rho of its value.
    """
    a, b, c = corners
    steepness = np.abs(dot(n, d))
    spread = permanent(b - a, c - a) / area[:, None]
    reach = np.abs(t)[:, None] * np.abs(d)
    share = [np.abs(weights[:, j : j + 1]) * np.abs(corner) for j, corner in enumerate(corners)]
    displacement = dot(np.abs(n), sum(share) + np.abs(a) + reach)
    lever = dot(np.abs(t[:, None] * d - a), spread)
    rho = KU * (dot(np.abs(n), np.abs(d)) + dot(np.abs(d), spread)) / steepness
    resolvable = rho < UNRESOLVABLE
    return KU * ((displacement + lever) / steepness + np.abs(t)) / (1.0 - np.minimum(rho, UNRESOLVABLE)), resolvable


def _shading(
    prims: Any, k: np.ndarray, n: np.ndarray, n_error: np.ndarray, weights: np.ndarray, weight_errors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolated normal and its bound: barycentrics off by their errors, three products and a length rounded.

    The errors of the barycentrics add up to nothing, so they act on what the normals differ by.
    """
    normals = [prims.normals[prims.faces[k, j]] for j in range(3)]
    summed = sum(weights[:, j : j + 1] * normals[j] for j in range(3))
    length = norm(summed)
    moved = sum(weight_errors[:, j] * norm(normals[j] - summed) for j in range(3))
    rounded = KU * sum(np.abs(weights[:, j]) * norm(normals[j]) for j in range(3))
    smooth = prims.smooth[k]
    error = np.where(smooth, (moved + rounded) / np.where(length > 0.0, length, np.nan) + KU, n_error)
    return np.where(smooth[:, None], unit(summed), n), error

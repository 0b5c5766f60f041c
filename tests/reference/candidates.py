"""Candidates for the tests: our caster by the interface of candidates, and the same with one fault each."""

from collections.abc import Callable
from typing import Any

import numpy as np

import caster
from caster.scene.model import Scene

Given = tuple[Any, Any]
Trace = Callable[[Scene, np.ndarray, np.ndarray], Given]


def ours(scene: Scene, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    hits = caster.cast(scene, o, d)
    return hits.t.copy(), hits.normal.copy()


def far_root(scene: Scene, o: np.ndarray, d: np.ndarray) -> Given:
    """The far hit of the only ball."""
    (ball,) = scene.shapes
    away = o - np.array(ball.center)
    b, c = (away * d).sum(axis=1), (away * away).sum(axis=1) - ball.radius**2
    a = (d * d).sum(axis=1)
    inside = b * b > a * c
    t = np.where(inside, (-b + np.sqrt(np.maximum(b * b - a * c, 0.0))) / a, np.inf)
    return t, away + np.where(inside, t, 0.0)[:, None] * d


def altered(change: Callable[[np.ndarray, np.ndarray], Given]) -> Trace:
    """Our caster, whose t and normals are changed; it has the name of the change."""

    def trace(scene: Scene, o: np.ndarray, d: np.ndarray) -> Given:
        return change(*ours(scene, o, d))

    trace.__name__ = change.__name__
    return trace


@altered
def flipped_normal(t: np.ndarray, n: np.ndarray) -> Given:
    return t, -n


@altered
def one_nan(t: np.ndarray, n: np.ndarray) -> Given:
    t[np.flatnonzero(np.isfinite(t))[7]] = np.nan
    return t, n


@altered
def one_missed_edge_pixel(t: np.ndarray, n: np.ndarray) -> Given:
    t[np.flatnonzero(np.isfinite(t))[0]] = np.inf
    return t, n


@altered
def one_hit_beside_the_edge(t: np.ndarray, n: np.ndarray) -> Given:
    first = np.flatnonzero(np.isfinite(t))[0]
    t[first - 1], n[first - 1] = t[first], n[first]
    return t, n


@altered
def t_off_by_a_ten_thousandth(t: np.ndarray, n: np.ndarray) -> Given:
    return t * (1 + 1e-4), n


def the_last_surface(scene: Scene, o: np.ndarray, d: np.ndarray) -> Given:
    """Return the second hit where there is one."""
    t, n = ours(scene, o, d)
    hit = np.flatnonzero(np.isfinite(t))
    behind = caster.cast(scene, o[hit] + 1.000001 * t[hit, None] * d[hit], d[hit])
    there = np.isfinite(behind.t)
    rows = hit[there]
    t[rows], n[rows] = 1.000001 * t[rows] + behind.t[there], behind.normal[there]
    return t, n


@altered
def without_normals(t: np.ndarray, n: np.ndarray) -> Given:
    return t, None


@altered
def ours_rounded(t: np.ndarray, n: np.ndarray) -> Given:
    return t.astype(np.float32), n.astype(np.float32)

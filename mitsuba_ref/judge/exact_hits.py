"""Exact answers about float32 rays of a scene, with the error bounds of t around them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from caster.geometry.packing import Packed, pack
from caster.geometry.world_space import as_float32
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import reference_bounds
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.reference.rays import SharedRays
from mitsuba_ref.reference.scene_export import model_of


@dataclass(frozen=True)
class PreparedScene:
    """A scene packed as float32 numbers, its error model, and float32 rays through it."""

    scene: Scene
    packed: Packed
    model: SceneModel
    o: np.ndarray  # (n, 3) float32
    d: np.ndarray  # (n, 3) float32

    @property
    def primitives(self) -> int:
        return int(self.packed.first[-1])


def prepare_scene(scene: Scene, o: np.ndarray, d: np.ndarray) -> PreparedScene:
    packed = pack(scene, as_float32)
    rays = SharedRays(o, d, np.full(len(o), np.inf, np.float32), np.zeros(len(o)))
    return PreparedScene(scene, packed, model_of(scene, packed, rays), o, d)


class ExactHits:
    """Exact first hits of rays o + t d, 0 < t <= t_max; all arrays have one row a ray."""

    def __init__(self, ready: PreparedScene, o: np.ndarray, d: np.ndarray, t_max: float = np.inf) -> None:
        self.ready, self.o, self.d = ready, o.astype(np.float64), d.astype(np.float64)
        self.answers = tuple(Oracle(ready.packed).first_hits(self.o, self.d, t_max=t_max))
        self.hit = np.array([answer.hit for answer in self.answers], bool)
        self.t = np.array([np.inf if answer.t is None else float(answer.t) for answer in self.answers])
        self.ties = [frozenset(tie.prim for tie in answer.ties) for answer in self.answers]
        ray = np.repeat(np.arange(len(self.answers)), [len(answer.ties) for answer in self.answers])
        prim = np.array([tie.prim for answer in self.answers for tie in answer.ties], int)
        # (n,) bounds on |t - exact t| in either arithmetic, at the most generous of the primitives that are exactly
        # nearest; inf: unbounded, 0: a miss
        self.float64, self.float32 = np.zeros((2, len(self.answers)))
        for out, bound in zip((self.float64, self.float32), self.bounds(ray, prim), strict=True):
            np.maximum.at(out, ray, bound)

    def bounds(self, rows: np.ndarray, prim: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of t in (float64, float32) for ray rows[i] at primitive prim[i], at the root nearest to the hit."""
        found = reference_bounds(self.ready.model, prim, self.o[rows], self.d[rows], self.t[rows])
        own, at = (np.where(np.isnan(side.t_error), np.inf, side.t_error) for side in (found.own, found.at))
        return own, at

    def errors(self, rows: Sequence[int] | np.ndarray, t: np.ndarray) -> np.ndarray:
        """(m,) |t - exact t| of these rays, exactly rounded; NaN for a NaN."""
        return np.array([self._error(int(row), float(value)) for row, value in zip(rows, t, strict=True)])

    def _error(self, row: int, t: float) -> float:
        exact = self.answers[row].t
        return float("nan") if exact is None or np.isnan(t) else exact.off(t)

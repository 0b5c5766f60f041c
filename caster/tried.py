"""One ray against every primitive of a scene, or against the near ones of a large one, each as if it stood alone."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from caster.kernels.each import answer_each
from caster.kernels.nearest import Rays, choose, no_hits
from caster.margins import EDGE_ON, Margin, margins
from caster.packing import Kind, Packed

MOST = 256  # primitives that are looked at one by one; of more, those whose boxes are nearest to the ray


@dataclass(frozen=True)
class Tried:
    """What one primitive answers."""

    shape_id: int
    prim_id: int  # within its shape
    t: float  # exactly the first in range, as float64; inf on a miss
    off: float  # how far float64 alone may be off in t; inf where it could not tell
    margins: tuple[Margin, ...]
    box: tuple[np.ndarray, np.ndarray] | None  # low, high corner (3,); None for a kind without bounds
    span: tuple[float, float] | None  # t where the ray enters and leaves the box; None where it passes by

    @property
    def decided_by(self) -> str:
        return "float64" if math.isfinite(self.off) else "integers"

    @property
    def nearly(self) -> float:
        """How far outside its outline the ray passes, for an order among misses; inf where it runs along, elsewhere."""
        if self.span is None and any(margin.of == EDGE_ON for margin in self.margins):
            return math.inf
        return max((-margin.inside for margin in self.margins), default=0.0)

    @property
    def out_of_range(self) -> bool:
        """Missed although its line passes inside the outline: behind, beyond t_max, or past a cylinder's ends."""
        return math.isinf(self.t) and bool(self.margins) and all(m.inside > 0.0 for m in self.margins)


def try_each(packed: Packed, rays: Rays) -> tuple[Tried, ...]:
    """The answers of the near primitives to rays[0], hits by t, then misses by how nearly. Without a ray: none."""
    if rays.t_max[0] < 0.0:
        return ()
    found = [tried for kind, rows in _near(packed, rays) for tried in _try(packed, kind, rows, rays)]
    order = sorted(found, key=lambda each: (each.t, each.nearly, each.shape_id, each.prim_id))
    return tuple(order[:MOST])


def _near(packed: Packed, rays: Rays) -> Iterator[tuple[Kind, np.ndarray]]:
    """(kind, places within it of the MOST nearest): the overall nearest are among them."""
    for kind in packed.kinds:
        if len(kind.ids) <= MOST or not kind.bounded:
            yield kind, np.arange(len(kind.ids))[:MOST]
            continue
        low, high = kind.boxes()
        away = distance_to_boxes(rays.o[0], rays.d[0], low, high)
        yield kind, np.sort(np.argsort(away, kind="stable")[:MOST])


def distance_to_boxes(o: np.ndarray, d: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(n,) a number that is 0 where the ray passes the ball around a box, else its distance from that; behind: more."""
    with np.errstate(all="ignore"):
        center, radius = 0.5 * low + 0.5 * high, 0.5 * np.linalg.norm(high - low, axis=1)
        ahead = np.maximum((center - o) @ d / (d @ d), 0.0)
        away = np.linalg.norm(o + ahead[:, None] * d - center, axis=1) - radius
    return np.where(np.isfinite(away), np.maximum(away, 0.0), np.inf)


def _try(packed: Packed, kind: Kind, rows: np.ndarray, rays: Rays) -> Iterator[Tried]:
    t, off = answers(kind, rows, rays)
    boxes = kind.boxes() if kind.bounded else None
    ids = kind.ids[rows]
    shapes, numbers = packed.shape_of(ids), packed.number_in_shape(ids)
    for j, k in enumerate(rows.tolist()):
        box = (boxes[0][k], boxes[1][k]) if boxes else None
        span = box and span_in(rays.o[0], rays.d[0], *box)
        edges = margins(kind.prims, k, rays.o[0], rays.d[0])
        yield Tried(int(shapes[j]), int(numbers[j]), float(t[j]), float(off[j]), edges, box, span)


def answers(kind: Kind, rows: np.ndarray, rays: Rays) -> tuple[np.ndarray, np.ndarray]:
    """(t, off) of some primitives of a kind: what float64 says, and t of integers where off is inf."""
    t, off = np.full(len(rows), np.inf), np.zeros(len(rows))
    answer_each(kind.prims, rows.astype(np.int64), rays, t, off, 0, len(rows))
    doubtful = np.flatnonzero(np.isinf(off))
    if len(doubtful):
        again = Rays(*(np.repeat(a, len(doubtful), axis=0) for a in rays))
        found, starts = no_hits(len(doubtful)), np.arange(len(doubtful) + 1)
        choose(kind.prims, again, starts, rows[doubtful].astype(np.int32), found, 0, len(doubtful))
        t[doubtful] = found.t
    return t, off


def span_in(o: np.ndarray, d: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[float, float] | None:
    """t where the line enters and leaves a box, within some roundings; None where it passes by or lies behind."""
    enter, leave = -math.inf, math.inf
    for a, way, start, end in zip(o.tolist(), d.tolist(), low.tolist(), high.tolist(), strict=True):
        if way == 0.0:
            if not start <= a <= end:
                return None
            continue
        ends = sorted(((start - a) / way, (end - a) / way))
        enter, leave = max(enter, ends[0]), min(leave, ends[1])
    return (enter, leave) if enter <= leave and leave >= 0.0 else None

"""A scene as the judge sees it: its primitives in float32, what stands in for them, and their error models."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import SceneError
from caster.description.fields import Shape
from caster.geometry.packing import Packed, concatenate_parts
from caster.scene.model import Scene
from mitsuba_ref.error_model.intersections import ErrorModel, Intersections
from mitsuba_ref.reference.rays import SharedRays
from mitsuba_ref.shapes import REFERENCES
from mitsuba_ref.shapes.shape_reference import ShapeReference


class MissingReferenceError(SceneError, LookupError):
    """A scene with a shape or a camera that the judge does not know."""


def reference_of(shape: Shape) -> ShapeReference:
    """Raises MissingReferenceError with what to write, where a shape has no reference yet."""
    if type(shape) not in REFERENCES:
        raise MissingReferenceError(missing_reference(type(shape).__name__, "shapes"))
    return REFERENCES[type(shape)]


def missing_reference(name: str, kind: str) -> str:
    return (
        f"{name} has no reference: write mitsuba_ref/{kind}/{name.lower()}.py and add its line to "
        f"mitsuba_ref/{kind}/__init__.py (docs/adding-a-shape.md)"
    )


class PairIntersections(NamedTuple):
    """Intersections of several pairs, all roots: row i belongs to pair[i]."""

    pair: np.ndarray  # (m,) index into the pairs that were asked for
    at: Intersections


@dataclass(frozen=True)
class SceneModel:
    """Primitives are numbered as in `packed`."""

    packed: Packed
    parts: tuple[Any, ...]  # each shape's arrays, stand-ins in place
    kinds: tuple[Any, ...]  # the same, joined by kind
    models: tuple[ErrorModel, ...]  # one for each kind

    def intersect(
        self, prim: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float, *, ours: bool
    ) -> PairIntersections:
        """Primitive prim[i] (m,) with ray i (m, 3), (m, 3), for each i; ours: as our caster has it."""
        shape = self.packed.shape_of(prim)
        kind = self.packed.kind_of[shape]
        k = prim - self.packed.first[shape] + self.packed.start[shape]
        pairs, found = [], []
        for place, model in enumerate(self.models):
            rows = np.flatnonzero(kind == place)
            if len(rows):
                intersect = (ours and model.intersect_ours) or model.intersect
                for at in intersect(self.kinds[place], k[rows], o[rows], d[rows], ku):
                    pairs.append(rows)
                    found.append(with_edges(at))
        if not found:
            return PairIntersections(np.zeros(0, int), no_intersections())
        return PairIntersections(
            np.concatenate(pairs), Intersections(*(np.concatenate(a) for a in zip(*found, strict=True)))
        )

    @cached_property
    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """(low, high) corners of all primitives, (n, 3) each."""
        low, high = np.empty((self.packed.first[-1], 3)), np.empty((self.packed.first[-1], 3))
        for place, kind in enumerate(self.packed.kinds):
            low[kind.ids], high[kind.ids] = self.models[place].bounds(self.kinds[place])
        return low, high


def with_edges(at: Intersections) -> Intersections:
    """Kinds without edges say so in full, so that all kinds can be put together."""
    if at.edge is not None:
        return at
    return at._replace(edge=np.full((len(at.t), 6), np.nan), side=np.zeros(len(at.t)))


def no_intersections() -> Intersections:
    none, rows, flags = np.zeros(0), np.zeros((0, 3)), np.zeros(0, bool)
    return Intersections(none, none, rows, none, rows, none, flags, flags, none, np.zeros((0, 6)), none)


def model_of(scene: Scene, packed: Packed, rays: SharedRays) -> SceneModel:
    """The judge's view of packed float32 geometry; stand-ins are cut to these rays."""
    references = [reference_of(shape) for shape in scene.shapes]
    real = rays.t_max >= 0.0
    o, d = rays.o[real].astype(np.float64), rays.d[real].astype(np.float64)
    parts = tuple(
        reference.stand_in(part, o, d) for reference, part in zip(references, packed.parts, strict=True)
    )
    members = [np.flatnonzero(packed.kind_of == place) for place in range(len(packed.kinds))]
    kinds = tuple(concatenate_parts([parts[s] for s in shapes]) for shapes in members)
    models = tuple(_model(references, packed, shapes) for shapes in members)
    return SceneModel(packed, parts, kinds, models)


def _model(references: Sequence[ShapeReference], packed: Packed, shapes: np.ndarray) -> ErrorModel:
    first = int(shapes[0])
    return references[first].model_of(packed.parts[first])

"""A scene of the benchmark on disk, in every form that some contestant reads."""

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from caster.packing import Packed, Triangles, pack
from caster.placing import as_float32
from caster.scene import Scene
from mitsuba_ref.bench.scenes import BenchScene, rays_of
from mitsuba_ref.bench.work import MESH, PLAIN, RAYS, ROBUST, SCENE, SHADING
from mitsuba_ref.export import export
from mitsuba_ref.model import Model, model_of
from mitsuba_ref.rays import SharedRays


@dataclass(frozen=True)
class Prepared:
    """What is known of it here."""

    scene: Scene
    packed: Packed
    model: Model
    o: np.ndarray  # (n, 3) float32
    d: np.ndarray  # (n, 3) float32

    @property
    def primitives(self) -> int:
        return int(self.packed.first[-1])


def prepare(scene: BenchScene, folder: Path, size: int) -> Prepared:
    """Write everything. size: of the film, or the square root of how many rays there are."""
    made = scene.make(folder).with_film(width=size, height=size)
    packed = pack(made, as_float32)
    o, d = rays_of(scene, made)
    rays = SharedRays(o, d, np.full(len(o), np.inf, np.float32), np.zeros(len(o)))
    model = model_of(made, packed, rays)
    (folder / SCENE).write_bytes(pickle.dumps(made))
    if scene.asks != SHADING:
        for name in (ROBUST, PLAIN):
            export(made, model, robust=name == ROBUST).write(folder / name)
        np.savez(folder / RAYS, o=o, d=d)
    if all(isinstance(part, Triangles) for part in packed.parts):
        vertices, faces = together(packed.parts)
        np.savez(folder / MESH, vertices=vertices, faces=faces)
    return Prepared(made, packed, model, o, d)


def together(parts: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of all shapes as one mesh: (n, 3) float32 corners, (m, 3) int32 faces."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, first, strict=False)]
    vertices = np.concatenate([part.vertices for part in parts])
    return vertices.astype(np.float32), np.concatenate(faces).astype(np.int32)

"""What AOVs are computed from: rays, their nearest hits and, where something asks, surfaces and shadows."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from caster.geometry.packing import Packed
from caster.kernels.nearest import Nearest, Rays, new_rays
from caster.kernels.surface.lighting import received_irradiance_of_rays, shadow_rays_of
from caster.kernels.surface.surfaces import (
    Surfaces,
    find_all_normals,
    find_normals_at,
    find_surfaces,
    no_surfaces,
)
from caster.rendering.casting import find_any
from caster.rendering.threads import parallel_for
from caster.scene.lights import Light
from caster.scene.model import Scene

__all__ = ["View"]


@dataclass(frozen=True)
class View:
    """Rays cast into a scene. `start` is what each ray's depth counts from, beyond its origin."""

    scene: Scene
    packed: Packed
    rays: Rays
    nearest: Nearest
    start: np.ndarray  # (n,) float64
    threads: int | None = None

    @cached_property
    def hit(self) -> np.ndarray:
        """(n,) bool."""
        return self.nearest.prim >= 0

    @cached_property
    def shape_id(self) -> np.ndarray:
        """(n,) int32, -1 on a miss."""
        return self.packed.shape_of(self.nearest.prim)

    @cached_property
    def prim_id(self) -> np.ndarray:
        """(n,) int32 within the shape, -1 on a miss."""
        return self.packed.index_in_shape(self.nearest.prim)

    @cached_property
    def surfaces(self) -> Surfaces:
        """Position, normals and uv of every hit."""
        out = no_surfaces(len(self.hit))
        for prims, where, ks in self._hits_by_kind():
            find = partial(find_surfaces, prims, ks, where, self.rays, self.nearest.t, out)
            parallel_for(find, len(where), self.threads)
        return out

    @cached_property
    def normals(self) -> np.ndarray:
        """(n, 3) geometric normals of the hits alone, 0 on a miss; those of `surfaces`."""
        if len(self.packed.parts) == 1:
            found, (t, prim) = np.empty((len(self.hit), 3)), (self.nearest.t, self.nearest.prim)
            find = partial(find_all_normals, self.packed.kinds[0].prims, self.rays, prim, t, found)
            parallel_for(find, len(found), self.threads)
            return found
        out = np.zeros((len(self.hit), 3))
        for prims, where, ks in self._hits_by_kind():
            find = partial(find_normals_at, prims, ks, where, self.rays, self.nearest.t, out)
            parallel_for(find, len(where), self.threads)
        return out

    def _hits_by_kind(self) -> Iterator[tuple[Any, np.ndarray, np.ndarray]]:
        """(primitives, rays that hit them, which of them each ray hits) for each kind."""
        packed, prim = self.packed, self.nearest.prim
        if len(packed.parts) == 1:
            where = np.flatnonzero(self.hit)
            yield packed.kinds[0].prims, where, prim[where].astype(np.int64)
            return
        for place, kind in enumerate(packed.kinds):
            where = np.flatnonzero(self.hit & (packed.kind_of[self.shape_id] == place))
            shape = self.shape_id[where]
            yield kind.prims, where, prim[where] - packed.first[shape] + packed.start[shape]

    @cached_property
    def reflectance(self) -> np.ndarray:
        """(n, 3) of the material that was hit, 0 on a miss."""
        if not self.scene.shapes:
            return np.zeros((len(self.hit), 3))
        table = np.array([self.scene.material_of(shape).reflectance for shape in self.scene.shapes])
        return np.where(self.hit[:, None], table[self.shape_id], 0.0)

    @cached_property
    def two_sided(self) -> np.ndarray:
        """(n,) bool."""
        table = np.array([self.scene.material_of(shape).two_sided for shape in self.scene.shapes], bool)
        return table[self.shape_id] & self.hit if len(table) else self.hit

    def arriving(self, light: Light) -> tuple[np.ndarray, np.ndarray]:
        """(hits that the light reaches, (m,); irradiance there, (m, 3))."""
        seen, flux = np.zeros(len(self.hit), bool), np.zeros((len(self.hit), 3))
        received_irradiance_of_rays(
            light.pack(), self.surfaces, self.rays, self.hit, self.two_sided, seen, flux
        )
        where = np.flatnonzero(seen)
        where = where[self.lit(light, where)]
        return where, flux[where]

    def lit(self, light: Light, where: np.ndarray) -> np.ndarray:
        """Whether nothing stands between the hits `where` and the light; True in a scene without shadows."""
        if not self.scene.shading.shadows:
            return np.ones(len(where), bool)
        return ~find_any(self.packed, self.shadow_rays(light, where), self.threads)

    def shadow_rays(self, light: Light, where: np.ndarray) -> Rays:
        """From the hits `where` to the light."""
        out = new_rays(len(where))
        shadow_rays_of(light.pack(), self.surfaces, self.rays, self.nearest.t, where, out)
        return out


def length(v: np.ndarray) -> np.ndarray:
    """Euclidean length of each row."""
    return np.sqrt(v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1] + v[:, 2] * v[:, 2])

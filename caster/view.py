"""What AOVs are computed from: rays, their nearest hits and, where something asks, surfaces and shadows."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from caster.casting import find_nearest
from caster.kernels.gather import Surfaces, find_surfaces, no_surfaces
from caster.kernels.nearest import Nearest, Rays
from caster.lights import Light
from caster.packing import Packed
from caster.scene import Scene

# A computed hit lies within 16 u (|o| + t + |p|) of the surface (kernels/roots.py, triangles.py); shadow rays start
# four times as far out, along the normal, so that no surface shadows itself. u = 2^-53.
SHADOW_OFFSET = 4 * 16.0 * 2.0**-53


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
        return self.packed.number_in_shape(self.nearest.prim)

    @cached_property
    def surfaces(self) -> Surfaces:
        """Position, normals and uv of every hit."""
        out = no_surfaces(len(self.hit))
        packed = self.packed
        for place, kind in enumerate(packed.kinds):
            where = np.flatnonzero(self.hit & (packed.kind_of[self.shape_id] == place))
            shape = self.shape_of_hits(where)
            ks = self.nearest.prim[where] - packed.first[shape] + packed.start[shape]
            find_surfaces(kind.prims, ks, where, self.rays, self.nearest.t, out)
        return out

    def shape_of_hits(self, where: np.ndarray) -> np.ndarray:
        return self.shape_id[where]

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

    def lit(self, light: Light, where: np.ndarray) -> np.ndarray:
        """Whether nothing stands between the hits `where` and the light; True in a scene without shadows."""
        if not self.scene.shading.shadows:
            return np.ones(len(where), bool)
        return find_nearest(self.packed, self.shadow_rays(light, where), threads=self.threads).prim < 0

    def shadow_rays(self, light: Light, where: np.ndarray) -> Rays:
        """From the hits `where` to the light: off the surface, to the side the light is on.

        What lies nearer than the offset does not count: a hit in the crease of two faces may be a rounding
        behind the other one.
        """
        p, n = self.surfaces.p[where], self.surfaces.n[where]
        side = np.sign(np.sum(n * light.towards(p)[0], axis=1))
        size = np.abs(self.rays.o[where]).max(axis=1, initial=0.0)
        size += self.nearest.t[where] * length(self.rays.d[where])
        size += np.abs(p).max(axis=1, initial=0.0)
        offset = SHADOW_OFFSET * size
        o = np.ascontiguousarray(p + (side * offset)[:, None] * n)
        d, reach = light.shadow_rays(o)
        away = length(d)
        near = np.divide(offset, away, out=np.zeros(len(where)), where=away > 0.0)
        return Rays(o, np.ascontiguousarray(d), near, reach)


def length(v: np.ndarray) -> np.ndarray:
    """Euclidean length of each row."""
    return np.sqrt(v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1] + v[:, 2] * v[:, 2])

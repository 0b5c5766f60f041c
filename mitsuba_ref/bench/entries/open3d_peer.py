"""Open3D's RaycastingScene: Embree, t and normal of triangles."""

from typing import Any

import numpy as np
import open3d

from mitsuba_ref.bench.work import ANY, FIRST_RAY, SHADOW_END, Work, blocked, given_mesh, given_rays

tensor = open3d.core.Tensor


class Open3D:
    def __init__(self, work: Work) -> None:
        self.work = work
        self.vertices, self.faces = given_mesh(work.folder)

    def build(self, size: int) -> None:
        self.scene = open3d.t.geometry.RaycastingScene(nthreads=self.work.threads)
        self.scene.add_triangles(tensor(self.vertices), tensor(self.faces.astype(np.uint32)))
        self._cast(rays_of(*FIRST_RAY))  # the tree grows with it
        self.size = size

    def take_rays(self) -> None:
        self.rays = rays_of(*given_rays(self.work.folder, self.size))

    def cast(self) -> int:
        self._cast(self.rays)
        return int(self.rays.shape[0])

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        if self.work.asks == ANY:
            return blocked(self._cast(rays_of(o, d)))
        return self._cast(rays_of(o, d)).astype(np.float64)

    def _cast(self, rays: Any) -> np.ndarray:
        if self.work.asks == ANY:
            return self.scene.test_occlusions(rays, 0.0, SHADOW_END, nthreads=self.work.threads).numpy()
        found = self.scene.cast_rays(rays, nthreads=self.work.threads)
        found["primitive_normals"].numpy()  # no copy, and so it costs nothing
        return found["t_hit"].numpy()


def rays_of(o: np.ndarray, d: np.ndarray) -> Any:
    return tensor(np.hstack([o, d]))

"""Other ray casters of triangles from Python: embreex, trimesh and Open3D; each is imported by its own class."""

from typing import Any

import numpy as np

from mitsuba_ref.bench.work import (
    ANY,
    FIRST_RAY,
    SHADOW_END,
    CannotRun,
    Work,
    blocked,
    given_mesh,
    given_rays,
)

NO_HIT = -1


class Embreex:
    """Embree through embreex: `EmbreeScene.run` with all outputs; one thread."""

    def __init__(self, work: Work) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self.work, self.new_scene, self.add_mesh = work, rtcore_scene.EmbreeScene, TriangleMesh
        self.vertices, self.faces = given_mesh(work.folder)

    def build(self, size: int) -> None:
        self.scene = self.new_scene()
        self.add_mesh(self.scene, self.vertices, self.faces)
        self.answer(*FIRST_RAY)  # builds the tree
        self.size = size

    def take_rays(self) -> None:
        self.o, self.d = given_rays(self.work.folder, self.size)

    def cast(self) -> int:
        if self.work.workload == ANY:
            self._blocked(self.o, self.d)
        else:
            self.scene.run(self.o, self.d, output=True)
        return len(self.o)

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        if self.work.workload == ANY:
            return blocked(self._blocked(o, d) != NO_HIT)
        found = self.scene.run(o, d, output=True)
        return np.where(found["primID"] == NO_HIT, np.inf, found["tfar"].astype(np.float64))

    def _blocked(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        ends = np.full(len(o), SHADOW_END, np.float32)
        return self.scene.run(o, d, ends, query="OCCLUDED")


class Trimesh:
    """`intersects_location` of trimesh with embreex: the first hit, and from it t and normal."""

    def __init__(self, work: Work) -> None:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        if work.workload == ANY:
            raise CannotRun("no limit to rays")
        vertices, self.faces = given_mesh(work.folder)
        self.vertices = vertices.astype(np.float64)
        self.folder = work.folder
        self.make, self.intersector = trimesh.Trimesh, RayMeshIntersector

    def build(self, size: int) -> None:
        self.mesh = self.make(self.vertices, self.faces, process=False)
        self.rays = self.intersector(self.mesh)
        self.normals = self.mesh.face_normals
        self.answer(*FIRST_RAY)
        self.size = size

    def take_rays(self) -> None:
        o, d = given_rays(self.folder, self.size)
        self.o, self.d = o.astype(np.float64), d.astype(np.float64)

    def cast(self) -> int:
        self._cast(self.o, self.d)
        return len(self.o)

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        return self._cast(o.astype(np.float64), d.astype(np.float64))

    def _cast(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        places, rays, faces = self.rays.intersects_location(o, d, multiple_hits=False)
        t, n = np.full(len(o), np.inf), np.zeros((len(o), 3))
        along: Any = d[rays]
        t[rays] = ((places - o[rays]) * along).sum(axis=1) / (along * along).sum(axis=1)
        n[rays] = self.normals[faces]
        return t


class Open3D:
    """RaycastingScene: Embree, t and normal of triangles."""

    def __init__(self, work: Work) -> None:
        import open3d

        self.work, self.open3d = work, open3d
        self.vertices, self.faces = given_mesh(work.folder)

    def build(self, size: int) -> None:
        self.scene = self.open3d.t.geometry.RaycastingScene(nthreads=self.work.threads)
        self.scene.add_triangles(self._tensor(self.vertices), self._tensor(self.faces.astype(np.uint32)))
        self._cast(self._rays(*FIRST_RAY))  # builds the tree
        self.size = size

    def take_rays(self) -> None:
        self.rays = self._rays(*given_rays(self.work.folder, self.size))

    def cast(self) -> int:
        self._cast(self.rays)
        return int(self.rays.shape[0])

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        if self.work.workload == ANY:
            return blocked(self._cast(self._rays(o, d)))
        return self._cast(self._rays(o, d)).astype(np.float64)

    def _cast(self, rays: Any) -> np.ndarray:
        if self.work.workload == ANY:
            return self.scene.test_occlusions(rays, 0.0, SHADOW_END, nthreads=self.work.threads).numpy()
        found = self.scene.cast_rays(rays, nthreads=self.work.threads)
        found["primitive_normals"].numpy()  # no copy, and so it costs nothing
        return found["t_hit"].numpy()

    def _rays(self, o: np.ndarray, d: np.ndarray) -> Any:
        return self._tensor(np.hstack([o, d]))

    def _tensor(self, array: np.ndarray) -> Any:
        return self.open3d.core.Tensor(array)

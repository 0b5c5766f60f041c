"""Contestants: their task, what they share, and all of them but Mitsuba (mitsuba_entries.py).

A task is a folder with the scene in every form that some contestant reads, and what to compute. This module is light to
import: what a contestant's process loads beside the contestant counts as its memory.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import caster

# Workloads: an image of some AOVs; t and normal along given rays; whether given rays hit anything.
FILM, NEAREST, ANY = "film", "nearest", "any"
AOVS = ("depth", "normal")  # of a film, unless others are asked for

SCENE_FILE, MESH_FILE, RAYS_FILE = "scene.pickle", "mesh.npz", "rays.npz"  # files of a folder
ROBUST, DEFAULT = "robust", "default"  # folders within: a scene for Mitsuba in Embree's two modes
FIRST_RAY = (np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # for trees that are built on the first ray
SHADOW_END = 1.0  # t_max of shadow rays: t = 1 is the light
WARM_UP_SIDE = 8  # pixels: enough to make everything that is made before rays are cast


@dataclass(frozen=True)
class Work:
    """One contestant's job."""

    folder: str
    workload: str
    threads: int  # how many processors it may use
    entry: str  # "module:class" of the contestant, in mitsuba_ref.bench
    aovs: tuple[str, ...] = AOVS
    options: Mapping[str, Any] = field(default_factory=dict)  # its own


class CannotRun(Exception):  # noqa: N818 - the reason of an empty row, not an error
    """str(): what is missing."""


class Entry:
    """A contestant, in a process of its own: a subclass defines build, prepare and trace.

    Its class is called with the Work. Each method raises CannotRun for what there is no way to do.
    """

    def __init__(self, work: Work) -> None:
        self.work, self.any = work, work.workload == ANY

    def build(self, size: int) -> None:
        """Everything between loaded arrays and the first ray, for a film of size x size or as many rays; once."""
        raise NotImplementedError

    def prepare(self, o: np.ndarray, d: np.ndarray) -> Any:
        """Rays (n, 3) float32 in the form in which they are cast. Not timed."""
        raise NotImplementedError

    def trace(self, rays: Any) -> Any:
        """Cast rays, results in memory as arrays; returns t along each, of shadow rays whether it hits anything."""
        raise NotImplementedError

    def take_rays(self, size: int) -> None:
        """Prepare the rays of the folder: all of them, or size * size that are spread evenly."""
        with np.load(Path(self.work.folder) / RAYS_FILE) as file:
            o, d = file["o"], file["d"]
        some = slice(None) if len(o) <= size * size else np.linspace(0, len(o) - 1, size * size).astype(int)
        self.count = len(o[some])
        self.rays = self.prepare(o[some], d[some])

    def cast(self) -> int:
        """Cast all rays once; the number of rays."""
        self.trace(self.rays)
        return self.count

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """(n,) float64 t along other rays (n, 3) float32, inf on a miss; of shadow rays 0 where they hit anything."""
        found = self.trace(self.prepare(o, d))
        t = np.broadcast_to(found.numpy() if hasattr(found, "numpy") else found, (len(o),))
        return np.where(t, 0.0, np.inf) if self.any else t.astype(np.float64)

    @property
    def scene_file(self) -> Path:
        return Path(self.work.folder) / SCENE_FILE

    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) float32 corners, (m, 3) int32 faces. Raises CannotRun where the scene is more than triangles."""
        path = Path(self.work.folder) / MESH_FILE
        if not path.exists():
            raise CannotRun("triangles only")
        with np.load(path) as file:
            return file["vertices"], file["faces"]


class Ours(Entry):
    """options: culling; the planned one by default."""

    def build(self, size: int) -> None:
        import caster

        self.caster, self.scene = caster, pickle.loads(self.scene_file.read_bytes()).with_film(width=size, height=size)
        if self.work.workload == FILM:
            self._render(self.scene.with_film(width=WARM_UP_SIDE, height=WARM_UP_SIDE))
        else:
            self.trace(self.prepare(*FIRST_RAY))

    def prepare(self, o: np.ndarray, d: np.ndarray) -> Any:
        return o.astype(np.float64), d.astype(np.float64)

    def trace(self, rays: Any) -> Any:
        o, d = rays
        if self.any:
            return self.caster.occluded(self.scene, o, d, SHADOW_END)
        hits = self.caster.cast(self.scene, o, d)
        hits.normal  # noqa: B018 - computed on access
        return hits.t

    def cast(self) -> int:
        if self.work.workload != FILM:
            return super().cast()
        self._render(self.scene)
        return int(self.scene.film.width * self.scene.film.height)

    def _render(self, scene: caster.Scene) -> None:
        culling = self.work.options.get("culling")
        self.caster.render(scene, self.work.aovs, threads=self.work.threads, culling=culling, dtype=np.float32)


class Candidate(Entry):
    """A ray caster from elsewhere that takes rays. options: as of `parse_candidate`, and the folder to run it in."""

    def __init__(self, work: Work) -> None:
        from caster.description.errors import SceneError
        from mitsuba_ref.subjects.requests import parse_candidate

        super().__init__(work)
        if self.any:
            raise CannotRun("a candidate gives nearest hits")
        options = work.options
        os.chdir(options["folder"])
        try:
            self.subject = parse_candidate(options["text"], options["precision"], served=options["served"])
        except SceneError as error:
            raise CannotRun(str(error)) from error

    def build(self, size: int) -> None:
        """The scene in the numbers that are traced, and one ray."""
        from mitsuba_ref.reference.shared_input import model_of, packed_float32
        from mitsuba_ref.subjects.subject import CastRequest

        scene: caster.Scene = pickle.loads(self.scene_file.read_bytes())
        one = self.prepare(*FIRST_RAY)
        folder = Path(self.work.folder) / f"candidate-{size}"
        model = model_of(scene, packed_float32(scene), one)
        self.request = CastRequest(scene.with_film(width=size, height=size), model, one, folder)
        self.trace(one)

    def prepare(self, o: np.ndarray, d: np.ndarray) -> Any:
        from mitsuba_ref.reference.shared_input import SharedRays

        return SharedRays(o, d, np.full(len(o), np.inf, np.float32), np.zeros(len(o)))

    def trace(self, rays: Any) -> Any:
        from mitsuba_ref.subjects.subject import NoAnswer

        try:
            return self.subject.answer(self.request.with_rays(rays)).t
        except NoAnswer as error:
            raise CannotRun(str(error)) from error


# ---- other ray casters, each imported by its own class ----


class Trimesh(Entry):
    """`intersects_location` of trimesh with embreex: the first hit, and from it t and normal."""

    def build(self, size: int) -> None:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        if self.any:
            raise CannotRun("no limit to rays")
        vertices, faces = self.mesh()
        mesh = trimesh.Trimesh(vertices.astype(np.float64), faces, process=False)
        self.intersector, self.normals = RayMeshIntersector(mesh), mesh.face_normals
        self.trace(self.prepare(*FIRST_RAY))

    def prepare(self, o: np.ndarray, d: np.ndarray) -> Any:
        return o.astype(np.float64), d.astype(np.float64)

    def trace(self, rays: Any) -> Any:
        o, d = rays
        places, hit, faces = self.intersector.intersects_location(o, d, multiple_hits=False)
        t, n = np.full(len(o), np.inf), np.zeros((len(o), 3))
        t[hit] = ((places - o[hit]) * d[hit]).sum(axis=1) / (d[hit] * d[hit]).sum(axis=1)
        n[hit] = self.normals[faces]
        return t


class Open3D(Entry):
    """RaycastingScene: Embree, t and normal of triangles."""

    def build(self, size: int) -> None:
        import open3d

        self.tensor = open3d.core.Tensor
        vertices, faces = self.mesh()
        self.scene = open3d.t.geometry.RaycastingScene(nthreads=self.work.threads)
        self.scene.add_triangles(self.tensor(vertices), self.tensor(faces.astype(np.uint32)))
        self.trace(self.prepare(*FIRST_RAY))  # builds the tree

    def prepare(self, o: np.ndarray, d: np.ndarray) -> Any:
        return self.tensor(np.hstack([o, d]))

    def trace(self, rays: Any) -> Any:
        if self.any:
            return self.scene.test_occlusions(rays, 0.0, SHADOW_END, nthreads=self.work.threads)
        found = self.scene.cast_rays(rays, nthreads=self.work.threads)
        found["primitive_normals"].numpy()  # no copy, and so it costs nothing
        return found["t_hit"]

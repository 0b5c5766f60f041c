"""Contestants: their task, the protocol of their classes, and all of them but Mitsuba (mitsuba_entries.py).

A task is a folder with the scene in every form that some contestant reads, and what to compute. This module is light to
import: what a contestant's process loads beside the contestant counts as its memory.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from xml.etree import ElementTree

import numpy as np

if TYPE_CHECKING:
    import caster
    from mitsuba_ref.reference.shared_input import SharedRays
    from mitsuba_ref.subjects.subject import Answer, CastRequest

# Tasks: an image of some AOVs; t and normal along given rays; whether given rays hit anything; a shaded image, of our
# caster alone; a whole process that renders an image into a file; one that validates the installed scenes.
FILM, NEAREST, ANY, SHADING = "film", "nearest", "any", "shading"
PROCESS, VALIDATION = "process", "validation"

SCENE_FILE, MESH_FILE, RAYS_FILE = "scene.pickle", "mesh.npz", "rays.npz"  # files of a folder
ROBUST, DEFAULT = "robust", "default"  # folders within: a scene for Mitsuba in Embree's two modes
FIRST_RAY = (np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # for trees that are built on the first ray
SHADOW_END = 1.0  # t_max of shadow rays: t = 1 is the light


@dataclass(frozen=True)
class Work:
    """One contestant's job."""

    folder: str
    workload: str
    threads: int  # how many processors it may use
    entry: str  # "module:class" of the contestant, in mitsuba_ref.bench
    options: Mapping[str, Any] = field(default_factory=dict)  # its own

    def to_json(self) -> str:
        return json.dumps(asdict(self))


class Entry(Protocol):
    """A contestant, in a process of its own; its class is called with the Work.

    Each method, and the class, raises CannotRun for what there is no way to do.
    """

    def build(self, size: int) -> None:
        """Everything between loaded arrays and the first ray, for a film of size x size or as many rays; once."""

    def take_rays(self) -> None:
        """Convert the rays of the folder, at most size * size, to the form they are cast in. Not timed."""

    def cast(self) -> int:
        """Cast all rays once, results in memory as arrays; the number of rays."""

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """(n,) float64 t along other rays (n, 3) float32, inf on a miss.

        Shadow rays: 0 where they hit anything.
        """


class CannotRun(Exception):  # noqa: N818 - the reason of an empty row, not an error
    """str(): what is missing."""


def given_rays(folder: str, size: int) -> tuple[np.ndarray, np.ndarray]:
    """o, d: (n, 3) float32; all of them, or size * size that are spread evenly."""
    with np.load(Path(folder) / RAYS_FILE) as file:
        o, d = file["o"], file["d"]
    if len(o) <= size * size:
        return o, d
    some = np.linspace(0, len(o) - 1, size * size).astype(int)
    return o[some], d[some]


def given_mesh(folder: str) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) float32 corners and (m, 3) int32 faces. Raises CannotRun where the scene is more than triangles."""
    path = Path(folder) / MESH_FILE
    if not path.exists():
        raise CannotRun("triangles only")
    with np.load(path) as file:
        return file["vertices"], file["faces"]


def blocked(hit: np.ndarray) -> np.ndarray:
    """Hits of shadow rays in the form of Entry.answer."""
    return np.where(hit, 0.0, np.inf)


# ---- our caster, and the copying of its images as a lower bound of time ----

AOVS = ("depth", "normal")  # of a film, unless others are asked for
CHANNELS = 4  # of these: depth and the three of a normal
BYTES_PER_CHANNEL = 4  # float32, as EXR stores them and the other contestants return them
WARM_UP_SIDE = 8  # pixels: enough to make everything that is made before rays are cast


class Ours:
    """options: culling, aovs, shadows; by default the planned culling, depth and normal, with shadows."""

    def __init__(self, work: Work) -> None:
        self.work = work
        self.aovs = tuple(work.options.get("aovs", AOVS))
        self.file = Path(work.folder) / SCENE_FILE

    def build(self, size: int) -> None:
        """A new scene, and an image of a few pixels; mesh files are read before."""
        import caster

        self.caster = caster
        scene: caster.Scene = pickle.loads(self.file.read_bytes())
        shadows = caster.Shading(shadows=self.work.options.get("shadows", True))
        self.scene = scene.with_film(width=size, height=size).model_copy(update={"shading": shadows})
        if self.work.workload in (NEAREST, ANY):
            self._cast(*FIRST_RAY)
        else:
            self._render(self.scene.with_film(width=WARM_UP_SIDE, height=WARM_UP_SIDE))

    def take_rays(self) -> None:
        if self.work.workload in (NEAREST, ANY):
            o, d = given_rays(self.work.folder, self.scene.film.width)
            self.o, self.d = o.astype(np.float64), d.astype(np.float64)

    def cast(self) -> int:
        if self.work.workload in (NEAREST, ANY):
            self._cast(self.o, self.d)
            return len(self.o)
        self._render(self.scene)
        return self.scene.film.width * self.scene.film.height

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        if self.work.workload == ANY:
            return blocked(self.caster.occluded(self.scene, o, d, SHADOW_END))
        return self.caster.cast(self.scene, o, d).t

    def _render(self, scene: caster.Scene) -> None:
        self.caster.render(
            scene, self.aovs, threads=self.work.threads, culling=self.work.options.get("culling"), dtype=np.float32
        )

    def _cast(self, o: np.ndarray, d: np.ndarray) -> None:
        if self.work.workload == ANY:
            self.caster.occluded(self.scene, o, d, SHADOW_END)
        else:
            hits = self.caster.cast(self.scene, o, d)
            hits.normal  # noqa: B018 - computed on access


class Candidate:
    """A ray caster from elsewhere that takes rays. options: text, precision and served, as of `parse_candidate`.

    And folder, where its module or program is.
    """

    def __init__(self, work: Work) -> None:
        from caster.description.errors import SceneError
        from mitsuba_ref.subjects.requests import parse_candidate

        if work.workload == ANY:
            raise CannotRun("a candidate gives nearest hits")
        options, self.work = work.options, work
        os.chdir(options["folder"])
        try:
            self.subject = parse_candidate(options["text"], options["precision"], served=options["served"])
        except SceneError as error:
            raise CannotRun(str(error)) from error

    def build(self, size: int) -> None:
        """The scene in the numbers that are traced, and one ray."""
        from mitsuba_ref.reference.shared_input import model_of, packed_float32
        from mitsuba_ref.subjects.subject import CastRequest

        scene: caster.Scene = pickle.loads((Path(self.work.folder) / SCENE_FILE).read_bytes())
        self.size, one = size, self._rays(*FIRST_RAY)
        model = model_of(scene, packed_float32(scene), one)
        folder = Path(self.work.folder) / f"candidate-{size}"
        self.request = CastRequest(scene.with_film(width=size, height=size), model, one, folder)
        self._answer(self.request)

    def take_rays(self) -> None:
        self.request = self.request.with_rays(self._rays(*given_rays(self.work.folder, self.size)))

    def cast(self) -> int:
        self._answer(self.request)
        return len(self.request.rays.t_max)

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        return self._answer(self.request.with_rays(self._rays(o, d))).t

    def _rays(self, o: np.ndarray, d: np.ndarray) -> SharedRays:
        from mitsuba_ref.reference.shared_input import SharedRays

        return SharedRays(o, d, np.full(len(o), np.inf, np.float32), np.zeros(len(o)))

    def _answer(self, request: CastRequest) -> Answer:
        from mitsuba_ref.subjects.subject import NoAnswer

        try:
            return self.subject.answer(request)
        except NoAnswer as error:
            raise CannotRun(str(error)) from error


class Copying:
    """Copies arrays as large as the images of depth and normal: the least time that writing them takes."""

    def __init__(self, work: Work) -> None:
        self.threads = work.threads
        self.pool = ThreadPoolExecutor(work.threads)

    def build(self, size: int) -> None:
        self.count = size * size
        self.source = np.ones(CHANNELS * self.count * BYTES_PER_CHANNEL, np.uint8)
        self.target = np.zeros_like(self.source)

    def take_rays(self) -> None:
        """There are none."""

    def cast(self) -> int:
        pairs = zip(*(np.array_split(a, self.threads) for a in (self.target, self.source)), strict=True)
        list(self.pool.map(lambda pair: np.copyto(*pair), pairs))
        return self.count

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """It has no t to be wrong about."""
        return np.full(len(o), np.nan)


# ---- scenes of Mitsuba ----

# Our AOVs by the names of its AOV integrator; `diffuse` is light, of an integrator within.
INTEGRATOR_AOVS = {
    "depth": "depth",
    "normal": "geo_normal",
    "shading_normal": "sh_normal",
    "position": "position",
    "uv": "uv",
    "albedo": "albedo",
    "prim_id": "prim_index",
    "shape_id": "shape_index",
}
LIT = "diffuse"
XML = Path(ROBUST) / "scene.xml"


def integrator_element(aovs: Sequence[str]) -> ElementTree.Element:
    """The AOV integrator for these, with `direct` inside for light: one sample of an emitter, none of a BSDF."""
    root = ElementTree.Element("integrator", type="aov")
    missing = [name for name in aovs if name not in INTEGRATOR_AOVS and name != LIT]
    if missing:
        raise CannotRun(f"the AOV integrator has no {missing[0]}")
    names = ",".join(f"{name}:{INTEGRATOR_AOVS[name]}" for name in aovs if name != LIT)
    ElementTree.SubElement(root, "string", name="aovs", value=names)
    if LIT in aovs:
        direct = ElementTree.SubElement(root, "integrator", type="direct", name="radiance")
        ElementTree.SubElement(direct, "integer", name="emitter_samples", value="1")
        ElementTree.SubElement(direct, "integer", name="bsdf_samples", value="0")
    return root


def sized(xml: Path, size: int, aovs: Sequence[str]) -> Path:
    """The same scene with a film of size x size and an integrator for these AOVs, in a file beside it."""
    tree = ElementTree.parse(xml)
    root = tree.getroot()
    for element in root.findall("./integrator"):
        root.remove(element)
    root.insert(0, integrator_element(aovs))
    for name in ("width", "height"):
        for element in tree.iterfind(f"./sensor/film/integer[@name='{name}']"):
            element.set("value", str(size))
    path = xml.with_name(f"scene-{size}-{'-'.join(aovs)}.xml")
    tree.write(path)
    return path


# ---- whole processes ----


class WholeProcess:
    """A command from its start to its end. options: program; of `mitsuba` a variant, of `validate` whether a store."""

    def __init__(self, work: Work) -> None:
        self.folder, self.options, self.aovs = Path(work.folder), work.options, work.options.get("aovs", AOVS)
        kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        store = str(self.folder / "store") if self.options.get("store") else "off"
        self.environment = kept | {"MITSUBA_REF_STORE": store}

    def build(self, size: int) -> None:
        """The scene as a file, and the command."""
        make = {"caster": self._caster, "mitsuba": self._mitsuba, "validate": self._validate}
        self.command, self.count = make[self.options["program"]](size)

    def _caster(self, size: int) -> tuple[list[str], int]:
        from caster.scene.export import to_toml

        scene = pickle.loads((self.folder / SCENE_FILE).read_bytes()).with_film(width=size, height=size)
        file = self.folder / "scene.toml"
        file.write_text(to_toml(scene, self.folder), encoding="utf-8")
        names = ["--aov", ",".join(self.aovs), "-o", str(self.folder / "ours.exr")]
        return [sys.executable, "-m", "caster", "render", str(file), *names], size * size

    def _mitsuba(self, size: int) -> tuple[list[str], int]:
        program = Path(sys.executable).with_name("mitsuba")
        if not program.exists():
            raise CannotRun(f"no command {program}")
        xml, out = sized(self.folder / XML, size, self.aovs), str(self.folder / "theirs.exr")
        return [str(program), "-m", self.options["variant"], str(xml), "-o", out], size * size

    def _validate(self, size: int) -> tuple[list[str], int]:
        folder = Path(__file__).parents[1] / "runner" / "builtin"
        scenes = len(list(folder.rglob("*.toml")))
        words = ["-m", "mitsuba_ref", "validate", "--builtin", "all", "--size", str(size), str(size)]
        return [sys.executable, *words], scenes * size * size

    def take_rays(self) -> None:
        """It makes its own."""

    def cast(self) -> int:
        done = subprocess.run(self.command, env=self.environment, capture_output=True, text=True, check=False)
        if done.returncode:
            last = (done.stderr.splitlines() or [""])[-1]
            raise CannotRun(f"{self.options['program']} ended with exit code {done.returncode}: {last}")
        return self.count

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Its image is a file."""
        return np.full(len(o), np.nan)

    def peak_memory(self) -> int:
        """Bytes, of the largest of its processes."""
        import resource  # POSIX alone

        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024


# ---- peers: embreex, trimesh and Open3D, each imported by its own class ----

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

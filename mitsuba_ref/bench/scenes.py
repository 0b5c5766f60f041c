"""Scenes of the benchmark, made of float32 numbers here, so that all contestants cast the same ones."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from caster.aovs import BY_NAME
from caster.cameras import Fisheye, Orthographic, Pinhole
from caster.description.errors import FileMissing, SceneError, suggestion
from caster.geometry.mesh_files import MESH_SUFFIXES
from caster.geometry.packing import Triangles
from caster.scene.files import load_scene
from caster.scene.model import Ambient, Diffuse, Point, Scene
from caster.shapes import Cylinder, Disk, MeshFile, Plane, Sphere, Teapot
from caster.shapes.heightfield import tessellate_heightfield
from caster.shapes.torus import tessellate_torus
from caster.system.atomic_files import write_bytes
from mitsuba_ref.bench.entries import ANY, AOVS, FILM, NEAREST, PROCESS, SHADING, VALIDATION
from mitsuba_ref.reference.shared_input import packed_float32, shared_rays
from mitsuba_ref.scene_xml.elements import ply_bytes
from mitsuba_ref.subjects.subject import scene_as_traced


def write_mesh(folder: Path, name: str, vertices: np.ndarray, faces: np.ndarray, **more: str) -> MeshFile:
    """A mesh as a PLY file, and the shape that reads it. vertices: (n, 3), rounded to float32 here; faces: (m, 3)."""
    corners = np.asarray(vertices, np.float32).astype(np.float64)
    flat = np.zeros(len(faces), bool)
    none, no_uv = np.zeros_like(corners), np.zeros((len(corners), 2))
    file = folder / f"{name}.ply"
    write_bytes(file, ply_bytes(Triangles(corners, np.asarray(faces, np.int32), none, no_uv, flat, flat)))
    return MeshFile(file=str(file), face_normals=True, **more)


def torus_mesh(folder: Path, segments: int, sides: int, **more: str) -> MeshFile:
    """A closed torus of 2 * segments * sides triangles: silhouettes, and surface behind surface."""
    mesh = tessellate_torus(1.0, 0.4, segments, sides)
    return write_mesh(folder, "ring", mesh.vertices, mesh.faces, **more)


def heightfield_mesh(folder: Path, triangles: int, **more: str) -> MeshFile:
    """About so many triangles of a hilly square of side 2."""
    resolution = max(1, round((triangles / 2) ** 0.5))
    mesh = tessellate_heightfield(2.0, resolution, 0.2, 8, 0)
    return write_mesh(folder, "hills", mesh.vertices, mesh.faces, **more)


def layers_mesh(folder: Path, count: int) -> MeshFile:
    """Squares behind each other, in an order drawn by chance: every ray crosses all of them."""
    order = np.random.default_rng(0).permutation(count)
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    vertices = np.concatenate([corners - [0.0, 0.0, place / 64.0] for place in order])
    return write_mesh(folder, "layers", vertices, quads(4 * np.arange(count)[:, None] + np.arange(4)))


def square_mesh(folder: Path, half: float) -> MeshFile:
    """Two triangles in the plane z = 0."""
    vertices = half * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return write_mesh(folder, "square", vertices, quads(np.arange(4)[None]))


def quads(corners: np.ndarray) -> np.ndarray:
    """(n, 4) corners around -> (2 n, 3) triangles."""
    return np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


# Corners as Cornell University published them, in millimetres; x, y, z of each quad in turn.
CORNELL_WALLS = (
    ((552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)),
    ((556, 548.8, 0), (556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0)),
    ((549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2)),
    ((0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2)),
    ((552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0)),
)
CORNELL_BLOCKS = (  # height; x and z around the top
    (165.0, ((130, 65), (82, 225), (240, 272), (290, 114))),
    (330.0, ((423, 247), (265, 296), (314, 456), (472, 406))),
)


def cornell_mesh(folder: Path) -> MeshFile:
    """Walls and blocks as one mesh."""
    every = [np.array(wall, np.float64) for wall in CORNELL_WALLS]
    for height, top in CORNELL_BLOCKS:
        above = np.array([(x, height, z) for x, z in top])
        below = above * [1.0, 0.0, 1.0]
        every.append(above)
        for i in range(4):
            j = (i + 1) % 4
            every.append(np.stack([below[i], below[j], above[j], above[i]]))
    vertices = np.concatenate(every)
    return write_mesh(folder, "cornell", vertices, quads(np.arange(len(vertices)).reshape(-1, 4)))


Rays = tuple[np.ndarray, np.ndarray]  # o, d: (n, 3) float32 each


@dataclass(frozen=True)
class BenchScene:
    """One scene of the benchmark.

    workload: FILM an image of `aovs`; NEAREST t and normal along rays that are handed over; ANY whether something lies
    on them; SHADING a shaded image, by our caster alone; PROCESS an image into a file, by a whole process; VALIDATION
    the scenes that are installed, judged.
    """

    name: str
    title: str
    make: Callable[[Path], Scene]  # writes its meshes into the folder
    workload: str = FILM
    rays: Callable[[Scene], Rays] | None = None  # None: the camera's
    aovs: tuple[str, ...] = AOVS
    side: int = 0  # pixels a side, where the run's are more; 0: those of the run
    turns: int = 0  # alternations, where the run's are more; 0: those of the run


def scene_from_front(*shapes: Any, **more: Any) -> Scene:
    """A scene seen from the front, somewhat above; its film gets a size later."""
    camera = Pinhole(eye=(0.0, -4.0, 1.5), look_at=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), fov=40.0)
    return Scene(**({"camera": camera, "shapes": shapes} | more))


def spheres(count: int) -> Scene:
    """Random spheres in a cube; together they cover most of the view."""
    rng = np.random.default_rng(count)
    centers = as_float32(rng.uniform(-1.0, 1.0, (count, 3)))
    radii = as_float32(rng.uniform(0.3, 1.0, count) * 0.8 * count ** (-1.0 / 3.0))
    pairs = zip(centers.tolist(), radii.tolist(), strict=True)
    return scene_from_front(*(Sphere(center=center, radius=radius) for center, radius in pairs))


def as_float32(a: np.ndarray) -> np.ndarray:
    return a.astype(np.float32).astype(np.float64)


def one_sphere(folder: Path) -> Scene:
    return scene_from_front(Sphere(center=(0.0, 0.0, 0.0), radius=1.0))


def ring(folder: Path) -> Scene:
    return scene_from_front(torus_mesh(folder, 264, 133))


def hills(folder: Path) -> Scene:
    return scene_from_front(heightfield_mesh(folder, 1_000_000))


def layers(folder: Path) -> Scene:
    # Off the middle, or a pixel in a thousand would lie exactly on the diagonal of every square.
    camera = Pinhole(eye=(0.117, 0.053, 3.0), look_at=(0.031, 0.017, 0.0), up=(0.0, 1.0, 0.0), fov=20.0)
    return Scene(camera=camera, shapes=[layers_mesh(folder, 256)])


def cornell(folder: Path) -> Scene:
    camera = Pinhole(eye=(278.0, 273.0, -800.0), direction=(0.0, 0.0, 1.0), fov=39.307684)
    return Scene(camera=camera, shapes=[cornell_mesh(folder)])


def grazing(folder: Path) -> Scene:
    camera = Pinhole(eye=(0.0, -20.0, 0.01), direction=(0.0, 1.0, 0.0), up=(0.0, 0.0, 1.0), fov=40.0)
    return Scene(camera=camera, shapes=[square_mesh(folder, 1000.0)])


def orthographic(folder: Path) -> Scene:
    camera = Orthographic(eye=(0.0, -4.0, 1.5), look_at=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), width=3.0)
    return scene_from_front(torus_mesh(folder, 264, 133), camera=camera)


def fisheye(folder: Path) -> Scene:
    camera = Fisheye(eye=(0.0, -1.0, 0.2), look_at=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), fov=180.0)
    return scene_from_front(torus_mesh(folder, 264, 133), camera=camera)


LIT: dict[str, Any] = {
    "lights": [Point(position=(2.0, -3.0, 3.0), intensity=(40.0, 40.0, 40.0)), Ambient(radiance=(0.05, 0.05, 0.05))],
    "materials": {"grey": Diffuse(reflectance=(0.5, 0.5, 0.5))},
}


def lit_ring(folder: Path) -> Scene:
    return scene_from_front(torus_mesh(folder, 264, 133, material="grey"), **LIT)


def lit_spheres(folder: Path) -> Scene:
    lit = tuple(sphere.model_copy(update={"material": "grey"}) for sphere in spheres(200).shapes)
    return scene_from_front(*lit, **LIT)


def incoherent(scene: Scene) -> Rays:
    """From random points of a sphere around the scene to random points within: incoherent neighbours."""
    rng, count = np.random.default_rng(1), scene.film.width * scene.film.height
    o = 3.0 * unit(rng.normal(size=(count, 3)))
    return towards(o, rng.uniform(-1.0, 1.0, (count, 3)) * [1.4, 1.4, 0.4])


def shadow_rays_to_light(scene: Scene) -> Rays:
    """From points near the surface to one light; t = 1 is the light, so that t_max = 1 ends there."""
    rng, count = np.random.default_rng(2), scene.film.width * scene.film.height
    u, v = 2.0 * np.pi * rng.random((2, count))
    tube = 1.0 + 0.41 * np.cos(v)
    o = np.column_stack([tube * np.cos(u), tube * np.sin(u), 0.41 * np.sin(v)]).astype(np.float32)
    return o, np.subtract(np.array([2.0, -3.0, 3.0]), o.astype(np.float64)).astype(np.float32)


def towards(o: np.ndarray, p: np.ndarray) -> Rays:
    start = o.astype(np.float32)
    return start, unit(p - start.astype(np.float64)).astype(np.float32)


def unit(v: np.ndarray) -> np.ndarray:
    rows: np.ndarray = v / np.linalg.norm(v, axis=1, keepdims=True)
    return rows


def lit_teapot(folder: Path) -> Scene:
    """A smooth mesh of 6,320 triangles, lit."""
    return as_traced(scene_from_front(teapot(), **LIT), folder)


def teapot() -> Teapot:
    smaller = [{"scale": 0.45}, {"translate": (0.0, 0.0, -0.6)}]
    return Teapot(subdivisions=10, to_world=smaller, material="grey")


def several_kinds(folder: Path) -> Scene:
    """A teapot, forty spheres, cylinders and disks on a plane, lit."""
    rng = np.random.default_rng(4)
    around = [(1.7 * np.cos(a), 1.7 * np.sin(a), z) for a, z in zip(*rng.uniform(0, 6, (2, 40)), strict=True)]
    shapes: list[Any] = [teapot(), Plane(point=(0.0, 0.0, -0.6), normal=(0.0, 0.0, 1.0))]
    shapes += [Sphere(center=(x, y, 0.15 * z - 0.5), radius=0.08) for x, y, z in around]
    for x, y, z in around[:8]:
        shapes.append(Cylinder(p0=(0.6 * x, 0.6 * y, -0.6), p1=(0.6 * x, 0.6 * y, 0.1 * z), radius=0.05))
        shapes.append(Disk(to_world=[{"scale": 0.12}, {"translate": (0.8 * x, 0.8 * y, 0.1 * z)}]))
    lit = [shape.model_copy(update={"material": "grey"}) for shape in shapes]
    return as_traced(scene_from_front(*lit, **LIT), folder)


def as_traced(scene: Scene, folder: Path) -> Scene:
    return scene_as_traced(scene, packed_float32(scene), folder)


def teapot_as_described(folder: Path) -> Scene:
    return scene_from_front(teapot(), **LIT)


def rays_of(scene: BenchScene, sized: Scene) -> Rays:
    """What is handed to those who take rays, and in a scene of rays to everybody; one for each pixel."""
    if scene.rays:
        return scene.rays(sized)
    shared = shared_rays(sized)
    real = shared.t_max > 0.0  # a fisheye's image has corners without rays
    return shared.o[real], shared.d[real]


def scene_of_file(path: str, mesh_dirs: Sequence[str] = ()) -> BenchScene:
    """A scene or mesh file, in the float32 numbers that all contestants cast. Raises SceneError, FileMissing."""
    scene = load_scene(path, mesh_dirs)
    return BenchScene(Path(path).stem, path, lambda folder: as_traced(scene, folder))


# AOVs that an image is timed with, by what they add to the scene's name; `diffuse` has the scene's lights and shadows.
AOV_SETS = {"": AOVS, "smooth": (*AOVS, "shading_normal"), "lit": (*AOVS, "diffuse")}


def in_each_set(scene: BenchScene) -> Iterator[BenchScene]:
    """An image in each set of AOV_SETS."""
    for name, aovs in AOV_SETS.items():
        yield replace(scene, name=f"{scene.name}-{name}" if name else scene.name, aovs=aovs)


def with_aovs(scene: BenchScene, aovs: Sequence[str]) -> BenchScene:
    """The image in other AOVs. Raises SceneError for a name that is none."""
    for name in aovs:
        if name not in BY_NAME:
            hint = suggestion(name, BY_NAME)
            raise SceneError(f"--aov {name}: unknown{hint} (known: {', '.join(BY_NAME)})")
    names = tuple(aovs)
    return scene if names == AOVS else replace(scene, name=f"{scene.name}:{','.join(names)}", aovs=names)


MESHES_VARIABLE = "MITSUBA_REF_MESHES"  # a folder of mesh files


def scenes_of_meshes(folder: str) -> Iterator[BenchScene]:
    """An image of each mesh file of a folder, one of each name, in each set. Raises FileMissing, SceneError."""
    if not Path(folder).is_dir():
        raise FileMissing(f"{folder}: expected a folder of mesh files")
    files = sorted(path for path in Path(folder).iterdir() if path.suffix.lower() in MESH_SUFFIXES)
    for path in {path.stem: path for path in reversed(files)}.values():
        yield from in_each_set(replace(scene_of_file(str(path)), title=f"the mesh {path.name}"))


SCENES = (
    BenchScene("one-sphere", "one sphere", one_sphere),
    BenchScene("spheres-200", "200 spheres", lambda folder: spheres(200)),
    BenchScene("spheres-10k", "10,000 spheres", lambda folder: spheres(10_000)),
    BenchScene("mesh-70k", "a closed mesh of 70,224 triangles", ring),
    BenchScene("mesh-1m", "hills of 999,698 triangles", hills),
    BenchScene("overdraw-256", "256 squares behind each other", layers),
    BenchScene("cornell-box", "the Cornell box", cornell),
    BenchScene("grazing-plane", "a square of two triangles, seen at half a thousandth of a radian", grazing),
    BenchScene("orthographic", "the mesh of 70,224 triangles, parallel rays", orthographic),
    BenchScene("fisheye", "the mesh of 70,224 triangles, a fisheye of 180 degrees", fisheye),
    BenchScene("rays-coherent", "the camera's rays at the mesh of 70,224 triangles, handed over", ring, NEAREST),
    BenchScene("rays-incoherent", "rays in any order at the mesh of 70,224 triangles", ring, NEAREST, incoherent),
    BenchScene("rays-shadow", "whether anything lies between the mesh and a light", ring, ANY, shadow_rays_to_light),
    BenchScene("lit-mesh", "shading the mesh of 70,224 triangles by one point light", lit_ring, SHADING),
    BenchScene("lit-spheres", "shading 200 spheres by one point light", lit_spheres, SHADING),
    BenchScene("lit-teapot", "shading a smooth teapot of 6,320 triangles by one point light", lit_teapot, SHADING),
    *in_each_set(BenchScene("kinds", "a teapot, spheres, cylinders and disks on a plane", several_kinds)),
    BenchScene("process", "the teapot from a file to an EXR file", teapot_as_described, PROCESS),
    BenchScene("process-256", "the same in 256 x 256 pixels", teapot_as_described, PROCESS, side=256),
    BenchScene("validate", "the installed scenes judged", one_sphere, VALIDATION, side=256, turns=3),
)

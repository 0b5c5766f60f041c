"""Families of coincident surfaces, shadow rays that start on a surface, and watertight meshes."""

from collections.abc import Callable

import numpy as np

from caster.cameras import Pinhole
from caster.geometry.packing import Triangles
from caster.scene.model import Film, Scene
from caster.shapes import Icosphere, Sphere, Triangle
from mitsuba_ref.stress.family import (
    DEFAULT_CLOSED_RAYS,
    EYE_DISTANCE,
    CameraRays,
    Family,
    Rays,
    Rng,
    Setting,
    float32,
    hits_sphere,
    hits_triangles,
    icosphere_scene,
    part_of,
    random_directions,
    random_turn,
    rays_to_triangle,
    scene_of,
    select_rays,
    sphere_scene,
    towards,
    unit,
    unit_normal,
)

GAPS = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)


def coincident_triangles(rng: Rng, gap: float, count: int) -> Setting:
    """A large triangle and its copy, moved along the normal; the copy is in front for half of the rays."""
    corners = np.array([[1.0, 0.1, 0.2], [-0.6, 0.8, -0.3], [-0.4, -0.9, 0.1]]) + rng.normal(scale=0.1, size=(3, 3))
    n = unit_normal(corners)
    scene = scene_of(Triangle(vertices=corners), Triangle(vertices=corners + gap * n))

    def candidates(number: int) -> Rays:
        return rays_to_triangle(rng, corners, n, EYE_DISTANCE, number)

    parts = [part_of(scene, i) for i in (0, 1)]
    hits = hits_triangles(np.concatenate([part.vertices[part.faces] for part in parts]))
    return Setting(gap, scene, *select_rays(candidates, hits, count))


def coincident_spheres(rng: Rng, gap: float, count: int) -> Setting:
    """Two concentric spheres; the second is the larger one."""
    center = rng.normal(scale=0.3, size=3)
    scene = scene_of(Sphere(center=center, radius=1.0), Sphere(center=center, radius=1.0 + gap))

    def candidates(number: int) -> Rays:
        aim = center + 1.2 * np.sqrt(rng.random((number, 1))) * random_directions(rng, number)
        return towards(center + EYE_DISTANCE * random_directions(rng, number), aim)

    return Setting(gap, scene, *select_rays(candidates, hits_sphere(center, 1.0 + gap), count))


COINCIDENT_TRIANGLES = Family(
    "coincident-triangles",
    "how close two triangles lie to each other",
    "gap over size",
    GAPS,
    GAPS[-1],
    coincident_triangles,
)
COINCIDENT_SPHERES = Family(
    "coincident-spheres",
    "how close two concentric spheres lie to each other",
    "gap over radius",
    GAPS,
    GAPS[-1],
    coincident_spheres,
)


SHADOW_OFFSETS = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
SHADOW_ERROR = "error of t over radius"


def rays_leaving(rng: Rng, offset: float, scene: Scene, surface: tuple[np.ndarray, np.ndarray]) -> Setting:
    """Rays from p + offset n: half outwards, half inwards. surface = (p, n), (m, 3) each."""
    p, n = surface
    d = random_directions(rng, len(p))
    outwards = np.where(np.arange(len(p)) % 2 == 0, 1.0, -1.0)
    d *= (np.sign(np.einsum("ij,ij->i", d, n)) * outwards)[:, None]
    return Setting(offset, scene, float32(p + offset * n), float32(d), unit=1.0)


def leaving_sphere(rng: Rng, offset: float, count: int) -> Setting:
    scene = sphere_scene(1.0, rng.normal(scale=0.3, size=3))
    n = random_directions(rng, count)
    return rays_leaving(rng, offset, scene, (part_of(scene).center[0] + part_of(scene).radius[0] * n, n))


def leaving_mesh(rng: Rng, offset: float, count: int) -> Setting:
    scene = icosphere_scene(rng, 1.0, rng.normal(scale=0.3, size=3))
    part = part_of(scene)
    corners = part.vertices[part.faces[rng.integers(len(part.faces), size=count)]]
    p = np.einsum("ij,ijk->ik", rng.dirichlet(np.ones(3), count), corners)
    n = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    return rays_leaving(rng, offset, scene, (p, n))


SHADOW_SPHERE = Family(
    "shadow-sphere",
    "how far off a sphere the rays start that leave it",
    "offset of the start over radius",
    SHADOW_OFFSETS,
    SHADOW_OFFSETS[-1],
    leaving_sphere,
    error=SHADOW_ERROR,
)
SHADOW_MESH = Family(
    "shadow-mesh",
    "how far off a sphere of triangles the rays start that leave it",
    "offset of the start over radius",
    SHADOW_OFFSETS,
    SHADOW_OFFSETS[-1],
    leaving_mesh,
    error=SHADOW_ERROR,
)


SUBDIVISIONS = 4  # 5,120 faces
WATERTIGHT_OFFSETS = (0.0, 1e1, 1e3, 1e4, 1.5e5, 1e6)  # of the centre from the origin; the radius is 1
MAX_EYE_RADIUS = 0.5  # radii: how far from the centre rays start

# Six images of 90 degrees around each eye. Rasterization tries the half of all faces that is behind the eye at every
# pixel, so a finer film would only cost time.
CUBE_MAP_SIDE = 32  # pixels
CUBE_MAP_VIEWS = [(side * np.eye(3)[axis], np.eye(3)[axis - 1]) for axis in range(3) for side in (1.0, -1.0)]
POINTS_PER_EYE = 3 * len(CUBE_MAP_VIEWS) * CUBE_MAP_SIDE**2  # of those in one pixel, the first is kept

PointSampler = Callable[[Rng, Triangles, int], np.ndarray]


def points_on_edges(rng: Rng, part: Triangles, number: int) -> np.ndarray:
    """(number, 3) points between the ends of edges."""
    corners = part.vertices[part.faces[rng.integers(len(part.faces), size=number)]]
    return corners[:, 0] + rng.random((number, 1)) * (corners[:, 1] - corners[:, 0])


def mesh_vertices(rng: Rng, part: Triangles, number: int) -> np.ndarray:
    return part.vertices[rng.permutation(len(part.vertices))[:number]]


def watertight_setting(aim: PointSampler) -> Callable[[Rng, float, int], Setting]:
    def make(rng: Rng, offset: float, count: int) -> Setting:
        """`count` rays from as many eyes as that takes."""
        move = offset * random_directions(rng, 1)[0]
        scene = scene_of(
            Icosphere(subdivisions=SUBDIVISIONS, face_normals=True, to_world=[random_turn(rng), {"translate": move}])
        )
        part = part_of(scene)
        check_closed(part.faces)
        origins: list[np.ndarray] = []
        aimed: list[np.ndarray] = []
        found: list[CameraRays] = []
        done = 0
        while done < count:
            eye = float32(move + MAX_EYE_RADIUS * rng.random() * random_directions(rng, 1)[0])
            d, cameras = cube_map_rays(eye, directions_to(eye, aim(rng, part, POINTS_PER_EYE)), count - done)
            found += [each._replace(rays=each.rays + done) for each in cameras]
            origins.append(np.tile(eye, (len(d), 1)))
            aimed.append(d)
            done += len(d)
        return Setting(offset, scene, np.concatenate(origins), np.concatenate(aimed), camera_rays=found, closed=True)

    return make


def directions_to(eye: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(m, 3) float32 directions to p: every other one p - eye, which float32 often holds exactly, the rest unit."""
    d = p - eye.astype(np.float64)
    d[1::2] = unit(d[1::2])
    return float32(d)


def cube_map_rays(eye: np.ndarray, d: np.ndarray, limit: int) -> tuple[np.ndarray, list[CameraRays]]:
    """At most this many of the rays d (m, 3) from an eye, no two in one pixel, and the cube map's views of them."""
    film = Film(width=CUBE_MAP_SIDE, height=CUBE_MAP_SIDE)
    kept: list[np.ndarray] = []
    found: list[CameraRays] = []
    left = limit
    for direction, up in CUBE_MAP_VIEWS:
        camera = Pinhole(eye=tuple(map(float, eye)), direction=tuple(direction), up=tuple(up), fov=90.0)
        rows, pixels = project_to_pixels(camera, d.astype(np.float64))
        rows, pixels = rows[:left], pixels[:left]
        if len(rows):
            found.append(CameraRays(camera, film, limit - left + np.arange(len(rows)), pixels))
            kept.append(d[rows])
            left -= len(rows)
    return np.concatenate(kept), found


def project_to_pixels(camera: Pinhole, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rays within the image, no two through one pixel; their pixels)."""
    right, up, forward = camera.frame
    depth = d @ forward
    with np.errstate(all="ignore"):
        x = np.floor(0.5 * (1.0 + d @ right / depth) * CUBE_MAP_SIDE)
        y = np.floor(0.5 * (1.0 - d @ up / depth) * CUBE_MAP_SIDE)
    inside = np.flatnonzero((depth > 0.0) & (x >= 0.0) & (x < CUBE_MAP_SIDE) & (y >= 0.0) & (y < CUBE_MAP_SIDE))
    pixels, first = np.unique((y[inside] * CUBE_MAP_SIDE + x[inside]).astype(int), return_index=True)
    order = np.argsort(first)
    return inside[first[order]], pixels[order]


def check_closed(faces: np.ndarray) -> None:
    """Raise ValueError unless every edge occurs once in each direction: no ray from inside then leaves the mesh."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2).tolist()
    directed = {tuple(edge) for edge in ends}
    if len(directed) != len(ends) or any((b, a) not in directed for a, b in directed):
        raise ValueError("the mesh is not closed, so a ray may get out of it")


def watertight_family(name: str, aim: PointSampler) -> Family:
    return Family(
        f"watertight-{name}",
        f"rays from inside a closed mesh of 5,120 faces, aimed at its {name}",
        "offset from the origin over radius",
        WATERTIGHT_OFFSETS,
        WATERTIGHT_OFFSETS[0],
        watertight_setting(aim),
        misses=False,
        rays=DEFAULT_CLOSED_RAYS,
    )


WATERTIGHT_EDGES = watertight_family("edges", points_on_edges)
WATERTIGHT_VERTICES = watertight_family("vertices", mesh_vertices)

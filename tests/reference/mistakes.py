"""A small correct caster of spheres, planes and triangles in float64, and beginners' mistakes: one edit of it each."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from places import shipped

from caster.scene.model import Scene


class Caster:
    """trace(scene, o, d) -> (t, n); every method is a place for a mistake."""

    both_roots, determinant_epsilon, t_min = True, 0.0, 0.0

    def __call__(self, scene: Any, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.scene = scene
        o, d = self.rays(scene, o, d)
        t, n = np.full(len(o), np.inf), np.zeros((len(o), 3))
        for shape in scene.shapes:
            for found, normal in self.hits(shape, o, d):
                nearer = self.nearer(found, t)
                t[nearer], n[nearer] = found[nearer], np.broadcast_to(normal, n.shape)[nearer]
        return self.answer(scene, o, d, t, n)

    def rays(self, scene, o, d):
        return o, d

    def nearer(self, found, t):
        return found < t

    def answer(self, scene, o, d, t, n):
        return t, n

    def faces(self, shape, faces):
        return faces

    def hits(self, shape, o, d):
        if shape.type == "sphere":
            yield self.sphere(np.array(shape.center), shape.radius, o, d)
        elif shape.type == "plane":
            yield self.plane(np.array(shape.point), np.array(shape.normal), o, d)
        else:
            mesh = shape.mesh()
            for face in self.faces(shape, mesh.faces):
                yield self.triangle(*mesh.vertices[face], o, d)

    def sphere(self, center, radius, o, d):
        away = center - o
        dd = (d * d).sum(axis=1)
        middle = (away * d).sum(axis=1) / dd
        closest = middle[:, None] * d - away
        left = radius * radius - (closest * closest).sum(axis=1)
        half = np.sqrt(np.maximum(left, 0) / dd)
        t = self.root(middle - half, middle + half)
        t = np.where((left >= 0) & (t > self.t_min), t, np.inf)
        return t, (o + np.where(np.isfinite(t), t, 0.0)[:, None] * d - center) / radius

    def root(self, near, far):
        return np.where(near > self.t_min, near, far) if self.both_roots else near

    def plane(self, point, normal, o, d):
        with np.errstate(all="ignore"):
            t = ((point - o) @ normal) / (d @ normal)
        return np.where(t > self.t_min, t, np.inf), normal

    def triangle(self, a, b, c, o, d):
        n = np.cross(b - a, c - a)
        pairs = (((c - o), (b - o)), ((a - o), (c - o)), ((b - o), (a - o)))
        edges = np.stack([(d * np.cross(p - q, p + q)).sum(axis=1) for p, q in pairs])
        with np.errstate(all="ignore"):
            t = ((a - o) @ n) / (d @ n)
        inside = self.inside(edges) & (t > self.t_min) & self.seen(d @ n) & self.thick(a, b, c)
        return np.where(inside, t, np.inf), n

    def inside(self, edges):
        return (edges >= 0).all(axis=0) | (edges <= 0).all(axis=0)

    def seen(self, determinant):
        return np.abs(determinant) > self.determinant_epsilon

    def thick(self, a, b, c):
        return True


@dataclass(frozen=True)
class Mistake:
    """A caster with one mistake, the scene that shows it, and words of the cause."""

    name: str
    trace: Any
    scene: str
    says: str


def edited(**methods: Any) -> Caster:
    """The caster with some methods, or constants, replaced."""
    return type("Edited", (Caster,), methods)()


def answering(change: Any) -> Caster:
    """change(scene, o, d, t, n) -> (t, n) of a right answer."""
    return edited(answer=lambda self, *given: change(*given))


def casting(change: Any) -> Caster:
    """change(scene, o, d) -> the rays that are cast in their place."""
    return edited(rays=lambda self, *given: change(*given))


def without_far_hits(scene: Scene, o: np.ndarray, d: np.ndarray, t: np.ndarray, n: np.ndarray) -> Any:
    """Only hits nearer than 1."""
    return np.where(t * length(d) > 1.0, np.inf, t), n


def in_order(change: Any) -> Caster:
    """change of an image (height, width, ...)."""

    def answer(scene, o, d, t, n):
        h, w = scene.film.height, scene.film.width
        return change(t.reshape(h, w)).reshape(-1).copy(), change(n.reshape(h, w, 3)).reshape(-1, 3).copy()

    return answering(answer)


def length(v: np.ndarray) -> np.ndarray:
    return np.sqrt((v * v).sum(axis=1))


def camera_z(scene, o, d, t, n):
    from mitsuba_ref.cameras.camera_reference import camera_axes

    return t * (d @ camera_axes(scene.camera)[2]) / length(d), n


def camera_normals(scene, o, d, t, n):
    from mitsuba_ref.cameras.camera_reference import camera_axes

    return t, n @ np.asarray(camera_axes(scene.camera)).T


def interpolated(scene, o, d, t, n):
    import caster

    return t, caster.cast(scene, o, d).shading_normal


def in_float32(scene, o, d, t, n):
    return t.astype(np.float32).astype(np.float64), n


def from_points(scene, o, d, t, n):
    p = o + np.where(np.isinf(t), 0.0, t)[:, None] * d
    return np.where(np.isinf(t), t, ((p - o) * d).sum(axis=1) / (d * d).sum(axis=1)), n


def moved_along_normals(scene, o, d, t, n):
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(t), t, t + 1e-3 * length(n) / (n * d).sum(axis=1)), n


def numbers_from_one(scene, o, d, t, n):
    import caster

    hits = caster.cast(scene, o, d)
    first = np.cumsum([0, *(len(shape.mesh().faces) for shape in scene.shapes)])
    return t, n, np.where(np.isinf(t), -1, first[hits.shape_id] + hits.prim_id + 1)


def turned_at_some_faces(scene, o, d, t, n):
    import caster

    return t, np.where((caster.cast(scene, o, d).prim_id % 10 == 7)[:, None], -n, n)


def facing(scene, o, d, t, n):
    return t, np.where(((n * d).sum(axis=1) > 0)[:, None], -n, n)


def mirrored(v, axis):
    return v * np.where(np.arange(3) == axis, -1.0, 1.0)


def scene_of(name: str, folder: Path, width: int = 24, height: int = 18) -> Scene:
    """A shipped scene, or one of these, with a small film. folder: for files of meshes."""
    if name not in MADE:
        return shipped(name, width, height)
    camera = {"type": "pinhole", "eye": (0.3, 0.2, 5.0), "look_at": (0, 0, 0), "fov": 40}
    if name == "from above":
        camera = {"type": "orthographic", "eye": (0.3, 0.2, 5.0), "direction": (0, 0, -1), "width": 1}
    files = (folder / f"{name}-{i}.obj" for i in range(9))
    if name == "sphere around":
        camera = {"type": "fisheye", "eye": (0.3, 0.2, 0.5), "look_at": (0, 0, -9), "fov": 160}
    if name.startswith("far"):
        camera |= {"eye": (4096.3, 0.2, 5.0), "look_at": (4096, 0, 0), "fov": 40 if name == "far away" else 20}
    shapes = [mesh_file(next(files), *s) if isinstance(s, tuple) else s for s in MADE[name]]
    return Scene(film={"width": width, "height": height}, camera=camera, shapes=shapes)


def mesh_file(path: Path, vertices: Any, faces: Any) -> dict[str, Any]:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")
    return {"type": "mesh", "file": str(path)}


def grid(z: Any, size: int = 8, x: float = 0.0) -> tuple[Any, Any]:
    """A mesh of squares over [-1.5, 1.5]^2 with heights z(x, y), moved along x."""
    at = np.linspace(-1.5, 1.5, size + 1)
    vertices = [(float(x + across), float(y), float(z(across, y))) for y in at for across in at]
    faces = []
    for j in range(size):
        for i in range(size):
            a = j * (size + 1) + i
            faces += [(a, a + 1, a + size + 2), (a, a + size + 2, a + size + 1)]
    return vertices, faces


PLACES = [(0.3 * x, 0.4 * y) for x in range(-2, 3) for y in range(-2, 3)]
CORNERS = ((-1, -1), (1, -1), (0, 1))
MADE = {
    "layers": [{"type": "sphere", "center": (0.2 * i, 0, -i), "radius": 1.0} for i in range(3)],
    "shuffled layers": [{"type": "sphere", "center": (0.2 * i, 0, -i), "radius": 1.0} for i in (0, 2, 1)],
    "sphere around": [{"type": "sphere", "radius": 3.0}],
    "one-triangle": [([(-1, -1, 0), (1, -1, 0.2), (0, 1, 0.1)], [(0, 1, 2)])],
    "far away": [grid(lambda x, y: 0.3 * x * y + 0.1, x=4096.0)],
    "far wall": [grid(lambda x, y: 0.3 * x * y + 0.1, x=4096.0)],
    "from above": [grid(lambda x, y: 0.1 * x * y)],
    "pile": [([(x + a, y + b, 0) for x, y in PLACES for a, b in CORNERS], np.arange(3 * len(PLACES)).reshape(-1, 3))],
    "mixed": [grid(lambda x, y: max(0.0, 0.3 * x)), grid(lambda x, y: 0.1 * x * y - 0.7)],
}


def normals_from_the_origin(scene, o, d, t, n):
    """As Pluecker tests do: the corners of a face minus o, in float32, and the normal from these."""
    import caster

    hits = caster.cast(scene, o, d)
    with np.errstate(invalid="ignore"):
        corners = np.stack([corners_of(scene)[s][p] for s, p in zip(hits.shape_id, hits.prim_id, strict=True)])
        seen = corners.astype(np.float32) - o.astype(np.float32)[:, None]
        n = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    n[np.isinf(t)] = 0.0
    return t.astype(np.float32), n


def larger(*corners):
    """About the centre of a triangle."""
    return [sum(corners) / 3.0 + 1.05 * (corner - sum(corners) / 3.0) for corner in corners]


def corners_of(scene):
    meshes = [shape.mesh() for shape in scene.shapes]
    return [mesh.vertices[mesh.faces] for mesh in meshes]


FACES, SPHERE = "cornell-box", "one-sphere"
MISTAKES = [
    Mistake("t is a distance", answering(lambda s, o, d, t, n: (t * length(d), n)), FACES, "distance in place of t"),
    Mistake("d normalised", casting(lambda s, o, d: (o, d / length(d)[:, None])), SPHERE, "distance in place of t"),
    Mistake("z depth", answering(camera_z), SPHERE, "depth along z, the view axis"),
    Mistake("1 / t", answering(lambda s, o, d, t, n: (1.0 / t, n)), FACES, "1 / t in place of t"),
    Mistake("float32 inside", answering(in_float32), FACES, "computed in float32"),
    Mistake(
        "misses are 0",
        answering(lambda s, o, d, t, n: (np.where(np.isinf(t), 0.0, t), n)),
        SPHERE,
        "t is 0 where nothing",
    ),
    Mistake("mirrored", in_order(lambda a: a[:, ::-1]), FACES, "the image is mirrored"),
    Mistake("upside down", in_order(lambda a: a[::-1]), FACES, "the image is upside down"),
    Mistake("turned by half", in_order(lambda a: a[::-1, ::-1]), FACES, "the image is turned by half a turn"),
    Mistake("columns first", in_order(lambda a: np.swapaxes(a, 0, 1)), FACES, "the image is transposed"),
    Mistake("d reversed", casting(lambda s, o, d: (o, -d)), "inside-sphere", "the directions are reversed"),
    Mistake("x of d turned", casting(lambda s, o, d: (o, mirrored(d, 0))), "inside-sphere", "the x axis of directions"),
    Mistake(
        "left handed", casting(lambda s, o, d: (mirrored(o, 2), mirrored(d, 2))), "inside-sphere", "another handedness"
    ),
    Mistake("origin forgotten", casting(lambda s, o, d: (0 * o, d)), "inside-sphere", "taken for (0, 0, 0)"),
    Mistake("far root", edited(root=lambda self, near, far: far), SPHERE, "another root of the surface"),
    Mistake("inside missed", edited(both_roots=False), "inside-sphere", "the surface's first root is behind"),
    Mistake(
        "last one wins",
        edited(nearer=lambda self, f, t: np.isfinite(f) & ~(f < np.where(np.isinf(t), 0, t))),
        "layers",
        "the last surface in the order of the scene",
    ),
    Mistake(
        "farthest hit",
        edited(nearer=lambda self, f, t: np.isfinite(f) & ~(f <= np.where(np.isinf(t), 0, t))),
        "shuffled layers",
        "the last surface along the ray",
    ),
    Mistake("back faces culled", edited(seen=lambda self, det: det < 0), "triangles", "back faces are culled"),
    Mistake("front faces culled", edited(seen=lambda self, det: det > 0), FACES, "front faces are culled"),
    Mistake("normal turned", answering(lambda s, o, d, t, n: (t, -n)), FACES, "the normal is turned round"),
    Mistake("normal to the ray", answering(facing), "inside-sphere", "turned towards the ray"),
    Mistake("normals interpolated", answering(interpolated), "torus-smooth", "the interpolated normal"),
    Mistake("normal's x", answering(lambda s, o, d, t, n: (t, mirrored(n, 0))), SPHERE, "(-x, y, z) in place of"),
    Mistake("camera's normals", answering(camera_normals), SPHERE, "in the camera's axes"),
    Mistake(
        "normals as colours",
        answering(lambda s, o, d, t, n: (t, 0.5 * n / np.maximum(length(n), 1e-9)[:, None] + 0.5)),
        SPHERE,
        "stored as a colour",
    ),
    Mistake(
        "position for normal",
        answering(lambda s, o, d, t, n: (t, o + np.where(np.isinf(t), 0, t)[:, None] * d)),
        SPHERE,
        "the position in place of the normal",
    ),
    Mistake(
        "normals from the origin",
        answering(normals_from_the_origin),
        "torus-smooth",
        "computed from corners minus the ray's origin",
    ),
    Mistake(
        "one normal", answering(lambda s, o, d, t, n: (t, 0 * n + [0.36, 0.48, 0.8])), SPHERE, "one normal everywhere"
    ),
    Mistake(
        "float32 normals",
        answering(lambda s, o, d, t, n: (t, n.astype(np.float32).astype(np.float64))),
        SPHERE,
        "computed in float32",
    ),
    Mistake("t of points", answering(from_points), "far away", "t is computed from absolute coordinates"),
    Mistake(
        "a few t of fewer digits",
        answering(lambda s, o, d, t, n: (np.where(np.arange(len(t)) % 397 == 7, t * (1.0 + 1e-13), t), n)),
        "far wall",
        "  t is off: behind what is hit, by 1e-13 of itself",
    ),
    Mistake(
        "some normals turned",
        answering(turned_at_some_faces),
        "torus-smooth",
        "the primitive's number in its shape is 7 modulo 10",
    ),
    Mistake(
        "a moved plane", answering(moved_along_normals), "one-triangle", "  t is off: before what is hit, by 0.0002"
    ),
    Mistake("moved surfaces", answering(moved_along_normals), "torus-smooth", "moved along its normal by 0.001"),
    Mistake(
        "misses are NaN where no ray misses",
        answering(lambda s, o, d, t, n: (np.where(np.isinf(t), np.nan, t), n)),
        "far wall",
        "ray_conventions: t is nan where nothing is hit; a miss has t inf",
    ),
    Mistake(
        "numbers from 1", answering(numbers_from_one), FACES, "the primitive's number in the scene is off by one (+1)"
    ),
    Mistake(
        "triangles too large",
        edited(triangle=lambda self, *given: Caster.triangle(self, *larger(*given[:3]), *given[3:])),
        "pile",
        "beyond the outline of a triangle",
    ),
    Mistake(
        "hits and misses exchanged",
        answering(lambda s, o, d, t, n: (np.where(np.isinf(t), 1.0, np.inf), np.ones_like(n))),
        "pile",
        "  missed; exact arithmetic hits",
    ),
    Mistake("everything missed", answering(lambda s, o, d, t, n: (t + np.inf, n)), SPHERE, "misses everything"),
]

# Defects of some pixels: one quantity separates wrong from right ones.
DEFECTS = [
    Mistake(
        "determinant epsilon",
        edited(determinant_epsilon=2e-3),
        "torus-smooth",
        "the determinant |d . (e1 x e2)| is below",
    ),
    Mistake(
        "flat boxes",
        edited(thick=lambda self, *abc: (np.ptp(abc, axis=0) > 0).all()),
        "mixed",
        "the box of the primitive is flat",
    ),
    Mistake(
        "one face lost",
        edited(faces=lambda self, s, f: f[1:] if s is self.scene.shapes[0] else f),
        FACES,
        ", prim 0, is hit: ",
    ),
    Mistake(
        "some of fewer rays than pixels lost",
        answering(lambda s, o, d, t, n: (np.where(np.arange(len(t)) % 5 == 3, np.inf, t), n)),
        "sphere around",
        "where the ray's number is 3 modulo 5",
    ),
    Mistake("epsilon too large", edited(determinant_epsilon=5.0), "torus-smooth", "hit with d scaled by 2^40"),
    Mistake("one side hit", edited(seen=lambda self, det: det > 0), "one-triangle", "hit from the other side"),
    Mistake("near hits lost", edited(t_min=20.0), "torus-smooth", "hit from 1000 times as far"),
    Mistake("far hits lost", answering(without_far_hits), "torus-smooth", "hit from 1000 times as near"),
    Mistake(
        "d along an axis",
        answering(lambda s, o, d, t, n: (np.where((d == 0.0).any(axis=1), np.inf, t), n)),
        "from above",
        "hit with d turned by 20 degrees",
    ),
    Mistake(
        "too many rays",
        answering(lambda s, o, d, t, n: (np.where(len(t) > 100, np.inf, t), n)),
        "torus-smooth",
        "does the number of rays matter? The same rays hit alone",
    ),
    Mistake("absolute t_min", edited(t_min=3.2), SPHERE, "t is below 3.2"),
    Mistake(
        "last triangles left out", edited(faces=lambda self, s, f: f[:2000]), "torus-smooth", "number of the primitive"
    ),
    Mistake(
        "no third edge",
        edited(inside=lambda self, e: (e[:2] >= 0).all(axis=0) | (e[:2] <= 0).all(axis=0)),
        "one-triangle",
        "beyond the outline of a triangle",
    ),
]

"""Watertightness: rays from inside a closed mesh, aimed at its edges and at its vertices. Every miss is a leak."""

from collections.abc import Callable

import numpy as np

from caster.cameras import Pinhole
from caster.packing import Triangles
from caster.scene import Film
from caster.shapes import Icosphere
from mitsuba_ref.stress.aiming import directions, float32, part_of, scene_of, turn, unit
from mitsuba_ref.stress.family import CLOSED_RAYS, Family, Rng, Setting, Shot

SUBDIVISIONS = 4  # 5,120 faces
OFFSETS = (0.0, 1e1, 1e3, 1e4, 1.5e5, 1e6)  # of the middle from the origin; the radius is 1
INSIDE = 0.5  # radii: how far from the middle rays start

# Six pictures of 90 degrees around each eye. The screen tries the half of all faces that is behind the eye at every
# pixel, so a finer film would only cost time.
SIDE = 32  # pixels
LOOKS = [(side * np.eye(3)[axis], np.eye(3)[axis - 1]) for axis in range(3) for side in (1.0, -1.0)]
TRIED = 3 * len(LOOKS) * SIDE**2  # points that an eye aims at; of those in one pixel, the first is kept

Aim = Callable[[Rng, Triangles, int], np.ndarray]


def at_edges(rng: Rng, part: Triangles, many: int) -> np.ndarray:
    """(many, 3) points between the ends of edges."""
    corners = part.vertices[part.faces[rng.integers(len(part.faces), size=many)]]
    return corners[:, 0] + rng.random((many, 1)) * (corners[:, 1] - corners[:, 0])


def at_vertices(rng: Rng, part: Triangles, many: int) -> np.ndarray:
    return part.vertices[rng.permutation(len(part.vertices))[:many]]


def maker(aim: Aim) -> Callable[[Rng, float, int], Setting]:
    def make(rng: Rng, offset: float, count: int) -> Setting:
        """`count` rays from as many eyes as it takes."""
        move = offset * directions(rng, 1)[0]
        scene = scene_of(
            Icosphere(subdivisions=SUBDIVISIONS, face_normals=True, to_world=[turn(rng), {"translate": move}])
        )
        part = part_of(scene)
        check_closed(part.faces)
        origins: list[np.ndarray] = []
        aimed: list[np.ndarray] = []
        shots: list[Shot] = []
        done = 0
        while done < count:
            eye = float32(move + INSIDE * rng.random() * directions(rng, 1)[0])
            d, cameras = looked_around(eye, aimed_at(eye, aim(rng, part, TRIED)), count - done)
            shots += [shot._replace(rays=shot.rays + done) for shot in cameras]
            origins.append(np.tile(eye, (len(d), 1)))
            aimed.append(d)
            done += len(d)
        return Setting(
            offset, scene, np.concatenate(origins), np.concatenate(aimed), shots=shots, closed=True
        )

    return make


def aimed_at(eye: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(m, 3) float32 directions to p: every other one p - eye, which float32 often holds exactly, the rest unit."""
    d = p - eye.astype(np.float64)
    d[1::2] = unit(d[1::2])
    return float32(d)


def looked_around(eye: np.ndarray, d: np.ndarray, most: int) -> tuple[np.ndarray, list[Shot]]:
    """At most so many of the rays d (m, 3) from an eye, no two in one pixel, and the pictures that hold them."""
    film = Film(width=SIDE, height=SIDE)
    kept: list[np.ndarray] = []
    shots: list[Shot] = []
    left = most
    for look, up in LOOKS:
        camera = Pinhole(eye=tuple(map(float, eye)), direction=tuple(look), up=tuple(up), fov=90.0)
        rows, pixels = in_picture(camera, d.astype(np.float64))
        rows, pixels = rows[:left], pixels[:left]
        if len(rows):
            shots.append(Shot(camera, film, most - left + np.arange(len(rows)), pixels))
            kept.append(d[rows])
            left -= len(rows)
    return np.concatenate(kept), shots


def in_picture(camera: Pinhole, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(which rays go through the picture, no two through one pixel; their pixels)."""
    right, up, forward = camera.frame
    depth = d @ forward
    with np.errstate(all="ignore"):
        x = np.floor(0.5 * (1.0 + d @ right / depth) * SIDE)
        y = np.floor(0.5 * (1.0 - d @ up / depth) * SIDE)
    seen = np.flatnonzero((depth > 0.0) & (x >= 0.0) & (x < SIDE) & (y >= 0.0) & (y < SIDE))
    pixels, first = np.unique((y[seen] * SIDE + x[seen]).astype(int), return_index=True)
    order = np.argsort(first)
    return seen[first[order]], pixels[order]


def check_closed(faces: np.ndarray) -> None:
    """Every edge is run along once in each direction; raises ValueError otherwise. From inside, no ray gets out."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2).tolist()
    ways = {tuple(edge) for edge in ends}
    if len(ways) != len(ends) or any((b, a) not in ways for a, b in ways):
        raise ValueError("the mesh is not closed, so a ray may get out of it")


def watertight(name: str, aimed_at: str, aim: Aim) -> Family:
    return Family(
        f"watertight-{name}",
        f"rays from inside a closed mesh of 5,120 faces, aimed at its {aimed_at}",
        "offset from the origin over radius",
        OFFSETS,
        OFFSETS[0],
        maker(aim),
        misses=False,
        rays=CLOSED_RAYS,
    )


EDGES = watertight("edges", "edges", at_edges)
VERTICES = watertight("vertices", "vertices", at_vertices)

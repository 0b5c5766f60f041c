"""Cases 38 and 77: meshes with corners that are nowhere or too far out, and meshes of random bits."""

from collections.abc import Iterator

import numpy as np
from aimed_rays import direction

from cases import integer_shapes
from cases.case import FLOAT64, Case, Maker, Question
from cases.shapes import mesh_of
from caster import cast
from caster.geometry.packing import rejected_faces

TOO_LARGE = 1.844e18  # Embree's limit, which is ours: such a face is left out
BAD = (np.nan, np.inf, -np.inf, TOO_LARGE, -1e19, 1e30)
MESHES, FACES_EACH, RAYS_EACH = 150, 64, 100
SHARE_CHECKED = (
    10  # of a garbage mesh's rays, one in so many goes to the oracle; all are held to the faces that are left
)
SEPARATE = np.arange(3 * FACES_EACH).reshape(-1, 3)


def spoilt_balls(make: Maker) -> Iterator[tuple[str, np.ndarray, np.ndarray, int]]:
    """(name, vertices, faces, the bad corner): a closed mesh with one bad coordinate."""
    for bad in BAD:
        for axis in range(3):
            vertices, faces = integer_shapes.coarse_ball(make.rng, 1)
            vertices = vertices * integer_shapes.UNIT / 64.0
            corner = int(make.rng.integers(len(vertices)))
            vertices[corner, axis] = bad
            yield f"{bad:g} in a corner, axis {axis}", vertices, faces, corner


def bad_corners(make: Maker) -> Iterator[Question]:
    """Its faces are left out, those beside them are not: through the hole the far side is seen."""
    for name, vertices, faces, corner in spoilt_balls(make):
        scene = make.scene([mesh_of(vertices, faces)])
        o = make.rounded(3.0 * direction(make.rng, make.count(15)))
        yield make.ask(f"{name}, anywhere", scene, o, 0.3 * direction(make.rng, len(o)) - o, hit=8)
        around = np.setdiff1d(faces[(faces == corner).any(axis=1)], [corner])
        hole = vertices[around].mean(axis=0)
        o = make.rounded(hole * 3.0 + 0.1 * direction(make.rng, 6))
        yield make.ask(f"{name}, at the hole", scene, o, hole - o)


def usable(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(n,) bool."""
    with np.errstate(invalid="ignore"):
        kept: np.ndarray = (np.abs(vertices) < TOO_LARGE).all(axis=1)[faces].all(axis=1)
    return kept


def same_without(vertices: np.ndarray, faces: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[int, int]:
    """Bit for bit as if the bad faces were not in the file, and they are counted; (hits, faces left out)."""
    make, kept = Maker(77, FLOAT64), usable(vertices, faces)
    scene = make.scene([mesh_of(vertices, faces)])
    clean = make.scene([mesh_of(vertices[faces[kept]].reshape(-1, 3), np.arange(3 * kept.sum()).reshape(-1, 3))])
    found, wanted = cast(scene, o, d), cast(clean, o, d)
    hit = wanted.prim_id >= 0
    number = np.flatnonzero(kept)
    assert found.t.tobytes() == wanted.t.tobytes()
    assert np.array_equal(found.prim_id[hit], number[wanted.prim_id[hit]]) and (found.prim_id[~hit] == -1).all()
    assert np.isfinite(found.surface.n).all() and np.array_equal(found.surface.n, wanted.surface.n)
    counted = rejected_faces(scene).get("shape-0")
    bad = int((~kept).sum())
    assert (0 if counted is None else counted.not_finite + counted.too_large) == bad
    return int(hit.sum()), bad


def neighbours() -> int:
    make, faces_left, hits = Maker(38, FLOAT64), 0, 0
    for _, vertices, faces, _ in spoilt_balls(make):
        o = 3.0 * direction(make.rng, 100)
        hit, left = same_without(vertices, faces, o, 0.3 * direction(make.rng, 100) - o)
        assert left in (5, 6) and hit > 80
        hits, faces_left = hits + hit, faces_left + left
    return hits


def random_mesh(rng: np.random.Generator) -> np.ndarray:
    """Corners (192, 3) of faces of which about half have coordinates of random bits."""
    bits = rng.integers(0, 2**32, (3 * FACES_EACH, 3), np.uint32).view(np.float32)
    good = rng.normal(size=(3 * FACES_EACH, 3)).astype(np.float32)
    wild = np.repeat(rng.random(FACES_EACH) < 0.5, 3)[:, None]
    with np.errstate(invalid="ignore"):
        return np.where(wild, bits, good).astype(np.float64)


def rays_into(make: Maker, count: int) -> tuple[np.ndarray, np.ndarray]:
    o = make.rounded(3.0 * direction(make.rng, count))
    return o, make.rng.normal(size=(count, 3)) - o


def random_meshes(make: Maker) -> Iterator[Question]:
    for i in range(MESHES // 5):
        scene = make.scene([mesh_of(random_mesh(make.rng), SEPARATE)])
        yield make.ask(f"mesh {i}", scene, *rays_into(make, make.count(RAYS_EACH // SHARE_CHECKED)), hit=2)


def as_if_they_were_not_there() -> int:
    make, hits, left = Maker(77, FLOAT64), 0, 0
    for _ in range(MESHES):
        counts = same_without(random_mesh(make.rng), SEPARATE, *rays_into(make, RAYS_EACH))
        hits, left = hits + counts[0], left + counts[1]
    assert left > MESHES * FACES_EACH / 4
    return hits


LEFT_OUT = "faces at that corner are left out and counted; all others are there, bit for bit as without them"
CASES = (
    Case(38, "NaN, inf or 1.844e18 in one corner", LEFT_OUT, bad_corners, {"hits": neighbours}),
    Case(
        77,
        "meshes of garbage: half of the faces of random bits",
        "faces with a corner that is not finite, or from 1.844e18 on, are left out and counted; the rest is as without",
        random_meshes,
        {"hits": as_if_they_were_not_there},
    ),
)

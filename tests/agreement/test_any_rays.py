"""BVH traversal gives the hits of brute force, for random and adversarial rays."""

import numpy as np
import pytest
from hard_rays import FAMILIES, hard_rays
from places import scene_of
from random_scenes import KINDS, name, random_scene
from same_bits import assert_same_bits
from triangle_soup import triangle_soup

from caster.cameras import Pinhole
from caster.description.errors import SceneError
from caster.geometry.packing import Kind, Packed
from caster.kernels.protocol import surface
from caster.rendering.casting import find_nearest
from caster.rendering.hits import cast, occluded, packed, validated_rays
from caster.rendering.threads import CHUNKS_PER_THREAD, thread_count
from caster.scene.model import Scene
from caster.shapes import SHAPES, Icosphere

SIZES = (1e-3, 1.0, 1e3)
BALL = scene_of(Icosphere())
RAYS = 100  # of each family, for each shape, size and offset; `make nightly` casts 200,000 hard rays a shape


def count_hits_where_tree_agrees(scene: Scene, o: np.ndarray, d: np.ndarray, what: str) -> int:
    """Number of rays that hit; fails where `cast` or `occluded` differs from brute force."""
    hits = cast(scene, o, d)
    sooner = {"blocked": occluded(scene, o, d), "normal": hits.normal}
    assert_same_bits({"blocked": hits.shape_id >= 0, "normal": hits.surfaces["normal"]}, sooner, what)
    slow = find_nearest(packed(scene), validated_rays(o, d, 0.0, np.inf), "brute-force")
    fast = {"t": hits.t, "prim": hits.nearest.prim}
    assert_same_bits({"t": slow.t, "prim": slow.prim}, fast, what)
    assert np.isfinite(hits.t).sum() == (hits.prim_id >= 0).sum(), f"{what}: a hit without a finite t"
    return int((hits.prim_id >= 0).sum())


CAREFUL = ("sphere", "ellipsoids", "linear_curve", "cylinder", "torus", "cube")  # shapes that may need `surface`


@pytest.mark.parametrize("shape", [shape for shape in SHAPES if name(shape) in CAREFUL], ids=name)
def test_the_surface_of_a_single_hit_has_the_bits_of_vector_code(shape):
    """`surface` stands in where `fast_surface` is not safe: elsewhere both have the same bits."""
    rng, same = np.random.default_rng([62, SHAPES.index(shape)]), 0
    for _ in range(4):
        scene = random_scene(rng, [shape], Pinhole, count=2)
        for o, d in hard_rays(packed(scene), rng, 8).values():
            hits = cast(scene, o, d / np.linalg.norm(d, axis=1, keepdims=True))
            expected = (hits.position, hits.normal, hits.shading_normal, hits.uv)
            for row in np.flatnonzero(hits.hit):
                kind, k = packed(scene).place_of(int(hits.nearest.prim[row]))
                ray = [tuple(each[row].tolist()) for each in (hits.rays.o, hits.rays.d)]
                p, n, sh_n, *uv = surface(kind.prims, k, *ray, float(hits.nearest.t[row]), True)
                assert [tuple(each[row].tolist()) for each in expected] == [p, n, sh_n, tuple(uv)], ray
                same += 1
    assert same >= 100


def test_limits_may_be_given_for_each_ray():
    o, d = np.tile([0.1, 0.2, 5.0], (4, 1)), np.tile([0.0, 0.0, -1.0], (4, 1))
    starts, ends = [0.0, 5.0, 9.0, 0.0], np.array([np.inf, 9.0, 10.0, 1.0])
    found = cast(BALL, o, d, t_min=starts, t_max=ends).t
    alone = [cast(BALL, o[i : i + 1], d[i : i + 1], t_min=starts[i], t_max=ends[i]).t[0] for i in range(4)]
    assert found.tolist() == alone and found[0] < 5.0 < found[1] and np.isinf(found[2:]).all()
    assert np.array_equal(occluded(BALL, o, d, t_min=starts, t_max=ends), np.isfinite(found))


WRONG_LIMITS = {
    "number, or one for each of 2 rays, got shape (3,)": {"t_min": [0, 0, 0]},
    "number, or one for each of 2 rays, got shape (2, 1)": {"t_max": [[1], [2]]},
    r"rays[1]: need t_min >= 0 and a t_max, got t_min -1.0 and t_max inf": {"t_min": [0, -1]},
    r"rays[0]: need t_min >= 0 and a t_max, got t_min 0.0 and t_max nan": {"t_max": [np.nan, 1]},
    r"rays: need t_min >= 0 and a t_max, got t_min -2.0 and t_max inf": {"t_min": -2},
    "rays: t_min must be numbers, got list": {"t_min": ["a", 1]},
}


@pytest.mark.parametrize("text", WRONG_LIMITS)
@pytest.mark.parametrize("function", [cast, occluded])
def test_wrong_limits_are_scene_errors(function, text):
    with pytest.raises(SceneError) as found:
        function(BALL, np.zeros((2, 3)), np.ones((2, 3)), **WRONG_LIMITS[text])
    assert text in str(found.value)


@pytest.mark.parametrize("function", [cast, occluded])
def test_the_first_of_several_rays_that_are_none_is_named(function):
    """The second bad ray begins another thread's piece, and is found long before the first one."""
    count = 1 << 18
    o, d = np.zeros((count, 3)), np.ones((count, 3))
    pieces = CHUNKS_PER_THREAD * thread_count()
    second = int(np.linspace(0, count, pieces + 1)[1])
    d[[second - 1, second, count - 1]] = 0.0
    with pytest.raises(SceneError, match=rf"^rays\[{second - 1}\]: "):
        function(BALL, o, d)


@pytest.mark.parametrize("shape", KINDS, ids=name)
def test_a_tree_never_changes_a_hit(shape):
    rng = np.random.default_rng([10, SHAPES.index(shape)])
    hits = dict.fromkeys(FAMILIES, 0)
    for size in SIZES:
        for offset in (0.0, 1e3 * size):
            scene = random_scene(rng, [shape], Pinhole, size=size, offset=offset)
            for family, (o, d) in hard_rays(packed(scene), rng, RAYS).items():
                hits[family] += count_hits_where_tree_agrees(scene, o, d, family)
    assert min(hits.values()) >= 25, f"few hits prove little: {hits}"


def test_a_tree_never_changes_a_hit_where_all_kinds_are_mixed():
    rng = np.random.default_rng(11)
    for size in SIZES:
        scene = random_scene(rng, SHAPES, Pinhole, count=3, size=size, offset=size)
        for family, (o, d) in hard_rays(packed(scene), rng, 125).items():
            assert count_hits_where_tree_agrees(scene, o, d, family) >= 35


def slivers(rng: np.random.Generator, count: int) -> Packed:
    """Long thin triangles along one line, edge-on to rays in their plane: t is noise in most of them."""
    axis, side, place = rng.normal(size=(3, 3))
    along, across = rng.uniform(-1.0, 1.0, (3 * count, 1)), 10.0 ** rng.uniform(-18.0, -3.0, (3 * count, 1))
    corners = place + along * axis + across * side
    prims = triangle_soup(corners)
    kind = Kind(prims, np.arange(count, dtype=np.int32))
    return Packed((kind,), (prims,), np.array([0, count], np.int64))


def test_a_tree_never_changes_a_hit_of_slivers_seen_edge_on():
    """Where float64 cannot decide a hit, exact arithmetic finds the same one through the BVH as by brute force."""
    rng = np.random.default_rng(12)
    hits = 0
    for _ in range(10):
        packed = slivers(rng, 60)
        for family, (o, d) in hard_rays(packed, rng, 50).items():
            rays = validated_rays(o, d, 0.0, np.inf)
            slow, fast = find_nearest(packed, rays, "brute-force"), find_nearest(packed, rays, "bvh")
            assert_same_bits(slow._asdict(), fast._asdict(), family)
            hits += int((slow.prim >= 0).sum())
    assert hits >= 500


@pytest.mark.parametrize("power", [40, 52, 60, 300])
def test_a_tree_never_changes_a_hit_from_so_far_away_that_rays_are_wider_than_the_tree(power):
    """From so far away, empty places of a node are entered, too. Neighbouring rays differ a lot, or not at all."""
    rng = np.random.default_rng(power)
    scene = scene_of(Icosphere(subdivisions=1))  # nodes that are not full
    o = rng.normal(size=(64, 3))
    o *= 2.0**power / np.linalg.norm(o, axis=1, keepdims=True)
    together = np.repeat(o[:8], 8, axis=0)
    for origins, what in ((o, "alone"), (together, "together")):
        assert count_hits_where_tree_agrees(scene, origins, -origins, what) >= 32

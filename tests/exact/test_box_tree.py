"""No box that a ray passes is left out, and few others are passed: against Fractions, and all pairs of a scene."""

from fractions import Fraction

import numpy as np
import pytest
from aimed_rays import KINDS, Setting, rays_at, scene_of

from caster.shapes import Plane
from mitsuba_ref.error_model.scene_model import OUR_SIDE, SceneModel
from mitsuba_ref.oracle import boxes
from mitsuba_ref.oracle.boxes import BRANCHING_FACTOR, BoxTree
from mitsuba_ref.oracle.oracle import BOX_MARGIN
from mitsuba_ref.reference.shared_input import SharedRays, model_of

SETTINGS = (Setting(), Setting(distances=(1e3, 1e4)), Setting(size=10.0, offset=1e5), Setting(distances=(1e-3, 1.0)))
RAYS, BOXES = 60, 70


def crossing(line, box) -> tuple[Fraction, Fraction] | None:
    """From which t to which a line is within a box, in Fractions; None: nowhere."""
    near = far = None
    for o, d, low, high in zip(*line, *box, strict=True):
        if not d:
            if not low <= o <= high:
                return None
            continue
        ends = sorted([(low - o) / d, (high - o) / d])
        near, far = ((ends[0] if near is None else max(near, ends[0])), (ends[1] if far is None else min(far, ends[1])))
    return None if near > far else (near, far)


def lattice(rng):
    """Many rays along faces and through corners, or that begin or end at a box."""
    o, d = rng.integers(-4, 5, (RAYS, 3)).astype(float), rng.integers(-2, 3, (RAYS, 3)).astype(float)
    low = rng.integers(-4, 2, (BOXES, 3)).astype(float)
    return o, d, low, low + rng.integers(0, 6, (BOXES, 3))


def extremes(rng):
    """Boxes that are points, flat boxes, equal ones, and boxes of 1e308 and 1e-308; denormal directions."""
    scale = 10.0 ** rng.choice([-308.0, 0.0, 0.0, 300.0, 308.0], (BOXES, 1))
    middle = scale * rng.uniform(-1.0, 1.0, (BOXES, 3))
    middle[::9] = 0.0
    size = 10.0 ** rng.choice([-300.0, -2.0, 0.0], (BOXES, 1)) * np.minimum(scale, 1e307)
    size = size * rng.uniform(0.5, 1.0, (BOXES, 3))
    size[::7, 1] = size[::9] = 0.0
    target = middle[rng.integers(0, BOXES, RAYS)]
    o = np.where(rng.random((RAYS, 1)) < 0.5, rng.normal(size=(RAYS, 3)), target)
    d = (target * 0.5 - o * 0.5) * np.where(rng.random((RAYS, 3)) < 0.1, 0.0, rng.choice([1.0, 2.0**-1022], (RAYS, 1)))
    return o, d, middle - size, middle + size


@pytest.mark.parametrize("make", [lattice, extremes])
def test_a_ray_passes_a_box_as_it_does_in_fractions(make):
    """`near` is no later than the box; on the lattice, no box is passed that only rounding or an end touches."""
    rng = np.random.default_rng(14)
    o, d, low, high = make(rng)
    d[~d.any(axis=1)] = [0.0, -0.0, 1e-320]
    t_min, t_max = rng.choice([-np.inf, 0.0, 1.0], RAYS), rng.choice([np.inf, np.inf, 2.0, 1.0, -1.0], RAYS)
    near = {
        (ray, box): t
        for found in BoxTree(low, high, BOX_MARGIN).crossings(o, d, t_min, t_max)
        for ray, box, t in zip(*(column.tolist() for column in found[1:]), strict=True)
    }
    lines, corners = ([[[*map(Fraction, row)] for row in a.tolist()] for a in pair] for pair in ((o, d), (low, high)))
    passed, touched = 0, 0
    for i, line in enumerate(zip(*lines, strict=True)):
        for j, box in enumerate(zip(*corners, strict=True)):
            span = crossing(line, box)
            inside = span is not None and span[1] > t_min[i] and span[0] <= t_max[i] and t_min[i] <= t_max[i]
            passed += inside
            if inside:
                assert near[i, j] <= span[0]
                assert make is extremes or span[0] - Fraction(near[i, j]) <= 1e-9 * max(1, abs(span[0]))
            elif (i, j) in near and make is lattice:
                touched += 1
                assert span is not None and (span[1] == t_min[i] or t_min[i] > t_max[i])
    assert passed >= 200 and (touched or make is extremes)


def crowd(kind: str, seed: list[int], setting: Setting, rays: int) -> tuple[SceneModel, np.ndarray, np.ndarray]:
    """A scene of many primitives with a plane among them, and rays at every one."""
    rng = np.random.default_rng(seed)
    scene = scene_of(kind, rng, setting, 1 if kind == "meshes" else 70)
    o, d = rays_at(scene, rng, setting, rays)
    if kind != "planes":
        scene = scene.model_copy(update={"shapes": (*scene.shapes, Plane(point=o[0] + 1.0, normal=(0, 0.6, 0.8)))})
    shared = SharedRays(*(a.astype(np.float32) for a in (o, d, np.full(len(o), np.inf))), np.zeros(len(o)))
    return model_of(scene, shared), o, d


@pytest.mark.parametrize("kind", KINDS)
def test_every_possible_hit_ahead_is_near(kind):
    """Against every ray with every primitive: the possible hits by float64 include all exact hits."""
    tried, hits = 0, 0
    for number, setting in enumerate(SETTINGS):
        model, o, d = crowd(kind, [110, number], setting, 150)
        count = len(model.boxes[0])
        ray, prim = (a.ravel() for a in np.meshgrid(np.arange(len(o)), np.arange(count), indexing="ij"))
        met = model.intersect(prim, o[ray], d[ray], OUR_SIDE)
        sure = met.pair[met.at.possible & (met.at.t > 0.0)]
        needed = set((ray[sure] * count + prim[sure]).tolist())
        given = np.concatenate([near.ray * count + near.box for near in model.nearby.crossings(o, d)])
        assert needed <= set(given.tolist())
        assert kind != "meshes" or len(given) < 0.3 * len(ray)
        tried, hits = tried + len(ray), hits + len(needed)
    assert tried >= 4e4 and hits >= 350


@pytest.mark.parametrize(("limit", "value"), [("RAYS_PER_BATCH", 7), ("MAX_RAY_BOX_PAIRS", 64 * BRANCHING_FACTOR)])
def test_each_ray_is_in_one_batch_only(monkeypatch, limit, value):
    """And batches change nothing."""
    model, o, d = crowd("triangles", [111], Setting(), 500)
    whole = list(model.nearby.crossings(o, d))
    monkeypatch.setattr(boxes, limit, value)
    pieces = list(model.nearby.crossings(o, d))
    assert len(whole) == 1 and len(pieces) > 5
    assert np.concatenate([np.arange(500)[piece.batch] for piece in pieces]).tolist() == list(range(500))
    assert all(np.isin(piece.ray, np.arange(500)[piece.batch]).all() for piece in pieces)
    for i in range(1, 4):
        assert np.array_equal(np.concatenate([piece[i] for piece in pieces]), whole[0][i])


def test_boxes_without_bounds_come_last_and_spoil_no_others():
    rng = np.random.default_rng(113)
    low = rng.uniform(-1.0, 1.0, (200, 3))
    high = low + 0.01
    endless = np.arange(0, 200, 5)
    low[endless], high[endless] = -np.inf, np.inf
    tree = BoxTree(low, high, BOX_MARGIN)
    assert tree.order[-len(endless) :].tolist() == endless.tolist()
    (found,) = tree.crossings(np.array([[0.0, 0.0, 9.0]]), np.array([[0.0, -0.0, 1.0]]))  # away from all
    assert sorted(found.box.tolist()) == endless.tolist() and np.isneginf(found.near).all()


def test_boxes_at_one_place_or_none_at_all_are_fine():
    same = np.zeros((BRANCHING_FACTOR + 1, 3))
    (found,) = BoxTree(same, same, BOX_MARGIN).crossings(np.array([[0.0, 0.0, 9.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert len(found.box) == BRANCHING_FACTOR + 1
    nothing = np.zeros((0, 3))
    (found,) = BoxTree(nothing, nothing, BOX_MARGIN).crossings(np.zeros((2, 3)), np.ones((2, 3)))
    assert len(found.ray) == len(found.box) == len(found.near) == 0

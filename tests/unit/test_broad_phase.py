"""The broad phase of the error models never drops a primitive that a ray hits."""

import numpy as np
import pytest
from aimed_rays import KINDS, Setting, rays_at, scene_of

from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32
from caster.shapes import Plane
from mitsuba_ref.error_model import scene_model
from mitsuba_ref.error_model.scene_model import BRANCHING_FACTOR, BroadPhase, SceneModel
from mitsuba_ref.error_model.tolerances import KU_OURS
from mitsuba_ref.reference.shared_input import SharedRays, model_of

SETTINGS = (Setting(), Setting(distances=(1e3, 1e4)), Setting(size=10.0, offset=1e5), Setting(distances=(1e-3, 1.0)))


def crowd(kind: str, seed: list[int], setting: Setting, rays: int) -> tuple[SceneModel, np.ndarray, np.ndarray]:
    """A scene of many primitives with a plane among them, and rays at every one."""
    rng = np.random.default_rng(seed)
    scene = scene_of(kind, rng, setting, 1 if kind == "meshes" else 70)
    o, d = rays_at(scene, rng, setting, rays)
    if kind != "planes":
        scene = scene.model_copy(update={"shapes": (*scene.shapes, Plane(point=o[0] + 1.0, normal=(0, 0.6, 0.8)))})
    shared = SharedRays(*(a.astype(np.float32) for a in (o, d, np.full(len(o), np.inf))), np.zeros(len(o)))
    return model_of(scene, pack(scene, as_float32), shared), o, d


@pytest.mark.parametrize("kind", KINDS)
def test_every_possible_hit_ahead_is_near(kind):
    """Against every ray with every primitive: what float64 takes for possible holds all exact hits."""
    tried, hits = 0, 0
    for number, setting in enumerate(SETTINGS):
        model, o, d = crowd(kind, [110, number], setting, 150)
        count = len(model.boxes[0])
        ray, prim = (a.ravel() for a in np.meshgrid(np.arange(len(o)), np.arange(count), indexing="ij"))
        met = model.intersect(prim, o[ray], d[ray], KU_OURS, ours=True)
        sure = met.pair[met.at.possible & (met.at.t > 0.0)]
        needed = set((ray[sure] * count + prim[sure]).tolist())
        given = [r * count + p for r, p in BroadPhase(*model.boxes).pairs(o, d)]
        assert needed <= set(np.concatenate(given).tolist())
        tried, hits = tried + len(ray), hits + len(needed)
    assert tried >= 4e4 and hits >= 350


def test_each_ray_is_in_one_piece_only(monkeypatch):
    """And pieces change nothing."""
    model, o, d = crowd("triangles", [111], Setting(), 500)
    whole = list(BroadPhase(*model.boxes).pairs(o, d))
    monkeypatch.setattr(scene_model, "BOX_TESTS_PER_BATCH", 64 * BRANCHING_FACTOR * 7)
    pieces = list(BroadPhase(*model.boxes).pairs(o, d))
    assert len(whole) == 1 and len(pieces) > 50
    rays = [set(ray.tolist()) for ray, _ in pieces]
    assert sum(map(len, rays)) == len(set.union(*rays))
    for i in range(2):
        assert np.array_equal(np.concatenate([piece[i] for piece in pieces]), whole[0][i])


def test_every_box_is_grown_by_the_margin_of_its_farthest_corner(monkeypatch):
    monkeypatch.setattr(scene_model, "BOXES_PER_CHUNK", 8)
    low = np.random.default_rng(114).uniform(-9.0, 9.0, (3, 20))
    high = low + 1.0
    margin = scene_model.BOX_MARGIN * np.maximum(np.abs(low), np.abs(high)).max(axis=0)
    assert np.array_equal(scene_model.grown(low.copy(), high.copy()), (low - margin, high + margin))


def test_most_of_what_a_ray_passes_by_is_left_out():
    model, o, d = crowd("meshes", [112], Setting(distances=(10.0, 20.0)), 300)
    ((_, prim),) = BroadPhase(*model.boxes).pairs(o, d)
    assert len(prim) < 0.1 * len(o) * len(model.boxes[0])


def test_boxes_without_bounds_come_last_and_spoil_no_others():
    rng = np.random.default_rng(113)
    low = rng.uniform(-1.0, 1.0, (200, 3))
    high = low + 0.01
    endless = np.arange(0, 200, 5)
    low[endless], high[endless] = -np.inf, np.inf
    boxes = BroadPhase(low, high)
    assert sorted(boxes.order.tolist()) == list(range(200))
    assert boxes.order[-len(endless) :].tolist() == endless.tolist()
    assert np.isfinite(boxes.levels[1].low[:, 0, : 160 // BRANCHING_FACTOR]).all()
    ((_, prim),) = boxes.pairs(np.array([[0.0, 0.0, 9.0]]), np.array([[0.0, 0.0, 1.0]]))  # away from all
    assert sorted(prim.tolist()) == endless.tolist()


def test_boxes_at_one_place_or_none_at_all_are_fine():
    same = np.zeros((BRANCHING_FACTOR + 1, 3))
    ((_, prim),) = BroadPhase(same, same).pairs(np.array([[0.0, 0.0, 9.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert len(prim) == BRANCHING_FACTOR + 1
    nothing = np.zeros((0, 3))
    ((ray, prim),) = BroadPhase(nothing, nothing).pairs(np.zeros((2, 3)), np.ones((2, 3)))
    assert len(ray) == len(prim) == 0

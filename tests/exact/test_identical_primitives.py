"""Identical primitives are decided once, with the same answers as if each were decided."""

import numpy as np
import pytest
from oracle_aims import packed, triangles

from caster.geometry.packing import Triangles, pack
from caster.geometry.world_space import as_float32
from caster.scene.model import Scene
from caster.shapes import Sphere, Triangle
from mitsuba_ref.error_model import scene_model
from mitsuba_ref.error_model.bracket import CLAIMED_MISS, Bracket, Claims
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.oracle import oracle as oracle_module
from mitsuba_ref.oracle.interface import lowest_identical, tied_prims
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.reference.shared_input import SharedRays, model_of

Rng = np.random.Generator


def pile_of_triangles(rng: Rng) -> Triangles:
    """A few faces, each again many times: as it is, with other vertices, turned, mirrored, a bit beside, with -0.0."""
    base = rng.integers(-3, 4, (4, 3, 3)).astype(np.float64)
    corners = base[rng.integers(0, 4, 60)]
    order = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0]])[rng.integers(0, 5, 60)]
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    beside = rng.integers(0, 60, 8)
    corners[beside, 0, 0] = np.nextafter(corners[beside, 0, 0], 9.0)
    other_zero = rng.integers(0, 60, 8)
    corners[other_zero] = np.where(corners[other_zero] == 0.0, -0.0, corners[other_zero])
    shared = triangles(corners)
    again = rng.integers(0, 60, 60)
    return shared._replace(
        faces=np.vstack([shared.faces, shared.faces[again]]),
        smooth=np.r_[shared.smooth, shared.smooth[again]],
        textured=np.r_[shared.textured, shared.textured[again]],
    )


def rays_at(rng: Rng, prims: Triangles, count: int) -> tuple[np.ndarray, np.ndarray]:
    """At the inside, edges and vertices of faces, along planes, and elsewhere; whole numbers keep that exact."""
    corners = prims.vertices[prims.faces[rng.integers(0, len(prims.faces), count)]]
    weights = np.array([[1, 0, 0], [0.5, 0.5, 0], [0.25, 0.25, 0.5]])[rng.integers(0, 3, count)]
    d = rng.integers(-9, 10, (count, 3)).astype(np.float64)
    d[(d == 0.0).all(axis=1), 2] = 1.0
    return np.einsum("ij,ijk->ik", weights, corners) - 2.0 * d, d


def answers_each_way(monkeypatch, arrays, o, d):
    together = Oracle(packed(*arrays)).first_hits(o, d)
    with monkeypatch.context() as patch:
        patch.setattr(oracle_module, "lowest_identical", lambda *_, **__: None)
        alone = Oracle(packed(*arrays)).first_hits(o, d)
    return together, alone


def differing(together, alone) -> int:
    return sum(
        (a.t, tuple(a.ties), a.prim, a.flags, len(a.ties), tied_prims(a).tolist(), list(a.ties[1:3]))
        != (b.t, b.ties, b.prim, b.flags, len(b.ties), tied_prims(b).tolist(), list(b.ties[1:3]))
        or (bool(b.ties) and (a.ties[0], a.ties[-1]) != (b.ties[0], b.ties[-1]))
        for a, b in zip(together, alone, strict=True)
    )


def test_the_oracle_answers_random_piles_as_if_it_decided_each_face(monkeypatch):
    ties, flags = 0, set()
    for seed in range(20):
        rng = np.random.default_rng(seed)
        prims = pile_of_triangles(rng)
        together, alone = answers_each_way(monkeypatch, [prims], *rays_at(rng, prims, 60))
        assert differing(together, alone) == 0, seed
        ties += sum(len(answer.ties) > 2 for answer in alone)
        flags |= set().union(*(answer.flags for answer in alone))
    assert ties > 200 and flags >= {"edge_on", "degenerate"}, (ties, flags)


def test_faces_that_are_the_same_by_less_than_all_bits_are_noticed(monkeypatch):
    """A comparison of the first corners alone gives other answers."""

    def by_first_corner(prims, more=(), *, shading):
        first = prims._replace(faces=prims.faces[:, [0, 0, 0]])
        return lowest_identical(first, more, shading=shading)

    wrong = 0
    for seed in range(5):
        rng = np.random.default_rng(seed)
        prims = pile_of_triangles(rng)
        o, d = rays_at(rng, prims, 60)
        _, alone = answers_each_way(monkeypatch, [prims], o, d)
        with monkeypatch.context() as patch:
            patch.setattr(oracle_module, "lowest_identical", by_first_corner)
            wrong += differing(Oracle(packed(prims)).first_hits(o, d), alone)
    assert wrong > 10


# ---- which rows are identical


def test_faces_of_other_vertices_are_identical_unless_shading_that_differs_is_asked_for():
    prims = triangles(np.tile(np.eye(3), (2, 1, 1)))
    assert lowest_identical(prims, shading=True).tolist() == [0, 0]
    prims.smooth[1] = True
    assert lowest_identical(prims, shading=True) is None
    assert lowest_identical(prims, shading=False).tolist() == [0, 0]


# ---- brackets


def pile_of_shapes(rng: Rng):
    """Triangles in shapes of their own and as faces of meshes, twice and more, and spheres."""
    corners = rng.integers(-2, 3, (3, 3, 3)).astype(np.float64) / 3.0
    shapes = [Triangle(vertices=tuple(map(tuple, corners[i]))) for i in rng.integers(0, 3, 6)]
    shapes += [Sphere(center=(0, 0, -1), radius=r) for r in (1.0, 1.0, 0.5)]
    o = rng.normal(size=(200, 3)) * 2.0
    return shapes, o, -o + rng.normal(size=(200, 3)) * 0.4


def model_with_pile(rng: Rng):
    """The model of a pile, its last shape a mesh of a few faces that come again and again, and rays."""
    shapes, o, d = pile_of_shapes(rng)
    scene = Scene(camera={"type": "pinhole", "eye": [0, 0, 9], "look_at": [0, 0, 0]}, shapes=shapes)
    o, d = o.astype(np.float32), d.astype(np.float32)
    rays = SharedRays(o, d, np.full(len(o), np.inf, np.float32), np.zeros(len(o)))
    numbers = pack(scene, as_float32)
    place = next(i for i, kind in enumerate(numbers.kinds) if isinstance(kind.prims, Triangles))
    again = numbers.kinds[place].prims
    rows = rng.integers(0, len(again.faces), 30)
    again = again._replace(faces=again.faces[rows], smooth=again.smooth[rows], textured=again.textured[rows])
    return packed(again, *(kind.prims for i, kind in enumerate(numbers.kinds) if i != place)), scene, rays


def brackets(monkeypatch, rng: Rng, *, ours: bool):
    numbers, scene, rays = model_with_pile(rng)
    usual = model_of(scene, pack(scene, as_float32), rays)
    kinds = tuple(kind.prims for kind in numbers.kinds)
    models = tuple(usual.models[[type(k) for k in usual.kinds].index(type(prims))] for prims in kinds)
    found = []
    for dedupe in (True, False):
        with monkeypatch.context() as patch:
            if not dedupe:
                patch.setattr(scene_model, "lowest_identical", lambda *_, **__: None)
            model = scene_model.SceneModel(numbers, kinds, kinds, models)
            assert (model.identical is not None) == dedupe and model.distinct is not None
        found.append(Bracket(model, KU_OURS if ours else KU, ours=ours))
    return found, rays.o.astype(np.float64), rays.d.astype(np.float64)


@pytest.mark.parametrize("ours", [False, True])
def test_brackets_of_piles_judge_as_if_each_primitive_was_looked_at(monkeypatch, ours):
    allowed_some = refused_some = blocked_some = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        (some, each), o, d = brackets(monkeypatch, rng, ours=ours)
        assert sum(len(prim) for _, prim in some.model.distinct.pairs(o, d)) < 0.6 * sum(
            len(prim) for _, prim in some.model.nearby.pairs(o, d)
        )
        t_max = np.full(len(o), np.inf)
        hits = each.possible_hits(o, d, t_max)
        assert sorted(zip(hits.ray, hits.prim, strict=True)) == sorted(
            zip(*some.possible_hits(o, d, t_max)[:2], strict=True)
        )
        taken = np.unique(hits.ray, return_index=True)[1]
        at, ray = hits.take(taken).at, hits.ray[taken]
        shape, number = np.full(len(o), CLAIMED_MISS), rng.integers(-1, 32, len(o))
        t, n = np.full(len(o), np.inf), np.zeros((len(o), 3))
        shape[ray], t[ray], n[ray] = each.model.packed.shape_of(hits.prim[taken]), at.t, at.n
        number[ray[::2]] = each.model.packed.index_in_shape(hits.prim[taken])[::2]
        for prim in (None, number):
            also = np.where(number >= 30, -1, number)
            for extra in (None, also):
                one = some.judge(o, d, t_max, Claims(t, shape, n, prim=prim), also=extra)
                other = each.judge(o, d, t_max, Claims(t, shape, n, prim=prim), also=extra)
                assert all(map(np.array_equal, one, other)), seed
                allowed_some, refused_some = (allowed_some + one.allowed.sum(), refused_some + (~one.allowed).sum())
        start = np.full(len(o), -1)
        start[ray] = hits.prim[taken]
        p = np.where(np.isfinite(t)[:, None], o + np.where(np.isfinite(t), t, 0.0)[:, None] * d, o)
        for off in (0.0, 1e-6):
            args = p, -d, np.full(len(o), 5.0), (start, np.full(len(o), off))
            one, other = some.blocked(*args), each.blocked(*args)
            assert all(map(np.array_equal, one, other)), seed
            blocked_some += one[0].sum()
    assert min(allowed_some, refused_some, blocked_some) > 100

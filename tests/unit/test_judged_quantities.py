"""Light, statistics, listed failures and ratios of the judge by tables, with formulas written a second time."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import caster
from caster.aovs import Aovs
from caster.description.errors import SceneError
from caster.scene.model import Scene
from mitsuba_ref.error_model.intersections import Intersections
from mitsuba_ref.judge import aggregate, classification, diffuse
from mitsuba_ref.judge.adjudication import Adjudication
from mitsuba_ref.judge.classification import CLASS_CODE, EXACT, Judgement
from mitsuba_ref.judge.comparison import ImagePair, PixelPairs, SelfCheck, UvPair, check_allowances
from mitsuba_ref.judge.verdict import CLASSES, ErrorStatistics, Extremes, KindBias, SceneVerdict, Verdict
from mitsuba_ref.shapes.triangle_meshes import TRIANGLES
from mitsuba_ref.subjects.subject import Answer

INF, NAN = np.inf, np.nan
Z = (0.0, 0.0, 1.0)


def intersections(t, t_error=0.0, n=Z, n_error=0.0, sh_n=Z, certain=True, possible=True) -> Intersections:
    t = np.array(t, float)
    count = len(t)

    def rows(value, width=0):
        return np.array(np.broadcast_to(value, (count, width) if width else count))

    return Intersections(
        t, rows(t_error), rows(n, 3), rows(n_error), rows(sh_n, 3), rows(0.0), rows(possible), rows(certain),
        rows(0.0), rows(0.0, 3), rows(0.0),
    )  # fmt: skip


# ---- light

RED, GREY = (0.75, 0.25, 0.125), (0.5, 0.5, 0.5)


def lit_scene(shadows=True, ambient=True) -> Scene:
    lights = [
        caster.Point(position=(0, 0, 4), intensity=(8, 16, 32)),
        caster.Directional(direction=(0, 0, -2), irradiance=(1, 2, 3)),
    ]
    if ambient:
        lights.insert(1, caster.Ambient(radiance=(0.25, 0.5, 1.0)))
    return Scene(
        film=caster.Film(width=2, height=2), camera=caster.Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0)),
        shapes=[caster.Sphere(name="grey"), caster.Sphere(name="red", material="red")], lights=lights,
        materials={"red": {"reflectance": RED}, "default": {"reflectance": GREY}},
        shading=caster.Shading(shadows=shadows),
    )  # fmt: skip


def hits_at(count: int, facing=1.0, p_error=0.0, sh_error=0.0) -> diffuse.ShadingPoints:
    """Points at the origin of the red sphere, normals along z, rays from above."""
    at = intersections([1.0] * count, n=Z, sh_n=Z)._replace(
        p_error=np.full(count, p_error), sh_error=np.broadcast_to(sh_error, count)
    )
    d = np.tile([np.sqrt(1.0 - facing**2), 0.0, -facing], (count, 1))
    return diffuse.ShadingPoints(np.zeros((count, 3)), d, np.ones(count, int), at)


POINT = np.array(RED) / np.pi * np.array([8.0, 16.0, 32.0]) / 16.0
SUN = np.array(RED) / np.pi * np.array([1.0, 2.0, 3.0])
AMBIENT = np.array(RED) * [0.25, 0.5, 1.0]


@pytest.mark.parametrize("shadows", [True, False])
@pytest.mark.parametrize("seen", list(itertools.product([False, True], repeat=2)))
def test_our_light_is_there_or_in_shadow_as_float64_allows(monkeypatch, seen, shadows):
    """seen: whether the point light may be lit, and whether it may be shaded; the other one is lit."""
    asked = []

    def our_visibility(bracket, hit, light, prim):
        asked.append((bracket, prim.tolist()))
        point = np.isfinite(light.reach[0])
        return np.full(4, seen[0] if point else True), np.full(4, seen[1] if point else False)

    monkeypatch.setattr(diffuse.lambert, "our_visibility", our_visibility)
    bright, dark = AMBIENT + POINT + SUN, AMBIENT + SUN
    values = np.array([bright, dark, AMBIENT, bright * (1.0 + 1e-9)])
    prim = np.array([7, 7, 8, 8])
    found = diffuse.diffuse_within_float64(lit_scene(shadows), hits_at(4), prim, values, "bracket")
    lit, shaded = seen if shadows else (True, False)
    assert found.tolist() == [lit, shaded or not lit, False, False]
    assert asked == ([("bracket", prim.tolist())] * 2 if shadows else [])


def test_near_grazing_either_face_may_be_the_one_that_is_seen():
    scene = lit_scene(shadows=False)
    values = np.array([AMBIENT + POINT + SUN, AMBIENT + SUN, AMBIENT, AMBIENT + 2.0 * SUN])
    for facing, sh_error, expected in (
        (-1e-9, 1e-8, [True, True, True, False]),
        (-0.5, 1e-8, [False, False, True, False]),
    ):
        found = diffuse.diffuse_within_float64(scene, hits_at(4, facing, 0.0, sh_error), np.zeros(4, int), values, None)
        assert found.tolist() == expected
    none = lit_scene(shadows=False, ambient=False).model_copy(update={"lights": ()})
    zero = np.zeros((4, 3))
    assert diffuse.diffuse_within_float64(none, hits_at(4), np.zeros(4, int), zero, None).all()
    assert not diffuse.diffuse_within_float64(none, hits_at(4), np.zeros(4, int), zero + 1e-9, None).any()


def test_materials_are_those_of_each_shape():
    found = diffuse.materials_of(lit_scene())
    assert found.reflectance.tolist() == [list(GREY), list(RED)] and found.two_sided.dtype == bool


def test_the_contrary_of_light_is_darkness_without_an_error_and_of_darkness_light_with_its_own():
    """At three pixels: lit, in shadow, and in shadow where either face may be the one that is seen."""
    light = SimpleNamespace(
        doubtful=np.array([False, False, True]), radiance=np.full((3, 3), 2.0), error=np.full((3, 3), 0.25),
        either_side=np.full((3, 3), 3.0),
    )  # fmt: skip
    lit = np.array([True, False, False])
    given, error = (np.where(lit[:, None], number, 0.0)[None] for number in (2.0, 0.25))
    lights = diffuse.LightAnswers([light], given * np.ones(3), error * np.ones(3), lit[None])
    found = diffuse._choices(lit_scene(shadows=False), None, lights, None, np.arange(3), (None, None))
    assert found.first[0, :, 0].tolist() == [2.0, 0.0, 0.0]
    assert found.first_error[0, :, 0].tolist() == [0.25, 0.0, 0.0]
    assert found.second[0, :, 0].tolist() == [0.0, 2.0, 3.0]
    assert found.second_error[0, :, 0].tolist() == [0.0, 0.25, 0.25]
    assert found.doubt.tolist() == [[False, False, True]]


# the subject's light, Mitsuba's visibility, (they lit, they shaded, we lit, we shaded) -> beyond, explained
LIGHT = [
    ("bright", True, (1, 0, 1, 0), False, False), ("dark", True, (1, 0, 1, 0), True, False),
    ("dark", True, (1, 0, 0, 1), True, True), ("dark", True, (0, 0, 0, 1), True, False),
    ("dark", True, (1, 1, 1, 0), True, False), ("dark", False, (0, 1, 0, 1), False, False),
    ("bright", False, (0, 1, 1, 0), True, True), ("bright", False, (0, 1, 0, 1), True, False),
    ("bright", False, (1, 0, 1, 1), True, False), ("other", True, (1, 1, 1, 1), True, False),
]  # fmt: skip


@pytest.mark.parametrize("shadows", [True, False])
def test_light_is_compared_where_geometry_agrees(monkeypatch, shadows):
    count = len(LIGHT) + 3  # the first is not judged, the last but one has no bound, the last is lit by the other alone
    values = {"bright": AMBIENT + POINT + SUN, "dark": AMBIENT + SUN, "other": AMBIENT + 3.0 * SUN}
    given = np.array([values["other"], *(values[each[0]] for each in LIGHT), values["other"], values["bright"]])
    visible = np.array([True, *(each[1] for each in LIGHT), True, True])
    flags = np.array([(0, 0, 0, 0), *(each[2] for each in LIGHT), (0, 0, 0, 0), (0, 0, 0, 0)], bool)
    rows = np.arange(1, count)
    at = intersections([2.0] * count, sh_n=Z)._replace(p_error=np.where(np.arange(count) == count - 2, 9.0, 0.0))
    place = np.arange(count)

    def visibility(which, *, theirs):
        def found(bracket, hit, light, *more):
            assert bracket == ("theirs" if theirs else "ours")
            asked = found.rows
            point = np.isfinite(light.reach[0])
            if theirs:
                assert np.array_equal(more[0][:, 0], asked) and np.array_equal(more[1][:, 1], asked)
            else:
                assert more[0].tolist() == (asked + 100).tolist()
            one, two = flags[asked][:, which].T
            nothing = np.zeros(len(asked), bool)
            return (one, two) if point else (nothing, nothing)

        return found

    reference, ours = visibility([0, 1], theirs=True), visibility([2, 3], theirs=False)
    monkeypatch.setattr(diffuse.lambert, "reference_visibility", reference)
    monkeypatch.setattr(diffuse.lambert, "our_visibility", ours)
    images = Aovs(
        {"diffuse": given.reshape(1, count, 3), "shape_id": np.ones((1, count), int)}, np.ones((1, count), bool)
    )
    theirs = Aovs(
        {
            "position": np.tile(place[:, None], (1, 3)).reshape(1, count, 3),
            "normal": np.tile(place[:, None], (1, 3)).reshape(1, count, 3),
        },
        images.hit,
    )
    unshadowed = np.array([np.tile(POINT, (count, 1)), np.tile(SUN, (count, 1))])
    result = SimpleNamespace(
        visible=np.array([visible, np.ones(count, bool)]), unshadowed=unshadowed, ambient=np.tile(AMBIENT, (count, 1))
    )
    o = np.zeros((count, 3))
    o[:, 2] = 2.0
    pair = SimpleNamespace(
        t=np.full(count, 2.0), rays=SimpleNamespace(o=o, d=np.tile([0.0, 0.0, -1.0], (count, 1))), subject=images,
        reference=theirs, result=result, prim=place + 100,
    )  # fmt: skip
    beyond_rows = np.array([i + 1 for i, each in enumerate(LIGHT) if each[3]] + [count - 2])
    reference.rows = ours.rows = beyond_rows
    bounds = SimpleNamespace(at=at)
    found = diffuse.judge_diffuse(lit_scene(shadows), pair, bounds, rows, ("ours", "theirs"))
    assert np.flatnonzero(~(found.ratio <= 1.0)).tolist() == beyond_rows.tolist() and found.ratio[0] == 0.0
    explained = [i + 1 for i, each in enumerate(LIGHT) if each[4]]
    assert np.flatnonzero(found.explained).tolist() == (explained if shadows else [])
    assert np.flatnonzero(found.unresolvable).tolist() == [count - 2]


# ---- what is counted and listed


def judgement_of(classes, ratios=None, exact=None, cases=None, allowed=None, answered=None) -> Judgement:
    codes = np.array([CLASS_CODE[name] for name in classes])
    rows = np.arange(len(codes))
    given = np.zeros(len(codes)) if exact is None else np.array(exact, float)
    answers = [SimpleNamespace(t=1.0, prim=0)] * len(codes)
    arrays = {name: np.array(values, float) for name, values in (ratios or {}).items()}
    allowed = dict.fromkeys(arrays, 1.0) | (allowed or {})
    arrays[EXACT] = given
    return Judgement(codes, arrays, allowed, Adjudication(rows, answers, given), cases or {}, 0.0)


def test_hits_and_failures_are_counted_by_class():
    judgement = judgement_of(["agree", "agree", "wrong", "undecided", "tie", "tie"], cases={0: None, 1: 8, 2: 8, 3: 30})
    counts = aggregate.class_counts(judgement, np.array([1, 0, 0, 1, 1, 0], bool))
    assert counts == dict.fromkeys(CLASSES, 0) | {"agree": 1, "wrong": 1, "undecided": 1, "tie": 1}
    assert list(counts) == list(CLASSES)
    assert list(aggregate.defect_counts(judgement).items()) == [("8", 2), ("30", 1), ("unlisted", 1)]
    some = judgement_of(["agree", "wrong", "agree"], {"a": [0.25, 9.0, 0.5], "b": [0.125, 0.0, 0.0]}, [0.0, 5.0, 0.75])
    assert aggregate.largest_ratios(some) == {"a": 0.5, "b": 0.125, EXACT: 0.75}
    assert aggregate.largest_ratios(judgement_of(["wrong"], {"a": [3.0]})) == {"a": 0.0, EXACT: 0.0}


def test_the_cameras_shapes_and_primitives_are_counted():
    shapes = [caster.Cube(), caster.Sphere(), caster.Cube(name="b")]
    camera = caster.Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0))
    found = aggregate.scene_statistics(Scene(film=caster.Film(width=2, height=2), camera=camera, shapes=shapes))
    assert (found.camera, found.shapes, found.primitives) == ("pinhole", {"cube": 2, "sphere": 1}, 25)


# ---- statistics of errors


def test_errors_count_where_both_name_the_same_surface_within_its_bounds(monkeypatch):
    """One pixel of each kind; errors in quarters of their bounds."""
    rows = {
        "counts": {}, "exact, without error": {"t": 2.0, "t_error": 0.0}, "t beyond": {"t": 2.26},
        "t before": {"t": 1.75},
        "no bound": {"t_error": INF}, "n within": {"n": (0.25, 0.0, 1.0)}, "n beyond": {"n": (0.26, 0.0, 1.0)},
        "another shape": {"shape": 5}, "no primitive": {"prim": -1}, "no hit": {"hit": False},
        "tied beyond": {"shape": 5, "t": 9.0},
    }  # fmt: skip
    plain = {"t": 2.125, "t_error": 0.25, "n": (0.0, 0.0, 1.0), "shape": 4, "prim": 3, "hit": True}
    table = [plain | change for change in rows.values()]
    columns = {name: np.array([each[name] for each in table]) for name in plain}
    count = len(table)

    def images(n, shape):
        return Aovs({"normal": n.reshape(1, count, 3), "shape_id": shape.reshape(1, count)}, np.ones((1, count), bool))

    pair = SimpleNamespace(
        t=np.full(count, 2.0), prim=columns["prim"], subject=images(np.tile(Z, (count, 1)), np.full(count, 4)),
        reference=images(columns["n"], columns["shape"]), result=SimpleNamespace(t=columns["t"], hit=columns["hit"]),
    )  # fmt: skip
    bounds = SimpleNamespace(at=SimpleNamespace(t_error=columns["t_error"], n_error=np.full(count, 0.25)))
    seen = {}

    def groups(packed, given, at, share, rows, tied):
        assert packed == "packed" and given is pair and at is bounds
        seen.update(rows=rows.tolist(), tied=tied.tolist(), share=share[rows].tolist())
        return {"kind": ()}

    monkeypatch.setattr(aggregate, "_errors_of_kinds", groups)
    found = aggregate.pixel_errors("packed", pair, bounds)
    assert seen == {"rows": [0, 1, 3, 5], "tied": [7], "share": [0.5, 0.0, -1.0, 0.5]}
    assert found.k_t.tolist() == [2.0, 0.0, 4.0, 2.0] and found.k_normal.tolist() == [0.0, 0.0, 0.0, 4.0]
    assert found.kinds == {"kind": ()}


def test_groups_of_a_kind_are_by_its_roundings_in_the_variant(monkeypatch):
    def way(factor):
        def key(prims, k, n, o, d):
            return factor * k[:, None] + n[:, :1] + o[:, :1] + d[:, 1:2] + (1000 if prims == "b" else 0)

        return key

    references = {
        "a": SimpleNamespace(
            name="A", rounding_groups=(way(1.0), way(0.0)), rounding_groups_llvm=(way(5.0),), position_terms=None
        ),
        "b": SimpleNamespace(name="B", rounding_groups=(way(1.0),), rounding_groups_llvm=None, position_terms=None),
    }
    monkeypatch.setattr(aggregate, "kind_of", lambda prims: references[prims])
    first, start = np.array([0, 10, 20, 30]), np.array([0, 0, 10])
    packed = SimpleNamespace(
        shape_of=lambda prim: prim // 10, kind_of=np.array([0, 1, 0]), first=first, start=start,
        kinds=[SimpleNamespace(prims="a"), SimpleNamespace(prims="b")],
    )  # fmt: skip
    prim = np.array([3, 25, 3, 14, 14, 9])
    rows = np.array([0, 1, 2, 3, 4])
    share = np.array([0.25, 0.5, 0.125, 1.0, 2.0, 9.0])
    zero = np.zeros((6, 3))
    o, d, n = zero.copy(), zero.copy(), zero.copy()
    o[:, 0], d[:, 1], n[:, 0] = 0.25, 0.5, 0.125

    def found(variant, tied=()):
        pair = SimpleNamespace(
            prim=prim, t=np.full(6, 2.0), rays=SimpleNamespace(o=o.astype(np.float32), d=d.astype(np.float32)),
            result=SimpleNamespace(answer=SimpleNamespace(versions={"variant": variant})),
        )  # fmt: skip
        bounds = SimpleNamespace(own=SimpleNamespace(n=n), at=SimpleNamespace(t_error=np.full(6, 2.0**-24)))
        kinds = aggregate._errors_of_kinds(packed, pair, bounds, share, rows, np.array(tied, int))
        assert kinds["A"].quantity == "t" and kinds["A"].t_sums.tolist() == [2.0 * 0.875, 3 * 4.0]
        return {
            name: [(g.keys.ravel().tolist(), g.errors.tolist(), g.counts.tolist()) for g in errors.groups]
            for name, errors in kinds.items()
        }

    b = [([1004.875], [3.0], [2])]
    assert found("scalar_rgb") == {"A": [([3.875, 15.875], [0.375, 0.5], [2, 1]), ([0.875], [0.875], [3])], "B": b}
    assert found("llvm_ad_rgb") == {"A": [([15.875, 75.875], [0.375, 0.5], [2, 1])], "B": b}
    # two tied pixels of the second kind, of two: no evidence there
    assert found("scalar_rgb", [3, 4])["B"] == [([], [], [])]


def test_a_position_is_compared_with_ours_along_the_ray_whatever_its_barycentrics_add_up_to():
    """A face in z = 4 + x / 4, met along z: its height above the face, over what its sum is rounded from."""
    corners = np.array([[0.0, 0, 4], [4, 0, 5], [0, 4, 4]])
    prims = SimpleNamespace(vertices=corners, faces=np.array([[0, 1, 2]]))
    b1, b2 = np.float32([0.15, 0.27])
    weights = np.array([np.float32(1.0) - b1 - b2, b1, b2], np.float64)
    assert 0.1 < abs(weights.sum() - 1.0) * 2.0**24 < 2.0  # as Mitsuba has them
    p, n = weights @ corners, np.array([-1.0, 0, 4]) / np.sqrt(17.0)
    o = np.array([p[0], p[1], 0.0]).astype(np.float32)
    t = 4.0 + float(o[0]) / 4.0

    def share(t, p=p, o=o, direction=1, t_error=0.0):
        answer = SimpleNamespace(prim_uv=np.array([[b1, b2]]), p=np.array([p]))
        pair = SimpleNamespace(
            t=np.array([t]), result=SimpleNamespace(answer=answer),
            rays=SimpleNamespace(o=o[None], d=np.array([[0, 0, direction]], np.float32)),
        )  # fmt: skip
        bounds = SimpleNamespace(own=SimpleNamespace(n=n[None], t_error=np.array([t_error])))
        row = np.zeros(1, int)
        return aggregate.position_shares(TRIANGLES.position_terms, prims, row, row, pair, bounds).item()

    rounding = aggregate.KU * (np.abs(n) @ (weights @ corners)) / n[2]
    off = 0.25 * rounding
    assert share(t) == pytest.approx(0.0, abs=1e-6)
    assert share(t - off) == pytest.approx(0.25) and share(t + off) == pytest.approx(-0.25)
    behind = o + np.array([0, 0, 8], np.float32)  # the same, met from the other side
    assert share(8.0 - t - off, o=behind, direction=-1) == pytest.approx(0.25)
    assert share(t - off, t_error=rounding) == pytest.approx(0.125)
    assert share(t - 1.0) == 1.0 and share(t + 1.0) == -1.0
    assert share(t, p=np.full(3, np.nan)) == 0.0


def test_the_mean_error_of_t_is_in_roundings_and_by_how_well_t_is_resolved():
    t, t_error = np.array([1.0, 8.0, 8.0]), np.array([4.0, 4.0, 1024.0]) * 2.0**-24
    error = np.array([-0.5, -4.0, 640.0]) * 2.0**-24  # half a rounding each, but where t is hardly resolved
    total, weight = aggregate.t_roundings(error / t_error, t, t_error)
    assert total / weight == pytest.approx(-0.5, abs=0.01)


def test_statistics_of_all_windows():
    def window(k_t, k_normal, **groups):
        sums = {
            name: tuple(aggregate.group_sums(np.array(keys)[:, None], np.array(errors)) for keys, errors in ways)
            for name, ways in groups.items()
        }
        kinds = {name: aggregate.KindErrors("t", ways, np.array([-3.0, len(ways)])) for name, ways in sums.items()}
        return aggregate.PixelErrors(np.array(k_t), np.array(k_normal), kinds)

    one = window([1.0, 3.0], [0.5], A=[([1.0, 2.0], [0.5, 0.25])], B=[([1.0], [1.0])])
    two = window([2.0], [0.25, 0.125], A=[([2.0, 3.0], [0.75, -0.5])])
    found = aggregate.error_statistics([one, two])
    means = np.array([0.5, 0.5, -0.5])
    z = means.sum() / np.sqrt((means**2).sum())
    assert found.pixels == 3 and found.looseness == 2.0
    assert (found.k_t.largest, found.k_normal.largest) == (3.0, 0.5)
    assert (found.k_t.p99, found.k_normal.p99) == (pytest.approx(2.98), pytest.approx(0.495))
    expected = [("A", 3, pytest.approx(z), "t", -3.0), ("B", 1, 1.0, "t", -3.0)]
    assert [(each.kind, each.groups, each.z, each.quantity, each.t_bias) for each in found.biases] == expected
    assert aggregate.extremes(np.zeros(0)) == Extremes(0.0, 0.0)
    assert aggregate.looseness(np.zeros(0)) == aggregate.looseness(np.zeros(3)) == INF
    assert aggregate.weakest_bias([(5, -2.0), (3, 4.0), (9, 1.5)]) == (3, 1.5)
    assert aggregate.z_of_groups(aggregate.GroupSums(np.zeros((2, 1)), np.zeros(2), np.ones(2))) == (2, 0.0)


def test_tied_pixels_are_no_evidence_beyond_the_root_of_their_number():
    prim, kind = np.array([1, 1, 2, 3, 9, 9, 9, 9, 9]), np.array([0, 0, 0, 0, 1, 1, 1, 1, 1])
    assert aggregate.untied(prim, kind, np.array([1, 2]), np.array([0, 0])).all()  # 2^2 = 4
    found = aggregate.untied(prim, kind, np.array([1, 2, 1]), np.array([0, 0, 0]))
    assert found.tolist() == [False, False, False, *[True] * 6]


def test_a_lean_of_enough_groups_fails():
    from mitsuba_ref.error_model.tolerances import LARGEST_Z
    from mitsuba_ref.judge.verdict import MIN_GROUPS

    def check(*biases):
        found = ErrorStatistics(9, Extremes(), Extremes(), 1.0, biases)
        return found.z, aggregate.check_bias(found)

    few, enough = KindBias("few", MIN_GROUPS - 1, 90.0), KindBias("fine", MIN_GROUPS, -0.5 * LARGEST_Z)
    lean = KindBias("bad", MIN_GROUPS, -1.25 * LARGEST_Z)
    assert check()[1].what == "nothing to look at" and check()[0] == 0.0 and check(few)[0] == 0.0
    z, fine = check(few, enough)
    assert z == -0.5 * LARGEST_Z and fine.ratio == 0.5 and fine.ok
    assert fine.what == (
        f"few z 90.0 of {MIN_GROUPS - 1} groups, too few to tell; fine z {-0.5 * LARGEST_Z:.1f} of {MIN_GROUPS} groups"
    )
    z, bad = check(enough, lean, few)
    assert z == -1.25 * LARGEST_Z and bad.ratio == 1.25 and not bad.ok
    assert bad.what == f"t of bad is biased: z {z:.1f} of {MIN_GROUPS} groups, {LARGEST_Z:g} at most by chance"
    edge = check(KindBias("edge", MIN_GROUPS, LARGEST_Z))[1]
    assert edge.ok and edge.what.startswith("edge z ")


def test_a_verdict_of_rays_and_of_candidates():
    rays = SceneVerdict("n", "p", counts=dict.fromkeys(CLASSES, 0), rays=(100, 140), size=(8, 5))
    assert rays.ray_at(0, 0) == 100 and rays.ray_at(7, 4) == 139
    one = SceneVerdict("n", "p", counts=dict.fromkeys(CLASSES, 0), candidate="theirs")
    assert Verdict((one,)).candidate == "theirs" and Verdict((), 0, selected=("a",)).ok is False
    assert replace(Verdict((one,)), requested_candidate="mine").candidate == "mine"


# ---- ratios


def pairs(subject, reference, at=None, own=None, uv=None, **more) -> PixelPairs:
    count = len(subject["hit"])

    def images(values):
        return Aovs(
            {name: np.array(each).reshape(1, count, -1) if np.ndim(each) > 1 else np.array(each).reshape(1, count)
             for name, each in values.items() if name != "hit"}, np.array(values["hit"], bool).reshape(1, count),
        )  # fmt: skip

    bounds = SimpleNamespace(at=SimpleNamespace(**(at or {})), own=SimpleNamespace(**(own or {})))
    answer = SimpleNamespace(**more)
    length = np.array(more.get("length", np.ones(count)), float)
    return PixelPairs(images(subject), images(reference), bounds, answer, length, np.zeros((count, 3)), uv)


def ratio_of(name, pixels):
    from mitsuba_ref.judge import comparison

    return getattr(comparison, name)(pixels).tolist()


def test_hits_and_ids_are_the_same_or_not():
    both = {"hit": [1, 1, 0, 0], "shape_id": [1, 2, -1, 3], "prim_id": [5, 5, -1, 6]}
    other = {"hit": [1, 0, 1, 0], "shape_id": [1, 3, -1, 3], "prim_id": [5, 6, -1, 6]}
    found = pairs(both, other)
    assert ratio_of("mask_ratio", found) == [0.0, INF, INF, 0.0]
    assert ratio_of("shape_id_ratio", found) == ratio_of("prim_id_ratio", found) == [0.0, INF, 0.0, 0.0]


def test_t_is_held_to_its_bound_and_what_it_was_stored_as():
    hit = {"hit": [1, 1, 1, 0, 1]}
    own = {"t": np.full(5, 2.0), "t_error": np.full(5, 0.25), "possible": np.array([1, 1, 0, 0, 1], bool)}
    found = pairs(hit, {"hit": [1, 1, 1, 1, 0]}, None, own, t=np.array([2.25, 1.0, 2.0, 9.0, 2.5]), t_rounding=0.25)
    assert ratio_of("surface_ratio", found) == [0.5, 2.0, INF, 0.0, 1.0]
    assert ratio_of("depth_to_named_surface", found) == [0.5, 2.0, INF, 0.0, 0.0]


def test_depth_is_held_to_the_bound_of_t_in_scene_units_and_one_rounding():
    from mitsuba_ref.error_model.tolerances import KU_OURS

    found = pairs(
        {"hit": [1, 1, 0], "depth": [8.0, -8.0, 1.0]}, {"hit": [1, 1, 1], "depth": [9.0, -8.5, 5.0]},
        {"t_error": np.array([0.25, 0.0, 0.0])}, length=[4.0, 1.0, 1.0],
    )  # fmt: skip
    from mitsuba_ref.judge.comparison import depth_bound

    assert depth_bound(found).tolist() == [1.0 + 8.0 * KU_OURS, 8.0 * KU_OURS, KU_OURS]
    assert ratio_of("depth_ratio", found) == [1.0 / (1.0 + 8.0 * KU_OURS), 0.5 / (8.0 * KU_OURS), 0.0]


@pytest.mark.parametrize("name", ["normal", "shading_normal"])
def test_normals_are_held_to_the_reference_and_to_their_own_primitive(name):
    short = {"normal": "n", "shading_normal": "sh"}[name]
    error = f"{short}_error"
    value = {"normal": "n", "shading_normal": "sh_n"}[name]
    subject = {"hit": [1, 1, 1], name: [[0.5, 0, 0], [0.5, 0, 0], [0.5, 0, 0]]}
    reference = {"hit": [1, 1, 0], name: [[0.25, 0, 0], [0.25, 0, 0], [0, 0, 9.0]]}
    own = {value: np.array([[0.0, 0, 0]] * 3), error: np.array([0.25, 1.0, 0.25])}
    found = pairs(subject, reference, {error: np.array([0.5, 0.125, 0.5])}, own)
    assert ratio_of(f"{name}_ratio", found) == [2.0, 2.0, 0.0]


def test_uv_of_another_face_are_held_to_that_face_wherever_both_hit_and_mitsuba_has_uv(monkeypatch):
    """Points of uv are uv + (face, 0): of face 1, Mitsuba's are off by as much as from what its own t gives."""
    prim, theirs = np.array([0, 1, -1, 0, 0, 2]), np.array([1, 0, 1, -1, 0, 1])
    uv = np.array([[[0.25, 0.5]] * 6])
    reference_uv = uv + 2.0**-10
    calls = []

    def at(model, other, lines, t, ku, *, ours):
        calls.append((other.tolist(), lines[0][:, 0].tolist(), t.tolist(), ours))
        off = uv[0, : len(other)] + 2.0**-9
        return SimpleNamespace(uv=np.column_stack([off[:, 0] + other, off[:, 1]]), uv_error=np.full(len(other), 7.0))

    monkeypatch.setattr(classification, "intersections_at", at)
    model = SimpleNamespace(
        uv_points=lambda prim, uv, ours: np.column_stack([uv[:, 0] + prim, uv[:, 1]]),
        reference_has_uv=lambda prim: prim != 2,
    )
    hit = np.ones((1, 6), bool)
    pair = SimpleNamespace(subject=Aovs({"uv": uv}, hit), reference=Aovs({"uv": reference_uv}, hit))
    numbers = np.arange(6.0)
    judge = SimpleNamespace(
        prim=prim, reference_prim=theirs, pair=pair, model=model, reference_t=numbers,
        reference_lines=(numbers[:, None], numbers[:, None], numbers),
        bounds=SimpleNamespace(at=SimpleNamespace(uv_error=np.ones(6))),
    )  # fmt: skip
    found = classification.Judge._uv_pair(judge)
    assert calls == [([1, 0], [0.0, 1.0], [0.0, 1.0], False)]
    assert found.bound.tolist() == [7.0, 7.0, 1.0, 1.0, 1.0, 1.0]
    off = np.array([-(2.0**-10)] * 2 + [2.0**-10] * 3 + [0.0])  # of the two, 2^-10 less 2^-9
    assert np.array_equal(found.reference, found.subject + off[:, None])


def test_uv_is_compared_in_the_space_of_its_kind():
    uv = UvPair(np.array([[1.0, 0, 0]] * 3), np.array([[0.5, 0, 0]] * 3), np.array([0.25, 1.0, 1.0]))
    own = {"uv": np.array([[0.0, 0, 0]] * 3), "uv_error": np.array([1.0, 0.5, 0.25])}
    values = {"hit": [1, 1, 0], "uv": [[9.0, 9.0]] * 3}
    found = pairs(values, {"hit": [1, 1, 1], "uv": [[9.0, 8.0]] * 3}, {"uv_error": np.full(3, 7.0)}, own, uv)
    assert ratio_of("uv_ratio", found) == [2.0, 2.0, 0.0] and found.distance("uv").tolist() == [0.5] * 3
    assert ratio_of("uv_bound", found) == [0.25, 1.0, 1.0]
    plain = pairs(values, {"hit": [1, 1, 1], "uv": [[9.0, 8.0]] * 3}, {"uv_error": np.full(3, 7.0)}, own)
    assert ratio_of("uv_bound", plain) == [7.0] * 3 and plain.distance("uv").tolist() == [1.0] * 3


def test_a_self_check_fails_beyond_its_bound_where_it_counts():
    found = SelfCheck("n", np.array([1.0, 1.1, 1.1, NAN]), np.ones(4), np.array([True, True, False, True]))
    assert found.fails.tolist() == [found.fails_at(row) for row in range(4)] == [False, True, False, True]


def test_allowances_are_of_quantities_with_bounds():
    check_allowances({"depth": None, "uv": None})
    for name in ("mask", "shape_id", "nonsense"):
        with pytest.raises(
            SceneError, match=rf"^check\.{name}: is compared exactly or not at all; there are bounds of depth, "
        ):
            check_allowances({"depth": None, name: None})


def test_a_subject_that_names_no_primitives_has_none():
    answer = Answer(np.array([1.0, INF]), None, "float64", {})
    pair = ImagePair(SimpleNamespace(), answer, None, None, None)
    assert pair.prim.tolist() == [-1, -1] and pair.t.tolist() == [1.0, INF]


def test_images_of_an_answer_count_depth_from_the_eye():
    from mitsuba_ref.judge.comparison import _images_of
    from mitsuba_ref.subjects.subject import NOT_FINITE

    rays = SimpleNamespace(start=np.array([1.0, 2.0]), d=np.array([[0.0, 0, 2.0], [3.0, 4.0, 0]], np.float32))
    n = np.array([[0.0, 0, 1.0], [1.0, 0, 0]])
    answer = Answer(np.array([3.0, INF]), n, "float64", {}, shape_id=np.array([4, 5]))
    found = _images_of(answer, rays, (2, 1))
    assert found["depth"].tolist() == [[7.0], [INF]] and found.hit.tolist() == [[True], [False]]
    assert found["normal"].tolist() == n.reshape(2, 1, 3).tolist() and found["shape_id"].tolist() == [[4], [5]]
    assert set(found) == {"depth", "normal", "shape_id"}
    marked = {NOT_FINITE: np.array([True, False])}
    broken = replace(answer, shape_id=None, prim_id=np.array([7, 8]), broken=marked)
    found = _images_of(broken, rays, (1, 2))
    assert np.isnan(found["normal"][0, 0]).all() and found["normal"][0, 1].tolist() == [1.0, 0.0, 0.0]
    assert found["prim_id"].tolist() == [[7, 8]] and set(found) == {"depth", "normal", "prim_id"}
    assert set(_images_of(Answer(answer.t, None, "float64", {}), rays, (1, 2))) == {"depth"}
    pair = ImagePair(rays, answer, found, None, SimpleNamespace(hit=np.array([False, False])))
    assert pair.any_hit.tolist() == [True, False] and pair.shape == (1, 2) and pair.length.tolist() == [2.0, 5.0]
    pair.result.hit[1] = True
    assert pair.any_hit.all()


def test_checks_are_of_what_an_answer_has():
    from mitsuba_ref.judge.comparison import checks_of

    def names(uv=None, **given):
        plain = {"prim": None, "hits_only": False, "n": None, "shape_id": None, "prim_id": None}
        pixels = SimpleNamespace(answer=SimpleNamespace(**(plain | given)), uv=uv)
        return [check.name for check in checks_of(pixels)]

    own = ["mask", "shape_id", "on_surface", "depth", "position", "normal", "shading_normal"]
    assert names(prim=1) == own and names(1, prim=1) == [*own, "uv"]
    assert names() == ["mask", "depth"] and names(hits_only=True) == ["mask"]
    for name, check in (("n", "normal"), ("shape_id", "shape_id"), ("prim_id", "prim_id")):
        assert names(**{name: 1}) == ["mask", "depth", check]


def test_what_is_allowed_is_a_share_of_the_bound():
    from mitsuba_ref.judge.comparison import Comparison, compare

    ratios = {"a": np.array([0.5, 0.51, 0.2, NAN]), "b": np.array([1.0, 0.0, 1.1, 0.0])}
    found = Comparison(ratios, {"a": 0.5, "b": 1.0})
    assert found.agrees.tolist() == [True, False, False, False] and found.derived.tolist() == [True, True, False, False]
    hit = {"hit": [1, 0], "shape_id": [1, -1]}
    given = pairs(hit, {"hit": [1, 1], "shape_id": [2, 1]}, prim=None, hits_only=True, n=None, shape_id=1, prim_id=None)
    found = compare(given, {"diffuse": SimpleNamespace(ratio=0.25), "other": SimpleNamespace(ratio=9.0)})
    assert found.allowed == {"mask": 1.0, "shape_id": 1.0, "diffuse": 0.25}
    assert {name: ratio.tolist() for name, ratio in found.ratios.items()} == {
        "mask": [0.0, INF],
        "shape_id": [INF, INF],
    }


def test_normals_and_positions_are_held_to_the_surface_that_is_named():
    hit = {"hit": [1, 1, 1], "position": [[0.5, 0, 0]] * 3}
    own = {"n": np.zeros((3, 3)), "n_error": np.full(3, 0.25), "p_error": np.array([0.25, 1.0, 1.0])}
    n = np.array([[0.5, 0, 0], [0.125, 0, 0], [0.5, 0, 0]])
    reference = {"hit": [1, 1, 0], "position": [[0.25, 0, 0]] * 3}
    found = pairs(hit, reference, {"p_error": np.array([1.0, 0.125, 1.0])}, own, n=n)
    assert ratio_of("normal_of_named_surface", found) == [2.0, 0.5, 0.0]
    assert ratio_of("position_ratio", found) == [2.0, 2.0, 0.0]


def test_self_checks_hold_what_float64_resolves():
    from mitsuba_ref.judge.comparison import fails_self_check, self_checks

    images = {name: [[0.5, 0, 0]] * 4 for name in ("normal", "shading_normal", "position")} | {"hit": [1, 1, 1, 0]}
    zero = np.zeros((4, 3))
    own = {
        "n": zero, "sh_n": zero + np.array([0.25, 0, 0]), "n_error": np.full(4, 0.5), "sh_error": np.full(4, 0.125),
        "p_error": np.full(4, 0.5), "t_error": np.array([0.0, INF, 1.0, 1.0]),
        "uv": zero, "uv_error": np.array([1, 1, 0.5, 1]),
    }  # fmt: skip
    uv = UvPair(zero + np.array([0.75, 0, 0]), zero, np.ones(4))
    found = list(self_checks(pairs(images, images, None, own, uv, prim=np.array([0, 4, 5, -1]))))
    assert [(check.name, check.counts.tolist(), check.fails.tolist()) for check in found] == [
        ("normal", [True, True, True, False], [False] * 4),
        ("shading_normal", [True, False, True, False], [True, False, True, False]),
        ("position", [True, False, True, False], [False] * 4),
        ("uv", [True, False, True, False], [False, False, True, False]),
    ]  # fmt: skip
    assert [check.error[0] for check in found] == [0.5, 0.25, 0.5, 0.75]
    assert (
        fails_self_check(found, 4).tolist() == [True, False, True, False]
        and fails_self_check([], 2).tolist() == [False] * 2
    )
    assert len(list(self_checks(pairs(images, images, None, own, prim=np.zeros(4, int))))) == 3
    assert not list(self_checks(pairs(images, images, None, own, prim=None)))

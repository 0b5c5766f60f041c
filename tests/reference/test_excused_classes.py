"""The classes explained and out_of_domain excuse rounding and nothing else."""

import numpy as np
import pytest
from mitsuba_scenes import lit_scene
from places import SCENES

import caster
from caster.rendering.hits import RayHits
from caster.scene.files import load_scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.classification import Judge, Judgement
from mitsuba_ref.judge.explanations import reason
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import EXPLAINED, JUDGED_WITHOUT_REFERENCE
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.report.verdict_text import failure_text


@pytest.fixture(scope="module")
def shaded(brought) -> Judge:
    """A scene with many pixels that are excused: their rays pass through edges, exactly."""
    return brought(load_scene(SCENES / "shared-edges-icosphere.toml"))


@pytest.fixture(scope="module")
def first(shaded) -> Judgement:
    """The judgement of its unaltered pixels."""
    return shaded.judge()


@pytest.mark.parametrize("name", ["diffuse", "depth", "position", "normal"])
@pytest.mark.slow("each judges a scene", keep=2)
def test_an_excused_pixel_has_to_be_right_by_our_own_arithmetic(shaded, first, name):
    before, excused = (first.classes, first.is_class(*JUDGED_WITHOUT_REFERENCE) & shaded.subject.hit.ravel())
    assert 50 <= excused.sum() < len(excused) // 10
    image = aov_rows(shaded.subject, name)
    kept = image.copy()
    image[excused] = 1.5 * image[excused] + 0.1
    try:
        after = Judge(shaded.scene, shaded.model, shaded.pair).judge()
    finally:
        image[:] = kept
    # A depth contradicts our own hit, whatever exact arithmetic says.
    assert np.all(after.is_class("undecided" if name == "depth" else "wrong")[excused])
    assert np.array_equal(after.classes[~excused], before[~excused])


def test_more_excuses_than_evidence_do_not_pass(judged):
    """Every ray meets the rim of a ball, exactly: float32 may miss it."""
    wall = caster.Disk(to_world=[{"translate": [0.0, 1.0, 0.0]}])
    camera = caster.Orthographic(eye=(0, 0, 3), direction=(0, 0, -1), width=2.0**-40)
    found = judged(lit_scene(wall, camera=camera))
    assert not found.ok and found.failing == 0 and found.counts["reference_wrong"] == 0
    assert found.counts[EXPLAINED] >= found.evidence
    told = f"too little evidence: {found.evidence} pixels agree or tie, {found.excused} are only excused"
    assert told in failure_text(found)


def test_a_plane_edge_on_excuses_neither_what_stands_before_it_nor_beside_it(judged, monkeypatch):
    """Rays lie in the plane up to rounding: intersections with it are undefined. The ball is judged as usual."""
    shapes = (caster.Sphere(), caster.Plane(normal=(0, 0.6, 0.8), offset=0))
    camera = caster.Orthographic(eye=(0, -4, 3), direction=(0, 0.8, -0.6), up=(0, 0, 1), width=1.5)
    scene = lit_scene(*shapes, camera=camera)
    assert judged(scene).ok
    evaluate = RayHits.evaluate

    def with_turned_normals(hits, aovs, *dtype):
        return {aov: -rows if aov == "normal" else rows for aov, rows in evaluate(hits, aovs, *dtype).items()}

    monkeypatch.setattr(RayHits, "evaluate", with_turned_normals)
    found = judged(scene)
    assert not found.ok and found.counts["wrong"] > 0.9 * found.hit_pixels


@pytest.mark.parametrize("first", [True, False])
def test_a_doubtful_shadow_counts_whichever_place_its_light_has(first):
    """Pixel centres lie on a shadow's border, exactly; six more lights are in no doubt."""
    others = [caster.Point(position=(i, 0.5, 9), intensity=(1, 1, 1)) for i in range(9)]
    sun = [caster.Directional(direction=(-1, -1, 0), irradiance=(1, 1, 1))]
    roof = caster.Rectangle(
        to_world=[{"rotate": {"axis": [1, 0, 0], "degrees": -90}}, {"translate": [0.125, 1, 0.125]}]
    )
    scene = lit_scene(
        caster.Plane(normal=(0, 1, 0), offset=0),
        roof,
        camera=caster.Orthographic(eye=(0, 5, 0), look_at=(0, 0, 0), up=(0, 0, 1), width=8),
        film=caster.Film(width=32, height=32),
        lights=sun + others if first else others + sun,
    )
    found = validate_scene(Task(scene, "shadow"), keep=True)
    assert found.ok and found.counts["explained"] > 0, found
    judge, judgement = found.seen.judge, found.seen.judgement
    reasons = {reason(judge, judgement, {}, int(row)) for row in np.flatnonzero(judgement.is_class(EXPLAINED))}
    assert any(each.startswith("a shadow: both sides see the same point") for each in reasons)


@pytest.mark.parametrize("name", ["depth", "position", "normal", "shading_normal", "uv", "diffuse"])
def test_a_scene_may_request_less_than_the_derived_bound(judged, name):
    strict = lit_scene(caster.Sphere(), checks={name: {"ratio": 1e-6}})
    found = judged(strict)
    assert not found.ok and found.counts["undecided"] > 100
    assert f"beyond the share of the bound that [check.{name}] allows" in failure_text(found)
    lax = judged(lit_scene(caster.Sphere(), checks={name: {"ratio": 2.0}}))
    assert lax.ok and lax.allowed == {name: 2.0}


def test_a_check_that_nothing_would_heed_is_refused(judged):
    with pytest.raises(caster.SceneError, match=r"check.shape_id: shape_id has no bound to scale"):
        judged(lit_scene(caster.Sphere(), checks={"shape_id": {"ratio": 0.1}}))

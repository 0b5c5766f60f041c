"""Each class of a pixel is reached by a scene or a planted fault, and the failing classes fail."""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from edited_tree import ROOT, run
from mitsuba_scenes import lit_scene, scene_judge
from outputs import json_of
from places import shipped

import caster
from caster.aovs import Aovs
from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32
from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref import shapes as judges_model
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.classification import AGREEING_PIXELS_ADJUDICATED, CLASS_CODE, Judge
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import FAILING, UNLISTED, Verdict
from mitsuba_ref.oracle.oracle import Oracle, OutsideDomain
from mitsuba_ref.probe.pixel import probe_with_evidence
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.mitsuba_process import SendRequest
from mitsuba_ref.reference.shared_input import shared_rays
from mitsuba_ref.report.reproducers import involved_prims, reproducer
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.report.verdict_text import failure_text, summary_text
from mitsuba_ref.subjects import subject
from mitsuba_ref.subjects.subject import cast_ours

TURN = [{"rotate": {"axis": [1, 2, 3], "degrees": 37}}]


# A skinny triangle nearly edge-on, which the ray misses. Mitsuba hits it, with operations fused or not, and 180 lengths
# away: the signs that decide come before any reciprocal, so they are the same on every CPU with either.
H = float.fromhex
SKINNY = caster.Triangle(
    vertices=[
        [H("0x1.4d8dbep+6"), H("0x1.d3404p+5"), H("0x1.fea0fap+5")],
        [H("0x1.451a8ap+6"), H("0x1.83cd9cp+5"), H("0x1.1239dcp+6")],
        [H("0x1.4e11e2p+6"), H("0x1.c6e7cp+5"), H("0x1.00ec7p+6")],
    ]
)
PAST = caster.Ray(
    origin=[H("0x1.014626p+9"), H("0x1.ae318cp+7"), H("-0x1.2bf190p+8")],
    direction=[H("-0x1.76effap-1"), H("-0x1.1ca8acp-2"), H("0x1.3e49eap-1")],
)


def starting_on_a_disk() -> Scene:
    """Rays start in a window, some of them on a disk that lies in it: Mitsuba reports a hit at t = 0 for these."""
    camera = caster.Orthographic(eye=(0, 0, 3), direction=(0, 0, -1), width=4)
    small = caster.Disk(name="start", to_world=[{"scale": [0.4, 0.4, 1]}, {"translate": [0.4, 0.1, 3]}])
    return lit_scene(small, caster.Plane(name="floor", normal=(0.1, 0, 1), offset=0), camera=camera)


# ---- tie ----


def without(send: SendRequest, name: str) -> SendRequest:
    """Mitsuba has one shape less: it names the other of two that coincide.

    Which of them it names otherwise belongs to its BVH, and so to the CPU.
    """

    def trimmed(request: TraceRequest, timeout: float) -> TraceResponse | Crash:
        tree = ElementTree.parse(request.xml)
        (shape,) = (each for each in tree.getroot().iter("shape") if each.get("id") == name)
        tree.getroot().remove(shape)
        tree.write(request.xml)
        return send(request, timeout)

    return trimmed


COINCIDENT = {
    "quads": (caster.Rectangle(name="a", to_world=TURN, material="a"), caster.Rectangle(name="b", to_world=TURN)),
    "balls": (caster.Sphere(name="a", material="a"), caster.Sphere(name="b")),
    "disks": (caster.Disk(name="a", to_world=TURN, material="a"), caster.Disk(name="b", to_world=TURN)),
}
MATERIALS = {"a": {"reflectance": (0.9, 0.1, 0.1)}}


@pytest.mark.parametrize("shapes", COINCIDENT.values(), ids=COINCIDENT)
@pytest.mark.slow("each judges a film twice", keep=1)
def test_of_coincident_surfaces_either_may_be_the_one(send, shapes):
    scene = lit_scene(*shapes, materials=MATERIALS)
    for missing, verdict in (("a", "tie"), ("b", "agree")):  # ours names a, the first
        found = validate_scene(Task(scene, "scene", send=without(send, missing)))
        assert found.ok and found.counts[verdict] == found.hit_pixels >= 200, found.counts
        assert found.evidence > 0 == found.excused


def test_a_tie_has_to_be_right_by_float64_all_the_same(send):
    judge = scene_judge(lit_scene(*COINCIDENT["balls"], materials=MATERIALS), send=without(send, "a"))
    before = judge.judge()
    tied = before.is_class("tie")
    aov_rows(judge.subject, "diffuse")[tied] += 0.1
    after = judge.judge()
    assert tied.sum() >= 200 and after.is_class("wrong")[tied].all()
    assert np.array_equal(after.classes[~tied], before.classes[~tied])


# ---- reference_wrong ----


def test_a_ray_that_starts_on_a_surface_does_not_hit_it_there(judged):
    found = judged(starting_on_a_disk())
    wrong = found.counts["reference_wrong"]
    assert found.ok and 10 <= wrong < found.evidence and found.cases == {"30": wrong}, found
    text = summary_text(Verdict((found,)), 1.0)
    assert f"ref. wrong: {wrong} pixels of case 30, a ray that starts on a flat surface" in text
    assert UNLISTED.upper() not in text


def test_a_reference_that_is_wrong_everywhere_is_no_evidence(judged):
    camera = caster.Pinhole(eye=(0, 0, 5), look_at=(0, 1, 0), fov=40)
    floor = caster.Plane(normal=(0, 1, 0), offset=0)
    found = judged(lit_scene(floor, caster.Sphere(center=(0, 1, 0)), camera=camera))
    assert not found.ok and found.counts["reference_wrong"] > 800 and found.failing == 0
    assert "the reference is wrong at 864 pixels and right at 0, so it is no evidence about ours here" in failure_text(
        found
    )


def test_a_triangle_nearly_edge_on_is_out_of_domain(judged):
    scene = Scene(film=caster.Film(width=1, height=1), camera=PAST, shapes=[SKINNY])
    found = judged(scene)
    assert found.counts["out_of_domain"] == 1 and not found.cases and found.failing == 0
    assert not found.ok  # one ray that float32 does not resolve says nothing about ours


def altered_export(monkeypatch: pytest.MonkeyPatch, shape: type, change: Any) -> None:
    """The exporter writes other numbers of this shape than were packed."""
    known = judges_model.REFERENCES[shape]
    altered = replace(known, to_xml=lambda out, one, part: known.to_xml(out, one, change(part)))
    monkeypatch.setitem(judges_model.REFERENCES, shape, altered)


BALL = caster.Sphere(name="ball", center=(-0.6, 0, 0))
LID = caster.Disk(name="lid", to_world=[{"translate": [1, 0, 0]}])
WALL = caster.Rectangle(name="wall", to_world=[{"scale": 9}, {"translate": [0, 0, -2]}])
EXPORTS = {
    "a disk that is too large": (caster.Disk, lambda part: part._replace(to_world=1.03 * part.to_world)),
    "a disk turned round": (caster.Disk, lambda part: part._replace(to_world=part.to_world * [1, 1, -1])),
    "a ball a little too small": (caster.Sphere, lambda part: part._replace(radius=part.radius * (1 - 3e-6))),
}


@pytest.mark.parametrize("what", EXPORTS)
def test_a_broken_exporter_is_no_defect_of_mitsuba(judged, monkeypatch, what):
    """Ours is right and the reference is wrong in a minority of the pixels, but by no known defect."""
    scene = lit_scene(WALL, BALL, LID)
    assert judged(scene).ok
    shape, change = EXPORTS[what]
    altered_export(monkeypatch, shape, change)
    found = judged(scene)
    assert not found.ok and found.cases[UNLISTED] == found.failing >= 3, found.cases
    assert found.counts["reference_wrong"] < found.evidence
    assert not any(found.counts[name] for name in FAILING)
    assert f"{found.failing} reference wrong in no known way" in failure_text(found)
    assert f"UNLISTED:   {found.failing} pixels" in summary_text(Verdict((found,)), 1.0)


# ---- wrong ----


@pytest.fixture(scope="module")
def one_cube(brought) -> Judge:
    return brought(shipped("shared-edges-cube", 25, 25))


@pytest.fixture
def cube(one_cube) -> Judge:
    """A judge whose images a test may alter."""
    pair = one_cube.pair
    images = {name: image.copy() for name, image in pair.subject.items()}
    answer = replace(pair.answer, prim=one_cube.subject_prim.copy())
    altered = replace(pair, subject=Aovs(images, pair.subject.hit.copy()), answer=answer)
    return Judge(one_cube.scene, one_cube.model, altered)


def test_ours_is_wrong_where_exact_arithmetic_states_it_though_both_agree(cube):
    """Two triangles of one face, and a ray through the edge between them: the same t, normal and shape."""
    before = cube.judge()
    tied = [row for row in before.exact.rows if (a := before.exact.of(row)) is not None and len(a.ties) == 2]
    rows = np.array([row for row in tied if before.classes[row] == CLASS_CODE["agree"]])
    assert len(rows) >= 10
    for row in rows:
        other = before.exact.of(row).ties[1].prim
        cube.subject_prim[row] = other
        aov_rows(cube.subject, "prim_id")[row] = other
    after = Judge(cube.scene, cube.model, cube.pair).judge()
    assert all((after.ratios[name][rows] <= 1.0).all() for name in after.ratios if name != "exact")
    assert after.is_class("wrong")[rows].all() and after.is_class("wrong").sum() == len(rows)
    assert np.isinf(after.ratios["exact"][rows]).all()


RIM = caster.Ray(origin=(1, 0, 3), direction=(0, 0, -1))


def test_a_caster_that_misses_at_a_rim_is_wrong_whatever_mitsuba_states(monkeypatch):
    """Float32 may miss the rim as well as hit it, and the bracket of float64 allows a miss, too."""
    scene = lit_scene(caster.Disk(), camera=RIM, film=caster.Film(width=1, height=1), lights=[])
    right = probe_with_evidence(scene, 0, 0)[0]
    assert right.ok and right.exact["ties"] == [{"shape": "shape-0", "prim": 0, "where": "rim"}]

    def misses(scene, rays):
        view = cast_ours(scene, rays)
        nothing = view.nearest._replace(t=np.array([np.inf]), prim=np.array([-1], np.int32))
        return replace(view, nearest=nothing)

    monkeypatch.setattr(subject, "cast_ours", misses)
    found = probe_with_evidence(scene, 0, 0)[0]
    assert (found.verdict, found.ok, found.exact) == ("wrong", False, right.exact)
    assert found.why.startswith("missed; exact arithmetic hits; beyond their bounds: ")
    assert not {"diffuse", "depth"} & set(found.ratios) and "mask" in found.ratios  # a share of 0 looks like agreement


def test_what_cannot_be_decided_is_undecided(cube, monkeypatch):
    before = cube.judge()
    asked = before.exact.rows
    refused = set(asked[::7].tolist())
    lines = {(*cube.o[row], *cube.d[row]) for row in refused}
    real = Oracle.first_hits

    def refuses(self, o, d, t_min=0.0, t_max=np.inf):
        if any((*a, *b) in lines for a, b in zip(o, d, strict=True)):
            raise OutsideDomain("planted")
        return real(self, o, d, t_min, t_max)

    monkeypatch.setattr(Oracle, "first_hits", refuses)
    after = cube.judge()
    undecided = set(np.flatnonzero(after.is_class("undecided")).tolist())
    assert undecided == refused and len(refused) >= 20


# ---- who is asked ----


def test_edges_disputes_and_a_sample_are_requested(brought):
    scene = lit_scene(BALL, LID, film=caster.Film(width=90, height=60))
    judge = brought(scene)
    found = judge.judge()
    hit = judge.subject_prim >= 0
    asked = np.isin(np.arange(len(hit)), found.exact.rows)
    image = np.pad(hit.reshape(60, 90), 1)
    beside = np.zeros((60, 90), bool)
    for dy in range(3):
        for dx in range(3):
            beside |= image[dy : dy + 60, dx : dx + 90]
    border = beside.ravel() & ~hit
    assert border.sum() >= 100 and asked[border].all()
    assert asked[hit & ~judge.at.certain].all()
    assert found.exact.answered.all() and found.exact.right.all()
    rest = asked & ~border & judge.at.certain & hit
    assert AGREEING_PIXELS_ADJUDICATED * 0.1 < rest.sum() <= AGREEING_PIXELS_ADJUDICATED


# ---- reproducers ----


def test_a_reproducer_holds_the_very_numbers_and_shows_the_same(brought):
    judge = brought(shipped("every-shape", 64, 60))
    packed, kinds = judge.model.packed, set()
    shapes = aov_rows(judge.subject, "shape_id")
    for row in (np.flatnonzero(shapes == shape)[0] for shape in np.unique(shapes[shapes >= 0])):
        alone, prims = reproducer(judge, int(row))[0], sorted(involved_prims(judge, int(row)))
        (ray,) = zip(*(getattr(shared_rays(alone), name) for name in ("o", "d", "t_max")), strict=True)
        for mine, name in zip(ray, ("o", "d", "t_max"), strict=True):
            theirs = getattr(judge.rays, name)[row]
            assert np.asarray(mine + 0.0).tobytes() == np.asarray(theirs + 0.0).tobytes()
        again = pack(alone, as_float32)
        assert len(again.parts) == len(prims) and int(judge.subject_prim[row]) in prims
        for part, prim in zip(again.parts, prims, strict=True):
            kinds.add(type(part))
            shape = int(packed.shape_of(np.array([prim]))[0])
            assert type(packed.parts[shape]) is type(part)
        assert len(again.parts) < len(packed.parts)  # what is far from the ray is left out
    assert len(kinds) >= 5, kinds


def test_the_command_validate_stores_a_few_and_states_of_how_many(tmp_path):
    scene = tmp_path / "start.toml"
    scene.write_text("# Start.\n" + starting_on_a_disk().to_toml(), encoding="utf-8")
    out = tmp_path / "out"
    found = run(ROOT, "validate", str(scene), "--out", str(out))
    assert found.returncode == 0, found.stdout + found.stderr
    (verdict,) = json_of(out / "verdict.json")["scenes"]
    files = sorted(path.name for path in out.glob("*.toml"))
    assert files == sorted(verdict["reproducers"]) and len(files) == 2
    assert all(name.startswith("start.case-30.") for name in files)
    left = verdict["cases"]["30"] - 2
    assert verdict["not_stored"] == left > 5
    assert f"stored:     2 scenes of one ray each; {left} more pixels are like them" in found.stdout
    again = probe_with_evidence(load_scene(out / files[0]), 0, 0)[0]
    assert (again.verdict, again.case, again.ok) == ("reference_wrong", "30", True)

"""A correct candidate passes; a wrong one fails with the place and the cause."""

import importlib.util
import os
import re
import runpy
from pathlib import Path
from typing import Any

import candidates
import numpy as np
import pytest
from marks import each_shipped_scene
from outputs import json_of, unfolded
from places import ROOT, SHIPPED, shipped

import caster
from caster.cameras.single_ray import Ray
from caster.image.exr import read_exr
from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref.__main__ import main
from mitsuba_ref.judge.aggregate import NEVER_GIVEN
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import CLASSES, EXPLAINED, REFERENCE_WRONG, TIE, WRONG, SceneCheck, SceneVerdict, Verdict
from mitsuba_ref.report.builtin_scenes import scene_path
from mitsuba_ref.report.validation import Validation, validate_scene
from mitsuba_ref.report.verdict_text import failure_text, summary_text
from mitsuba_ref.subjects.function import FunctionSubject

pytestmark = pytest.mark.usefixtures("remembered")
LARGE_SCENES = {"hills-131072-triangles", "two-thousand-spheres"}  # for a loop over all of them


def small(name: str, width: int = 24, height: int = 18) -> Scene:
    return shipped(name, width, height)


def worked(name: str) -> candidates.Trace:
    """`trace` of a module of docs/candidates."""
    return runpy.run_path(str(ROOT / f"docs/candidates/{name}.py"))["trace"]


def judged(trace: candidates.Trace, scene: Scene, precision: str | None = None) -> SceneVerdict:
    """The verdict on a candidate; Mitsuba traces each scene once for all of them."""
    subject = FunctionSubject(trace.__name__, trace, precision)
    return validate_scene(Task(scene, "scene", "scenes/scene.toml", subject=subject))


# ---- who is right ----


def supported(scene: Scene) -> bool:
    """The hits of docs/candidates/plain.py."""
    shapes = scene.shapes
    flat = not any(shape.type in ("disk", "cylinder", "ellipsoids", "linear_curve") for shape in shapes)
    return flat and not any(shape.type in ("sphere", "spheres") and shape.to_world for shape in shapes)


@each_shipped_scene
@pytest.mark.slow("every shipped scene, twice", every=7)
def test_ours_as_a_candidate_and_a_plain_float32_caster_pass(path):
    scene = small(path.stem, 16, 12)
    tried = [candidates.ours, candidates.ours_rounded]
    if supported(scene) and path.stem not in LARGE_SCENES:
        tried.append(worked("plain"))
    for trace, precision in zip(tried, ("float64", "float32", "float32"), strict=False):
        found = judged(trace, scene)
        assert found.ok, failure_text(found)
        assert found.precision == precision and found.counts[WRONG] == 0
        assert found.unjudged == NEVER_GIVEN


def test_what_is_not_given_is_not_judged_and_stated_so():
    found = judged(candidates.without_normals, small("one-sphere"))
    assert found.ok and found.unjudged == ("normal", *NEVER_GIVEN) and "normal" not in found.ratios
    told = summary_text(Verdict((found,)), 1.0)
    assert "not judged: normal, position, shading normal, uv, shape id, diffuse" in told
    assert "candidate:  without_normals, held to the bounds of float64" in told


# ---- who is wrong ----

FAULTS = [
    (candidates.one_nan, "no answer: t is NaN"),
    (candidates.one_missed_edge_pixel, "missed; exact arithmetic hits"),
    (candidates.one_hit_beside_the_edge, "a hit; exact arithmetic misses"),
]


@pytest.mark.parametrize(("trace", "says"), FAULTS, ids=[trace.__name__ for trace, _ in FAULTS])
def test_one_wrong_pixel_fails_and_is_named(trace, says):
    """Faults of many pixels are in mistakes.py."""
    found = judged(trace, small("one-sphere"))
    assert not found.ok and not found.problem and found.counts[WRONG] == 1
    told = failure_text(found)
    (first,) = found.findings
    assert says in first.what and first.what in told.splitlines()[0] and told.count(first.what) == 1
    assert (found.failures[0].x, found.failures[0].y) == (first.x, first.y)
    assert f"1 wrong of {found.hit_pixels} hit pixels" in told and "ours" not in told


def test_a_surface_behind_the_first_is_named_so():
    found = judged(candidates.the_last_surface, small("closest-of-several"))
    assert not found.ok and "a surface that lies behind the first one" in found.findings[0].what


def bias_of(found: SceneVerdict) -> SceneCheck:
    (bias,) = (check for check in found.checks if check.name == "t_bias")
    return bias


def scaled(roundings: int, dtype: type) -> candidates.Trace:
    """Our hits, rounded to dtype, with every t longer by a number of its roundings."""
    u = float(np.finfo(dtype).epsneg)

    @candidates.altered
    def trace(t: np.ndarray, n: np.ndarray) -> candidates.Given:
        return (t * (1.0 + roundings * u)).astype(dtype), n.astype(dtype)

    return trace


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("roundings", "passes"), [(0, True), (2, True), (-2, True), (6, False), (-6, False)])
def test_one_factor_on_every_t_fails_within_the_bounds(dtype, roundings, passes):
    found = judged(scaled(roundings, dtype), small("teapot", 60, 45))
    bias = bias_of(found)
    assert found.ok is bias.ok is passes and not found.counts[WRONG], bias.what
    measured = float(bias.what.split()[4])
    assert measured == pytest.approx(roundings, abs=1.0), bias.what


def estimated(x: np.ndarray, power: float) -> np.ndarray:
    """x^power, -1 or -1/2, in float32 as x86 does it: an estimate of 12 bits and one Newton step."""
    significand, exponent = np.frexp(x.astype(np.float64) ** power)
    first = np.ldexp(np.round(significand * 2.0**12) / 2.0**12, exponent).astype(np.float32)
    one = np.float32(1.0)
    return first * (one + one - x * first) if power == -1.0 else first * (1.5 * one - 0.5 * one * x * first * first)


def moeller_trumbore(reciprocal: Any, root: Any) -> candidates.Trace:
    """t in float32 along a direction of unit length, at the triangles that ours names; |d| is divided in float64."""

    def trace(scene: Scene, o: np.ndarray, d: np.ndarray) -> candidates.Given:
        hits = caster.cast(scene, o, d)
        (mesh,) = (shape.mesh() for shape in scene.shapes)
        a, b, c = mesh.vertices[mesh.faces[hits.prim_id]].astype(np.float32).transpose(1, 0, 2)
        length = (d.astype(np.float32) ** 2).sum(axis=1)
        o, unit = o.astype(np.float32), d.astype(np.float32) * root(length)[:, None]
        inverse = reciprocal(((b - a) * np.cross(unit, c - a)).sum(axis=1))
        t = inverse * ((c - a) * np.cross(o - a, b - a)).sum(axis=1) / np.linalg.norm(d, axis=1)
        return np.where(np.isfinite(hits.t), t, np.inf).astype(np.float32), hits.normal.astype(np.float32)

    return trace


HONEST = {
    "divisions": (lambda x: np.float32(1.0) / x, lambda x: np.float32(1.0) / np.sqrt(x)),
    "estimates": (lambda x: estimated(x, -1.0), lambda x: estimated(x, -0.5)),
}


@pytest.mark.parametrize("how", HONEST)
def test_reciprocals_and_roots_in_float32_are_no_factor(how):
    found = judged(
        moeller_trumbore(*HONEST[how]), load_scene(scene_path("builtin:scan-size-1e3")).with_film(width=64, height=64)
    )
    bias = bias_of(found)
    assert found.ok and "of 16" in bias.what and bias.ratio < 0.5, bias.what


def moved_origin(scene: Scene, o: np.ndarray, d: np.ndarray) -> candidates.Given:
    """Ours in float32, with every ray's origin moved by one vector of a few roundings."""
    far = o + 3.0 * np.abs(o).max() * 2.0**-24 * np.array([1.0, -1.0, 1.0])
    return candidates.ours_rounded(scene, far, d)


def test_one_shift_of_every_origin_is_rounding_and_no_factor():
    """A caster that moves rays to the space of an instance rounds their origin once for all."""
    found = judged(moved_origin, small("teapot"))
    bias = bias_of(found)
    assert bias.ok and bias.ratio < 0.3, bias.what


@pytest.mark.parametrize("t", [0.0, 1e-20, 2.0], ids=["closed", "closed, rounded", "open"])
def test_whether_a_ray_hits_the_surface_it_starts_on_is_the_candidates_choice(t):
    """Mitsuba reports a hit at t = 0 for these rays."""
    walls = [{"type": "triangle", "vertices": [(-4, -4, z), (8, -4, z), (-4, 8, z)]} for z in (0, 2)]
    camera = Ray(origin=(0.5, 0.25, 0.0), direction=(0.0, 0.0, 1.0))
    scene = Scene.model_validate({"camera": camera, "shape": walls}).with_film(width=1, height=1)

    def trace(scene: Scene, o: np.ndarray, d: np.ndarray) -> candidates.Given:
        found, n = candidates.ours(scene, o, d)
        return np.where(o[:, 2] == 0.0, t, found), n

    found = judged(trace, scene)
    assert found.counts == {**dict.fromkeys(CLASSES, 0), (TIE if t < 1.0 else REFERENCE_WRONG): 1}, found
    assert found.checks_pass


def all_misses_in_float32(scene, o, d):
    return np.full(len(o), np.inf, np.float32), np.zeros((len(o), 3), np.float32)


@pytest.mark.parametrize("name", ["shared-edges-icosphere", "shared-edges-cube"])
def test_a_leak_at_an_edge_that_faces_share_is_no_rounding(name):
    """Pixel centres lie exactly on edges: neither face is certain to be hit, but one of the two is."""
    scene = small(name, 25, 25)
    right = judged(candidates.ours_rounded, scene)
    assert right.ok and right.counts[EXPLAINED] + right.counts[TIE] > 5
    found = judged(all_misses_in_float32, scene)
    assert found.counts[EXPLAINED] <= 0.01 * found.hit_pixels  # where corners meet, nothing is promised
    assert found.counts[WRONG] + found.not_adjudicated >= 0.99 * found.hit_pixels


# ---- no answer at all ----


class Leaving:
    """An array type that ends the program with exit code 0 when it is converted."""

    def __array__(self, dtype=None, copy=None):
        raise SystemExit(0)


class Speechless(BaseException):
    def __str__(self):
        raise ValueError


def speechless(scene, o, d):
    raise Speechless


def talkative(scene, o, d):
    raise RuntimeError("\x1b[31m" + 100_000 * "x")


@candidates.altered
def masked(t, n):
    """Right numbers in a masked array."""
    return np.ma.masked_array(t, mask=np.isfinite(t)), n


def leaving(scene, o, d):
    raise SystemExit(0)


ANSWERS = [
    (leaving, "raised SystemExit: 0"),
    (lambda scene, o, d: (np.zeros(len(o)), o[:, :2]), "n: expected shape (n, 3) = (432, 3), got (432, 2)"),
    (lambda scene, o, d: (np.zeros(len(o), int), None), "t: expected float32 or float64 numbers, got int64"),
    (lambda scene, o, d: ([10**400] * len(o), None), "t: expected float32 or float64 numbers, got object"),
    (lambda scene, o, d: (Leaving(), None), "t is no array: SystemExit: 0"),
    (lambda scene, o, d: ((v for v in o), None), "t: expected an array of shape (n,) = (432,), got generator"),
    (masked, "values are masked; fill them, such as t.filled(inf)"),
    (speechless, "raised Speechless: (its message raises ValueError)"),
    (talkative, "\\u001b[31mxxx"),
]


@pytest.mark.parametrize(("trace", "says"), ANSWERS, ids=[says for _, says in ANSWERS])
def test_an_answer_of_another_form_is_a_problem_and_never_a_pass(trace, says):
    found = judged(trace, small("one-sphere"))
    assert not found.ok and says in found.problem and says in failure_text(found)
    assert not Verdict((found,)).ok


@candidates.altered
def far_normals(t, n):
    return t, 1e300 * n


@candidates.altered
def odd_arrays(t, n):
    """Arrays that are read-only, in Fortran order, of swapped byte order, or views of one another."""
    both = np.asfortranarray(np.column_stack([t, n]).astype(">f8"))
    both.flags.writeable = False
    return both[:, 0], both[:, 1:]


def leaving_things_behind(scene, o, d):
    """Change the working folder and NumPy's error state, and print something."""
    os.chdir("/")
    np.seterr(all="raise")
    print("not a result")
    return candidates.ours(scene, o, d)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("trace", [far_normals, odd_arrays, leaving_things_behind])
def test_how_a_right_answer_is_stored_does_not_count(trace, capsys):
    here, errors = Path.cwd(), np.geterr()
    assert judged(trace, small("one-sphere")).ok
    assert (Path.cwd(), np.geterr()) == (here, errors) and capsys.readouterr().out == ""


@candidates.altered
def far_t(t, n):
    return np.where(np.isfinite(t), 1e308, t), n


def nonsense(scene, o, d):
    rng = np.random.default_rng(5)
    odd = np.array([np.nan, -np.inf, 1e308, -1e308, 5e-324, -0.0, 1e-300, 1.0])
    return rng.choice(odd, len(o)), rng.choice(odd, o.shape)


WILD = [(far_t, "t is off: behind what is hit"), (nonsense, "no answer: the normal is not finite on a hit")]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("trace", "says"), WILD, ids=[trace.__name__ for trace, _ in WILD])
def test_wild_numbers_are_wrong_in_the_ordinary_way(trace, says, tmp_path):
    """There is no warning, and images are written although 1e308 exceeds what they can hold."""
    candidate, scene = FunctionSubject(trace.__name__, trace), small("one-sphere", 12, 9)
    found = validate_scene(Task(scene, "wild", "wild.toml", subject=candidate), folder=tmp_path, keep=True)
    assert not found.problem and found.counts[WRONG] > 20 and says in found.findings[0].what
    assert (read_exr(tmp_path / "wild.verdict.exr").channels["class.I"] == CLASSES.index(WRONG)).any()
    assert np.isfinite(read_exr(tmp_path / "wild.candidate.exr").channels["depth.Z"]).sum() > 20
    assert Validation((found,)).write_html(tmp_path / "wild").exists()


def interrupted(scene, o, d):
    raise KeyboardInterrupt


def test_an_interrupted_run_names_the_candidate_though_no_scene_is_done(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    file = tmp_path / "v.json"
    words = ["validate", str(SHIPPED[0]), "--size", "8", "6", "--candidate", "test_candidates:interrupted"]
    words += ["--json", str(file), "--html", str(tmp_path / "report"), "--junit", str(tmp_path / "j.xml")]
    assert main(words) == 130
    out = capsys.readouterr().out
    assert "candidate:  test_candidates:interrupted" in out and "agree" in out and "ours" not in out
    told = json_of(file)
    assert told["candidate"] == "test_candidates:interrupted" and "wrong" in told["counts"]
    assert '"candidate":"test_candidates:interrupted"' in (tmp_path / "report/index.html").read_text()


def test_the_command_line_has_exit_codes_files_and_a_precision(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    one = ["validate", "scenes/one-sphere.toml", "--size", "24", "18", "--candidate"]
    assert main([*one, "docs.candidates.plain:trace", "--out", str(tmp_path), "--candidate-precision", "float32"]) == 0
    out = capsys.readouterr().out
    assert "PASS  one-sphere" in out and " wrong" not in out  # classes without pixels are left out
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"verdict.json"} | {f"one-sphere.{part}.exr" for part in ("candidate", "reference", "verdict")}
    picture = read_exr(tmp_path / "one-sphere.candidate.exr").channels
    assert {"A", "depth.Z", "normal.X"} <= picture.keys() and picture["A"].sum() > 50
    classes = read_exr(tmp_path / "one-sphere.verdict.exr")
    assert (classes.channels["A"] >= picture["A"]).all() and "5 wrong" in classes.provenance["caster/classes"]
    assert "5 #ff0000" in classes.provenance["caster/class_colors"]
    assert main([*one, "docs.candidates.textbook:trace", "--candidate-precision", "float64"]) == 0
    assert main([*one[:1], "scenes/inside-sphere.toml", *one[2:], "docs.candidates.textbook:trace"]) == 1
    assert "first root is behind the ray's origin" in unfolded(capsys.readouterr().out)


# ---- the worked examples ----


def test_the_textbook_caster_is_right_on_a_sphere_and_reported_what_is_wrong_inside_of_one():
    trace = worked("textbook")
    assert judged(trace, small("one-sphere")).ok
    far = judged(trace, small("far-small-spheres"))  # b^2 - 4 a c cancels
    assert not far.ok and "t is off: " in failure_text(far)
    found = judged(trace, small("inside-sphere"))
    assert not found.ok
    assert found.findings[0].what.startswith("missed: the surface's first root is behind the ray's origin")
    assert found.findings[0].pixels > 0.5 * found.hit_pixels


@pytest.mark.parametrize(("page", "package"), [("embree", "embreex"), ("open3d", "open3d")])
def test_the_peers_pass(page, package):
    """The code of their recipes. The run's header names those that are not installed."""
    text = (ROOT / f"docs/recipes/{page}.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n# \w+\.py\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed: pip install 'ray-reference[peers]'")
    names: dict[str, Any] = {}
    exec(code, names)
    trace = names.get("trace_with_our_normals", names["trace"])
    assert judged(trace, small("torus-smooth"), getattr(trace, "precision", None)).ok


def test_moeller_and_trumbore_from_the_last_corner_are_right_at_needles():
    def trace(scene, o, d):
        o, d, t_hit, n_hit = (*(v.astype(np.float32) for v in (o, d)), np.full(len(o), np.float32(np.inf)), 0.0 * o)
        for a, b, c in scene.triangles().astype(np.float32):
            e1, e2, s = a - c, b - c, o - c
            across, q = np.cross(d, e2), np.cross(s, e1)
            with np.errstate(all="ignore"):
                u, v, t = np.array([(s * across).sum(axis=1), (d * q).sum(axis=1), q @ e2]) / (across @ e1)
            hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < t_hit)
            t_hit[hit], n_hit[hit] = t[hit], np.cross(e1, e2)
        return t_hit, n_hit.astype(np.float32)

    needles = load_scene(scene_path("builtin:needles")).with_film(width=32, height=32)
    found = validate_scene(Task(needles, "needles", subject=FunctionSubject("mine", trace)))
    assert found.ok and found.counts["agree"] >= 200, failure_text(found)

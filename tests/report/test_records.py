"""Records of scenes for their pages, without a browser: to the bit where promised, never too small elsewhere."""

import base64
import zlib

import numpy as np
import planted
import pytest
import textbook_pages

import caster
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.judge.verdict import UNLISTED
from mitsuba_ref.report.evidence import film_edges, project_points
from mitsuba_ref.report.html_report import index_row
from mitsuba_ref.report.scene_record import FLOAT_LAYERS, coarse, narrowest, packed, scene_record
from mitsuba_ref.report.validation import Validation


def unpacked(array, like=None):
    """The way back, as mitsuba_ref/report/page/arrays.js has it, in a few lines of NumPy."""
    kind = np.dtype(array["type"])
    planes = np.frombuffer(zlib.decompress(base64.b64decode(array["z"])), np.uint8).reshape(kind.itemsize, -1)
    bits = np.ascontiguousarray(planes.T).view(f"u{kind.itemsize}").ravel()
    if "delta" in array:
        bits = np.cumsum(bits, dtype=bits.dtype)
    if "xor" in array:
        bits = bits ^ np.where(np.isnan(like), 0.0, like).astype(kind).view(bits.dtype)
    return bits.view(kind)


# ---- of a candidate


def test_a_record_has_what_the_candidate_gives_and_no_more(judged):
    assert set(scene_record(judged["inside"].seen).layers) == {"ids", "ratio", "depth", "normal", "edges"}
    assert set(scene_record(judged["single"].seen).layers) == {"ids", "ratio", "depth", "edges"}
    ids = scene_record(judged["inside"].seen).layers["ids"]
    assert set(ids) == {"shape_reference", "prim_reference", "t_reference", "t_ours"}
    assert set(scene_record(judged["inside"].seen).layers) < {"ids", "ratio", *FLOAT_LAYERS, "edges"}
    assert judged["single"].unjudged == ("normal", "position", "shading_normal", "uv", "shape_id", "diffuse")


@pytest.mark.parametrize("name", ["inside", "single"])
def test_t_is_what_the_function_returned_to_the_bit(judged, name):
    expected = textbook_pages.RETURNED[name]
    ids = scene_record(judged[name].seen).layers["ids"]
    reference = unpacked(ids["t_reference"])
    assert np.array_equal(reference, judged[name].seen.judge.result.t)
    assert np.array_equal(unpacked(ids["t_ours"], reference), expected)
    assert 0 < np.isfinite(expected).sum() < len(expected)


def test_what_is_no_answer_is_nan_and_never_zero():
    verdict = planted.judged_candidate("gaps", textbook_pages.trace_with_gaps, planted.scene())
    found = scene_record(verdict.seen)
    sides = {}
    for name, channels in (("depth", 1), ("normal", 3)):
        layer = found.layers[name]
        ours = unpacked(layer["ours"], unpacked(layer["reference"]))
        sides[name] = ours.reshape(channels, -1)
    no_normal, no_t = map(planted.row_of, (textbook_pages.NO_NORMAL, textbook_pages.NO_T))
    assert np.isnan(sides["normal"][:, no_normal]).all() and np.isnan(sides["depth"][:, no_t]).all()
    assert np.isnan(sides["normal"]).sum() == 3 and np.isnan(sides["depth"]).sum() == 1
    assert [finding.what for finding in verdict.findings] == [
        "no answer: t is NaN",
        "no answer: the normal is not finite on a hit",
    ]


def test_rows_and_pages_name_the_candidate(judged, tmp_path):
    assert "wrong" in index_row(judged["inside"], None)["counts"]
    index = Validation(tuple(judged.values())).write_html(tmp_path / "page")
    text = index.read_text(encoding="utf-8")
    assert '"candidate":"docs.candidates.inside:trace"' in text and f'"wrong","undecided","{UNLISTED}"' in text


# ---- arrays

ODD = [0.0, -0.0, 1.5, -2.25, np.inf, -np.inf, np.nan, 5e-324, 1e-45, 3.4e38, np.pi]


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32, np.uint8])
def test_what_goes_in_comes_out_to_the_bit(dtype):
    numbers = np.random.default_rng(4).normal(0.0, 40.0, (300, 3))
    values = numbers.astype(dtype) if dtype != np.uint8 else np.abs(numbers).astype(dtype)
    assert unpacked(packed(values)).tobytes() == np.ascontiguousarray(values.T).tobytes()


def test_bits_are_taken_off_the_reference_and_put_back():
    with np.errstate(over="ignore"):
        reference = np.array(ODD, np.float64).astype(np.float32)
    ours = np.array([*ODD[3:], *ODD[:3]], np.float64)
    for mine, theirs in ((ours, reference), (ours, reference.astype(np.float64))):
        assert unpacked(packed(mine, theirs), theirs).tobytes() == mine.tobytes()


def test_float32_only_where_nothing_is_lost():
    assert narrowest(np.array([1.5, np.nan, np.inf])).dtype == np.float32
    assert narrowest(np.array([1.5, 0.1])).dtype == np.float64


def test_shares_are_never_reported_smaller_than_they_are():
    numbers = 10.0 ** np.random.default_rng(4).uniform(-50.0, 50.0, 5000)
    told = coarse(numbers).astype(np.float64)
    assert np.all(told >= numbers)
    normal = (numbers > 2e-38) & (numbers < 3e38)
    assert np.all(told[normal] <= numbers[normal] * (1.0 + 2.0**-11 + 2.0**-22))


# ---- projected edges

VIEW = {"eye": (1, 2, 5), "look_at": (0.3, 0, 0)}
STRAIGHT = {
    "pinhole": caster.Pinhole(**VIEW, fov=50.0),
    "shifted": caster.Pinhole(**VIEW, principal_point=(0.2, -0.1)),
    "upside down": caster.Pinhole(**VIEW, up=(0, -1, 0.3), fov=100.0),
    "orthographic": caster.Orthographic(**VIEW, width=3.0),
}


@pytest.mark.parametrize("camera", STRAIGHT.values(), ids=STRAIGHT)
def test_a_point_on_a_ray_is_projected_to_the_centre_of_its_pixel(camera):
    film = caster.Film(width=20, height=14)
    scene = caster.Scene(camera=camera, film=film, shapes=[caster.Sphere()])
    y, x = np.mgrid[0:14, 0:20].reshape(2, -1) + 0.5
    rays = reference_of_camera(camera).rays(camera, film, x, y)
    points = rays.o + np.linspace(0.5, 70.0, len(x))[:, None] * rays.d
    assert np.abs(project_points(scene, points) - np.column_stack([x, y])).max() < 1e-9
    behind = project_points(scene, rays.o - 9.0 * rays.d)
    assert np.isnan(behind).all() == (camera.type != "orthographic")


def test_edges_of_the_triangles_that_are_hit_are_drawn():
    cube = caster.Scene(film=caster.Film(width=24, height=20), shapes=[caster.Cube()], camera=STRAIGHT["pinhole"])
    verdict = planted.judged_candidate("cube", lambda scene, o, d: (np.full(len(o), np.inf), None), cube)
    judge, judgement = verdict.seen.judge, verdict.seen.judgement
    hit = np.unique(judge.reference_prim[judge.reference_prim >= 0])
    edges = film_edges(judge, judgement)
    assert len(hit) == 4 and edges.shape == (12, 4)
    corners = project_points(cube, judge.model.packed.kinds[0].prims.vertices)
    assert np.abs(edges.reshape(-1, 1, 2) - corners).max(axis=2).min(axis=1).max() < 1e-4

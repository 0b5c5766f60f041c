"""Films judged in bands: the verdict is that of the whole film, and memory does not grow with it."""

import numpy as np
import pytest
from candidates import ours
from places import shipped

import caster
from mitsuba_ref.judge import classification, pipeline
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import AGREE, CLASSES, WRONG
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.subjects.function import function_subject

SIZE, BAND = (60, 42), 420  # six bands of seven rows


@pytest.fixture
def small_bands(monkeypatch):
    """A switch of bands, small enough for several in these films."""

    def switch(on: bool) -> None:
        monkeypatch.setattr(pipeline, "LARGEST_WHOLE_FILM", BAND if on else 1 << 20)
        monkeypatch.setattr(pipeline, "BAND_PIXELS", BAND)

    return switch


def scene(name: str) -> caster.Scene:
    return shipped(name, SIZE[0], SIZE[1])


@pytest.mark.parametrize("window", [(0, 0, 60, 42), (3, 5, 57, 40), (7, 0, 8, 42)])
def test_bands_are_whole_rows_that_make_up_the_window(small_bands, window):
    small_bands(True)
    whole = scene("one-sphere").with_film(crop=window)
    bands = [band.film.window for band in Task(whole, "").windows()]
    assert [y for _, first, _, end in bands for y in range(first, end)] == list(range(window[1], window[3]))
    assert {(x0, x1) for x0, _, x1, _ in bands} == {(window[0], window[2])}
    assert all((x1 - x0) * (y1 - y0) <= BAND for x0, y0, x1, y1 in bands)
    assert (len(bands) == 1) == ((window[2] - window[0]) * (window[3] - window[1]) <= BAND)


def test_a_film_that_is_wider_than_a_band_is_judged_row_by_row(small_bands, monkeypatch):
    small_bands(True)
    monkeypatch.setattr(pipeline, "BAND_PIXELS", 10)
    assert len(Task(scene("one-sphere"), "").windows()) == SIZE[1]


# Triangles with shared edges, a plane whose stand-in depends on the rays, a crop, a near plane, quadrics and lights.
@pytest.mark.parametrize(
    "name", ["torus-smooth", "plane-edge-on-pinhole", "crop-window", "near-far-clip", "every-shape"]
)
@pytest.mark.slow("each judges a film twice", keep=2)
def test_the_verdict_is_that_of_the_whole_film(small_bands, send, name):
    small_bands(False)
    whole = validate_scene(Task(scene(name), name, send=send))
    small_bands(True)
    bands = validate_scene(Task(scene(name), name, send=send))
    assert whole.ok and bands.ok, (whole.problem, bands.problem)
    assert (bands.pixels, bands.hit_pixels, bands.counts) == (whole.pixels, whole.hit_pixels, whole.counts)
    assert bands.cases == whole.cases and bands.size == whole.size
    assert [check.name for check in bands.checks] == [check.name for check in whole.checks]
    assert {"render", "sensor", "bias", "geometry", "knife_edges"} <= {c.name for c in bands.checks}
    assert bands.notes[0].startswith("judged in ") and not whole.notes


def test_rays_of_every_band_reach_mitsuba_once(small_bands, send):
    counts = []

    def counting(request, timeout):
        counts.append(len(request.o))
        return send(request, timeout)

    small_bands(True)
    assert validate_scene(Task(scene("one-sphere"), "one-sphere", send=counting)).ok
    assert counts == [BAND] * 6


def with_wrong_normals_below(scene, o, d):
    """Right, except in the lower part of the film."""
    t, n = ours(scene, o, d)
    return t, np.where((d[:, 1] < -0.12 * np.abs(d[:, 2]))[:, None], -n, n)


def test_a_fault_in_some_bands_fails_with_all_its_pixels_and_the_evidence_of_one_band(
    small_bands, send, tmp_path, monkeypatch
):
    monkeypatch.setattr(classification, "WRONG_PIXELS_ADJUDICATED", 60 * 42)  # of each band as of the whole: all
    subject = function_subject(with_wrong_normals_below)
    found = {}
    for on in (False, True):
        small_bands(on)
        found[on] = validate_scene(
            Task(scene("one-sphere"), "s", subject=subject, send=send), keep=True, folder=tmp_path
        )
    whole, bands = found[False], found[True]
    assert not bands.ok and bands.counts == whole.counts and 0 < bands.counts[WRONG] < bands.counts[AGREE] * 2
    assert bands.failing_by == whole.failing_by and set(bands.worst_by) == set(whole.worst_by)
    assert {f.what: f.pixels for f in bands.findings} == {f.what: f.pixels for f in whole.findings}
    x0, y0, x1, y1 = bands.seen.judge.scene.film.window
    assert (x1 - x0, y1 - y0) == (60, 7) and any(f"rows {y0} to {y1 - 1}" in note for note in bands.notes)
    assert all(y0 <= failure.y < y1 for failure in (bands.failures[0], bands.findings[0]))  # which the page can show
    assert (bands.seen.judgement.classes == CLASSES.index(WRONG)).any()
    files = sorted(path.name for path in tmp_path.glob("s.rows-*.verdict.exr"))
    assert len(files) == 6 and files[-1] == "s.rows-00035-00041.verdict.exr"


def test_a_crash_in_one_band_is_the_problem_of_the_scene(small_bands, send):
    calls = []

    def crashing(request, timeout):
        calls.append(request)
        return Crash(-6, "LLVM ERROR", 0.1) if len(calls) == 3 else send(request, timeout)

    small_bands(True)
    found = validate_scene(Task(scene("one-sphere"), "s", send=crashing))
    assert not found.ok and found.problem.startswith("rows 14 to 20: ") and "LLVM ERROR" in found.problem
    assert len(calls) == 3

"""`mitsuba-ref probe` lists every answer for a ray with its error, as text and as JSON."""

import json
import re

import numpy as np
import pytest
from mitsuba_scenes import scene_judge
from places import scene_of

import caster
from mitsuba_ref.__main__ import main
from mitsuba_ref.probe.pixel import STAND_IN_PIXELS, stand_in_rays

# Along an edge of the mesh within a rounding, where Embree lets the ray slip through unless it is told to be robust.
EDGE = """
# A ray on the edge of two faces.
[film]
width = 1
height = 1
[camera]
type = "ray"
origin = [0, 0, 0]
direction = ["0x1.73f45a0000000p-2", "-0x1.7922120000000p-2", "0x1.a40c1e0000000p-1"]
[[shape]]
type = "icosphere"
name = "ball"
subdivisions = 1
"""


def test_one_pixel_does_not_cost_what_the_film_does():
    """A plane's patch is cut to the film's rays, of a larger film to fewer with the same view."""
    ball, floor = (
        scene_of(shape, film={"width": 20000, "height": 20000})
        for shape in (caster.Sphere(), caster.Plane(offset=-1.0))
    )
    assert stand_in_rays(ball) is None and len(stand_in_rays(floor).d) <= STAND_IN_PIXELS


@pytest.mark.slow("waits for a time-out")
def test_mitsuba_may_be_given_less_time(here, capsys):
    (here / "edge.toml").write_text(EDGE)
    assert main(["probe", "edge.toml", "0", "0", "--timeout", "0.001"]) == 1
    assert re.search(r"Mitsuba ended without an answer \(killed after 0\.0\d+ s\)", capsys.readouterr().out)


@pytest.fixture(scope="module")
def probed(tmp_path_factory):
    """A folder with that ray."""
    folder = tmp_path_factory.mktemp("probe")
    (folder / "edge.toml").write_text(EDGE)
    return folder


@pytest.fixture(scope="module")
def said(probed):
    import contextlib
    import io

    out, err = io.StringIO(), io.StringIO()
    words = ["probe", str(probed / "edge.toml"), "0", "0", "--json"]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([*words, "--save", str(probed / "repro.toml")])
    return code, json.loads(out.getvalue()), err.getvalue()


def test_all_witnesses_speak_and_the_mode_that_leaks_is_named(said):
    code, found, _ = said
    rows = {row["who"]: row for row in found["witnesses"]}
    assert [*rows][:2] == ["ours", "exact"] and len(rows) >= 4
    assert code == 0 and found["verdict"] in ("agree", "tie")
    assert rows["ours"]["right"] and rows["exact"]["right"] and rows["mitsuba scalar_rgb robust"]["right"]
    leaks = rows["mitsuba scalar_rgb default"]
    assert (leaks["right"], leaks["shape"], leaks["t"], leaks["ulps"]) == (False, "miss", "inf", None)


def test_a_witness_is_off_by_so_many_units_of_its_own_last_place(said):
    _, found, _ = said
    exact = found["exact"]["t"]
    for row in found["witnesses"]:
        if row["right"] and row["who"] != "exact":
            ulp = float(np.spacing(np.asarray(exact).astype(row["format"])))
            # The exact t is not a float64: what is compared with here is off by half a unit of float64.
            assert row["off"] == pytest.approx(row["t"] - exact, abs=np.spacing(exact))
            assert row["ulps"] == pytest.approx(row["off"] / ulp)
            assert abs(row["ulps"]) < 16.0
    formats = {row["who"].split()[0]: row["format"] for row in found["witnesses"] if row["who"] != "exact"}
    assert formats == {"ours": "float64", "mitsuba": "float32"}


@pytest.mark.parametrize(
    ("kind", "off", "right"),
    [("float64", 1e-15, True), ("float64", 1e-12, False), ("float32", 1e-7, True), ("float32", 1e-5, False)],
)
def test_a_witness_on_the_right_surface_at_a_wrong_distance_is_wrong(probed, kind, off, right):
    from mitsuba_ref.probe.witnesses import WitnessAnswer, compared_with_exact, surface_of, witness_lines

    judge = scene_judge(caster.load_scene(probed / "edge.toml"))
    exact = judge.oracle.first_hit(judge.o[0], judge.d[0], t_max=judge.t_max[0])
    t = float(exact.t) * (1.0 + off)
    said = WitnessAnswer("somebody", *surface_of(judge, exact.prim), t, format=kind)
    saying = compared_with_exact(said, judge, exact)
    assert saying.right is right and (saying.share <= 1.0) is right
    (line,) = witness_lines((saying,))
    assert ("WRONG" in line and "x its bound" in line) is not right


def test_the_text_has_sections_within_80_columns_and_may_be_brief(probed, capsys):
    main(["probe", str(probed / "edge.toml"), "0", "0"])
    head, *sections = capsys.readouterr().out.split("\n\n")
    titles = [section.partition("\n")[0] for section in sections]
    assert head.startswith("pixel (0, 0) of ") and titles[:3] == ["who is right", "the ray", "t, in lengths of d"]
    assert {"normal", "depth", "share of each bound that our error uses"} <= set(titles)
    long = [line for section in sections[:-1] for line in section.splitlines() if len(line) > 80]
    assert not long and "mitsuba scalar_rgb default   WRONG    miss\n" in sections[0] + "\n"
    main(["probe", str(probed / "edge.toml"), "0", "0", "--brief"])
    assert capsys.readouterr().out == f"{head}\n\n{sections[0]}\n"


def test_the_reproducer_is_written(said, probed):
    assert "repro.toml: written; it " in said[2]
    alone = caster.load_scene(probed / "repro.toml")
    assert alone.film.width == 1 and len(alone.shapes) in (1, 2)

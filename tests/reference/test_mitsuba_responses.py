"""Responses of the child process equal Mitsuba's own results: ids, hits, light and sensor rays."""

from typing import Any

import numpy as np
import pytest
from mitsuba_scenes import VARIANTS, film, has_t, job, point_light, random_mesh, shape, sun, write
from places import scene_of
from programs import printed_by

import caster
import mitsuba_ref
from mitsuba_ref.reference import mitsuba_process, variants
from mitsuba_ref.reference.messages import Crash, TraceResponse
from mitsuba_ref.reference.rendering import render_reference

HERE = VARIANTS if variants.usable_variants().libllvm else VARIANTS[:1]  # the run's header says which
U = 2.0**-24

GROUP = '<shape type="shapegroup" id="group"><shape type="sphere" id="unit"/></shape>'
REF = '<ref id="group"/>'
SHAPES_APART = {  # where each shape's middle is: none covers another
    "ball": shape("sphere", "ball", -4, 2),
    "square": shape("rectangle", "square", 0, 2),
    "lid": shape("disk", "lid", 4, 2),
    "tube": shape("cylinder", "tube", -4, -2, stretch="1 1 3"),
    "egg 1": shape("instance", "egg 1", 0, -2, REF, "1.5 1 1"),
    "egg 2": shape("instance", "egg 2", 4, -2, REF, "1 1.5 2"),
    "box": shape("cube", "box", 0, 6),
    "strewn": '<shape type="ply" id="strewn"><string name="filename" value="strewn.ply"/></shape>',
}


def asked(*args: Any, **kwargs: Any) -> TraceResponse:
    """The response to a request by mitsuba_scenes.job."""
    answer = mitsuba_process.send_request(job(*args, **kwargs), 120.0)
    assert isinstance(answer, TraceResponse), answer
    return answer


@pytest.fixture
def many(tmp_path):
    """Every kind of shape, and lights among them."""
    corners = random_mesh(tmp_path / "strewn.ply", np.random.default_rng(1))
    light = point_light("0 3 9", "1 2 3")
    return write(tmp_path, "\n".join([GROUP, light, *SHAPES_APART.values(), sun("0.2 -1 -1", "3 2 1")])), corners


@pytest.mark.parametrize("variant", HERE)
def test_a_hit_names_its_shape_and_an_instance_goes_before_what_it_repeats(many, variant):
    aimed = {"ball": (-4, 2), "square": (0, 2), "lid": (4, 2), "egg 1": (0, -2), "egg 2": (4, -2), "box": (0, 6)}
    tube = {"tube": ((-6, -2.1, 1), (1, 0, 0))}
    down = {name: ((x + 0.3, y + 0.1, 9), (0, 0, -1)) for name, (x, y) in aimed.items()} | tube
    answer = asked(many[0], variant, *zip(*down.values(), strict=True))
    assert answer.names == list(SHAPES_APART)
    assert [answer.names[k] for k in answer.shape] == list(down)


@pytest.mark.parametrize("variant", HERE)
def test_prim_is_the_triangle_that_was_hit(many, variant):
    xml, corners = many
    middles = corners.mean(axis=1)
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    n /= np.linalg.norm(n, axis=1)[:, None]
    answer = asked(xml, variant, middles + 1e-3 * n, -n, 2e-3)
    assert np.array_equal(answer.prim, np.arange(len(corners)))
    assert {answer.names[k] for k in answer.shape} == {"strewn"}


@pytest.mark.parametrize("variant", HERE)
def test_a_miss_is_inf_minus_one_and_zero(many, variant):
    answer = asked(many[0], variant, [[0, 2, 9], [0, 2, 9]], [[0, 0, 1], [0, 0, -1]])
    assert has_t(answer, np.inf, 9.0)
    assert answer.shape[0] == answer.prim[0] == -1 and answer.shape[1] >= 0
    for name in ("n", "sh_n", "p", "uv", "albedo"):
        assert not getattr(answer, name)[0].any(), name
    assert not answer.light_rgb[:, 0].any() and not answer.light_visible[:, 0].any()
    assert answer.light_rgb[:, 1].all() and answer.light_visible[:, 1].all()


@pytest.mark.parametrize("variant", HERE)
def test_t_counts_in_lengths_of_d_and_ends_at_t_max(many, variant):
    rays = [[0, 2, 9]] * 2, [[0, 0, -1], [0, 0, -4]]
    assert has_t(asked(many[0], variant, *rays), 9.0, 2.25)
    assert has_t(asked(many[0], variant, *rays, t_max=8.5), np.inf, 2.25)


@pytest.mark.parametrize("variant", HERE)
def test_lights_come_in_the_order_of_the_document(tmp_path, variant):
    """Each of 24 lights shines straight down on the floor, with its number as its strength."""
    lights = [point_light("0 0 1", f"{k} {k} {k}") if k % 3 else sun("0 0 -1", f"{k} {k} {k}") for k in range(1, 25)]
    floor = shape("rectangle", "floor", 0)
    content = "\n".join([*lights[:7], floor, *lights[7:]])
    answer = asked(write(tmp_path, content), variant, [[0, 0, 0.5]], [[0, 0, -1]])
    expected = np.arange(1, 25)[:, None] * np.array([0.5, 0.25, 0.75]) / np.pi
    assert np.allclose(answer.light_rgb[:, 0], expected, rtol=8 * U, atol=0)


TWO_SIDED = '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>'
LIT = "\n".join(
    [
        '<sensor type="perspective"><float name="fov" value="50"/><transform name="to_world">'
        f'<lookat origin="0.3,-1,7" target="0,0,0" up="0,1,0"/></transform>{film(40, 30)}</sensor>',
        GROUP,
        shape("sphere", "ball", -1, 1),
        shape("instance", "egg", 1, -0.5, REF, "1.5 1 1"),
        shape("disk", "back", 2.4, 1, TWO_SIDED, "1 1 -1"),
        shape("disk", "dark", -2.4, -1, stretch="1 1 -1"),
        '<shape type="rectangle" id="wall"><transform name="to_world">'
        f'<matrix value="9 0 1 0 0 9 0 0 -1 0 9 -2 0 0 0 1"/></transform>{TWO_SIDED}</shape>',
    ]
)
RENDER = """
import sys
import mitsuba as mi, numpy as np
mi.set_variant(sys.argv[1])
scene = mi.load_file(sys.argv[2], optimize=False)
np.save(sys.argv[3], np.array(mi.render(scene, integrator=mi.load_dict({"type": "direct"}), spp=1))[..., :3])
"""


CUBE = """
import sys
import mitsuba as mi, numpy as np
mi.set_variant(sys.argv[1])
cube = mi.traverse(mi.load_dict({"type": "cube"}))
columns = [np.array(cube[f"vertex_{name}"]).reshape(24, -1) for name in ("positions", "normals", "texcoords")]
np.save(sys.argv[2], np.column_stack(columns))
"""


@pytest.mark.parametrize("variant", HERE[:1])
def test_uv_of_a_cube_grow_along_the_axes_of_mitsubas_own(tmp_path, variant):
    printed_by("-c", CUBE, variant, tmp_path / "cube.npy")
    found = {tuple(row[:6]): tuple(row[6:]) for row in np.load(tmp_path / "cube.npy").tolist()}
    mesh = caster.Cube().mesh()
    sides = np.repeat(np.round(mesh.vertices.reshape(6, 4, 3).mean(axis=1)), 4, axis=0)
    rows = np.column_stack([mesh.vertices, sides, mesh.uv]).tolist()
    assert len(found) == 24 and {tuple(row[:6]): tuple(row[6:]) for row in rows} == found


BEHIND = (  # a wall behind the point light, and behind the camera: it shadows nothing
    '<shape type="rectangle" id="behind"><transform name="to_world">'
    '<matrix value="90 0 0 0 0 90 0 0 0 0 1 9 0 0 0 1"/></transform></shape>'
)


@pytest.mark.parametrize(
    "light", [point_light("1 4 5", "30 20 10") + BEHIND, sun("-0.3 -0.8 -1", "3 2 1")], ids=["point", "sun"]
)
@pytest.mark.parametrize("variant", HERE)
def test_light_times_its_visibility_is_what_the_direct_integrator_renders(tmp_path, variant, light):
    xml = write(tmp_path, LIT + light)
    printed_by("-c", RENDER, variant, xml, tmp_path / "direct.npy")
    rendered = np.load(tmp_path / "direct.npy").reshape(-1, 3)
    sensor = asked(xml, variant, [], [], sensor=True)
    answer = mitsuba_process.send_request(
        mitsuba_process.TraceRequest(xml, variant, sensor.sensor[:, :3], sensor.sensor[:, 3:6], sensor.sensor[:, 6])
    )
    lit = answer.light_rgb[0] * answer.light_visible[0][:, None]
    assert {"wall", "ball", "egg", "back", "dark"} == {answer.names[k] for k in set(answer.shape)}
    assert np.sum(~answer.light_visible[0] & answer.light_rgb[0].any(axis=1)) > 100, "nothing is shadowed"
    assert np.array_equal(lit, rendered)


@pytest.mark.parametrize("variant", HERE)
@pytest.mark.parametrize("stretch", [1.0, 0.8])
def test_spheres_of_one_shape_answer_as_its_primitives(variant, stretch):
    """Each sphere is one Mitsuba shape with a numbered id; names may have special characters of XML and of formats."""
    rng = np.random.default_rng(4)
    placed = {"to_world": {"scale": [1, stretch, 1]}}
    names = ("a{1}", 'b "&<%d>', "$x", "a.b$", "Kugel, groß[0]{")
    centers = np.array([[x, y, 0.0] for x in range(-2, 3) for y in range(-2, 3)]) + rng.uniform(-0.1, 0.1, (25, 3))
    order = rng.permutation(25).reshape(5, 5)
    shapes = [
        caster.SphereCloud(name=name, centers=centers[rows], radius=0.3, **placed)
        for name, rows in zip(names, order, strict=True)
    ]
    scene = caster.Scene(
        film={"width": 40, "height": 40},
        camera=caster.Orthographic(eye=(0, 0, 9), look_at=(0, 0, 0), width=5.5),
        shapes=[caster.Sphere(name="x", center=(0, 0, -5), radius=0.5), *shapes],
    )
    found = render_reference(scene, ("hit", "shape_id", "prim_id"), variant=variant)
    assert not isinstance(found, Crash), found
    theirs, ours = found[0], caster.render(scene, ("hit", "shape_id", "prim_id"))
    assert all(np.array_equal(theirs[name], ours[name]) for name in ("hit", "shape_id", "prim_id"))
    assert len(np.unique(ours["shape_id"] * 10 + ours["prim_id"])) == 27


def test_what_mitsuba_leaves_out_within_a_curve_is_a_known_defect():
    rng = np.random.default_rng(7)
    points, radii = rng.normal(0.0, 0.7, (8, 3)).cumsum(axis=0), rng.uniform(0.2, 0.5, 8)
    points, radii = (a.astype(np.float32).astype(np.float64) for a in (points, radii))
    scene = scene_of(caster.LinearCurve(points=points, radii=radii))
    k = rng.integers(0, 7, 200)
    o, d = (a.astype(np.float32).astype(np.float64) for a in (points[k], rng.normal(size=(200, 3))))
    rays = np.hstack([o, d, np.tile([0.0, np.inf], (200, 1))])
    (verdict,) = mitsuba_ref.judge_hits(scene, rays, {"t": caster.cast(scene, o, d).t}).scenes
    assert not verdict.failing and set(verdict.cases) == {"78"} and verdict.counts["agree"] > 20

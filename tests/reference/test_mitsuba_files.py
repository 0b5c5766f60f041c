"""Mitsuba files as the reference: what is judged of them, their import, and what is refused."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from candidates import ours
from outputs import json_of, unfolded
from places import ROOT, shipped

import mitsuba_ref
from caster.description.errors import FileMissing, SceneError
from caster.rendering.images import camera_rays, render
from caster.scene.files import load_scene
from mitsuba_ref.__main__ import main
from mitsuba_ref.reference.original_files import Opening, import_xml, open_scene
from mitsuba_ref.reference.originals import original_of
from mitsuba_ref.reference.shared_input import export_scene, shared_rays

SENSOR = '<sensor type="perspective"><transform name="to_world"><translate z="-5"/></transform></sensor>'
BALL = '<shape type="sphere" id="ball"/>'


@pytest.fixture
def folder(here):
    shutil.copytree(ROOT / "tests/mitsuba_files", here, dirs_exist_ok=True)
    return here


def written(folder, content, name="scene.xml"):
    path = folder / name
    path.write_text(f'<scene version="3.0.0">{content}</scene>')
    return str(path)


def judged(path, **more):
    return mitsuba_ref.validate(path, **more).scenes[0]


def test_every_shape_is_judged_but_one_that_is_named(folder):
    scene = judged(folder / "every-plugin.xml")
    assert scene.ok and scene.counts["agree"] > 1200 and not scene.counts["wrong"] + scene.counts["undecided"]
    covered = scene.coverage
    assert (covered.shapes, covered.judged) == (9, 8) and covered.hidden > 50
    assert re.fullmatch(r"bsplinecurve 'hair' at \S+/every-plugin.xml:\d+:\d+: .*", covered.left_out[0])
    assert covered.dropped["emitter envmap"] == 1 and covered.dropped["bsdf plastic"] == 1
    assert "diffuse" in scene.unjudged and "diffuse" not in scene.images["ours"]
    names = set(np.array(open_scene(str(folder / "every-plugin.xml")).shape_names()))
    assert {"quad", "pair/pea", "ball", "tube", "lid", "box", "wall"} < names


def test_light_is_compared_where_the_caster_has_the_same(folder):
    scene = judged(folder / "lit.xml")
    assert scene.ok and "diffuse" in scene.ratios and scene.images["reference"]["diffuse"].max() > 0.1
    assert not scene.unjudged and not scene.coverage.lines()


PICTURE = """<texture type="bitmap" name="reflectance"><string name="filename" value="swatch.png"/>
<string name="wrap_mode" value="mirror"/><transform name="to_uv"><scale x="2.6" y="1.7"/></transform></texture>"""
BOARD = '<texture type="checkerboard" name="reflectance"><rgb name="color0" value="0.1 0.9 0.2"/></texture>'
WITHIN = '<bsdf type="twosided" id="{}"><bsdf type="diffuse">{}</bsdf></bsdf>'
LAMP = '<emitter type="point"><point name="position" value="0 0 -9"/><rgb name="intensity" value="50 40 30"/></emitter>'


def judged_and_imported(path):
    """What is found of a scene, and of what `import` writes of it; both pass."""
    scene = judged(path, size=(36, 24))
    assert scene.ok and "diffuse" in scene.ratios and not scene.coverage.lines()
    assert main(["import", path, "-o", "out.toml", "--size", "36", "24"]) == 0
    again = judged("out.toml")
    assert again.ok
    return scene, again


def test_textures_are_compared_where_their_files_are(folder, capsys):
    """The texels that Mitsuba holds; `import` writes them as a picture."""
    shutil.copy(ROOT / "scenes/pictures/swatch.png", folder)
    shapes = BALL.replace("/>", f">{WITHIN.format('green', BOARD)}</shape>")
    wall = f'<transform name="to_world"><scale value="9"/></transform>{WITHIN.format("wall", PICTURE)}'
    path = written(folder, f'{SENSOR}{LAMP}{shapes}<shape type="rectangle">{wall}</shape>')
    scene, again = judged_and_imported(path)
    assert len(np.unique(scene.images["reference"]["diffuse"].reshape(-1, 3), axis=0)) > 500
    assert again.counts == scene.counts and Path("out").joinpath("0001-wall.png").exists()
    ours, theirs = (each.images["ours"]["diffuse"] for each in (again, scene))
    assert np.abs(ours - theirs).max() < 1e-5 * theirs.max()
    for content in (b"no picture", None):
        Path("swatch.png").unlink() if content is None else Path("swatch.png").write_bytes(content)
        capsys.readouterr()
        assert main(["validate", path, "--size", "9", "6"]) == 0
        said = unfolded(capsys.readouterr().out)
        assert re.search(r"diffuse is not compared: cannot read swatch.png of texture bitmap at \S+:1:\d+", said)


PAINT = '<texture type="mesh_attribute" name="reflectance"><string name="name" value="{}_color"/></texture>'
PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float r
property float g
property float b
element face 2
property list uchar int vertex_indices
property float r
property float g
property float b
end_header
-1 -1 0 0.9 0.1 0
1 -1 0.3 0.2 1 0.3
1 1 0 0 0 0
-1 1 0.2 1 1 1
3 0 1 2 0.9 0.5 0.1
3 0 2 3 0.1 0.7 0.2
"""


@pytest.mark.parametrize("of", ["vertex", "face"])
def test_colours_of_meshes_are_compared_and_imported(of, folder):
    """Two meshes with one material, each with colours of its own; normals of one are reversed."""
    (folder / "a.ply").write_text(PLY)
    (folder / "b.ply").write_text(PLY.replace("0.9", "0.4"))
    mesh = '<shape type="ply"><string name="filename" value="{}.ply"/><ref id="m"/>{}</shape>'
    turned = '<boolean name="flip_normals" value="true"/><transform name="to_world"><translate x="1.5"/></transform>'
    content = WITHIN.format("m", PAINT.format(of)) + mesh.format("a", "") + mesh.format("b", turned)
    path = written(folder, SENSOR + LAMP + content)
    scene, again = judged_and_imported(path)
    assert len(np.unique(scene.images["ours"]["albedo"].reshape(-1, 3), axis=0)) >= (100 if of == "vertex" else 4)
    assert again.hit_pixels == scene.hit_pixels > 500 and "diffuse" in again.ratios


@pytest.mark.parametrize("placed", ["<scale x='-1' y='1.2'/>", "<scale value='1'/>"], ids=["mirrored", "plain"])
@pytest.mark.parametrize("flipped", ["true", "false"])
def test_meshes_of_instances_have_mitsubas_barycentrics_and_normals(placed, flipped, folder):
    """Corners have the order of the file, whatever turns the normal over; normals are interpolated, then transformed.

    Colours are not compared there.
    """
    (folder / "a.ply").write_text(PLY)
    inner = f'<boolean name="flip_normals" value="{flipped}"/>{WITHIN.format("m", PAINT.format("vertex"))}'
    mesh = f'<shape type="ply" id="a"><string name="filename" value="a.ply"/>{inner}</shape>'
    group = f'<shape type="shapegroup" id="g">{mesh}</shape>'
    instance = f'<shape type="instance"><ref id="g"/><transform name="to_world">{placed}</transform></shape>'
    scene = judged(written(folder, SENSOR + LAMP + group + instance), size=(36, 24))
    assert scene.ok and scene.counts["agree"] > 300 and not scene.counts["reference_wrong"]
    assert "of an instance" in scene.coverage.unlit[0]


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        (f"{BOARD.replace('<rgb', PICTURE.replace('reflectance', 'color1') + '<rgb')}", "texture checkerboard"),
        (BOARD.replace("</", '<transform name="to_uv"><scale x="0"/></transform></'), "texture checkerboard"),
        (PAINT.format("vertex").replace("_color", "_heat"), "mesh_attribute"),
        (PAINT.format("vertex"), "colours that are missing"),
    ],
)
def test_a_texture_that_the_caster_has_not_is_a_reason_not_to_compare_diffuse(folder, parts, reason):
    """Also where it is defined apart; one of a material that no shape has is none."""
    shutil.copy(ROOT / "scenes/pictures/swatch.png", folder)
    apart = parts.replace('name="reflectance"', 'id="t"', 1)
    within = WITHIN.format("m", '<ref id="t" name="reflectance"/>')
    for scene, said in ((BALL.replace("/>", '><ref id="m"/></shape>'), reason), (BALL, "")):
        path = written(folder, SENSOR + LAMP + apart + within + scene)
        verdict = judged(path, size=(20, 20))
        assert verdict.ok and ("diffuse" in verdict.ratios) != bool(said)
        assert said in "".join(verdict.coverage.unlit) and bool(verdict.coverage.unlit) == bool(said)


def test_a_mesh_without_uv_is_judged_without_its_texture(folder):
    (folder / "flat.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n")
    mesh = f'<shape type="obj"><string name="filename" value="flat.obj"/>{WITHIN.format("m", BOARD)}</shape>'
    scene = judged(written(folder, SENSOR + LAMP + mesh), size=(20, 20))
    assert scene.ok and scene.hit_pixels > 20 and "no uv" in scene.coverage.unlit[0]


def test_curves_ellipsoids_flipped_quadrics_and_specular_materials_are_judged(folder):
    """Mitsuba itself finds wrong hits, or none at all, on curves and ellipsoids in an instance."""
    scene = judged(folder / "quadrics.xml")
    assert scene.ok and scene.counts["agree"] > 300 and not scene.counts["wrong"] + scene.counts["undecided"]
    assert scene.coverage.judged == 6 and not scene.coverage.lines() and {"diffuse", "uv"} <= {*scene.ratios}
    assert {each.type for each in open_scene(str(folder / "quadrics.xml")).materials.values()} == {
        *("diffuse", "glass", "mirror")
    }
    (folder / "dot.txt").write_text("0 0 0 0\n1 0 0 1\n")
    curve = '<shape type="linearcurve" id="{}"><string name="filename" value="{}.txt"/></shape>'
    group = f'<shape type="shapegroup" id="g">{curve.format("c", "parts/strands")}</shape>'
    group += f'<shape type="instance">{STRETCHED}<ref id="g"/></shape>'
    scene = mitsuba_ref.validate(written(folder, SENSOR + BALL + group + curve.format("thin", "dot")), size=(20, 20))
    zero, instanced = sorted(scene.scenes[0].coverage.left_out, key=lambda each: "instance" in each)
    assert scene.ok and "radii[0] must be > 0, got 0" in zero and "in an instance" in instanced


# Together they hold every shape that is exported, ellipsoids as instances, crops, clip planes, lights.
EXPORTED = ("every-shape", "ellipsoids", "crop-window", "orthographic-clip", "transforms", "lights-and-shadows")


@pytest.mark.parametrize("name", EXPORTED)
def test_an_exported_scene_passes_as_an_original(name, tmp_path):
    """With its camera, compared with the sensor, as the check of the same name says."""
    path = export_scene(shipped(name, 36, 24)).write(tmp_path)
    scene = judged(path)
    assert scene.ok and not scene.counts["wrong"] and {"sensor", "camera"} <= {check.name for check in scene.checks}
    assert scene.coverage.judged == scene.coverage.shapes


def test_an_imported_scene_hits_the_same_as_the_original(folder, capsys):
    """The scene that was written, cast along the original's rays and judged against the original."""
    (folder / "there").mkdir()
    assert main(["import", "every-plugin.xml", "-o", "there/out.toml", "-D", "res=40"]) == 0
    said = capsys.readouterr().out
    assert "left out: bsplinecurve 'hair'" in said and "there/out.toml: 8 shapes, 4 left out or changed" in said
    written = load_scene("there/out.toml")
    assert written.film.width == 40 and "# left out: bsplinecurve 'hair'" in Path("there/out.toml").read_text()
    verdict = mitsuba_ref.validate("every-plugin.xml", candidate=lambda scene, o, d: ours(written, o, d))
    counts = verdict.scenes[0].counts
    assert verdict.ok and sum(counts.values()) == counts["agree"] + counts["explained"] + counts["tie"] > 1200


def test_rays_are_the_sensors_own(folder):
    """Also of sensors that the caster has not, of another size, and of a crop."""
    crop = '<film type="specfilm"><integer name="width" value="9"/><integer name="height" value="6"/>'
    crop += '<integer name="crop_offset_x" value="3"/><integer name="crop_width" value="4"/></film>'
    radius = f'<float name="aperture_radius" value="2"/>{crop}</sensor>'
    path = written(folder, SENSOR.replace("perspective", "thinlens").replace("</sensor>", radius) + BALL)
    scene = open_scene(path)
    assert scene.film.window == (3, 0, 7, 6)
    assert np.abs(shared_rays(scene).d - camera_rays(scene).d).max() < 1e-6  # through the middle of the lens
    assert open_scene(path, size=(18, 12)).film.window == (6, 0, 14, 12)
    meter = '<sensor type="radiancemeter"><point name="origin" value="0 0 3"/><vector name="direction" value="0 0 -1"/>'
    meter += '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/></film></sensor>'
    path = written(folder, SENSOR + meter + BALL)
    scene = judged(open_scene(path, Opening({}, sensor=1)))
    assert scene.ok and scene.hit_pixels == scene.pixels == 1 and "sensor radiancemeter" in scene.coverage.notes[0]
    on_shape = '<shape type="disk"><sensor type="irradiancemeter"/></shape><shape type="rectangle">{}</shape>'
    facing = on_shape.format('<transform name="to_world"><translate z="3"/></transform>')
    scene = judged(written(folder, facing, "facing.xml"), size=(8, 8))
    assert scene.ok and scene.hit_pixels == 64 and "sensor irradiancemeter" in scene.coverage.notes[0]
    with pytest.raises(SceneError, match="sensor 2: the file has 2, counted from 0"):
        open_scene(path, Opening({}, sensor=2))
    scene = judged(written(folder, BALL, "view.xml"), size=(20, 20))
    assert scene.ok and 50 < scene.hit_pixels < 350 and "no sensor" in scene.coverage.notes[0]
    with pytest.raises(SceneError, match="perspective or orthographic"):
        import_xml(written(folder, meter + BALL))


@pytest.mark.parametrize("plugin", ["perspective", "orthographic"])
def test_axes_of_a_sensor_that_differ_in_length_are_no_cameras(folder, plugin):
    """As in a matrix of six decimals: the caster's camera would be off by many roundings."""
    sensor = f'<sensor type="{plugin}"><transform name="to_world"><scale y="1.00002"/><translate z="-5"/></transform>'
    scene = judged(written(folder, sensor + "</sensor>" + BALL), size=(40, 40))
    assert scene.ok and "differ in length" in scene.coverage.notes[0]


def test_what_a_verdict_covers_is_shown_everywhere(folder, capsys):
    words = [
        "validate",
        "every-plugin.xml",
        "--strict",
        "--json",
        "v.json",
        "--junit",
        "j.xml",
        "--summary-md",
        "s.md",
        "--html",
        "r",
    ]
    assert main(words) == 1
    said = capsys.readouterr().out
    assert re.search(r"^FAIL  every-plugin .* 8 of 9 shapes$", said, re.MULTILINE)
    assert "coverage: 8 of 9 shapes; bsplinecurve 'hair'" in said and "--strict" in said
    found = json_of("v.json")["scenes"][0]
    assert found["coverage"]["shapes"] == 9 and found["options"] == ["--strict"]
    assert all("8 of 9 shapes" in Path(file).read_text() for file in ("j.xml", "s.md"))
    assert main(words[:2]) == 0
    said = re.sub(r"\s+", " ", capsys.readouterr().out)
    assert "not judged: " in said and "pixels, where Mitsuba hits a shape that is left out" in said


def test_the_store_depends_on_the_contents_of_every_file(folder):
    path = str(folder / "every-plugin.xml")

    def digest(**parameters):
        return original_of(open_scene(path, Opening(parameters))).request.digest

    first = digest()
    assert first == digest() != digest(res="40")
    for file in ("parts/quad.obj", "parts/group.xml", "parts/hair.txt"):
        (folder / file).write_text((folder / file).read_text() + "\n")
        assert first != (first := digest()), file


STRETCHED = '<transform name="to_world"><scale x="2"/></transform>'
REFUSED = [
    (
        SENSOR + '<shape type="obj"><string name="filename" value="no.obj"/></shape>',
        4,
        r"scene.xml:1:\d+: cannot read no.obj \(tried ",
    ),
    (SENSOR, 5, "it has no shape"),
    (WITHIN.format("m", BOARD), 5, "it has no shape"),
    (SENSOR + BALL.replace("/>", f">{STRETCHED}</shape>"), 5, "none of its 1 shapes"),
    (SENSOR + BALL.replace("/>", '><float name="radius" value="$r"/></shape>'), 2, r"\$r; give it by -D NAME=VALUE"),
    (SENSOR + BALL.replace("/>", '><float name="radus" value="1"/></shape>'), 2, r"(?s)line 1, col \d+.*radus"),
]


@pytest.mark.parametrize(("content", "code", "says"), REFUSED)
def test_what_cannot_be_judged_is_refused_with_place_and_exit_code(folder, content, code, says):
    with pytest.raises(SceneError, match=says) as caught:
        open_scene(written(folder, content))
    assert caught.value.exit_code == code and isinstance(caught.value, FileMissing) == (code == 4)


COURSE = """
OrthographicCamera { center 0 0 0 direction 0 0 -1 up 0 1 0 size 4 }
Materials { numMaterials 1 Material { diffuseColor 1 0 0 } }
Group { numObjects 1 MaterialIndex 0 Sphere { center 0 0 0 radius 1 } }
"""


def test_a_text_of_the_course_is_imported_too(here, capsys):
    """Its window is moved behind everything, and the import says so."""
    Path("s.txt").write_text(COURSE)
    assert main(["import", "s.txt", "-o", "s.toml", "--size", "41", "21"]) == 0
    said = capsys.readouterr().out
    assert "the window stands 3 farther back" in said and said.endswith("s.toml: 1 shape, 2 left out or changed\n")
    depth = render(load_scene("s.toml"), ("depth",))["depth"]
    assert depth.shape == (21, 41) and depth[10, 20] == 2.0


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ("gone.xml -o s.toml", 4, "gone.xml: cannot read this Mitsuba scene file"),
        ("s.obj -o s.toml", 2, "expected Mitsuba's .xml, or .txt of MIT 6.837"),
        ("gone.xml -o s.json", 2, "expected a name that ends in .toml"),
        ("gone.txt -o s.toml -D a=1", 2, "has no parameters"),
        ("gone.xml -o s.toml -D a", 2, "-D a: expected NAME=VALUE"),
        ("gone.txt -o s.toml --size 0 4", 2, "--size 0 4: "),
    ],
)
def test_wrong_use_is_reported_with_its_exit_code(here, capsys, words, code, says):
    assert main(["import", *words.split()]) == code
    assert says in capsys.readouterr().err and not list(here.iterdir())

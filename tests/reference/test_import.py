"""`mitsuba-ref import`: exports come back, and Mitsuba hits the same in an imported scene as in its original."""

import re
from pathlib import Path

import numpy as np
import pytest
from mitsuba_scenes import VARIANTS, job

from caster.description.errors import FileMissing, SceneError
from caster.geometry.mesh_files import load_mesh
from caster.rendering.images import render
from caster.scene.files import load_scene
from mitsuba_ref.__main__ import main
from mitsuba_ref.importers.mitsuba_xml import import_xml
from mitsuba_ref.reference.mitsuba_process import send_request
from mitsuba_ref.reference.shared_input import export_scene

ROOT = Path(__file__).resolve().parents[2]
U = 2.0**-24

# Together they hold every shape, ellipsoids as instances, planes as patches, mirrors, lights, crops, clip planes.
ROUND_TRIPS = (
    "every-shape",
    "ellipsoids",
    "cylinders",
    "crop-window",
    "orthographic",
    "orthographic-clip",
    "near-far-clip",
    "two-sided",
    "transforms",
    "lights-and-shadows",
)


def lines_of(xml):
    """Without comments; numbers apart, since a sensor's may differ in their last digit."""
    lines = re.sub(r"<!--.*?-->", "", xml, flags=re.DOTALL).split("\n")
    return [line.strip() for line in lines if line.strip()]


def same_but_for_roundings(a, b):
    """Equal lines, or equal ones but for numbers that two roundings of float64 set apart."""
    number = r"-?\d+\.?\d*(?:e-?\d+)?"
    if re.sub(number, "#", a) != re.sub(number, "#", b):
        return False
    x, y = (np.array([float(found) for found in re.findall(number, line)]) for line in (a, b))
    return bool(np.all(np.abs(x - y) <= 8 * 2.0**-53 * max(1.0, np.abs(x).max(initial=0.0))))


@pytest.mark.parametrize("name", ROUND_TRIPS)
def test_an_exported_scene_comes_back(name, tmp_path):
    """Exported again, it is the same document: shapes to the bit, the sensor's matrix within roundings of float64."""
    first = export_scene(load_scene(ROOT / f"scenes/{name}.toml"))
    xml = first.write(tmp_path / "first")
    again = export_scene(import_xml(str(xml)).scene)
    again.write(tmp_path / "again")
    pairs = list(zip(lines_of(first.xml), lines_of(again.xml), strict=True))
    different = [pair for pair in pairs if pair[0] != pair[1]]
    assert all(same_but_for_roundings(*pair) for pair in different) and len(different) <= 2
    assert first.meshes.keys() == again.meshes.keys()
    for file in first.meshes:
        a, b = (load_mesh(str(tmp_path / folder / file)) for folder in ("first", "again"))
        assert np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces)
        if a.normals is not None:  # of unit length, made so twice
            assert np.abs(a.normals - b.normals).max() <= U


OBJ = "v -1 -1 0\nv 1 -1 0\nv 1 1 0.25\nv -1 1 0.5\nf 1 2 3 4\n"
PARTS = """<scene version="3.0.0">
  <bsdf type="twosided" id="both"><bsdf type="diffuse"><rgb name="reflectance" value="0.25, 0.5, 0.75"/></bsdf></bsdf>
  <shape type="shapegroup" id="group">
    <shape type="sphere"><ref id="both"/><transform name="to_world"><scale value="0.5"/></transform></shape>
    <shape type="cube"><transform name="to_world"><scale value="0.25"/><translate x="1"/></transform></shape>
  </shape>
</scene>
"""
SCENE = """<scene version="3.0.0">
  <default name="res" value="48"/>
  <default name="far" value="3"/>
  <integrator type="path"/>
  <include filename="parts/parts.xml"/>
  <sensor type="perspective">
    <string name="fov_axis" value="larger"/><float name="fov" value="50"/>
    <float name="near_clip" value="0.1"/><float name="far_clip" value="100"/>
    <transform name="to_world"><lookat origin="0.3, 0.4, 6" target="0 0 0" up="0 1 0.1"/></transform>
    <film type="hdrfilm"><integer name="width" value="$res"/><integer name="height" value="32"/></film>
  </sensor>
  <emitter type="point"><point name="position" x="1" y="2" z="$far"/><rgb name="intensity" value="9"/></emitter>
  <emitter type="area" id="unused"><rgb name="radiance" value="1"/></emitter>
  <shape type="obj" id="quad">
    <string name="filename" value="parts/quad.obj"/>
    <transform name="to_world"><rotate y="1" z="1" angle="20"/><scale x="1.5"/><translate x="-1.3" y="0.9"/></transform>
    <bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.1 0.2 0.3"/><float name="int_ior" value="1.9"/></bsdf>
    <ref id="unused"/>
  </shape>
  <shape type="instance" id="pair"><ref id="group"/>
    <transform name="to_world">
      <scale x="1" y="1.5" z="0.5"/><rotate x="1" angle="40"/><translate x="-1" y="-1"/></transform>
  </shape>
  <shape type="sphere" id="ball"><point name="center" value="1.5 1 0"/><float name="radius" value="0.5"/>
    <transform name="to_world"><scale value="1.25"/></transform><ref id="both"/></shape>
  <shape type="cylinder" id="tube"><point name="p0" x="1" y="-1" z="0"/><point name="p1" x="2" y="-0.5" z="0.5"/>
    <float name="radius" value="0.3"/></shape>
  <shape type="disk" id="lid"><boolean name="flip_normals" value="true"/>
    <transform name="to_world">
      <scale value="0.4"/><rotate x="1" y="0" z="0" angle="200"/><translate z="1"/></transform></shape>
  <shape type="rectangle"><transform name="to_world">
    <matrix value="3 0 0 0  0 3 0 0  0 0 3 -2  0 0 0 1"/></transform></shape>
  <shape type="bsplinecurve" id="hair"><string name="filename" value="hair.txt"/></shape>
</scene>
"""

# In SCENE all lies within 8 of the eye and is met no flatter than 1 : 10. Both sides round corners and centres to
# float32, Mitsuba after products with matrices (4 roundings), and compute t from there (4 more).
T_ATOL = 8 * U * 8.0 * 10.0
N_ATOL = T_ATOL / 0.08  # a normal turns by as much as its point moves, over the least radius of the ellipsoid


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/parts.xml").write_text(PARTS)
    (tmp_path / "parts/quad.obj").write_text(OBJ)
    (tmp_path / "scene.xml").write_text(SCENE)
    return tmp_path


def test_mitsuba_hits_the_same_in_an_imported_scene(folder):
    """Defaults, includes, references, an instance, a rotation about an axis of length 1.41: by Mitsuba's own account.

    Without its curve, whose file is not there; sensor rays to the bit, hits of these within roundings.
    """
    (folder / "scene.xml").write_text(re.sub(r'<shape type="bspline.*\n', "", SCENE))
    scene = import_xml(str(folder / "scene.xml")).scene
    again = export_scene(scene).write(folder / "again")
    one = np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)
    variant = VARIANTS[0]
    theirs, ours = (
        send_request(job(xml, variant, *one, lights=False, sensor=True, strict=False))
        for xml in (folder / "scene.xml", again)
    )
    assert np.array_equal(theirs.sensor[:, :6], ours.sensor[:, :6])
    rays = theirs.sensor[:, :3], theirs.sensor[:, 3:6]
    a, b = (send_request(job(xml, variant, *rays, lights=False, strict=False)) for xml in (folder / "scene.xml", again))
    hit = np.isfinite(a.t)
    assert np.array_equal(hit, np.isfinite(b.t)) and 1000 < hit.sum() < 48 * 32
    assert set(np.array(a.names)[a.shape]) >= {"quad", "pair", "ball", "tube", "lid", ""}
    assert np.abs(a.t[hit] - b.t[hit]).max() <= T_ATOL and np.abs(a.n - b.n).max() <= N_ATOL
    ours_too = render(scene, ("normal",))
    assert np.array_equal(ours_too.hit.ravel(), hit)
    assert np.abs(ours_too["normal"].reshape(-1, 3) - a.n).max() <= N_ATOL


def test_what_was_left_out_is_listed(folder):
    said = import_xml(str(folder / "scene.xml")).left_out
    assert [line.removeprefix(f"{folder}/scene.xml:") for line in said] == LEFT_OUT


LEFT_OUT = [
    "4:3: left out: integrator path",
    "17:5: left out: bsdf plastic: materials are diffuse here; its diffuse_reflectance is kept",
    "17:79: left out: float int_ior of bsdf plastic",
    '18:5: left out: emitter area "unused" of shape obj "quad": shapes emit no light here',
    '33:3: left out: shape bsplinecurve "hair": not supported '
    "(known: sphere, obj, ply, rectangle, disk, cube, cylinder, instance)",
]
ERRORS = [
    ('name="res" value="48"', 'name="ress" value="48"', "parameter $res has no value, did you mean 'ress'?"),
    ("parts/parts.xml", "parts/gone.xml", "cannot read this scene file: No such file or directory"),
    ("parts/parts.xml", "../outside.xml", "include must lie in the scene's folder or below it, got ../outside.xml"),
    ('<ref id="group"/>', '<ref id="grop"/>', "no element has the id \"grop\", did you mean 'group'?"),
    ('name="radius" value="0.5"', 'name="radius" value="-"', "float radius: value must be a number, got '-'"),
    ('name="radius" value="0.3"', 'name="radius" value="0"', "radius must be > 0, got 0"),
    ('value="50"', 'value="180"', "fov must be < 180, got 180"),
    ('float name="fov" value="50"', 'string name="focal_length" value="0mm"', "must be a length > 0 in mm"),
    ('float name="fov" value="50"', 'string name="focal_length" value="infmm"', "must be a length > 0 in mm"),
    ('integer name="height"', 'float name="height"', "height must be a <integer>, got <float>"),
    (
        '"perspective"',
        '"radiancemeter"',
        "needs a sensor of a supported kind: perspective, thinlens or orthographic, got",
    ),
    ("<translate z=", "<move z=", "unknown step <move> of a transform"),
    ("</scene>", "</sceen>", "not valid XML: mismatched tag"),
    ("<scene ", '<!DOCTYPE scene [<!ENTITY a "b">]><scene ', "a document type is no part of a scene"),
    ('id="lid"', 'id="tube"', 'id "tube" occurs twice'),
    (
        "parts/quad.obj",
        "../quad.obj",
        "must lie in the scene's folder, below it, or below a folder given by --mesh-dir",
    ),
]


@pytest.mark.parametrize(("old", "new", "says"), ERRORS)
def test_errors_are_reported_with_file_line_and_column(folder, old, new, says):
    assert old in SCENE
    (folder / "scene.xml").write_text(SCENE.replace(old, new, 1))
    with pytest.raises(SceneError) as caught:
        import_xml(str(folder / "scene.xml"))
    lines = str(caught.value).split("\n")
    assert any(re.match(r"\S+\.xml:\d+:\d+: ", line) and says in line for line in lines), caught.value
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ('<shape type="cube">' * 9999 + "</shape>" * 9999, "elements are nested deeper than 64"),
        ('<include filename="scene.xml"/>' * 3, "does a file include itself?"),
        (
            '<bsdf type="twosided" id="a"><ref id="a"/></bsdf><shape type="cube"><ref id="a"/></shape>',
            "refers to itself",
        ),
        (
            '<shape type="shapegroup" id="g"><shape type="instance"><ref id="g"/></shape></shape>'
            '<shape type="instance"><ref id="g"/></shape>',
            "an instance inside a shapegroup",
        ),
    ],
)
def test_what_goes_on_without_end_is_refused(folder, content, says):
    sensor = '<sensor type="perspective"><float name="fov" value="40"/></sensor>'
    (folder / "scene.xml").write_text(f'<scene version="3.0.0">{sensor}{content}</scene>')
    with pytest.raises(SceneError, match=re.escape(says)):
        import_xml(str(folder / "scene.xml"))


def test_a_missing_mesh_is_exit_code_4(folder):
    (folder / "parts/quad.obj").unlink()
    with pytest.raises(FileMissing) as caught:
        import_xml(str(folder / "scene.xml"))
    assert caught.value.exit_code == 4 and "scene.xml:14:3: shapes[0] (mesh" in str(caught.value)


def test_parameters_are_given_on_the_command_line(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    assert main(["import", "scene.xml", "-o", "out.toml", "-D", "res=64"]) == 0
    assert load_scene("out.toml").film.width == 64
    said = capsys.readouterr().out
    assert "scene.xml:4:3: left out: integrator path\n" in said and "out.toml: 7 shapes, " in said
    assert main(["import", "scene.xml", "-o", "out.toml", "-D", "rez=64"]) == 2
    assert "no parameter $rez in it" in capsys.readouterr().err


def test_the_scene_that_is_written_is_the_scene_that_was_read(folder, capsys, monkeypatch):
    """Also where the meshes lie elsewhere, which needs --mesh-dir, as the command says."""
    monkeypatch.chdir(folder)
    (folder / "there").mkdir()
    assert main(["import", "scene.xml", "-o", "there/out.toml"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"note: meshes are in {folder}/parts: add --mesh-dir {folder}/parts" in said
    assert load_scene("there/out.toml", ["parts"]) == import_xml("scene.xml").scene
    with pytest.raises(SceneError, match="--mesh-dir"):
        load_scene("there/out.toml")


COURSE = """
OrthographicCamera { center 0 0 0 direction 0 0 -1 up 0 1 0 size 4 }
Materials { numMaterials 1 Material { diffuseColor 1 0 0 } }
Group { numObjects 1 MaterialIndex 0 Sphere { center 0 0 0 radius 1 } }
"""


def test_a_text_of_the_course_is_imported_too(tmp_path, capsys, monkeypatch):
    """Its window is moved behind everything, and the import says so."""
    monkeypatch.chdir(tmp_path)
    Path("s.txt").write_text(COURSE)
    assert main(["import", "s.txt", "-o", "s.toml", "--size", "41", "21"]) == 0
    said = capsys.readouterr().out
    assert "the window stands 3 farther back" in said and said.endswith("s.toml: 1 shape, 2 left out or changed\n")
    depth = render(load_scene("s.toml"), ("depth",))["depth"]
    assert depth.shape == (21, 41) and depth[10, 20] == 2.0


EMITTERS = {
    "constant": '<emitter type="constant"><rgb name="radiance" value="{}"/></emitter><shape type="sphere"/>',
    "area": '<shape type="sphere"><emitter type="area"><rgb name="radiance" value="{}"/></emitter></shape>',
    "spot": '<emitter type="spot"><rgb name="intensity" value="{}"/></emitter><shape type="sphere"/>',
    "by reference": '<emitter type="area" id="e"><spectrum name="radiance" value="{}"/></emitter>'
    '<shape type="sphere"><ref id="e"/></shape>',
    "point": '<emitter type="point"><rgb name="intensity" value="{}"/></emitter><shape type="sphere"/>',
}


@pytest.mark.parametrize("emitter", EMITTERS)
def test_what_sends_no_light_is_not_reported_as_left_out_since_nothing_is(tmp_path, emitter):
    """Mitsuba renders the same without it. An emitter that sends light is reported, unless ours is the same."""
    path, found = tmp_path / "a.xml", {}
    for value in ("0", "1e-3"):
        inside = EMITTERS[emitter].format(value)
        path.write_text(f'<scene version="3.0.0"><sensor type="perspective"/>{inside}</scene>')
        found[value] = import_xml(str(path))
    assert found["0"].left_out == () and len(found["0"].scene.shapes) == 1
    assert len(found["0"].scene.lights) == (emitter == "point")
    assert len(found["1e-3"].left_out) == (emitter != "point")


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ("gone.xml -o s.toml", 4, "gone.xml: cannot read this scene file"),
        ("s.obj -o s.toml", 2, "expected Mitsuba's .xml, or .txt of MIT 6.837"),
        ("gone.xml -o s.json", 2, "expected a name that ends in .toml"),
        ("gone.txt -o s.toml -D a=1", 2, "has no parameters"),
        ("gone.xml -o s.toml -D a", 2, "-D a: expected NAME=VALUE"),
        ("gone.txt -o s.toml --size 0 4", 2, "--size 0 4: "),
    ],
)
def test_wrong_use_is_reported_with_its_exit_code(tmp_path, monkeypatch, capsys, words, code, says):
    monkeypatch.chdir(tmp_path)
    assert main(["import", *words.split()]) == code
    assert says in capsys.readouterr().err and not list(tmp_path.iterdir())

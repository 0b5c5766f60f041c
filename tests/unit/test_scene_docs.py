"""docs/scene-format.md lists every key with its default, and its examples load."""

import re

import pytest
from places import ROOT

from caster.aovs import BY_NAME
from caster.cameras import CAMERAS
from caster.description.errors import format_value
from caster.description.fields import Camera, Shape
from caster.scene.files import load_scene, scene_from_text
from caster.scene.model import LIGHTS, MAX_FILM_SIDE, Check, Diffuse, Film, Glass, Mirror, Shading
from caster.shapes import SHAPES

DOCUMENT = (ROOT / "docs/scene-format.md").read_text()
CAMERA = '[camera]\ntype = "panorama"\neye = [0, 0, 0]\ndirection = [0, 0, 1]\n'


def section(title):
    """The text below a heading, up to the next one."""
    found = re.findall(rf"^##+ {re.escape(title)}\n(.*?)(?=^##)", DOCUMENT, re.MULTILINE | re.DOTALL)
    assert len(found) == 1, f"expected one heading {title!r}, found {len(found)}"
    return found[0]


def rows(title):
    """key -> default, of the table below a heading."""
    cells = re.findall(r"^\| `(\w+)` \|.*\| ([^|]*) \|$", section(title), re.MULTILINE)
    return dict(cells)


def own_fields(description):
    """The keys that this class adds to those all shapes or cameras have."""
    shared = Shape if issubclass(description, Shape) else Camera if issubclass(description, Camera) else None
    known = {"type", *(shared.model_fields if shared else ())}
    return {name: field for name, field in description.model_fields.items() if name not in known}


KINDS = [(kind.model_fields["type"].default, kind) for kind in (*SHAPES, *CAMERAS, *LIGHTS, Mirror, Glass)]
TABLES = [("[film]", Film), ("[shading]", Shading), ("[check.AOV]", Check), ("[material.NAME]", Diffuse)]


@pytest.mark.parametrize(("title", "description"), [*KINDS, *TABLES], ids=lambda v: getattr(v, "__name__", v))
def test_every_key_is_documented_with_its_default(title, description):
    documented = rows(f"`{title}`")
    documented.pop("type", None)
    fields = own_fields(description)
    assert documented.keys() == fields.keys()
    for name, field in fields.items():
        default = documented[name].split(" (")[0]
        expected = (
            "required"
            if field.is_required()
            else "none"
            if field.default is None
            else f"`{format_value(field.default)}`"
        )
        assert default == expected, name


@pytest.mark.parametrize(("title", "base"), [("[camera]", Camera), ("[[shape]]", Shape)])
def test_the_keys_of_all_cameras_and_shapes_are_documented(title, base):
    assert rows(f"`{title}`").keys() == base.model_fields.keys()


BLOCKS = re.findall(r"```toml\n(.*?)```", DOCUMENT, re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.splitlines()[1])
def test_every_example_is_a_scene(block, tmp_path):
    (tmp_path / "meshes").mkdir()
    text = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    for name in ("bunny", "points"):
        (tmp_path / f"meshes/{name}.ply").write_text(text)
    scene_from_text(block if "[camera]" in block else CAMERA + block, folder=tmp_path)


def test_every_kind_has_an_example():
    shown = set(re.findall(r'^type = "(\w+)"', "\n".join(BLOCKS), re.MULTILINE))
    assert shown >= {kind for kind, _ in KINDS}


def test_the_example_in_python_runs(here):
    (code,) = re.findall(r"```python\n(.*?)```", DOCUMENT, re.DOTALL)
    exec(code, {})
    assert len(load_scene(here / "spheres.toml").shapes) == 3


def test_limits_and_names_are_those_of_the_code():
    assert f"1 to {MAX_FILM_SIDE}" in section("`[film]`")
    assert re.findall(r"AOVs are (.*)\.", DOCUMENT) == [", ".join(f"`{name}`" for name in BY_NAME)]

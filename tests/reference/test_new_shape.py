"""A shape of a plug-in needs one file for each package, as shown in docs/internals/adding-a-shape.md.

The code is taken from that page, so the page is right as long as this passes.
"""

import re

import pytest
from edited_tree import ROOT, ended_well, run_with, said_beside_progress
from outputs import unfolded
from programs import install

SENTENCE = (
    "Tetrahedron has no reference: write mitsuba_ref/shapes/tetrahedron.py and add its line to "
    "mitsuba_ref/shapes/__init__.py (mitsuba-ref docs adding-a-shape)"
)
SCENE = """
[film]
width = 12
height = 10

[camera]
type = "pinhole"
eye = [0.413, 1.687, 4.219]
look_at = [0.117, -0.061, 0.033]

[[light]]
type = "point"
position = [2.71, 3.14, 3.57]
intensity = [55, 52, 47]

[[shape]]
type = "tetrahedron"
name = "new"
face_normals = {flat}
to_world = [
  {{ scale = [0.913, -1.113, 0.771] }},
  {{ rotate = {{ axis = [0.3, 0.9, 0.2], degrees = 27.7 }} }},
  {{ translate = [0.119, -0.113, 0.071] }},
]
"""


def as_documented(path: str) -> str:
    """The file `path` as the page on adding shapes shows it."""
    page = (ROOT / "docs/internals/adding-a-shape.md").read_text(encoding="utf-8")
    (code,) = re.findall(rf"`{re.escape(path)}`:\n\n```python\n(.*?)```", page, re.DOTALL)
    return code


@pytest.fixture
def plugin(tmp_path):
    """A folder with an installed distribution: the shape on the caster's side alone, and two scenes."""
    for flat in ("true", "false"):
        (tmp_path / f"flat-{flat}.toml").write_text(SCENE.format(flat=flat))
    (tmp_path / "tetrahedron.py").write_text(as_documented("tetrahedron.py"), encoding="utf-8")
    install(tmp_path, "tetrahedron", caster="tetrahedron")
    return tmp_path


def add_reference(plugin):
    code = as_documented("tetrahedron_reference.py")
    (plugin / "tetrahedron_reference.py").write_text(code, encoding="utf-8")
    install(plugin, "tetrahedron", caster="tetrahedron", mitsuba_ref="tetrahedron_reference")


def test_a_shape_without_reference_is_refused_by_the_judge(plugin):
    scene = str(plugin / "flat-true.toml")
    found = run_with(plugin, "validate", scene)
    assert (found.returncode, said_beside_progress(found)) == (1, [])
    assert f"FAIL flat-true cannot be judged: {SENTENCE}" in unfolded(found.stdout)
    refused = run_with(plugin, "export", scene, "-o", str(plugin / "xml"))
    assert (refused.returncode, refused.stdout) == (2, "") and unfolded(refused.stderr).endswith(SENTENCE)


def test_with_its_reference_its_scenes_pass(plugin):
    add_reference(plugin)
    found = ended_well(run_with(plugin, "validate", str(plugin / "flat-true.toml"), str(plugin / "flat-false.toml")))
    assert found.stdout.count("PASS  ") == 2

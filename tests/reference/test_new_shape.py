"""A new shape is a file and its place in a registry on each side, as docs/adding-a-shape.md has it, and no more.

Its code is taken from there, so the page is right as long as this passes.
"""

import os
import re
import shutil
import subprocess
import sys

import pytest
from edited_tree import DEADLINE, ROOT, copy_tree, edit, run

SENTENCE = (
    "Tetrahedron has no reference: write mitsuba_ref/shapes/tetrahedron.py and add its line to "
    "mitsuba_ref/shapes/__init__.py (docs/adding-a-shape.md)"
)
SCENE = """
[film]
width = 24
height = 20

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
    page = (ROOT / "docs/adding-a-shape.md").read_text(encoding="utf-8")
    (code,) = re.findall(rf"`{re.escape(path)}`:\n\n```python\n(.*?)```", page, re.DOTALL)
    return code


def add(tree, path):
    (tree / path).write_text(as_documented(path), encoding="utf-8")


@pytest.fixture
def tree(tmp_path):
    """Both packages and the test that demands references, with the shape on the caster's side alone."""
    copy_tree(tmp_path)
    (tmp_path / "tests/unit").mkdir(parents=True)
    shutil.copy(ROOT / "tests/unit/test_registries.py", tmp_path / "tests/unit")
    for flat in ("true", "false"):
        (tmp_path / f"flat-{flat}.toml").write_text(SCENE.format(flat=flat), encoding="utf-8")
    add(tmp_path, "caster/shapes/tetrahedron.py")
    registry, line = "caster/shapes/__init__.py", "from caster.shapes.torus import Torus\n"
    edit(tmp_path, registry, line, f"from caster.shapes.tetrahedron import Tetrahedron\n{line}")
    edit(tmp_path, registry, "    Teapot,\n)", "    Teapot,\n    Tetrahedron,\n)")
    return tmp_path


def add_reference(tree):
    add(tree, "mitsuba_ref/shapes/tetrahedron.py")
    registry = "mitsuba_ref/shapes/__init__.py"
    edit(tree, registry, "    torus,\n    triangle,\n)", "    tetrahedron,\n    torus,\n    triangle,\n)")
    edit(tree, registry, "    teapot.REFERENCE,\n", "    teapot.REFERENCE,\n    tetrahedron.REFERENCE,\n")


def registries(tree):
    """The outcome of the registry test on the edited tree."""
    words = [
        sys.executable,
        "-P",
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "tests/unit/test_registries.py",
    ]
    environment = {**os.environ, "PYTHONPATH": str(tree), "CASTER_JIT": "0"}
    return subprocess.run(words, cwd=tree, env=environment, capture_output=True, text=True, timeout=DEADLINE)


def test_a_shape_without_reference_renders_but_is_refused_by_the_registry_test_and_by_validate(tree):
    scene = str(tree / "flat-true.toml")
    assert run(tree, "render", scene, "-o", str(tree / "out.exr"), module="caster").returncode == 0
    demanded = registries(tree)
    assert demanded.returncode == 1 and SENTENCE in demanded.stdout, demanded.stdout
    assert "test_every_shape_has_exactly_one_reference" in demanded.stdout
    found = run(tree, "validate", scene)
    assert (found.returncode, found.stderr) == (1, "")
    assert f"FAIL  flat-true  cannot be judged: {SENTENCE}\n" in found.stdout
    for command in (
        ["render", scene, "-o", str(tree / "ref.exr")],
        ["export", scene, "-o", str(tree / "xml")],
    ):
        refused = run(tree, *command)
        assert (refused.returncode, refused.stdout) == (2, "") and refused.stderr.strip().endswith(SENTENCE)


def test_with_its_reference_the_registry_test_passes_and_so_does_its_scene(tree):
    add_reference(tree)
    demanded = registries(tree)
    assert demanded.returncode == 0, demanded.stdout
    found = run(tree, "validate", str(tree / "flat-true.toml"), str(tree / "flat-false.toml"))
    assert (found.returncode, found.stderr) == (0, ""), found.stdout
    assert found.stdout.count("PASS  ") == 2


def test_a_mistake_in_the_new_shape_is_found(tree):
    add_reference(tree)
    edit(tree, "caster/shapes/tetrahedron.py", "MeshShape):", "MeshShape):\n    def pack(self, rounded):\n"
         "        from caster.geometry.world_space import transform_mesh\n\n"
         "        return transform_mesh(self.mesh(), 1.001 * self.matrix, rounded, self.face_normals)\n")  # fmt: skip
    found = run(tree, "validate", str(tree / "flat-true.toml"))
    assert found.returncode == 1 and "FAIL  flat-true  geometry: " in found.stdout

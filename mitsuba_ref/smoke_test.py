"""One small scene through one variant of Mitsuba: does it give the right answer here, or any?"""

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mitsuba_ref import child
from mitsuba_ref.jobs import Answer, Crash, Job

SECONDS = 60.0  # it takes one or two

# Without normals in the file Mitsuba computes them, with an instruction that an old libLLVM aborts at.
MESH = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
-4 -4 0
4 -4 0
4 4 0
-4 4 0
3 0 1 2
3 0 2 3
"""
SCENE = """<scene version="3.0.0">
    <emitter type="point"><point name="position" value="0 0 2"/></emitter>
    <shape type="ply" id="square"><string name="filename" value="square.ply"/><bsdf type="diffuse"/></shape>
</scene>
"""


def smoke_test(variant: str, settings: Mapping[str, str]) -> str:
    """'' if the variant gives the right answer under these environment variables, else what happened."""
    with tempfile.TemporaryDirectory(prefix="mitsuba-ref-") as name:
        folder = Path(name)
        (folder / "square.ply").write_text(MESH)
        (folder / "scene.xml").write_text(SCENE)
        fresh = {**settings, "DRJIT_CACHE_DIR": name}  # a cached kernel would hide an abort
        return _problem(child.put(_question(folder / "scene.xml", variant), SECONDS, fresh))


def _question(xml: Path, variant: str) -> Job:
    o = np.array([[1, 0.5, 8], [9, 0.5, 8]], np.float32)
    d = np.array([[0, 0, -1], [0, 0, -1]], np.float32)
    return Job(xml, variant, o, d, np.full(2, np.inf, np.float32))


def _problem(answer: Answer | Crash) -> str:
    if isinstance(answer, Crash):
        return f"{answer.kind} ({answer.exit}) {answer.headline}".strip()
    right = answer.t.tolist() == [8.0, np.inf] and np.allclose(answer.sh_n, [[0, 0, 1], [0, 0, 0]], atol=1e-6)
    return "" if right else f"wrong answer: t {answer.t.tolist()}, normals {answer.sh_n.tolist()}"

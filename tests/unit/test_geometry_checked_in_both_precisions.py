"""Packed geometry is checked as float64, which `render` casts, and as float32, which Mitsuba traces.

An error in one of them is found whatever the other one is like.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from marks import each_shipped_scene
from places import SCENES, scene_of

from caster.cameras import Pinhole
from caster.description.fields import Shape
from caster.geometry.packing import Packed, packed
from caster.scene.files import load_scene
from caster.scene.model import Scene
from caster.shapes import Cube, Cylinder, Disk, Heightfield, Icosphere, Mesh, Plane, Rectangle, Sphere, Torus, Triangle
from mitsuba_ref.judge.checks import shapes, worst_share
from mitsuba_ref.judge.checks.shapes import PACKINGS, check_geometry
from mitsuba_ref.shapes import reference_of

GEM = next(SCENES.rglob("gem.obj"))  # without normals of its own
MOVED = {"translate": [0.4, -0.7, 1.3]}
TURNED = {"rotate": {"axis": [1.0, 2.0, 3.0], "degrees": 50.0}}
STRETCHED = {"scale": [1.0, 2.0, 3.0]}
CORNERS = [[0.0, 0.1, 0.2], [1.0, 0.3, 0.0], [0.2, 1.0, 0.5]]
NORMALS = [[0.0, 0.6, 0.8], [0.6, 0.0, 0.8], [0.8, 0.6, 0.0]]
SHAPES: list[Shape] = [
    shape(**data, to_world=steps)
    for shape, data in (
        (Sphere, {"center": (0.3, 0.1, 0.2), "radius": 0.7}),
        (Disk, {}),
        (Cylinder, {"p0": (0.1, 0.2, 0.3), "p1": (0.5, 0.9, 1.7), "radius": 0.4}),
        (Plane, {"point": (0.1, 0.2, 0.3), "normal": (0.6, 0.0, 0.8)}),
        (Triangle, {"vertices": CORNERS}),
        (Triangle, {"vertices": CORNERS, "normals": NORMALS}),
        (Rectangle, {}),
        (Cube, {}),
        (Icosphere, {"subdivisions": 0}),
        (Heightfield, {"resolution": 2}),
        (Torus, {"segments": 3, "sides": 3}),
        (Mesh, {"file": str(GEM)}),
    )
    for steps in ([TURNED, MOVED], [STRETCHED, TURNED, MOVED])
]

# Far below a pixel, far above a dozen roundings of each precision.
OFF = {"float64": 1e-9, "float32": 1e-5}


def claims_of(shape: Shape) -> list[str]:
    part = packed(scene_of(shape)).parts[0]
    return [claim.what for claim in reference_of(shape).expected(shape, part)]


FAULTS = [
    pytest.param(shape, what, precision, id=f"{type(shape).__name__}-{i}-{what}-{precision}")
    for i, shape in enumerate(SHAPES)
    for what in claims_of(shape)
    for precision in PACKINGS
]


@pytest.mark.parametrize(("shape", "what", "precision"), FAULTS)
def test_one_claim_that_is_off_in_one_precision_is_found(monkeypatch, shape, what, precision):
    """The other precision is right, whichever is looked at last."""
    packed_now: list[str] = []

    def noting(name: str) -> Callable[[Scene], Packed]:
        def packing(scene: Scene) -> Packed:
            packed_now[:] = [name]
            return PACKINGS[name](scene)

        return packing

    def placed(shape: Shape, part: Any) -> Any:
        for claim in reference_of(shape).expected(shape, part):
            if claim.what == what and packed_now == [precision]:
                off = OFF[precision] if claim.rounded else 1.0  # an index or a flag is right or another one
                claim = claim._replace(packed=claim.packed + off * np.maximum(np.abs(claim.packed), off))
            yield claim

    monkeypatch.setattr(shapes, "PACKINGS", {name: noting(name) for name in PACKINGS})
    assert check_geometry(scene_of(shape)).ok
    monkeypatch.setattr(shapes, "reference_of", lambda shape: replace(reference_of(shape), expected=placed))
    found = check_geometry(scene_of(shape))
    assert not found.ok
    assert found.what == f"{what} of shape-0 ({precision})"


@each_shipped_scene
def test_shipped_scenes_keep_far_within_the_bound(path):
    # Of ellipsoids the squares of the axes are compared: products of rounded matrices, with more roundings.
    assert check_geometry(load_scene(path)).ratio <= (0.75 if path.stem == "ellipsoid-clouds" else 0.25)


def test_the_largest_share_counts_and_nan_is_larger_than_all():
    shares = [(7.0, "radius"), (0.0, "radius"), (0.5, "center")]
    assert worst_share(shares) == (7.0, "radius")
    assert worst_share([*shares, (np.nan, "normals"), (np.inf, "uv")])[1] == "normals"
    assert worst_share([]) == (0.0, "nothing to look at")


CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0.2), (1, 1, 0.5), (2, 2, 0)]


@pytest.mark.parametrize("face_normals", [True, False])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e19, 1e30])
@pytest.mark.parametrize("faces", [[(0, 1, 2), (1, 3, 2)], [(0, 1, 2), (1, 3, 4)]], ids=["unused", "of a face"])
def test_what_stands_in_for_a_corner_beyond_use_is_no_fault(tmp_path, monkeypatch, bad, face_normals, faces):
    """A face that is not rejected stays as it is."""
    corners = np.array(CORNERS)
    corners[4, 1] = bad
    lines = [f"v {x} {y} {z}" for x, y, z in corners.tolist()] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    shape = Mesh(file=str(tmp_path / "a.obj"), face_normals=face_normals, name="mesh")
    scene = Scene(camera=Pinhole(eye=(0.4, 0.5, 3.3), look_at=(0.3, 0.4, 0.0)), shapes=[shape]).with_film(
        width=9, height=7
    )
    assert check_geometry(scene).ok
    pack = Mesh.pack

    def swapped(self, rounded):
        part = pack(self, rounded)
        return part._replace(faces=np.concatenate([part.faces[:1, [0, 2, 1]], part.faces[1:]]))

    def dropped(self, rounded):
        part = pack(self, rounded)
        return part._replace(faces=np.concatenate([part.faces[:1] * 0, part.faces[1:]]))

    for wrong in (swapped, dropped):
        monkeypatch.setattr(Mesh, "pack", wrong)
        found = check_geometry(scene.model_copy())
        assert not found.ok and found.what.startswith("faces of mesh")

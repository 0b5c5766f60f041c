"""Peak memory of loading and packing a large mesh, in bytes per triangle."""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from places import scene_of

from caster import Scene
from caster.geometry.packing import pack, rejected_faces
from caster.shapes import Heightfield

RESOLUTION = 500
TRIANGLES = 2 * RESOLUTION**2

# A triangle of a heightfield is 12 bytes of indices and half a vertex of 64 bytes (position, normal, uv): 44. While it
# is packed there are the mesh and its copy in world space, and 2 bytes of flags: 90. With what bands, masks of one byte
# and one array of temporary positions (12) take, 110; 10 million triangles then stay below 4 GB, boxes, tree, images
# and all (48 + 33 + 24 + 16 bytes a triangle on top, and what is kept of the 110 is 50).
MESH, PACKING, LOOKING = 70.0, 110.0, 110.0


def peak_of(work: Callable[[], object]) -> float:
    """Peak memory in bytes per triangle."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / TRIANGLES
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(Heightfield(resolution=RESOLUTION))


def test_a_landscape_is_made_packed_and_looked_through_in_little_memory(scene):
    assert peak_of(scene.shapes[0].mesh) < MESH
    assert peak_of(lambda: pack(scene)) < PACKING
    assert peak_of(lambda: rejected_faces(scene)) < LOOKING


def test_a_shape_that_is_alone_in_its_kind_is_not_copied(scene):
    packed = pack(scene)
    assert all(np.shares_memory(a, b) for a, b in zip(packed.parts[0], packed.kinds[0].prims, strict=True))

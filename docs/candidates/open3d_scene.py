"""Open3D's RaycastingScene: triangles only. pip install open3d; Debian needs libusb-1.0-0 and libgl1 for it

mitsuba-ref validate scenes/torus-smooth.toml --candidate docs.candidates.open3d_scene:trace
mitsuba-ref validate scenes/torus-smooth.toml --candidate docs.candidates.open3d_scene:trace_with_our_normals
"""

import numpy as np
import open3d
from open3d.core import Tensor


def trace(scene, o, d):
    """`cast_rays` gives t in lengths of d and the normal of the face, both float32."""
    found = cast(meshes_of(scene), o, d)
    return found["t_hit"].numpy(), found["primitive_normals"].numpy()


def trace_with_our_normals(scene, o, d):
    """The same hits, with normals made from the corners of the faces: those of `cast_rays` are a little off."""
    meshes = meshes_of(scene)
    found = cast(meshes, o, d)
    n = np.zeros((len(o), 3), np.float32)
    for number, mesh in enumerate(meshes):
        rows = np.flatnonzero(found["geometry_ids"].numpy() == number)
        a, b, c = (mesh.vertices[mesh.faces[found["primitive_ids"].numpy()[rows], i]] for i in range(3))
        n[rows] = np.cross(b - a, c - a)
    return found["t_hit"].numpy(), n


def meshes_of(scene):
    if any(shape.type != "mesh" for shape in scene.shapes):
        raise NotImplementedError("a RaycastingScene casts rays at triangles only")
    return [shape.mesh() for shape in scene.shapes]


def cast(meshes, o, d):
    caster = open3d.t.geometry.RaycastingScene()
    for mesh in meshes:
        caster.add_triangles(Tensor(mesh.vertices.astype(np.float32)), Tensor(mesh.faces.astype(np.uint32)))
    return caster.cast_rays(Tensor(np.hstack([o, d]).astype(np.float32)))

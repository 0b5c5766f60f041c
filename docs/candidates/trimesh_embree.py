"""trimesh, which casts by Embree through embreex: triangles only. pip install trimesh embreex

mitsuba-ref validate scenes/torus-smooth.toml --candidate docs.candidates.trimesh_embree:trace
"""

import numpy as np
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector


def trace(scene, o, d):
    """`intersects_location`: the first point of each ray, from which t and the face's normal follow."""
    parts = [shape.mesh() for shape in scene.shapes if shape.type == "mesh"]
    if len(parts) < len(scene.shapes):
        raise NotImplementedError("trimesh casts rays at triangles only")
    meshes = [trimesh.Trimesh(part.vertices, part.faces, process=False) for part in parts]
    mesh = trimesh.util.concatenate(meshes)
    places, rays, faces = RayMeshIntersector(mesh).intersects_location(o, d, multiple_hits=False)
    t, n = np.full(len(o), np.inf), np.zeros((len(o), 3))
    along = d[rays]
    t[rays] = ((places - o[rays]) * along).sum(axis=1) / (along * along).sum(axis=1)
    n[rays] = mesh.face_normals[faces]
    return t, n


trace.precision = "float32"  # Embree's

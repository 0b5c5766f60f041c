import trimesh
from serve import first_of, t_of_points
from trimesh.ray.ray_triangle import RayMeshIntersector


def trace(v, f, o, d, t_min, t_max):
    mesh = trimesh.Trimesh(v, f, process=False)
    points, rays, _ = RayMeshIntersector(mesh).intersects_location(o, d, multiple_hits=False)
    return first_of(len(o), rays, t_of_points(o[rays], d[rays], points)), None

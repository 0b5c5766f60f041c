"""The scene in the very numbers that both sides trace: float32 values, meshes in world space."""

from pathlib import Path
from typing import Any

from caster.packing import Packed, Triangles
from caster.scene import Scene
from caster.shapes.plane import Planes
from caster.whole_files import check_folder, write_bytes
from mitsuba_ref.ply import ply_bytes
from mitsuba_ref.rebuilding import rebuilt
from mitsuba_ref.xml import safe_name


def traced_scene(scene: Scene, packed: Packed, folder: Path) -> Scene:
    """Film, camera, lights and materials as they were; shapes packed to float32, described anew.

    Everything made of triangles is a `mesh` without a to_world, its PLY file in `folder`/meshes; a ball is a `sphere`
    by centre and radius; stretched balls, tubes and disks are their unit shape under one matrix; planes have a normal
    and a point. packed: by as_float32.
    """
    check_folder(folder / "meshes")
    shapes = [_described(scene, packed, i, folder) for i in range(len(scene.shapes))]
    fields = {name: getattr(scene, name) for name in ("film", "camera", "lights", "materials", "shading")}
    return Scene(**fields, shapes=shapes)


def _described(scene: Scene, packed: Packed, i: int, folder: Path) -> dict[str, Any]:
    part, shape = packed.parts[i], scene.shapes[i]
    if isinstance(part, Triangles):
        path = folder / "meshes" / f"{i:04d}-{safe_name(scene.shape_names()[i])}.ply"
        write_bytes(path, ply_bytes(part))
        found: dict[str, Any] = {"type": "mesh", "file": str(path)}
        if not part.smooth.any():
            found["face_normals"] = True
    elif isinstance(part, Planes):  # any length of the normal is the same plane, so the very numbers will do
        found = {"type": "plane", "normal": part.normal[0].tolist(), "point": part.point[0].tolist()}
    else:
        found = rebuilt(part, 0)
    return {**found, "name": scene.shape_names()[i], "material": shape.material}

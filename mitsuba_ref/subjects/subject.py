"""The protocol of a subject, whoever is judged: it answers the rays of a scene; and the scene as it is traced."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from caster.geometry.packing import Packed, Triangles
from caster.geometry.world_space import as_float32
from caster.rendering.hits import RayHits, trace
from caster.rendering.images import evaluate, film_window
from caster.scene.model import Scene
from caster.system.atomic_files import check_folder, write_bytes
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.scene_xml.elements import ply_bytes, safe_name
from mitsuba_ref.shapes import kind_of
from mitsuba_ref.subjects.answer import FLOAT64, Answer

PrimitiveDescription = dict[str, Any]


def describe_primitive(part: Any, k: int) -> PrimitiveDescription:
    """A description of primitive k of a shape's arrays. Raises LookupError for a kind that has none."""
    return kind_of(part).describe(part, k)


def describe_surface(part: Any, k: int) -> PrimitiveDescription:
    """A description of the same surface, of whatever bits. Raises LookupError for a kind that has none."""
    kind = kind_of(part)
    return (kind.describe_surface or kind.describe)(part, k)


def packs_identically(part: Any, k: int, packed: Packed) -> bool:
    """Whether a scene packs to primitive k of these arrays and nothing else; a sphere's turn, for uv, apart."""
    if len(packed.parts) != 1 or type(packed.parts[0]) is not type(part):
        return False
    numbers = kind_of(part).numbers
    there, here = numbers(packed.parts[0], 0), numbers(part, k)
    return all(np.array_equal(a, b) for a, b in zip(there, here, strict=True))


# The scene in the very numbers that both sides trace: float32 values, meshes in world space.


def scene_as_traced(scene: Scene, packed: Packed, folder: Path) -> Scene:
    """Film, camera, lights and materials as they were; shapes packed to float32, described anew.

    Everything made of triangles is a `mesh` without a to_world, its PLY file in `folder`/meshes; a sphere is a `sphere`
    by centre and radius; ellipsoids, cylinders and disks are their unit shape under one matrix; planes have a normal
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
    else:
        found = describe_surface(part, 0)
    return {**found, "name": scene.shape_names()[i], "material": shape.material}


# The protocol of a subject, whoever is judged: it answers the rays of a scene with an `Answer`.


@dataclass(frozen=True)
class CastRequest:
    """One scene, its primitives in the float32 numbers that Mitsuba traces, and its rays."""

    scene: Scene  # as described
    model: SceneModel
    rays: SharedRays
    folder: Path  # a temporary one

    @cached_property
    def traced(self) -> Scene:
        """The scene described anew by the numbers that are traced; its meshes are files in `folder`."""
        return scene_as_traced(self.scene, self.model.packed, self.folder)


class Subject(Protocol):
    """A ray caster: ours, or a candidate in its place."""

    @property
    def name(self) -> str:
        """As its user named it; "" for ours."""

    @property
    def reads_xml(self) -> bool:
        """Whether it casts the same rays through the same scene as plain Mitsuba."""

    @property
    def takes_rays(self) -> bool:
        """Whether it casts the rays that it is given, so that it can be given some of them."""

    def answer(self, request: CastRequest) -> Answer:
        """The answer to every ray. Raises NoAnswer."""


# ---- our own caster ----

# What is compared, and the mask, which always comes along.
COMPARED_AOVS = ("depth", "position", "normal", "shading_normal", "shape_id", "diffuse")

# What has to follow from the hits, beside that.
DERIVED_AOVS = ("hit", "albedo", "prim_id")


def cast_ours(scene: Scene, rays: SharedRays) -> RayHits:
    """Our caster along the shared rays, on the float32 geometry."""
    return trace(scene, rays.o, rays.d, rays.t_max, rays.start, rounded=as_float32)


def answer_of_view(
    scene: Scene, view: RayHits, aovs: Sequence[str] = (*COMPARED_AOVS, *DERIVED_AOVS)
) -> Answer:
    """The answer to the rays of a view, one a pixel of the film's window."""
    images = evaluate(view, aovs, film_window(scene))
    nearest = view.nearest
    return Answer(nearest.t, None, FLOAT64, {}, prim=nearest.prim, images=images, exact_visibility=True)


@dataclass(frozen=True)
class OurCaster:
    """The subject `ours`."""

    name: str = ""
    reads_xml: bool = False
    takes_rays: bool = True

    def answer(self, request: CastRequest) -> Answer:
        """Cast the request's rays."""
        return answer_of_view(request.scene, cast_ours(request.scene, request.rays))


OURS = OurCaster()

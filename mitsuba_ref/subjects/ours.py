"""Both sides' answers along the same rays."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from caster.geometry.world_space import as_float32
from caster.rendering.hits import RayHits, trace
from caster.rendering.images import Aovs, evaluate, film_window
from caster.scene.model import Scene
from mitsuba_ref.reference.rays import SharedRays
from mitsuba_ref.reference.rendering import ReferenceResult, aovs_of

# What is compared, and the mask, which always comes along.
COMPARED_AOVS = ("depth", "position", "normal", "shading_normal", "shape_id", "diffuse")

# What of ours has to follow from our own hits, beside that.
DERIVED_AOVS = ("hit", "albedo", "prim_id")


@dataclass(frozen=True)
class ImagePair:
    """Ours and the reference's pictures of one scene."""

    rays: SharedRays
    ours: Aovs
    reference: Aovs
    t: np.ndarray  # (n,) ours, lengths of d, inf on a miss
    prim: np.ndarray  # (n,) int32 ours, numbered through the scene, -1 on a miss
    witness: ReferenceResult

    @cached_property
    def length(self) -> np.ndarray:
        """(n,) of each ray's d."""
        length: np.ndarray = np.linalg.norm(self.rays.d.astype(np.float64), axis=1)
        return length


def cast_ours(scene: Scene, rays: SharedRays) -> RayHits:
    """Our caster along the shared rays, on the float32 geometry."""
    return trace(scene, rays.o, rays.d, rays.t_max, rays.start, rounded=as_float32)


def pair_images(scene: Scene, rays: SharedRays, view: RayHits, witness: ReferenceResult) -> ImagePair:
    """The two as pictures under the same names."""
    window = film_window(scene)
    ours = evaluate(view, (*COMPARED_AOVS, *DERIVED_AOVS), window)
    reference = aovs_of(witness, rays, (window.height, window.width), COMPARED_AOVS)
    return ImagePair(rays, ours, reference, view.nearest.t, view.nearest.prim, witness)

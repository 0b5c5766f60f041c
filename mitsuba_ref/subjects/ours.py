"""Our own caster as the subject: every quantity along the shared rays, on the float32 geometry, in float64."""

from collections.abc import Sequence
from dataclasses import dataclass

from caster.geometry.world_space import as_float32
from caster.rendering.hits import RayHits, trace
from caster.rendering.images import evaluate, film_window
from caster.scene.model import Scene
from mitsuba_ref.reference.rays import SharedRays
from mitsuba_ref.subjects.answer import FLOAT64, Answer
from mitsuba_ref.subjects.subject import CastRequest

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

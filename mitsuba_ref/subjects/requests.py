"""A candidate is asked about the rays of a scene, in the very numbers that Mitsuba traces."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Packed, pack
from caster.geometry.world_space import as_float32
from caster.scene.model import Scene
from mitsuba_ref.cameras.camera_reference import clip_planes
from mitsuba_ref.error_model.scene_model import SceneModel, model_of
from mitsuba_ref.reference.rays import SharedRays, shared_rays
from mitsuba_ref.reference.rendering import clip_range
from mitsuba_ref.subjects.answer import Answer, NoAnswer
from mitsuba_ref.subjects.subject import Candidate, CastRequest
from mitsuba_ref.subjects.traced_scene import scene_as_traced

FAR_PLANE_NOTE = "in the XML, planes end at the sensor's far plane, and nothing is judged beyond it"


class SubjectResponse(NamedTuple):
    """What a candidate was asked, and what it says."""

    scene: Scene  # with a far plane where the XML has to have one
    model: SceneModel
    rays: SharedRays
    answer: Answer
    limits: tuple[str, ...]  # what the XML leaves out, in words
    alone: Answer | NoAnswer | None  # about one of the rays alone; None: not asked


def request_answer(candidate: Candidate, scene: Scene, *, alone: int | None = None) -> SubjectResponse:
    """Ask about all rays of the film's window. alone: a row to be asked about by itself as well, if it has a ray.

    Raises NoAnswer, whose words say what the candidate did.
    """
    packed = pack(scene, as_float32)
    scene, ends = with_far_plane(scene, packed) if candidate.reads_xml else (scene, ())
    rays = shared_rays(scene)
    model = model_of(scene, packed, rays)
    with tempfile.TemporaryDirectory(prefix="mitsuba-ref-") as place:
        where = Path(place)
        question = CastRequest(scene, scene_as_traced(scene, packed, where), model, rays, where)
        try:
            answer = candidate.answer(question)
        except NoAnswer as error:
            raise NoAnswer(f"the candidate gave no answer to judge: {error}") from error
        again = None if alone is None else _about_one_ray(candidate, question, alone)
    return SubjectResponse(scene, model, rays, answer, ends, again)


def _about_one_ray(candidate: Candidate, question: CastRequest, row: int) -> Answer | NoAnswer | None:
    """A program shoots its own rays, so that only a function can be asked."""
    if not candidate.takes_rays or question.rays.t_max[row] < 0.0:
        return None
    try:
        return candidate.answer(replace(question, rays=one_of(question.rays, row)))
    except NoAnswer as error:
        return error


def one_of(rays: SharedRays, row: int) -> SharedRays:
    """One ray, as rays."""
    return SharedRays(*(values[row : row + 1] for values in rays))


def with_far_plane(scene: Scene, packed: Packed) -> tuple[Scene, tuple[str, ...]]:
    """The scene as the XML has it, and what that leaves out: Mitsuba's sensors end somewhere, and a plane does not."""
    model = model_of(scene, packed, shared_rays(scene))
    if np.isfinite(model.boxes).all() or getattr(scene.camera, "far", 0.0) is not None:
        return scene, ()
    far = clip_planes(scene.camera, clip_range(scene, model))["far_clip"]
    camera = scene.camera.model_copy(update={"far": far})
    return scene.model_copy(update={"camera": camera}), (FAR_PLANE_NOTE,)

"""A candidate is asked about the rays of a scene, in the very numbers that Mitsuba traces."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from caster.packing import Packed, pack
from caster.placing import as_float32
from caster.scene import Scene
from mitsuba_ref.camera_reference import clip_planes
from mitsuba_ref.candidate.answer import Answer, NoAnswer
from mitsuba_ref.candidate.asking import Candidate, Question
from mitsuba_ref.candidate.traced import traced_scene
from mitsuba_ref.export import limits
from mitsuba_ref.model import Model, model_of
from mitsuba_ref.rays import SharedRays, share

PLANES_END = "in the XML, planes end at the sensor's far plane, and nothing is judged beyond it"


class Heard(NamedTuple):
    """What a candidate was asked, and what it says."""

    scene: Scene  # with a far plane where the XML has to have one
    model: Model
    rays: SharedRays
    answer: Answer
    limits: tuple[str, ...]  # what the XML leaves out, in words
    alone: Answer | NoAnswer | None  # about one of the rays alone; None: not asked


def hear(candidate: Candidate, scene: Scene, *, alone: int | None = None) -> Heard:
    """Ask about all rays of the film's window. alone: a row to be asked about by itself as well, if it has a ray.

    Raises NoAnswer, whose words say what the candidate did.
    """
    packed = pack(scene, as_float32)
    scene, ends = with_far_plane(scene, packed) if candidate.reads_xml else (scene, ())
    rays = share(scene)
    model = model_of(scene, packed, rays)
    with tempfile.TemporaryDirectory(prefix="mitsuba-ref-") as place:
        where = Path(place)
        question = Question(scene, traced_scene(scene, packed, where), model, rays, where)
        try:
            answer = candidate.answer(question)
        except NoAnswer as error:
            raise NoAnswer(f"the candidate gave no answer to judge: {error}") from error
        again = None if alone is None else _about_one_ray(candidate, question, alone)
    return Heard(scene, model, rays, answer, ends, again)


def _about_one_ray(candidate: Candidate, question: Question, row: int) -> Answer | NoAnswer | None:
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
    model = model_of(scene, packed, share(scene))
    if np.isfinite(model.boxes).all() or getattr(scene.camera, "far", 0.0) is not None:
        return scene, ()
    far = clip_planes(scene.camera, limits(scene, model))["far_clip"]
    camera = scene.camera.model_copy(update={"far": far})
    return scene.model_copy(update={"camera": camera}), (PLANES_END,)

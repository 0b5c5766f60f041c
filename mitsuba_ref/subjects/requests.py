"""Requests to a subject: the rays of a scene, in the values that Mitsuba traces."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from caster.description.errors import SceneError, error_prefix
from caster.geometry.packing import Packed
from caster.image.exr import read_exr
from caster.scene.model import Scene
from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.cameras import reference_of_camera
from mitsuba_ref.cameras.camera_reference import clip_planes
from mitsuba_ref.error_model.scene_model import SceneModel, UncertainRaysModel
from mitsuba_ref.error_model.tolerances import KU
from mitsuba_ref.reference.originals import original_of
from mitsuba_ref.reference.shared_input import (
    SharedRays,
    clip_range,
    described_model,
    model_of,
    packed_float32,
    shared_rays,
)
from mitsuba_ref.subjects.command import (
    PLACEHOLDER,
    PLACEHOLDERS,
    RAY_PLACEHOLDERS,
    CommandSubject,
    ExrFile,
    RayCommand,
    ServedCommand,
    split_command,
)
from mitsuba_ref.subjects.function import FUNCTION_PATTERN, import_function
from mitsuba_ref.subjects.subject import DEFAULT_SECONDS, PRECISIONS, Answer, CastRequest, NoAnswer, Subject

FAR_PLANE_NOTE = "in the XML, planes end at the sensor's far plane, and nothing is judged beyond it"


class SubjectResponse(NamedTuple):
    """A request to a subject and its answer."""

    scene: Scene  # with a far plane where the XML has to have one
    model: SceneModel
    rays: SharedRays
    answer: Answer
    view: SceneModel  # the model with the uncertainty of the subject's own rays
    limits: tuple[str, ...] = ()  # notes on what the XML leaves out


def request_answer(
    subject: Subject, scene: Scene, *, rays: SharedRays | None = None, whole: SharedRays | None = None
) -> SubjectResponse:
    """The answer of a subject to all rays of the film's window.

    rays: of a list, laid out as that film, in place of the camera's. whole: the rays to which patches of
    planes are cut, if not those of the window. Raises NoAnswer.
    """
    packed = packed_float32(scene)
    scene, ends = with_far_plane(scene, packed) if subject.reads_xml else (scene, ())
    original = original_of(scene)
    if original and original.coverage.partial and rays is not None:
        raise SceneError(f"a list of rays needs every shape: {original.coverage.brief} of the Mitsuba file are judged")
    if original and not original.exact_camera and not subject.takes_rays:
        raise NoAnswer(f"an image is of the scene's camera, which the caster has not ({original.coverage.notes[0]})")
    rays = shared_rays(scene) if rays is None else rays
    model = model_of(scene, rays if whole is None else whole, packed)
    with ScratchFolder() as folder:
        request = CastRequest(scene, model, rays, Path(folder))
        try:
            answer = subject.answer(request)
        except NoAnswer as error:
            raise type(error)(f"the candidate gave no answer to judge: {error}") from error
    view = model
    if answer.own_camera:  # its rays are known up to float32 rounding, which turns d and shifts o
        described = described_model(scene) if answer.own_geometry else None
        about = model.packed, model.parts, model.kinds, model.models
        turn = KU * reference_of_camera(scene.camera).amplification(scene.camera, scene.film)
        reach = float(np.abs(scene.camera.eye).max()) + getattr(scene.camera, "width", 0.0)
        view = UncertainRaysModel(*about, turn, turn * reach, as_described=described)
    return SubjectResponse(scene, model, rays, answer, view, ends)


def with_far_plane(scene: Scene, packed: Packed) -> tuple[Scene, tuple[str, ...]]:
    """(the scene as in the XML, notes on what it leaves out): Mitsuba's sensors have a far plane, which cuts planes."""
    model = model_of(scene, shared_rays(scene), packed)
    if np.isfinite(model.boxes).all() or getattr(scene.camera, "far", 0.0) is not None:
        return scene, ()
    far = clip_planes(scene.camera, clip_range(scene, model))["far_clip"]
    camera = scene.camera.model_copy(update={"far": far})
    return scene.model_copy(update={"camera": camera}), (FAR_PLANE_NOTE,)


def parse_candidate(
    text: str, precision: str | None = None, seconds: float = DEFAULT_SECONDS, *, served: bool = False
) -> Subject:
    """A subject from package.module:function, a command with placeholders, or an EXR file; served: a command without
    any.

    Raises SceneError for other texts, a function that cannot be imported, and a program that does not exist;
    FileMissing or UnreadableExr for an image.
    """
    if precision not in (None, *PRECISIONS):
        raise SceneError(f"--candidate-precision: expected {' or '.join(PRECISIONS)}, got {precision!r}")
    with error_prefix(f"--candidate{'-serve' if served else ''} {text!r}"):
        if served:
            return ServedCommand(text, split_command(text, ()), precision, seconds)
        if FUNCTION_PATTERN.fullmatch(text):
            return import_function(text, precision)
        if not PLACEHOLDER.search(text):
            if text.lower().endswith(".exr"):
                return ExrFile(text, read_exr(text), precision)
            raise SceneError(
                f"expected package.module:function{_function_in(text)}, or a command such as 'my-renderer {{xml}} -o "
                "{exr}' ({toml} in place of {xml} for our scene file), or an image, .exr"
            )
        words, named = split_command(text, (*PLACEHOLDERS, *RAY_PLACEHOLDERS)), {*PLACEHOLDER.findall(text)}
        if named & {"rays", "hits", "mesh"}:
            if not {"rays", "hits"} <= named <= set(RAY_PLACEHOLDERS):
                expected = "{rays}, the file to read, {hits}, that to write, and at most {mesh} and {toml} beside them"
                raise SceneError(f"expected {expected}")
            return RayCommand(text, words, precision, seconds)
        if "exr" not in named or not named & {"xml", "toml"} or not named <= set(PLACEHOLDERS):
            raise SceneError("expected {exr}, the file to write, and {xml} or {toml}, the scene")
        return CommandSubject(text, words, precision, seconds)


def _function_in(text: str) -> str:
    """The end of a message about the name of a module or its file: a function that is in it."""
    file = Path(f"{text.removesuffix('.py').replace('.', '/')}.py")
    functions = re.findall(r"^def (\w+)", file.read_text(errors="replace"), re.MULTILINE) if file.is_file() else []
    name = "trace" if "trace" in functions else "".join(functions[-1:])
    return f", did you mean '{'.'.join(file.with_suffix('').parts)}:{name}'?" if name else ""

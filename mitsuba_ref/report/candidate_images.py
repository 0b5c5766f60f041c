"""What a candidate was judged on, as files: its own picture, the reference's, and the class of every pixel."""

from pathlib import Path

import numpy as np

from caster.image.channels import aovs_to_channels
from caster.rendering.images import Aovs
from mitsuba_ref.judge.candidate_judge import CandidateJudge, CandidateJudgement
from mitsuba_ref.judge.verdict import FAILING
from mitsuba_ref.report import class_colors
from mitsuba_ref.report.class_images import class_map, clipped_to_float32, write_image_files
from mitsuba_ref.subjects.answer import NOT_FINITE


def write_images(folder: Path, name: str, judge: CandidateJudge, judgement: CandidateJudgement) -> None:
    """NAME.candidate.exr, NAME.reference.exr and NAME.verdict.exr. Raises OutputError."""
    hit = judge.answer.hit | judge.witness.hit | judgement.is_class(*FAILING)
    ratio = np.max(list(judgement.ratios.values()), axis=0)
    pictures = {
        "candidate": {
            channel: clipped_to_float32(values)
            for channel, values in aovs_to_channels(candidate_aovs(judge)).items()
        },
        "reference": aovs_to_channels(judge.reference),
        "verdict": class_map(hit.reshape(judge.reference.hit.shape), judgement.classes, ratio),
    }
    write_image_files(folder, name, judge.scene, pictures, class_colors.attributes())


def candidate_aovs(judge: CandidateJudge) -> Aovs:
    """What the candidate said, as pictures; depth counts from the eye, as the reference's.

    A normal that is not finite is NaN."""
    answer, shape = judge.answer, judge.reference.hit.shape
    length = np.linalg.norm(judge.d, axis=1)
    with np.errstate(over="ignore"):
        depth = judge.rays.start + answer.t * length
    images = {"depth": depth.reshape(shape)}
    if answer.n is not None:
        none = answer.broken.get(NOT_FINITE, np.zeros(len(answer.t), bool))
        images["normal"] = np.where(none[:, None], np.nan, answer.n).reshape(*shape, 3)
    return Aovs(images, answer.hit.reshape(shape))

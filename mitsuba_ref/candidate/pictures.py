"""What a candidate was judged on, as files: its own picture, the reference's, and the class of every pixel."""

from pathlib import Path

import numpy as np

from caster.channels import channels_of
from caster.rendering import Aovs
from mitsuba_ref import class_colors
from mitsuba_ref.candidate.answer import NOT_FINITE
from mitsuba_ref.candidate.judge import CandidateJudge, CandidateJudgement
from mitsuba_ref.pictures import class_map, within_float32, write_all
from mitsuba_ref.verdict import CANDIDATE_WRONG, CLASSES, FAILING, OURS_WRONG


def write_pictures(folder: Path, name: str, judge: CandidateJudge, judgement: CandidateJudgement) -> None:
    """NAME.candidate.exr, NAME.reference.exr and NAME.verdict.exr. Raises OutputError."""
    hit = judge.answer.hit | judge.witness.hit | judgement.is_class(*FAILING)
    ratio = np.max(list(judgement.ratios.values()), axis=0)
    pictures = {
        "candidate": {
            channel: within_float32(values) for channel, values in channels_of(candidate_aovs(judge)).items()
        },
        "reference": channels_of(judge.reference),
        "verdict": class_map(hit.reshape(judge.reference.hit.shape), judgement.classes, ratio),
    }
    names = [CANDIDATE_WRONG if text == OURS_WRONG else text for text in CLASSES]
    write_all(folder, name, judge.scene, pictures, class_colors.attributes(names))


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

"""What a candidate was judged on, as files: its own picture, the reference's, and the class of every pixel."""

from pathlib import Path

import numpy as np

from caster import __version__
from caster.channels import channels_of, provenance
from caster.exr import write_exr
from caster.rendering import Aovs
from mitsuba_ref.candidate.answer import NOT_FINITE
from mitsuba_ref.candidate.judge import CandidateJudge, CandidateJudgement
from mitsuba_ref.verdict import CANDIDATE_WRONG, CLASSES, OURS_WRONG


def write_pictures(folder: Path, name: str, judge: CandidateJudge, judgement: CandidateJudgement) -> None:
    """NAME.candidate.exr, NAME.reference.exr and NAME.verdict.exr. Raises OutputError."""
    shape = judge.reference.hit.shape
    ratio = np.max(list(judgement.ratios.values()), axis=0)
    verdict = {"class.I": judgement.classes.reshape(shape).astype(np.uint32), "ratio.Y": ratio.reshape(shape)}
    names = [CANDIDATE_WRONG if text == OURS_WRONG else text for text in CLASSES]
    codes = {"caster/classes": ", ".join(f"{code} {text}" for code, text in enumerate(names))}
    about = provenance(judge.scene, __version__, name) | codes
    pictures = {
        "candidate": channels_of(candidate_aovs(judge)),
        "reference": channels_of(judge.reference),
        "verdict": verdict,
    }
    film = (0, 0, judge.scene.film.width, judge.scene.film.height)
    for which, channels in pictures.items():
        path = folder / f"{name}.{which}.exr"
        write_exr(path, channels, about, data_window=judge.scene.film.window, display_window=film)


def candidate_aovs(judge: CandidateJudge) -> Aovs:
    """What the candidate said, as pictures; depth counts from the eye, as the reference's.

    A normal that is not finite is NaN."""
    answer, shape = judge.answer, judge.reference.hit.shape
    length = np.linalg.norm(judge.d, axis=1)
    images = {"depth": (judge.rays.start + answer.t * length).reshape(shape)}
    if answer.n is not None:
        none = answer.broken.get(NOT_FINITE, np.zeros(len(answer.t), bool))
        images["normal"] = np.where(none[:, None], np.nan, answer.n).reshape(*shape, 3)
    return Aovs(images, answer.hit.reshape(shape))

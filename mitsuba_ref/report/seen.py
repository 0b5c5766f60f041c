"""What a scene's verdict rests on, kept until somebody writes it down."""

from typing import NamedTuple

from mitsuba_ref.judge import Judge, Judgement


class Seen(NamedTuple):
    """Both pictures and what was found about each of their pixels: some 60 MB for 256 x 256 pixels."""

    judge: Judge
    judgement: Judgement

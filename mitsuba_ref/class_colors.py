"""The colour of each class of a pixel, wherever classes are drawn."""

from mitsuba_ref.verdict import CLASSES

COLORS = {
    "agree": (70, 120, 80),
    "explained": (255, 150, 0),
    "tie": (0, 200, 200),
    "reference_wrong": (200, 90, 255),
    "out_of_domain": (90, 90, 255),
    "ours_wrong": (255, 0, 0),
    "undecided": (255, 255, 0),
}


def in_words() -> str:
    """ "0 #467850, 1 ...": code and colour of each class, as files of verdicts carry it."""
    return ", ".join(f"{code} #{bytes(COLORS[name]).hex()}" for code, name in enumerate(CLASSES))

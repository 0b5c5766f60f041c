"""Colours of the classes of pixels, in images and as attributes of EXR files.

The report's page has the same, and one more for unlisted cases (report/html/page/colors.js, which a test compares).
"""

from collections.abc import Sequence

from mitsuba_ref.judge.verdict import CLASSES

COLORS = {
    "agree": (70, 120, 80),
    "explained": (255, 150, 0),
    "tie": (0, 200, 200),
    "reference_wrong": (200, 90, 255),
    "out_of_domain": (90, 90, 255),
    "wrong": (255, 0, 0),
    "undecided": (255, 255, 0),
}


def in_hex(name: str) -> str:
    """ "#467850"."""
    return f"#{bytes(COLORS[name]).hex()}"


def attributes(names: Sequence[str] = CLASSES) -> dict[str, str]:
    """EXR attributes that define the codes of a channel class.I. names: of the classes in that file."""
    return {
        "caster/classes": ", ".join(f"{code} {name}" for code, name in enumerate(names)),
        "caster/class_colors": ", ".join(f"{code} {in_hex(name)}" for code, name in enumerate(CLASSES)),
    }

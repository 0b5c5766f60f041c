"""The colour of each class of a pixel, wherever classes are drawn, and its name, as files of classes carry them.

The report's page has the same, and one more for what is unlisted (report/html/page/colors.js, which a test compares).
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
    """What an EXR file with the channel class.I says of its codes. names: what the classes are called there."""
    return {
        "caster/classes": ", ".join(f"{code} {name}" for code, name in enumerate(names)),
        "caster/class_colors": ", ".join(f"{code} {in_hex(name)}" for code, name in enumerate(CLASSES)),
    }

"""docs/glossary.md: in alphabetical order, every place exists, every class of a pixel is there."""

import re
from pathlib import Path

from mitsuba_ref.judge.verdict import CLASSES

ROOT = Path(__file__).resolve().parents[2]
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in (ROOT / "docs/glossary.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| term ")
]
TERMS = [row[0] for row in ROWS]


def test_the_terms_are_in_order_and_distinct():
    keys = [term.lower() for term in TERMS]
    assert keys == sorted(set(keys))


def test_every_place_exists():
    missing = [
        (term, place)
        for term, _, where in ROWS
        for place in re.findall(r"`([^`]+)`", where)
        if not (ROOT / place).exists()
    ]
    assert not missing and len(TERMS) > 40


def test_every_class_of_a_pixel_is_defined():
    assert set(CLASSES) <= set(TERMS)

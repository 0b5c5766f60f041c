"""Reproducers of the pixels where somebody is wrong, as files."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from caster.whole_files import write_text
from mitsuba_ref.jobs import Crash
from mitsuba_ref.judge import CODE, Judge, Judgement
from mitsuba_ref.judging import judge_of
from mitsuba_ref.reproducer import Reproducer, reproducer
from mitsuba_ref.telling import head_of, side_words
from mitsuba_ref.verdict import CLASSES, OURS_WRONG, REFERENCE_WRONG, UNLISTED, pixel_of

MOST = 2  # reproducers of one scene and case, or of ours_wrong: each is checked by asking Mitsuba again


class Stored(NamedTuple):
    """What came of storing a scene's reproducers."""

    files: tuple[str, ...]
    left_out: int  # pixels of the same classes without a file


def store_all(folder: Path, name: str, judge: Judge, judgement: Judgement, source: str) -> Stored:
    """NAME.CASE.X-Y.toml for pixels where ours or the reference is wrong, at most MOST a case. Raises OutputError."""
    files: list[str] = []
    left_out = 0
    for label, rows in _by_case(judgement).items():
        left_out += len(rows[MOST:])
        for row in rows[:MOST]:
            x, y = pixel_of(judge.scene, row)
            path = folder / f"{name}.{label}.{x}-{y}.toml"
            store(path, judge, judgement, row, f"{source}, pixel ({x}, {y})")
            files.append(path.name)
    return Stored(tuple(files), left_out)


def store(
    path: Path, judge: Judge, judgement: Judgement, row: int, source: str, more: Sequence[str] = ()
) -> bool:
    """Write one, and say in it whether its few primitives alone show the same. more: lines of comment.

    Raises OutputError, SceneError.
    """
    found = reproducer(judge, row, lit=bool(judgement.ratio("diffuse")[row] > 1.0))
    same, words = shows_the_same(found, judge, judgement, row)
    write_text(path, found.text([*head_of(judge, judgement, row, source), words, *more]))
    return same


def shows_the_same(found: Reproducer, judge: Judge, judgement: Judgement, row: int) -> tuple[bool, str]:
    """(whether class and Mitsuba's answer come out the same, that in words)."""
    again = judge_of(found.scene)
    if isinstance(again, Crash):
        return False, f"Checked:   Mitsuba ended without an answer on this file ({again.exit})."
    verdict, before = (CLASSES[int(code)] for code in (again.judge().classes[0], judgement.classes[row]))
    t, t_before = float(again.pair.witness.t[0]), float(judge.pair.witness.t[row])
    if verdict == before and (t == t_before or (np.isnan(t) and np.isnan(t_before))):
        return True, "Checked:   this file alone gives the same class, and the same t of Mitsuba."
    told = f"class {verdict}, Mitsuba: {side_words(again, 0, ours=False)}"
    return (
        False,
        f"Checked:   NOT THE SAME from this file alone, so what else is in the scene matters: {told}.",
    )


def _by_case(judgement: Judgement) -> dict[str, list[int]]:
    """Rows by the label of their file, worst first."""
    rows: dict[str, list[int]] = {}
    for row in _worst_first(judgement, REFERENCE_WRONG):
        case = judgement.cases.get(row)
        rows.setdefault(UNLISTED if case is None else f"case-{case}", []).append(row)
    for row in _worst_first(judgement, OURS_WRONG):
        rows.setdefault(OURS_WRONG.replace("_", "-"), []).append(row)
    return rows


def _worst_first(judgement: Judgement, name: str) -> Iterator[int]:
    rows = np.flatnonzero(judgement.classes == CODE[name])
    worst = np.max([judgement.excess(check)[rows] for check in judgement.names], axis=0)
    yield from rows[np.argsort(-worst, kind="stable")].tolist()

"""A sweep for the terminal, and the same table in Markdown."""

from collections.abc import Iterator

from mitsuba_ref.stress.score import Score
from mitsuba_ref.stress.sweeps import Outcome, Sweep
from mitsuba_ref.stress.witnesses import SCREEN, WITNESSES, Absent, Witness

NOTHING = "-"


def as_text(sweep: Sweep) -> str:
    """Head, one row a setting, who breaks down where, and what of ours fails."""
    family = sweep.family
    rows = [columns(sweep), *cells(sweep)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    mark = "PASS" if sweep.ok else "FAIL"
    head = (
        f"{mark}  {family.name}: {family.title}; {family.error}, wrong hits or misses   {sweep.seconds:.1f} s"
    )
    return "\n".join([head, *lines, *footnotes(sweep), *(f"FAIL  {line}" for line in sweep.problems)])


def shown_witnesses(sweep: Sweep) -> list[Witness]:
    """The witnesses that have a column: the screen only where it was asked."""
    absent = sweep.absence(SCREEN.key)
    return [witness for witness in WITNESSES if witness is not SCREEN or absent is None]


def columns(sweep: Sweep) -> list[str]:
    names = [name for witness in shown_witnesses(sweep) for name in (witness.key, "wrong")]
    return [sweep.family.quantity, "rays", "hits", "ties", "bound 64", "bound 32", *names]


def cells(sweep: Sweep) -> Iterator[list[str]]:
    for outcome in sweep.outcomes:
        bounds = [number(outcome.bound.float64), number(outcome.bound.float32)]
        counts = [f"{outcome.x:.4g}", str(outcome.rays), str(outcome.hits), str(outcome.ties)]
        said = [cell for witness in shown_witnesses(sweep) for cell in of_score(outcome, witness.key)]
        yield [*counts, *bounds, *said]


def of_score(outcome: Outcome, key: str) -> list[str]:
    """Largest error, with a ! beyond its bound; wrong masks, and wrong primitives behind a +."""
    score = outcome.scores[key]
    if isinstance(score, Absent):
        return [score.status, NOTHING]
    wrong = str(score.wrong_masks) + (f"+{score.wrong_primitives}" if score.wrong_primitives else "")
    return [number(score.error) + ("!" if score.beyond else ""), wrong]


def number(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1e}" if value else "0"


def footnotes(sweep: Sweep) -> Iterator[str]:
    """Where each witness first breaks down; why one is not there."""
    places = [f"{witness.key} {breakdown(sweep, witness.key)}" for witness in shown_witnesses(sweep)]
    yield f"breaks down at: {', '.join(places)}"
    if any(outcome.closed for outcome in sweep.outcomes):
        yield leaks(sweep)
    for witness in shown_witnesses(sweep):
        absent = sweep.absence(witness.key)
        if absent:
            yield f"{witness.title}: {absent.status}: {absent.why}"


def breakdown(sweep: Sweep, key: str) -> str:
    absent = sweep.absence(key)
    if absent:
        return absent.status
    places = sweep.breakdowns(key)
    return " and ".join(f"{x:.4g}" for x in places) if places else "never"


def leaks(sweep: Sweep) -> str:
    """Rays that got out of a closed mesh, all settings together."""
    found = []
    for witness in shown_witnesses(sweep):
        scores = [outcome.scores[witness.key] for outcome in sweep.outcomes]
        out = sum(score.false_misses for score in scores if isinstance(score, Score))
        absent = sweep.absence(witness.key)
        found.append(f"{witness.key} {absent.status if absent else out}")
    return f"leaks of {sum(outcome.rays for outcome in sweep.outcomes)} rays: {', '.join(found)}"

"""What a campaign did, as text and as JSON."""

from collections.abc import Iterator, Sequence
from typing import Any

from mitsuba_ref.fuzz.campaign import Outcome
from mitsuba_ref.fuzz.findings import Tally

COLUMNS = ("examples", "rays", "hits", "edges", "ties", "unbounded", "outside", "judged", "findings")


def text(outcome: Outcome) -> str:
    """A row a family, the failures, and a summary."""
    return "\n".join([*_table(outcome), *_failures(outcome), *_summary(outcome)])


def _table(outcome: Outcome) -> Iterator[str]:
    width = (
        max(len("family"), *(len(name) for name in outcome.families)) if outcome.families else len("family")
    )
    yield f"{'family':<{width}}" + "".join(f"  {name:>9}" for name in COLUMNS)
    for name, tally in outcome.families.items():
        yield f"{name:<{width}}" + _row(tally)
    if len(outcome.families) > 1:
        yield f"{'all':<{width}}" + _row(outcome.total)


def _row(tally: Tally) -> str:
    return "".join(f"  {getattr(tally, name):>9}" for name in COLUMNS)


def _failures(outcome: Outcome) -> Iterator[str]:
    for failure in outcome.failures:
        yield f"FAIL  {failure.kind}: {failure.what}"
        yield f"      scene:  {failure.file}"
        yield f"      replay: mitsuba-ref fuzz --replay {failure.file}"
        yield f"      from:   mitsuba-ref fuzz {failure.example}"


def _summary(outcome: Outcome) -> Iterator[str]:
    total, seconds = outcome.total, max(outcome.seconds, 1e-9)
    kinds = ", ".join(f"{number} {kind}" for kind, number in sorted(total.kinds.items()))
    not_kept = total.findings - len(outcome.failures)
    yield (
        f"seed {outcome.seed}: {total.examples} examples, {total.rays} rays adjudicated by exact arithmetic, "
        f"{total.judged} scenes judged against Mitsuba, in {outcome.seconds:.1f} s "
        f"({total.examples / seconds:.1f} examples/s, {total.rays / seconds:.0f} rays/s)"
    )
    if total.findings:
        more = f"; {not_kept} more of the same sorts not kept" if not_kept else ""
        yield f"{total.findings} findings: {kinds}{more}"
    else:
        yield "nothing found"


def to_dict(outcome: Outcome, *, interrupted: bool) -> dict[str, Any]:
    """As --json has it."""
    return {
        "ok": outcome.ok,
        "interrupted": interrupted,
        "seed": outcome.seed,
        "last_example": outcome.last,
        "seconds": round(outcome.seconds, 3),
        "total": outcome.total.to_dict(),
        "families": {name: tally.to_dict() for name, tally in outcome.families.items()},
        "failures": [dict(vars(failure)) for failure in outcome.failures],
    }


def replay_text(lines: Sequence[tuple[str, str, list[str]]]) -> str:
    """(file, kind it was kept for, what is wrong today) -> a row a file, and a summary."""
    rows = []
    for file, kind, wrong in lines:
        rows.append(f"{'FAIL' if wrong else 'PASS'}  {file}  {kind}")
        rows += [f"      {what}" for what in wrong]
    failing = sum(bool(wrong) for _, _, wrong in lines)
    return "\n".join([*rows, f"{len(lines)} kept scenes: {len(lines) - failing} pass, {failing} fail"])

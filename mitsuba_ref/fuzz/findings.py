"""Findings, tallies of what was checked, and the outcome of a run as text and as JSON."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import pydantic.dataclasses
from pydantic import computed_field

from mitsuba_ref.error_model.intersections import Rays
from mitsuba_ref.report.output import aligned

# The kinds of findings, the most informative first.
FINDING_KINDS = {
    "error": "the caster, or the judge, raised an exception",
    "missed": "by exact arithmetic the ray hits something, ours misses",
    "phantom": "by exact arithmetic the ray misses, ours hits something",
    "prim": "another primitive is hit first by exact arithmetic, or as early with a lower number",
    "t": "t is farther from the exact one than float64 rounding explains",
    "culling": "two ways to cast the same ray differ in some bit",
    "surface": "a position or normal is not finite, or a normal is not of length 1",
    "check": "a check of the image that does not need Mitsuba fails",
    "judged": "the comparison with Mitsuba and exact arithmetic fails",
    "answer": "the candidate gave no answer to judge",
    "crash": "Mitsuba ended without an answer",
}
JUDGED_KINDS = ("judged", "answer", "crash")  # found by the judge, with Mitsuba


@dataclass(frozen=True)
class Finding:
    """One error: of a scene's image, or of a single ray."""

    kind: str
    what: str  # ours and the exact answer, in words
    ray: Rays | None = None  # one row
    detail: str = ""  # the check that fails, or in which way a pixel does

    @property
    def mode(self) -> tuple[str, str]:
        """The failure mode, which shrinking must preserve."""
        return self.kind, self.detail


@dataclass
class Tally:
    """Counts of what was checked, so that "nothing found" comes with how much was checked."""

    examples: int = 0
    rays: int = 0  # each adjudicated by the oracle, those of images included
    hits: int = 0
    edges: int = 0  # exact hits on an edge, a corner, a rim, or in a tangent
    ties: int = 0  # exact hits of several primitives at once
    unbounded: int = 0  # hits whose t has no float64 bound: nearly edge-on or tangent up to rounding
    outside: int = 0  # rays or scenes outside the oracle's domain
    judged: int = 0  # scenes compared with Mitsuba; of a candidate, its ray lists as well
    pixels: int = 0  # of these
    declined: int = 0  # scenes and ray lists that a candidate declined
    findings: int = 0
    kinds: Counter[str] = field(default_factory=Counter)

    def add(self, other: "Tally") -> None:
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)


@dataclass(frozen=True)
class Failure:
    """A finding whose scene was kept."""

    kind: str
    what: str  # of the smallest case
    family: str
    example: str  # the options that make the scene it was shrunk from
    file: str
    replay: str  # the command that checks the kept scene again


@pydantic.dataclasses.dataclass
class Outcome:
    """Tallies and failures of a run so far."""

    seed: int
    families: dict[str, Tally] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    candidate: str = ""  # the name of who is judged; "": ours
    last_example: int = -1  # the number of the last finished one
    seconds: float = 0.0
    interrupted: bool = True  # until the run has ended by itself
    left_out: tuple[str, ...] = ()  # types of shapes that the candidate declines

    @computed_field  # type: ignore[prop-decorator]
    @property
    def total(self) -> Tally:
        total = Tally()
        for tally in self.families.values():
            total.add(tally)
        return total

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        """Nothing found, and of a candidate, something judged."""
        return self.total.findings == 0 and (not self.candidate or self.total.judged > 0)


# Columns of the table, and the lines that explain them.
COLUMNS = (
    ("examples", "rays", "hits", "edges", "ties", "unbounded", "outside", "judged", "findings"),
    """edges: hits on an edge, a rim or a tangent; ties: of several primitives at once;
unbounded: t without a float64 bound; outside: rays that exact arithmetic does not take;
judged: scenes compared with Mitsuba, too""",
)
CANDIDATE_COLUMNS = (
    ("examples", "declined", "outside", "judged", "pixels", "findings"),
    """declined, judged: films and lists of rays; outside: those beyond float32""",
)


def text(outcome: Outcome) -> str:
    """A table with a row per family, the failures, and a summary."""
    columns, about = CANDIDATE_COLUMNS if outcome.candidate else COLUMNS
    tallies = dict(outcome.families) | ({"all": outcome.total} if len(outcome.families) > 1 else {})
    rows = [[name, *(str(getattr(tally, column)) for column in columns)] for name, tally in tallies.items()]
    head = ["rays" if name == "pixels" else name for name in columns]
    failures = [
        f"FAIL  {failure.kind}: {failure.what}\n"
        f"      scene:  {failure.file}\n"
        f"      replay: {failure.replay}\n"
        f"      from:   mitsuba-ref fuzz {failure.example}"
        for failure in outcome.failures
    ]
    return "\n".join([*aligned([["family", *head], *rows], left=1), about, *failures, *_summary(outcome)])


def _summary(outcome: Outcome) -> Iterator[str]:
    total = outcome.total
    work = f"{total.rays} rays adjudicated by exact arithmetic, {total.judged} scenes judged against Mitsuba"
    if outcome.candidate:
        work = f"{total.pixels} rays of {total.judged} films and lists judged against Mitsuba and exact arithmetic"
    yield f"seed {outcome.seed}: {total.examples} examples, {work}, in {outcome.seconds:.1f} s"
    if outcome.left_out:
        yield f"without shapes that it declines: {', '.join(outcome.left_out)}"
    if outcome.candidate and not total.judged:
        yield f"FAIL  nothing was judged: {outcome.candidate} declined every scene, or none fits float32"
    kinds = ", ".join(f"{number} {kind}" for kind, number in sorted(total.kinds.items()))
    not_kept = total.findings - len(outcome.failures)
    more = f"; {not_kept} more of the same kinds not kept" if not_kept else ""
    yield f"{total.findings} findings: {kinds}{more}" if total.findings else "nothing found"


def replay_text(replays: Sequence[tuple[str, str, list[Finding]]]) -> str:
    """(file, kind it was kept for, findings today) -> a row per file, and a summary."""
    rows = []
    for file, kind, findings in replays:
        rows += [f"{'FAIL' if findings else 'PASS'}  {file}  {kind}", *(f"      {f.kind}: {f.what}" for f in findings)]
    failing = sum(bool(findings) for *_, findings in replays)
    return "\n".join([*rows, f"{len(replays)} kept scenes: {len(replays) - failing} pass, {failing} fail"])

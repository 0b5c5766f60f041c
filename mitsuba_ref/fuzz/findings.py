"""What may be found wrong, and what was looked at."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mitsuba_ref.fuzz.aims import Shots

# The kinds of findings, in the order of how much they say.
FINDING_KINDS = {
    "error": "the caster, or what judges it, raised an exception",
    "missed": "there is a hit by exact arithmetic, ours is a miss",
    "phantom": "there is none by exact arithmetic, ours is a hit",
    "prim": "another primitive is hit first by exact arithmetic, or as early with a lower number",
    "t": "t is farther from the exact one than float64 rounding explains",
    "culling": "two ways to cast the same ray differ in some bit",
    "surface": "a position or normal is not finite, or a normal is not of length 1",
    "judged": "the judge's comparison with Mitsuba fails",
    "crash": "Mitsuba ended without an answer",
}


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong. Of a picture's pixel, or of a ray that was cast for itself."""

    kind: str
    what: str  # ours and the exact answer, in words
    ray: Shots | None = None  # one row: the ray, where the finding is about one
    pixel: tuple[int, int] | None = None
    detail: str = ""  # of a judged one: the class of the pixel, or the check that fails

    @property
    def way(self) -> tuple[str, str]:
        """In which way it is wrong: what has to stay when the scene is made smaller."""
        return self.kind, self.detail


@dataclass
class Tally:
    """What was looked at, so that nothing found is known to be more than nothing looked for."""

    examples: int = 0
    rays: int = 0  # each adjudicated by the oracle, those of pictures included
    hits: int = 0
    edges: int = 0  # exact hits on an edge, a corner, a rim, or in a tangent
    ties: int = 0  # exact hits of several primitives at once
    unbounded: int = 0  # hits whose t float64 cannot be held to: nearly edge-on or tangent up to rounding
    outside: int = 0  # rays or scenes outside the oracle's domain
    judged: int = 0  # scenes compared with Mitsuba
    pixels: int = 0  # that were judged
    worst: float = 0.0  # largest error of t over its bound
    findings: int = 0
    kinds: dict[str, int] = field(default_factory=dict)

    def add(self, other: "Tally") -> None:
        for name, value in vars(other).items():
            if name == "worst":
                self.worst = max(self.worst, value)
            elif name != "kinds":
                setattr(self, name, getattr(self, name) + value)
        for kind, number in other.kinds.items():
            self.kinds[kind] = self.kinds.get(kind, 0) + number

    def found(self, finding: Finding) -> None:
        self.findings += 1
        self.kinds[finding.kind] = self.kinds.get(finding.kind, 0) + 1

    def to_dict(self) -> dict[str, Any]:
        return dict(vars(self))


def first_of_each_kind(findings: list[Finding]) -> list[Finding]:
    """One of each, in the order of KINDS."""
    order = {kind: i for i, kind in enumerate(FINDING_KINDS)}
    firsts = {finding.kind: finding for finding in reversed(findings)}
    return sorted(firsts.values(), key=lambda finding: order[finding.kind])


def t_text(t: float) -> str:
    return f"{t!r} ({float(t).hex()})" if np.isfinite(t) else "a miss"

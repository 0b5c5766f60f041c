"""What a scene is made of, in a few words and numbers, for those who compare verdicts."""

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from caster.geometry.packing import packed
from caster.scene.errors import SceneError
from caster.scene.files import Scene
from mitsuba_ref.judge.scene_checks.bias import ErrorStatistics
from mitsuba_ref.judge.scene_checks.scene_check import SceneCheck
from mitsuba_ref.report.replay import replay


@dataclass(frozen=True)
class SceneStatistics:
    """camera: its type, "" where nobody told; shapes: type -> how many; primitives: 0 where nobody counted."""

    camera: str = ""
    shapes: dict[str, int] = field(default_factory=dict)
    primitives: int = 0

    @classmethod
    def of(cls, scene: Scene) -> "SceneStatistics":
        """What a scene says of itself; primitives are counted where they can be packed."""
        count = 0
        with suppress(SceneError):
            count = int(packed(scene).first[-1])
        return cls(str(scene.camera.type), dict(Counter(str(shape.type) for shape in scene.shapes)), count)


# Comparison, brackets and exact answers -> a class for every pixel -> the verdict of a scene.


if TYPE_CHECKING:
    from mitsuba_ref.report.html.evidence import Evidence

# The classes of a pixel; the last two fail.
CLASSES = ("agree", "explained", "tie", "reference_wrong", "out_of_domain", "ours_wrong", "undecided")
AGREE, EXPLAINED, TIE, REFERENCE_WRONG, OUT_OF_DOMAIN, OURS_WRONG, UNDECIDED = CLASSES
EVIDENCE = (AGREE, TIE)  # both sides were compared, and are right
EXCUSED = (
    EXPLAINED,
    OUT_OF_DOMAIN,
    REFERENCE_WRONG,
)  # ours was compared with itself and exact arithmetic alone
JUDGED_WITHOUT_REFERENCE = (
    *EXCUSED,
    TIE,
)  # ours is compared with another surface than the reference's, so with nothing but float64
FAILING = (OURS_WRONG, UNDECIDED)
# the case of a pixel where the reference is wrong in no way that mitsuba_ref/judge/known_defects.py lists
UNLISTED = "unlisted"
VERDICT_FORMAT = 2  # of verdict.json: raised when a name in it changes its meaning or goes away
MAX_LISTED_FAILURES = 10  # failures a scene lists; all are counted

# What the class of a pixel is called where somebody's ray caster was put in the place of ours.
CANDIDATE_WRONG = "candidate_wrong"


@dataclass(frozen=True)
class Failure:
    """One pixel that fails its scene."""

    x: int
    y: int
    verdict: str  # its class
    check: str
    ratio: float  # error over bound
    ours: str
    reference: str
    exact: str
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """As verdict.json has it."""
        return {**vars(self), "ratio": json_number(self.ratio)}


class Finding(NamedTuple):
    """What is wrong at some pixels, said once for all of them."""

    pixels: int
    what: str
    x: int  # of the first of them
    y: int


@dataclass(frozen=True)
class SceneVerdict:
    """What became of one scene."""

    name: str
    path: str  # as given; "" for a scene made in Python
    pixels: int = 0
    hit_pixels: int = 0  # hit in either picture
    counts: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(CLASSES, 0)
    )  # hit or undecided pixels
    ratios: dict[str, float] = field(
        default_factory=dict
    )  # largest ratio of each check among agreeing pixels
    checks: tuple[SceneCheck, ...] = ()
    failures: tuple[Failure, ...] = ()
    versions: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    reference_seconds: float = 0.0
    problem: str = ""  # why there is no comparison at all: a crash of the reference, with its words
    size: tuple[int, int] = (0, 0)  # of the film
    resized: bool = False  # another film than the scene's own
    made_of: SceneStatistics = field(default_factory=SceneStatistics)  # of the scene, where a command judged
    allowed: dict[str, float] = field(default_factory=dict)  # the scene's own [check.AOV]: shares of bounds
    adjudicated: int = 0  # pixels that exact arithmetic was asked about
    exact_seconds: float = 0.0  # what that took, of `seconds`
    cases: dict[str, int] = field(default_factory=dict)  # pixels where the reference is wrong, by known case
    reproducers: tuple[str, ...] = ()  # files, one ray each
    statistics: ErrorStatistics | None = None  # of the errors of t and of the normal; None without an answer
    not_stored: int = 0  # pixels that would have been stored as well, but for their number
    failing_by: dict[str, int] = field(default_factory=dict)  # pixels that fail, by each check they fail
    worst_by: dict[str, Failure] = field(default_factory=dict)  # the worst of them
    inputs: str = ""  # a hash of all that the verdict depends on, where somebody asked for it
    files: dict[str, dict[str, Any]] = field(default_factory=dict)  # written beside it: bytes and sha256
    kept: bool = False  # taken over from an earlier run of the same inputs, not judged now
    candidate: str = ""  # who was judged in the place of ours, as named; "" for ours
    precision: str = ""  # of the candidate: float32 or float64
    unjudged: tuple[str, ...] = ()  # what there is to judge, and of this candidate was not
    findings: tuple[Finding, ...] = ()  # what is wrong with the candidate, by number of pixels
    notes: tuple[str, ...] = ()  # what else the candidate's verdict rests on
    options: tuple[str, ...] = ()  # of the command line, beside --size, that a replay has to repeat
    # what it rests on, for write_html; None where nobody kept it
    seen: "Evidence | None" = field(default=None, repr=False, compare=False)

    def called(self, name: str) -> str:
        """What a class is called in what people and programs read: ours_wrong of a candidate is candidate_wrong."""
        return CANDIDATE_WRONG if self.candidate and name == OURS_WRONG else name

    @property
    def ok(self) -> bool:
        """No problem, no failing pixel, every check within its bound, and more evidence than excuses."""
        return not self.problem and not self.failing and self.has_evidence and self.checks_pass

    @property
    def failing(self) -> int:
        """Pixels that fail: ours is wrong, nobody knows, or the reference is wrong in a way that is not known.

        What nobody has seen of Mitsuba before may as well be a fault of what it was handed, so somebody has to look.
        """
        return sum(self.counts[name] for name in FAILING) + self.cases.get(UNLISTED, 0)

    @property
    def evidence(self) -> int:
        """Hit pixels where both sides were compared and are right."""
        return sum(self.counts[name] for name in EVIDENCE)

    @property
    def excused(self) -> int:
        """Hit pixels that pass without being evidence."""
        return sum(self.counts[name] for name in EXCUSED)

    @property
    def has_evidence(self) -> bool:
        """More hit pixels are evidence than are excused; a scene that hits nothing proves nothing."""
        return self.evidence > self.excused

    @property
    def checks_pass(self) -> bool:
        return all(check.ok for check in self.checks)

    @property
    def worst(self) -> tuple[str, float]:
        """The check that comes nearest to its bound, and how near."""
        return max(self.ratios.items(), key=lambda item: item[1], default=("", 0.0))

    def to_dict(self) -> dict[str, Any]:
        """As verdict.json has it. Infinite ratios are the text "inf": JSON has no number for them."""
        found = {
            "name": self.name,
            "path": self.path,
            "ok": self.ok,
            "size": list(self.size),
            "resized": self.resized,
            "made_of": vars(self.made_of),
            "allowed": self.allowed,
            "pixels": self.pixels,
            "hit_pixels": self.hit_pixels,
            "counts": {self.called(name): count for name, count in self.counts.items()},
            "adjudicated": self.adjudicated,
            "cases": self.cases,
            "reproducers": list(self.reproducers),
            "not_stored": self.not_stored,
            "ratios": {name: json_number(ratio) for name, ratio in self.ratios.items()},
            "statistics": None if self.statistics is None else statistics_record(self.statistics),
            "checks": [
                {"name": c.name, "ok": c.ok, "ratio": json_number(c.ratio), "what": c.what}
                for c in self.checks
            ],
            "failures": [self._told(failure) for failure in self.failures],
            "failing_by": self.failing_by,
            "worst_by": {name: self._told(failure) for name, failure in self.worst_by.items()},
            "versions": self.versions,
            "seconds": round(self.seconds, 3),
            "reference_seconds": round(self.reference_seconds, 3),
            "exact_seconds": round(self.exact_seconds, 3),
            "problem": self.problem,
            "inputs": self.inputs,
            "files": self.files,
            "kept": self.kept,
            "options": list(self.options),
            "replay": replay(self),
        }
        return found | self._of_candidate() if self.candidate else found

    def _told(self, failure: Failure) -> dict[str, Any]:
        """A pixel with the command that shows it again."""
        return failure.to_dict() | {"replay": replay(self, (failure.x, failure.y))}

    def _of_candidate(self) -> dict[str, Any]:
        """What verdict.json says of a candidate beside, or in other words than of ours."""
        failures = []
        for failure in self.failures:
            said = self._told(failure) | {"verdict": self.called(failure.verdict)}
            said["candidate"] = said.pop("ours")
            failures.append(said)
        return {
            "candidate": self.candidate,
            "precision": self.precision,
            "unjudged": list(self.unjudged),
            "findings": [finding._asdict() for finding in self.findings],
            "notes": list(self.notes),
            "failures": failures,
        }


def statistics_record(found: ErrorStatistics) -> dict[str, Any]:
    """The errors of a scene as verdict.json has them."""
    return {
        "pixels": found.pixels,
        "k_t": {"largest": found.t_largest, "p99": found.t_p99},
        "k_normal": {"largest": found.normal_largest, "p99": found.normal_p99},
        "looseness": json_number(found.looseness),
        "z": found.z,
        "biases": [{**bias._asdict(), "tells": bias.tells} for bias in found.biases],
    }


def json_number(ratio: float) -> float | str:
    return float(ratio) if np.isfinite(ratio) else str(float(ratio))


@dataclass(frozen=True)
class Verdict:
    """What became of all of them."""

    scenes: tuple[SceneVerdict, ...]
    asked: int = 1  # how many scenes were to be judged
    names: tuple[str, ...] = ()  # theirs, as far as they are known
    shard: str = ""  # such as "2/4": these are the scenes of one of several runs
    selected: tuple[str, ...] = ()  # names of the scenes of all shards
    code: str = ""  # a hash of the sources that judged; of one of several runs, of all their scenes, too
    judged_with: dict[str, str] = field(default_factory=dict)  # versions, variants, machine
    on_trial: str = ""  # the candidate that was asked for, though no scene may be done; "" for ours

    @property
    def candidate(self) -> str:
        """Who was judged, or to be judged, in the place of ours; "" for ours."""
        return self.on_trial or next((scene.candidate for scene in self.scenes), "")

    def called(self, name: str) -> str:
        """As SceneVerdict.called."""
        return CANDIDATE_WRONG if self.candidate and name == OURS_WRONG else name

    @property
    def ok(self) -> bool:
        """Every scene that was asked for is there and passes; no scene at all is no pass, but for an empty shard."""
        some = self.asked > 0 or bool(self.shard and self.selected)
        return some and len(self.scenes) == self.asked and all(scene.ok for scene in self.scenes)

    @property
    def not_judged(self) -> tuple[str, ...]:
        """Names of the scenes that were to be judged, and were not."""
        judged = {scene.name for scene in self.scenes}
        return tuple(name for name in self.names if name not in judged)

    @property
    def counts(self) -> dict[str, int]:
        """Hit pixels of all scenes by class."""
        return {name: sum(scene.counts[name] for scene in self.scenes) for name in CLASSES}

    @property
    def adjudicated(self) -> int:
        """Pixels that exact arithmetic was asked about."""
        return sum(scene.adjudicated for scene in self.scenes)

    @property
    def cases(self) -> dict[str, int]:
        """Pixels where the reference is wrong, by known case."""
        total: dict[str, int] = {}
        for scene in self.scenes:
            for case, count in scene.cases.items():
                total[case] = total.get(case, 0) + count
        return total

    @property
    def versions(self) -> tuple[str, ...]:
        """What judged them, each once."""
        said = [", ".join(f"{k} {v}" for k, v in scene.versions.items()) for scene in self.scenes]
        return tuple(dict.fromkeys(filter(None, said)))

    def write_html(self, path: str | Path) -> Path:
        """A report into a folder, or into one file if `path` ends in .html; returns the file to open.

        Scenes that come from mitsuba_ref.validate have their pictures; what was judged in a campaign has let go of
        them, and is a row of the list alone. Raises OutputError.
        """
        from mitsuba_ref.report.html.html_report import write_report

        return write_report(path, self.scenes, self.asked)

    def to_dict(self) -> dict[str, Any]:
        """As verdict.json has it."""
        return {
            "format": VERDICT_FORMAT,
            "ok": self.ok,
            "asked": self.asked,
            "not_judged": list(self.not_judged),
            "shard": self.shard,
            "selected": list(self.selected),
            "code": self.code,
            "judged_with": self.judged_with,
            "counts": {self.called(name): count for name, count in self.counts.items()},
            **({"candidate": self.candidate} if self.candidate else {}),
            "adjudicated": self.adjudicated,
            "cases": self.cases,
            "scenes": [scene.to_dict() for scene in self.scenes],
        }


def pixel_of(scene: Scene, i: int) -> tuple[int, int]:
    """x, y on the film of row i of the window."""
    x0, y0, x1, _y1 = scene.film.window
    return x0 + i % (x1 - x0), y0 + i // (x1 - x0)

"""Results of the judge as pydantic models: classes of pixels, the verdict of a scene, the verdict of a run.

`verdict.json` is `Verdict` as JSON, and `mitsuba-ref schema verdict` prints its JSON Schema. judge/classification.py
computes results, report/ shows them.
"""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import field, replace
from typing import Annotated, Any

from pydantic import ConfigDict, Field, PlainSerializer, TypeAdapter, computed_field
from pydantic.dataclasses import dataclass

from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.tolerances import MEASURED_FOR, MIN_GROUPS
from mitsuba_ref.reference.messages import Coverage

# The classes of a pixel, for any subject; `wrong` means that the subject is wrong. The last two fail.
CLASSES = ("agree", "explained", "tie", "reference_wrong", "out_of_domain", "wrong", "undecided")
AGREE, EXPLAINED, TIE, REFERENCE_WRONG, OUT_OF_DOMAIN, WRONG, UNDECIDED = CLASSES
EVIDENCE = (AGREE, TIE)  # subject and reference were compared, and are right
EXCUSED = (EXPLAINED, OUT_OF_DOMAIN, REFERENCE_WRONG)  # the subject was compared with exact arithmetic alone
JUDGED_WITHOUT_REFERENCE = (*EXCUSED, TIE)  # the reference hits another surface, and so does not bound the subject
FAILING = (WRONG, UNDECIDED)
UNLISTED = "unlisted"  # the case of a pixel where the reference is wrong in no known way (judge/defect_lookup.py)
UNSUPPORTED, EXPECTED = "unsupported", "expected"  # a scene that is waived: declined, or a known failure
VERDICT_FORMAT = 6  # of verdict.json: raised when a name in it changes its meaning or goes away
MAX_LISTED_FAILURES = 10  # of one scene; all are counted


def json_number(value: float) -> float | str:
    """A float, or "inf" or "nan", for which JSON has no number."""
    return float(value) if math.isfinite(value) else str(float(value))


def as_json(result: Any) -> dict[str, Any]:
    """A pydantic dataclass as plain data, derived values included."""
    return dict(TypeAdapter(type(result)).dump_python(result, mode="json"))


JsonFloat = Annotated[
    float,
    PlainSerializer(json_number, return_type=float | str, when_used="json"),
    Field(description='A finite number, or "inf", "-inf" or "nan", for which JSON has no number.'),
]
Seconds = Annotated[float, PlainSerializer(lambda seconds: round(seconds, 3), return_type=float)]
RESULT = ConfigDict(extra="ignore")  # computed fields of a record are computed again when it is read


@dataclass(frozen=True, config=RESULT)
class SceneStatistics:
    """Camera, shapes and primitives of a scene."""

    camera: str = ""  # type; "" if unknown
    shapes: dict[str, int] = field(default_factory=dict)  # type -> how many
    primitives: int = 0  # 0 if unknown


@dataclass(frozen=True, config=RESULT)
class SceneCheck:
    """Result of a check that is made once per scene."""

    name: str
    ratio: JsonFloat  # largest error over its bound; inf where something must not be there, or is missing
    what: str  # place of the largest error, or what was compared

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        return self.ratio <= 1.0


@dataclass(frozen=True, config=RESULT)
class KindBias:
    """Bias of the reference's errors at the primitives of one kind (docs/method.md, "Bias")."""

    kind: str  # name of its packed arrays
    groups: int  # of the grouping that makes the fewest
    z: float  # of the grouping that makes it smallest; positive: the reference is farther along the rays
    quantity: str = "t"  # whose bias z is: "t", or "position" of a kind that the reference traces as triangles
    t_bias: float = 0.0  # mean error of the reference's t, in roundings: at triangles a property of the CPU

    @computed_field  # type: ignore[prop-decorator]
    @property
    def enough_groups(self) -> bool:
        """Whether there are enough groups to fail by."""
        return self.groups >= MIN_GROUPS


@dataclass(frozen=True, config=RESULT)
class Failure:
    """One pixel that fails its scene."""

    x: int
    y: int
    verdict: str  # its class
    check: str
    ratio: JsonFloat  # error over bound
    subject: str  # its answer as text, like the next two
    reference: str
    exact: str
    reason: str
    replay: str = ""  # the command that shows the pixel again
    pixel: tuple[int, int] | None = None  # of the camera, for a secondary ray


@dataclass(frozen=True, config=RESULT)
class Finding:
    """One diagnosis and its pixels."""

    pixels: int
    what: str
    x: int  # of the first pixel
    y: int
    of: int = 0  # wrong pixels among which a hypothesis was tested; 0: it is a description
    remedy: str = ""  # of a hypothesis that explains the pixels
    where: str = ""  # a property that separates these pixels from right ones
    alike: int = 0  # further pixels with the same symptom, which were not adjudicated

    @property
    def text(self) -> str:
        """Cause, evidence and remedy."""
        proof = f": {self.pixels} of {self.of} wrong pixels become right under it" if self.remedy else ""
        return "; ".join(filter(None, [self.what + proof, self.where, self.remedy]))


@dataclass(frozen=True, config=RESULT)
class SceneVerdict:
    """The verdict of one scene."""

    name: str
    path: str  # as given; "" for a scene made in Python
    pixels: int = 0
    hit_pixels: int = 0  # hit in either image
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CLASSES, 0))  # hit or failing pixels
    ratios: dict[str, JsonFloat] = field(default_factory=dict)  # largest of each check among agreeing pixels
    checks: tuple[SceneCheck, ...] = ()
    failures: tuple[Failure, ...] = ()
    versions: dict[str, str] = field(default_factory=dict)
    seconds: Seconds = 0.0
    reference_stored: bool = False  # Mitsuba's answer was taken from an earlier run
    problem: str = ""  # why there is no comparison, such as a crash of the reference with its output
    size: tuple[int, int] = (0, 0)  # of the film
    resized: bool = False  # another film than the scene's own
    composition: SceneStatistics = field(default_factory=SceneStatistics)
    allowed: dict[str, float] = field(default_factory=dict)  # the scene's own [check.AOV]: shares of bounds
    adjudicated: int = 0  # pixels compared with exact arithmetic
    not_adjudicated: int = 0  # undecided pixels of a kind that exact arithmetic found wrong in a sample
    cases: dict[str, int] = field(default_factory=dict)  # pixels where the reference is wrong, by known case
    reproducers: tuple[str, ...] = ()  # files, one ray each
    biases: tuple[KindBias, ...] = ()  # of each kind that is hit, of our caster
    not_stored: int = 0  # pixels without a reproducer, since enough of their kind have one
    failing_by: dict[str, int] = field(default_factory=dict)  # pixels that fail, by each check they fail
    worst_by: dict[str, Failure] = field(default_factory=dict)  # the worst of them
    files: tuple[str, ...] = ()  # written beside it
    kept: bool = False  # reused from an earlier run of the same inputs
    candidate: str = ""  # the candidate that was judged in place of our caster, as named; "" for ours
    thorough: bool = False  # with the checks of our caster beyond the judged film
    precision: str = ""  # of the subject: float32 or float64
    unjudged: tuple[str, ...] = ()  # quantities that the judge compares and this subject does not give
    findings: tuple[Finding, ...] = ()  # causes of the subject's errors, most pixels first
    notes: tuple[str, ...] = ()  # assumptions and limits of the verdict
    coverage: Coverage | None = None  # of a Mitsuba file that is the reference
    unsupported: bool = False  # the candidate declined the scene, as `problem` states
    # why the run passes although the scene is not ok
    waived: Annotated[str, Field(pattern=f"^({UNSUPPORTED}|{EXPECTED})?$")] = ""
    options: tuple[str, ...] = ()  # options of the command line, beside --size, that a replay has to repeat
    replay: str = ""  # the command that shows the scene again
    command: str = "validate"  # the command that judged it: validate or judge
    bounce: int = 0  # of the rays that were judged; 0: rays of the camera, or of a list
    kinds: dict[str, dict[str, int]] = field(default_factory=dict)  # kind of secondary ray -> rays of each class
    # of secondary rays: the camera's first pixel, x and y, and how many rows of the film are its view
    view: tuple[int, int, int] = (0, 0, 0)
    rays: tuple[int, int] = (0, 0)  # first and end of the rays judged of a list, which fill `size`; (0, 0): a film
    # the evidence, for the HTML report; None if it was not kept
    seen: Annotated[Any, Field(exclude=True)] = field(default=None, repr=False, compare=False)
    film: Annotated[Any, Field(exclude=True)] = field(default=None, repr=False, compare=False)  # a JudgedFilm, likewise

    def __repr__(self) -> str:
        return f"<SceneVerdict {self.name}: {'pass' if self.ok else 'fail'}>"

    @property
    def classes(self) -> Array:
        """(h, w) uint8, index into `mitsuba_ref.CLASSES` of each pixel of a verdict of `mitsuba_ref.validate`."""
        return self._judged_film.classes

    @property
    def images(self) -> dict[str, Any]:
        """`images["ours"]["depth"]`: images of whoever was judged, ("ours") and of Mitsuba ("reference"), by AOV.

        Of a verdict of `mitsuba_ref.validate`; (h, w) or (h, w, c) as from `caster.render`.
        """
        return self._judged_film.images

    def failing_pixels(self) -> tuple[Any, ...]:
        """Every pixel that fails (`mitsuba_ref.FailingPixel`), row by row, of a verdict of `mitsuba_ref.validate`."""
        return self._judged_film.failing

    @property
    def _judged_film(self) -> Any:
        if self.film is None:
            reason = self.problem or "only a verdict of mitsuba_ref.validate keeps them"
            raise ValueError(f"scene {self.name} has no images: {reason}")
        return self.film

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        """No problem, no failing pixel, every check within its bound, and more evidence than excuses."""
        return not self.problem and not self.failing and self.has_evidence and self.checks_pass

    def ray_at(self, x: int, y: int) -> int | None:
        """The number of the listed ray at a pixel; None for a camera's film."""
        return self.rays[0] + y * self.size[0] + x if self.rays[1] else None

    def place(self, x: int, y: int) -> str:
        """A pixel, or the listed ray at it, in words."""
        ray = self.ray_at(x, y)
        return f"({x}, {y})" if ray is None else f"ray {ray}"

    @property
    def failing(self) -> int:
        """Pixels where the subject is wrong, or nothing is decided, or the reference is wrong in an unknown way.

        An unknown error of Mitsuba may be a fault in the scene it was given, so that somebody has to look at it.
        """
        return sum(self.counts[name] for name in FAILING) + self.cases.get(UNLISTED, 0)

    @property
    def evidence(self) -> int:
        """Hit pixels where subject and reference were compared and are right; misses as well of secondary rays."""
        return sum(counts.get(name, 0) for counts in self.kinds.values() or [self.counts] for name in EVIDENCE)

    @property
    def excused(self) -> int:
        """Hit pixels that pass without being evidence."""
        return sum(self.counts[name] for name in EXCUSED)

    @property
    def has_evidence(self) -> bool:
        """More hit pixels are evidence than are excused; false for a scene that hits nothing.

        A bounce may have no rays.
        """
        return self.evidence > self.excused or bool(self.bounce and not self.kinds)

    @property
    def checks_pass(self) -> bool:
        return all(check.ok for check in self.checks)

    @property
    def worst(self) -> tuple[str, float]:
        """The check that comes nearest to its bound, and how near."""
        return max(self.ratios.items(), key=lambda item: item[1], default=("", 0.0))

    def with_failures(self, change: Callable[[Failure], Failure]) -> "SceneVerdict":
        """The verdict with each of its failures changed."""
        worst = {check: change(failure) for check, failure in self.worst_by.items()}
        return replace(self, failures=tuple(map(change, self.failures)), worst_by=worst)

    def to_dict(self) -> dict[str, Any]:
        """JSON values, as in verdict.json."""
        return as_json(self)


@dataclass(frozen=True, config=RESULT)
class Verdict:
    """The verdict of a run: of all its scenes."""

    scenes: tuple[SceneVerdict, ...]
    scene_count: int = 1  # how many scenes were to be judged
    names: tuple[str, ...] = ()  # of these scenes, as far as known
    # such as "2/4": these are the scenes of one of several runs
    shard: Annotated[str, Field(pattern=r"^([1-9]\d{0,8}/[1-9]\d{0,8})?$")] = ""
    selected: tuple[str, ...] = ()  # names of the scenes of all shards
    code: str = ""  # a hash of the sources that judged, and for a shard of all scenes
    judged_with: dict[str, str] = field(default_factory=dict)  # versions, variants, machine, processor
    min_scenes: int = 0  # the run passes only if at least so many scenes are judged and not declined
    fixed: tuple[str, ...] = ()  # scenes that --expected lists as failing, and that pass
    requested_candidate: str = ""  # the candidate that was requested, also if no scene is judged; "" for ours
    checks: tuple[SceneCheck, ...] = ()  # of a candidate, made once, whatever the scenes
    format: int = VERDICT_FORMAT

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        """Every requested scene was judged and passes or is waived, as do `checks`, and there are enough of them.

        A run without scenes does not pass, except for an empty shard; `merge` counts the scenes of shards.
        """
        some = self.scene_count > 0 or bool(self.shard and self.selected)
        enough = bool(self.shard) or not self.too_few
        return (
            some
            and enough
            and len(self.scenes) == self.scene_count
            and all(check.ok for check in self.checks)
            and all(scene.ok or scene.waived for scene in self.scenes)
        )

    @property
    def too_few(self) -> bool:
        """Whether fewer scenes were judged than `min_scenes`, or than one if some were declined."""
        declined = sum(scene.waived == UNSUPPORTED for scene in self.scenes)
        return len(self.scenes) - declined < max(self.min_scenes, min(declined, 1))

    @computed_field  # type: ignore[prop-decorator]
    @property
    def waived(self) -> dict[str, int]:
        """Number of scenes that are not ok but do not make the run fail, by reason."""
        return dict(Counter(scene.waived for scene in self.scenes if scene.waived))

    @computed_field  # type: ignore[prop-decorator]
    @property
    def candidate(self) -> str:
        """The candidate judged in place of our caster, or requested; "" for ours."""
        return self.requested_candidate or next((scene.candidate for scene in self.scenes), "")

    @computed_field  # type: ignore[prop-decorator]
    @property
    def not_judged(self) -> tuple[str, ...]:
        """Names of the requested scenes that were not judged."""
        judged = {scene.name for scene in self.scenes}
        return tuple(name for name in self.names if name not in judged)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def counts(self) -> dict[str, int]:
        """Hit pixels of all scenes by class."""
        return {name: sum(scene.counts[name] for scene in self.scenes) for name in CLASSES}

    @computed_field  # type: ignore[prop-decorator]
    @property
    def adjudicated(self) -> int:
        """Pixels compared with exact arithmetic."""
        return sum(scene.adjudicated for scene in self.scenes)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def cases(self) -> dict[str, int]:
        """Pixels where the reference is wrong, by known case."""
        return dict(sum((Counter(scene.cases) for scene in self.scenes), Counter()))

    @computed_field  # type: ignore[prop-decorator]
    @property
    def references_stored(self) -> int:
        """Number of scenes whose reference answers came from the store."""
        return sum(scene.reference_stored for scene in self.scenes)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Versions and variants of the reference that bounds and known defects were not measured for."""
        found = (
            f"{what} {scene.versions[what]}"
            for scene in self.scenes
            for what, known in MEASURED_FOR.items()
            if what in scene.versions and scene.versions[what] not in known
        )
        return tuple(dict.fromkeys(found))

    @property
    def versions(self) -> tuple[str, ...]:
        """Versions that judged the scenes, each once, and how many answers of Mitsuba came from the store."""
        each = [", ".join(f"{k} {v}" for k, v in scene.versions.items()) for scene in self.scenes]
        if self.references_stored:
            stored = f"{self.references_stored} of {len(self.scenes)} scenes"
            each.append(f"{stored}: answered in earlier runs, taken from the store")
        return tuple(dict.fromkeys(filter(None, each)))

    def to_dict(self) -> dict[str, Any]:
        """JSON values, as in verdict.json."""
        return as_json(self)

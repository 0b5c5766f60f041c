"""Results of a benchmark run: times of each row, their medians and ratios; and the tables."""

from collections.abc import Mapping
from statistics import median
from typing import Any

from pydantic import SerializerFunctionWrapHandler, computed_field, model_serializer
from pydantic.dataclasses import dataclass

from mitsuba_ref.bench.drivers import AOVS, NEAREST
from mitsuba_ref.report.output import NOTHING, aligned, number

JSON_FORMAT = 4  # goes up when a key changes its meaning or goes away
REFERENCE_ROW, CANDIDATE_ROW = "ours", "candidate"  # ratios are to the first


@dataclass(frozen=True)
class Score:
    """Errors of t on sampled rays."""

    rays: int
    ulps: float | None  # largest |t - exact t| in float32 ulps of the exact t; None: nothing to compare
    bounds: float | None  # largest error in units of the bound of its ray
    masks: int  # rays that hit where there is exactly nothing, or miss where there is something
    beyond: int  # hits whose t is beyond its bound, or not a number: another surface, or none


@dataclass(frozen=True)
class Row:
    """One caster in one scene. why: the reason why it ended early or could not start."""

    key: str
    title: str
    rays: int = 0  # of one cast
    size: int = 0  # pixels a side, or the square root of the number of rays
    build: float | None = None  # seconds
    seconds: tuple[float, ...] = ()  # of one cast, alternation by alternation
    score: Score | None = None
    why: str = ""

    @property
    def ran(self) -> bool:
        return bool(self.seconds)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ns(self) -> float | None:
        """Nanoseconds a ray, the median of all alternations."""
        return 1e9 * median(self.seconds) / self.rays if self.ran else None


@dataclass(frozen=True)
class SceneResult:
    """All rows of one scene."""

    name: str
    title: str
    workload: str
    primitives: int
    rows: tuple[Row, ...]
    seconds: float = 0.0  # that all of it took
    aovs: tuple[str, ...] = AOVS

    @model_serializer(mode="wrap")
    def _with_ratios(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = plain(self)
        for row in data["rows"]:
            row["ratio"] = self.ratio(row["key"])
        return data

    def row(self, key: str) -> Row | None:
        return next((row for row in self.rows if row.key == key), None)

    def ratio(self, key: str) -> float | None:
        """Time per ray as a multiple of that of ours; None where one of the two did not run.

        It is the median of the ratios within each alternation, so that other load on the machine affects both alike.
        """
        row, other = self.row(key), self.row(REFERENCE_ROW)
        if row is None or other is None:
            return None
        found = [(a / row.rays) / (b / other.rays) for a, b in zip(row.seconds, other.seconds, strict=False)]
        return median(found) if found else None


@dataclass(frozen=True)
class Run:
    """A whole run. settings: size, alternations, candidate; machine: versions, CPU; requested: scenes to time."""

    settings: Mapping[str, Any]
    machine: Mapping[str, str]
    requested: tuple[str, ...]
    scenes: tuple[SceneResult, ...] = ()
    format: int = JSON_FORMAT


COLUMNS = ("", "build ms", "ns/ray", "times as fast", "ulps", "bounds", "wrong")


def rows(scene: SceneResult) -> list[list[str]]:
    """The table's head and rows; a row that did not run has a reason in place of numbers."""
    found, largest = [[*COLUMNS]], max((row.size for row in scene.rows), default=0)
    for row in scene.rows:
        if not row.ran:
            found.append([row.title, row.why or "did not run"])
            continue
        errors = [NOTHING] * 3
        if score := row.score:
            wrong = f"{score.masks}+{score.beyond}" if score.beyond else str(score.masks)
            errors = [number(score.ulps, 2), number(score.bounds, 2), wrong]
        about = ", ".join(filter(None, [f"{row.size}^2" if row.size < largest else "", row.why]))
        title = f"{row.title} ({about})" if about else row.title
        build = number(None if row.build is None else 1e3 * row.build, 1)
        found.append([title, build, number(row.ns, 2), number(scene.ratio(row.key), 2), *errors])
    return found


# Columns of the table of all scenes.
OVERVIEW = {"raw-robust": "ray_intersect", "aov-robust": "AOV integrator", CANDIDATE_ROW: "candidate"}


def overview(run: Run) -> list[list[str]]:
    """The table of all scenes: AOVs, the time of ours, and how many times as fast as the others it is."""
    scenes = [(scene, row) for scene in run.scenes if (row := scene.row(REFERENCE_ROW)) and row.ran]
    keys = [key for key in OVERVIEW if any(scene.ratio(key) is not None for scene, _ in scenes)]
    found = [["scene", "AOVs", "ours, ms", *(OVERVIEW[key] for key in keys)]]
    for scene, row in scenes:
        what = "t, normal of any rays" if scene.workload == NEAREST else ", ".join(scene.aovs)
        ratios = [number(scene.ratio(key), 2) for key in keys]
        found.append([scene.name, what, number(1e3 * median(row.seconds), 1), *ratios])
    return found


def as_text(scene: SceneResult) -> str:
    """The table under a line with the scene."""
    aovs = f"; {', '.join(scene.aovs)}" if scene.aovs != AOVS else ""
    head = f"{scene.name}: {scene.title} ({scene.primitives:,} primitives{aovs})"
    about = "times as fast as this row: ours; errors of t; wrong hits and misses, +: hits beyond their bound"
    return "\n".join([head, *aligned(rows(scene), left=1), about])


def summary(run: Run) -> str:
    """The last line: numbers of scenes and rows."""
    rows = [row for scene in run.scenes for row in scene.rows]
    empty = sum(not row.ran for row in rows)
    rounds = f"medians of {run.settings['alternations']} alternations"
    scenes = f"{len(run.scenes)} of {len(run.requested)} scenes"
    return f"{scenes}, {len(rows) - empty} rows, {empty} without numbers; {rounds}"

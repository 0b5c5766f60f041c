"""Results of a benchmark run: times of each row, their medians and ratios; and the table of a scene."""

from collections.abc import Mapping, Sequence
from math import log
from statistics import median
from typing import Any

from pydantic import SerializerFunctionWrapHandler, computed_field, model_serializer
from pydantic.dataclasses import dataclass

from mitsuba_ref.bench.entries import ANY, AOVS, FILM, NEAREST, PROCESS, SHADING, VALIDATION
from mitsuba_ref.report.results import NOTHING, aligned, number

JSON_FORMAT = 1  # goes up when a key changes its meaning or goes away
REFERENCE_ROW = "ours"  # the row that all ratios are to


@dataclass(frozen=True)
class Score:
    """Errors of t on sampled rays of the film, and on as many rays aimed at edges."""

    rays: int
    ulps: float | None  # largest |t - exact t| in float32 ulps of the exact t; None: nothing to compare
    bounds: float | None  # largest error in units of the bound of its ray
    masks: int  # rays that hit where there is exactly nothing, or miss where there is something
    beyond: int  # hits whose t is beyond its bound, or not a number: another surface, or none
    edge_rays: int
    edge_masks: int
    edge_beyond: int


@dataclass(frozen=True)
class Row:
    """One contestant in one scene. `why`: what ended it, or kept it from beginning."""

    key: str
    title: str
    side: str
    rays: int = 0  # of one cast
    size: int = 0  # pixels a side, or the square root of the number of rays
    build: float | None = None  # seconds
    seconds: tuple[float, ...] = ()  # of one cast, alternation by alternation
    memory: int | None = None  # bytes, the most that its process had
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

    @computed_field  # type: ignore[prop-decorator]
    @property
    def mrays(self) -> float | None:
        """Million rays a second."""
        return 1e3 / self.ns if self.ns else None


def ratio(row: Row, to: Row) -> float | None:
    """How many times as long as the other it takes for a ray: the median of the ratios of each alternation.

    Both are of the same moment then, so that what else the machine did hits both. None where one has not run.
    """
    pairs = zip(row.seconds, to.seconds, strict=False)
    found = [(a / row.rays) / (b / to.rays) for a, b in pairs]
    return median(found) if found else None


@dataclass(frozen=True)
class SceneResult:
    """All rows of one scene."""

    name: str
    title: str
    workload: str
    primitives: int
    rows: tuple[Row, ...]
    seconds: float = 0.0  # that all of it took
    aovs: tuple[str, ...] = ()  # of an image

    @model_serializer(mode="wrap")
    def _with_ratios(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = plain(self)
        for row in data["rows"]:
            row["ratio"] = self.ratio(row["key"])
        return data

    def row(self, key: str) -> Row | None:
        return next((row for row in self.rows if row.key == key), None)

    @property
    def reference(self) -> str:
        """The row that ratios are to: ours, or the first where that is missing."""
        return REFERENCE_ROW if self.row(REFERENCE_ROW) or not self.rows else self.rows[0].key

    def ratio(self, key: str, to: str | None = None) -> float | None:
        """Of two rows, where both ran; the second is the reference by default."""
        row, other = self.row(key), self.row(to or self.reference)
        return ratio(row, other) if row and other else None


@dataclass(frozen=True)
class Series:
    """One contestant over a growing quantity; seconds of one cast, the medians, where it ran."""

    key: str
    title: str
    x: tuple[float, ...]
    seconds: tuple[float, ...]
    build: tuple[float, ...] = ()
    why: str = ""

    @computed_field  # type: ignore[prop-decorator]
    @property
    def slope(self) -> float | None:
        return fitted_slope(self.x, self.seconds)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def end_slope(self) -> float | None:
        """Between the last two: what does not grow counts least there."""
        return fitted_slope(self.x[-2:], self.seconds[-2:])


@dataclass(frozen=True)
class Sweep:
    """name: triangles, pixels or threads."""

    name: str
    quantity: str
    series: tuple[Series, ...]


@dataclass(frozen=True)
class Run:
    """Everything. settings: size, alternations, threads, seed; machine: versions, CPU; requested: scenes to time."""

    settings: Mapping[str, Any]
    machine: Mapping[str, str]
    requested: tuple[str, ...]
    scenes: tuple[SceneResult, ...] = ()
    sweeps: tuple[Sweep, ...] = ()
    bytes_of_pixel: int = 0  # of our images of depth and normal
    format: int = JSON_FORMAT

    def scene(self, name: str) -> SceneResult | None:
        return next((scene for scene in self.scenes if scene.name == name), None)

    @property
    def films(self) -> list[SceneResult]:
        """Images of depth and normal."""
        return [scene for scene in self.scenes if scene.workload == FILM and scene.aovs in ((), AOVS)]


def fitted_slope(x: Sequence[float], y: Sequence[float]) -> float | None:
    """b of the power law y = a x^b that fits best, in least squares of logarithms; None for fewer than two points."""
    pairs = [(log(a), log(b)) for a, b in zip(x, y, strict=True) if a > 0.0 and b > 0.0]
    if len({a for a, _ in pairs}) < 2:
        return None
    mean_x, mean_y = (sum(column) / len(pairs) for column in zip(*pairs, strict=True))
    above = sum((a - mean_x) * (b - mean_y) for a, b in pairs)
    return above / sum((a - mean_x) ** 2 for a, _ in pairs)


COLUMNS = (
    "", "rays", "build ms", "ns/ray", "Mray/s", "x ours", "t: ulps", "t: bounds", "wrong", "wrong at edges", "MB",
)  # fmt: skip


def rows(scene: SceneResult) -> list[list[str]]:
    """The head and a line for each row; one that did not run has the reason in place of its numbers."""
    return [[*COLUMNS], *(_cells(scene, row) for row in scene.rows)]


def _cells(scene: SceneResult, row: Row) -> list[str]:
    if not row.ran:
        return [row.title, row.why or "did not run"]
    errors = [NOTHING] * 4
    if score := row.score:
        wrong = _masks_text(score.masks, score.beyond), _masks_text(score.edge_masks, score.edge_beyond)
        errors = [number(score.ulps, 2), number(score.bounds, 2), *wrong]
    return [
        f"{row.title} ({row.why})" if row.why else row.title,
        f"{row.size}^2" if scene.workload in (FILM, SHADING, PROCESS) else f"{row.rays:,}",
        number(None if row.build is None else 1e3 * row.build, 1),
        number(row.ns, 2),
        number(row.mrays, 1),
        number(scene.ratio(row.key), 2),
        *errors,
        NOTHING if row.memory is None else f"{row.memory / 2**20:.0f}",
    ]


def _masks_text(masks: int, beyond: int) -> str:
    """Wrong hits and misses, and behind a + hits of another surface."""
    return f"{masks}+{beyond}" if beyond else str(masks)


# Columns of the table of everything that was asked for: how many times as fast as these ours is.
OVERVIEW_COLUMNS = ("raw-robust", "aov-robust", "open3d", "trimesh", "candidate")
OVERVIEW_TITLES = ("`ray_intersect`", "AOV integrator", "Open3D", "trimesh + embreex", "candidate")


def overview(run: Run) -> list[list[str]]:
    """Head and a line for each image and each kind of rays: what, of which AOVs, our milliseconds and the ratios."""
    scenes = [scene for scene in run.scenes if (row := scene.row(REFERENCE_ROW)) and row.ran]
    pairs = zip(OVERVIEW_COLUMNS, OVERVIEW_TITLES, strict=True)
    columns = [pair for pair in pairs if any(scene.ratio(pair[0]) is not None for scene in scenes)]
    found = [["scene", "AOVs", "ours, ms", *(title for _, title in columns)]]
    for scene in scenes:
        what = ", ".join(scene.aovs or AOVS) if scene.workload == FILM else RAYS_OF[scene.workload]
        ratios = [number(scene.ratio(key), 2) for key, _ in columns]
        found.append([scene.name, what, _milliseconds(scene, REFERENCE_ROW), *ratios])
    return found


RAYS_OF = {NEAREST: "t, normal of any rays", ANY: "any rays: hit or not"}


def processes(run: Run) -> list[list[str]]:
    """Head and a line for each row of a whole process: its time and that of the others over it."""
    found = [["whole process", "command", "s", "times as long as the first"]]
    for scene in run.scenes:
        if scene.workload in (PROCESS, VALIDATION):
            for row in scene.rows:
                seconds = number(median(row.seconds), 2) if row.ran else row.why
                found.append([scene.name, row.title, seconds, number(scene.ratio(row.key), 2)])
    return found


def _milliseconds(scene: SceneResult, key: str) -> str:
    row = scene.row(key)
    return number(1e3 * median(row.seconds) if row and row.ran else None, 1)


def overview_text(run: Run) -> str:
    """Both tables, where they have lines."""
    parts = []
    if len(table := overview(run)) > 1:
        table = [[cell.replace("`", "") for cell in line] for line in table]
        parts.append(["What you asked for: times as fast as the others", *aligned(table, left=2)])
    if len(table := processes(run)) > 1:
        parts.append(aligned(table, left=2))
    return "\n\n".join("\n".join(lines) for lines in parts)


def as_text(scene: SceneResult) -> str:
    """The table under a line with the scene."""
    aovs = f"; {', '.join(scene.aovs)}" if scene.aovs not in ((), AOVS) else ""
    count = f" ({scene.primitives:,} primitives{aovs})" if scene.primitives else ""
    head = f"{scene.name}: {scene.title}{count}"
    return "\n".join([head, *(f"  {line}" for line in aligned(rows(scene), left=1))])


def summary(run: Run) -> str:
    """The last line: how much was done."""
    rows = [row for scene in run.scenes for row in scene.rows]
    empty = sum(not row.ran for row in rows)
    rounds = f"medians of {run.settings['alternations']} alternations"
    scenes = f"{len(run.scenes)} of {len(run.requested)} scenes"
    return f"{scenes}, {len(rows) - empty} rows, {empty} without numbers; {rounds}"

"""What came of a run: rows of numbers, their medians and ratios, and the way to JSON and back."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import log
from statistics import median
from typing import Any

from mitsuba_ref.bench.scoring import Score
from mitsuba_ref.bench.work import FILM

JSON_FORMAT = 1  # of the JSON
REFERENCE_ROW = "ours"  # the row that all ratios are to


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

    @property
    def ns(self) -> float | None:
        """Nanoseconds a ray, the median of all alternations."""
        return 1e9 * median(self.seconds) / self.rays if self.ran else None

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
    name: str
    title: str
    asks: str
    primitives: int
    rows: tuple[Row, ...]
    seconds: float = 0.0  # that all of it took

    def row(self, key: str) -> Row | None:
        return next((row for row in self.rows if row.key == key), None)

    @property
    def reference(self) -> str:
        """The row that the others are set against: ours, or where only ours are asked the first of them."""
        return REFERENCE_ROW if self.row(REFERENCE_ROW) or not self.rows else self.rows[0].key

    def ratio(self, key: str, to: str | None = None) -> float | None:
        """Of two rows, where both ran; the second is the reference unless told."""
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

    @property
    def slope(self) -> float | None:
        return fitted_slope(self.x, self.seconds)

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
    """Everything. settings: size, alternations, threads, seed; machine: what it ran on; asked: the scenes to time."""

    settings: Mapping[str, Any]
    machine: Mapping[str, str]
    asked: tuple[str, ...]
    scenes: tuple[SceneResult, ...] = ()
    sweeps: tuple[Sweep, ...] = ()
    bytes_of_pixel: int = 0  # of the images of depth and normal that ours gives

    def scene(self, name: str) -> SceneResult | None:
        return next((scene for scene in self.scenes if scene.name == name), None)

    @property
    def films(self) -> list[SceneResult]:
        return [scene for scene in self.scenes if scene.asks == FILM]


def fitted_slope(x: Sequence[float], y: Sequence[float]) -> float | None:
    """b of the power law y = a x^b that fits best, in least squares of logarithms; None for fewer than two points."""
    pairs = [(log(a), log(b)) for a, b in zip(x, y, strict=True) if a > 0.0 and b > 0.0]
    if len({a for a, _ in pairs}) < 2:
        return None
    mean_x, mean_y = (sum(column) / len(pairs) for column in zip(*pairs, strict=True))
    above = sum((a - mean_x) * (b - mean_y) for a, b in pairs)
    return above / sum((a - mean_x) ** 2 for a, _ in pairs)


def as_json(run: Run) -> dict[str, Any]:
    """The run, and beside the numbers of each row what follows from them."""
    data = asdict(run)
    for scene, told in zip(run.scenes, data["scenes"], strict=True):
        for row, words in zip(scene.rows, told["rows"], strict=True):
            words |= {"ns": row.ns, "mrays": row.mrays, "ratio": scene.ratio(row.key)}
    for sweep, told in zip(run.sweeps, data["sweeps"], strict=True):
        for series, words in zip(sweep.series, told["series"], strict=True):
            words |= {"slope": series.slope, "end_slope": series.end_slope}
    return {"format": JSON_FORMAT} | data


def from_json(data: Mapping[str, Any]) -> Run:
    """The run that `as_json` told."""
    scenes = tuple(
        SceneResult(**(scene | {"rows": tuple(_row(row) for row in scene["rows"])}))
        for scene in data["scenes"]
    )
    sweeps = tuple(
        Sweep(sweep["name"], sweep["quantity"], tuple(_series(one) for one in sweep["series"]))
        for sweep in data["sweeps"]
    )
    rest = {name: data[name] for name in ("settings", "machine", "bytes_of_pixel")}
    return Run(asked=tuple(data["asked"]), scenes=scenes, sweeps=sweeps, **rest)


def _row(data: Mapping[str, Any]) -> Row:
    kept = {name: value for name, value in data.items() if name not in ("ns", "mrays", "ratio")}
    score = kept["score"]
    return Row(**(kept | {"seconds": tuple(kept["seconds"]), "score": Score(**score) if score else None}))


def _series(data: Mapping[str, Any]) -> Series:
    kept = {name: value for name, value in data.items() if name not in ("slope", "end_slope")}
    return Series(**(kept | {name: tuple(kept[name]) for name in ("x", "seconds", "build")}))

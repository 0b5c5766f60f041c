"""The same scenes judged with two versions of Mitsuba: what changed in bits, by how much, who is nearer to exact."""

from collections.abc import Iterator, Sequence
from dataclasses import field
from typing import NamedTuple

import numpy as np
from pydantic import computed_field
from pydantic.dataclasses import dataclass

from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import row_distance
from mitsuba_ref.judge.pipeline import Seen, Task, judge_film
from mitsuba_ref.judge.verdict import AGREE, RESULT, JsonFloat, SceneVerdict
from mitsuba_ref.reference.interpreter import chosen
from mitsuba_ref.reference.mitsuba_process import SendRequest, send_stored
from mitsuba_ref.reference.shared_input import pixel_of
from mitsuba_ref.report.results import NOTHING, aligned, number, percent, plural
from mitsuba_ref.report.verdict_text import mark_of

QUANTITIES = ("depth", "position", "normal", "shading_normal", "uv", "diffuse")
HIT = "hit"  # the primitive that is hit, or none
NAMES = ("A", "B")  # of the versions, in tables
QUANTILE = 0.999
MAX_LISTED_PIXELS = 10


@dataclass(frozen=True, config=RESULT)
class VersionErrors:
    """One version's errors against float64 at the exact hit, where both versions agree with it within the bounds."""

    rms: float
    p999: float  # 99.9 % of them are below
    nearer: int  # pixels that changed, and where this version is the nearer one


@dataclass(frozen=True, config=RESULT)
class QuantityChange:
    """The pixels where one quantity differs in bits between both versions."""

    quantity: str
    changed: int  # pixels
    largest: JsonFloat  # change, where both hit the same primitive; 0 for `hit`
    at: tuple[tuple[int, int], ...]  # some of them, the largest change first
    errors: tuple[VersionErrors, ...] = ()  # of A and B; none for `hit`


@dataclass(frozen=True, config=RESULT)
class SceneComparison:
    """One scene under both versions."""

    name: str
    verdicts: tuple[SceneVerdict, SceneVerdict]
    changes: tuple[QuantityChange, ...]  # those that changed; none where a version gave no answer

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        """Whether both pass, or both fail."""
        return self.verdicts[0].ok == self.verdicts[1].ok


@dataclass(frozen=True, config=RESULT)
class VersionComparison:
    """All scenes under both versions."""

    interpreters: tuple[str, ...]
    versions: tuple[dict[str, str], ...]  # of both; empty before any answer
    scenes: tuple[SceneComparison, ...] = field(default=())

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        return all(scene.ok for scene in self.scenes)


class _Window(NamedTuple):
    """The evidence of one version in one window of the film: n pixels."""

    pixels: np.ndarray  # (n, 2) x, y
    agree: np.ndarray  # (n,) bool, the class of the pixel
    hit: np.ndarray  # (n,) primitive, -1 on a miss
    sides: dict[str, tuple[np.ndarray, np.ndarray]]  # quantity -> (n, c) ours, the reference's


def _window_of(seen: Seen) -> _Window:
    judge = seen.judge
    sides = {name: judge.pixels.pair(name) for name in QUANTITIES}
    if judge.pixels.uv:
        sides["uv"] = judge.pixels.uv.subject, judge.pixels.uv.reference
    count = len(judge.hit)
    columns = {name: (one.reshape(count, -1), other.reshape(count, -1)) for name, (one, other) in sides.items()}
    pixels = np.array([pixel_of(judge.scene, row) for row in range(count)], np.int32).reshape(-1, 2)
    return _Window(pixels, seen.judgement.is_class(AGREE), judge.reference_prim, columns)


def judge_with(
    python: str, scene: Scene, name: str, path: str, timeout: float, send: SendRequest
) -> tuple[SceneVerdict, list[_Window]]:
    """The verdict of a scene with the Mitsuba of an interpreter, and its evidence, window by window."""
    windows: list[_Window] = []

    def collect(verdict: SceneVerdict, images: str) -> SceneVerdict:
        if isinstance(verdict.seen, Seen):
            windows.append(_window_of(verdict.seen))
        return verdict

    with chosen(python):
        return judge_film(Task(scene, name, path, timeout=timeout, send=send), collect), windows


def compare_scene(
    pythons: Sequence[str], scene: Scene, name: str, path: str, timeout: float, send: SendRequest = send_stored
) -> SceneComparison:
    """A scene under the Mitsuba of two interpreters. Raises SceneError for a scene that cannot be judged."""
    (first, a), (second, b) = (judge_with(python, scene, name, path, timeout, send) for python in pythons)
    changes = () if first.problem or second.problem else tuple(_changes(_joined(a), _joined(b)))
    return SceneComparison(name, (first, second), changes)


def _joined(windows: Sequence[_Window]) -> _Window:
    pixels, agree, hit, sides = zip(*windows, strict=True)
    whole = {
        name: (np.concatenate([each[name][0] for each in sides]), np.concatenate([each[name][1] for each in sides]))
        for name in QUANTITIES
    }
    return _Window(np.concatenate(pixels), np.concatenate(agree), np.concatenate(hit), whole)


def _changes(a: _Window, b: _Window) -> Iterator[QuantityChange]:
    same, agree = a.hit == b.hit, a.agree & b.agree & (a.hit >= 0)
    if not same.all():
        yield QuantityChange(HIT, int((~same).sum()), 0.0, _listed(a.pixels, np.flatnonzero(~same)))
    for name in QUANTITIES:
        exact, values = a.sides[name][0], (a.sides[name][1], b.sides[name][1])
        bits = [np.ascontiguousarray(each, np.float64).view(np.int64) for each in values]
        changed = (bits[0] != bits[1]).any(axis=1)
        if not changed.any():
            continue
        change = np.where(changed & same, row_distance(*values), 0.0)  # NaN where a value is not finite
        order = np.argsort(-np.nan_to_num(change, nan=np.inf), kind="stable")[: int(changed.sum())]
        largest = float(np.nan_to_num(change, nan=np.inf).max())
        errors = [row_distance(exact, each) for each in values]
        nearer = [changed & agree & (one < other) for one, other in (errors, errors[::-1])]
        found = [_errors(each[agree], int(rows.sum())) for each, rows in zip(errors, nearer, strict=True)]
        yield QuantityChange(name, int(changed.sum()), largest, _listed(a.pixels, order), tuple(found))


def _errors(errors: np.ndarray, nearer: int) -> VersionErrors:
    if not len(errors):
        return VersionErrors(0.0, 0.0, nearer)
    return VersionErrors(float(np.sqrt(np.mean(errors**2))), float(np.quantile(errors, QUANTILE)), nearer)


def _listed(pixels: np.ndarray, rows: np.ndarray) -> tuple[tuple[int, int], ...]:
    return tuple((int(x), int(y)) for x, y in pixels[rows[:MAX_LISTED_PIXELS]])


# ---- text ----

COLUMNS = ("changed", "largest", "rms A", "rms B", "99.9% A", "99.9% B", "B nearer")
LEGEND = """\
changed: pixels with other bits; largest: the largest change; rms and 99.9%: of
the errors against float64 at the exact hit; B nearer: of the changed pixels"""


def scene_text(scene: SceneComparison) -> str:
    """The verdicts with both versions, and a line for each quantity that changed."""
    both = tuple(zip(NAMES, scene.verdicts, strict=True))
    problems = [f"      {name}: {each.problem}" for name, each in both if each.problem]
    verdicts = ", ".join(f"{name} {mark_of(each)}" for name, each in both)
    head = f"{scene.name}: {verdicts}, {plural(scene.verdicts[0].hit_pixels, 'hit pixel')}"
    if not scene.changes:
        return "\n".join([head, *(problems or ["      no bit changed"])])
    return "\n".join([head, *aligned([("", *COLUMNS), *map(_row, scene.changes)], left=1)])


def _row(change: QuantityChange) -> tuple[str, ...]:
    if not change.errors:
        return change.quantity, str(change.changed), *[NOTHING] * (len(COLUMNS) - 1)
    a, b = change.errors
    sizes = (number(value, 1) for value in (change.largest, a.rms, b.rms, a.p999, b.p999))
    decided = a.nearer + b.nearer
    return change.quantity, str(change.changed), *sizes, percent(b.nearer, decided, 0) if decided else NOTHING


def summary_text(run: VersionComparison) -> str:
    """How many scenes changed, how many pass with each version, and where only one passes."""
    scenes = run.scenes
    changed = sum(bool(scene.changes) for scene in scenes)
    lines = [f"{plural(len(scenes), 'scene')}: {changed} differ in bits"]
    for i, (name, python) in enumerate(zip(NAMES, run.interpreters, strict=True)):
        about = ", ".join(f"{key} {value}" for key, value in run.versions[i].items() if key in ("mitsuba", "drjit"))
        lines.append(f"{name}: {sum(scene.verdicts[i].ok for scene in scenes)} pass; {about}, {python}")
    lines += [f"FAIL  {scene.name}: only one version passes" for scene in scenes if not scene.ok]
    return "\n".join(lines)

"""The same scenes judged with two versions of Mitsuba: what changed in bits, by how much, who is nearer to exact."""

from collections.abc import Iterator, Sequence

import numpy as np
from pydantic import computed_field
from pydantic.dataclasses import dataclass

from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import row_distance
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.pipeline import Seen, Task, judge_film
from mitsuba_ref.judge.verdict import AGREE, RESULT, JsonFloat, SceneVerdict
from mitsuba_ref.reference.interpreter import chosen
from mitsuba_ref.reference.shared_input import pixel_of
from mitsuba_ref.report.output import NOTHING, aligned, number, plural
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
    nearer: int  # pixels where this version is the nearer one


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

    versions: tuple[dict[str, str], ...]  # of A and B: mitsuba, drjit, python
    scenes: tuple[SceneComparison, ...]

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        return all(scene.ok for scene in self.scenes)


Evidence = dict[str, Array]  # one row a pixel; of a quantity (n, 2, c), for ours and the reference


def compare_scene(pythons: Sequence[str], task: Task) -> SceneComparison:
    """A scene with the Mitsuba of two interpreters. Raises SceneError for a scene that cannot be judged."""
    windows: list[Evidence] = []

    def collect(verdict: SceneVerdict, images: str) -> SceneVerdict:
        if isinstance(verdict.seen, Seen):
            judge, uv = verdict.seen.judge, verdict.seen.judge.uv
            assert uv is not None  # our caster gives it
            windows.append({HIT: judge.reference_prim, AGREE: verdict.seen.judgement.is_class(AGREE)})
            for name in QUANTITIES:
                sides = uv[:2] if name == "uv" else judge.sides(name)
                windows[-1][name] = np.stack([values.reshape(len(judge.hit), -1) for values in sides], axis=1)
        return verdict

    verdicts, films = list[SceneVerdict](), list[Evidence]()
    for python in pythons:
        windows.clear()
        with chosen(python):
            verdicts.append(judge_film(task, collect))
        films.append({name: np.concatenate([each[name] for each in windows]) for name in (windows or [{}])[0]})
    changes = () if any(verdict.problem for verdict in verdicts) else tuple(_changes(task.scene, *films))
    return SceneComparison(task.name, (verdicts[0], verdicts[1]), changes)


def _changes(scene: Scene, a: Evidence, b: Evidence) -> Iterator[QuantityChange]:
    same, agree = a[HIT] == b[HIT], a[AGREE] & b[AGREE] & (a[HIT] >= 0)
    if not same.all():
        yield QuantityChange(HIT, int((~same).sum()), 0.0, _listed(scene, np.flatnonzero(~same)))
    for name in QUANTITIES:
        values = [each[name][:, 1] for each in (a, b)]
        bits = [np.ascontiguousarray(each, np.float64).view(np.int64) for each in values]
        changed = (bits[0] != bits[1]).any(axis=1)
        if changed.any():
            change = np.nan_to_num(np.where(changed & same, row_distance(*values), 0.0), nan=np.inf)
            rows = np.argsort(-change, kind="stable")[: int(changed.sum())]
            errors = [row_distance(a[name][:, 0], each)[agree] for each in values]
            found = tuple(map(_errors, errors, errors[::-1]))
            yield QuantityChange(name, len(rows), float(change.max()), _listed(scene, rows), found)


def _errors(errors: Array, others: Array) -> VersionErrors:
    if not len(errors):
        return VersionErrors(0.0, 0.0, 0)
    rms, p999 = float(np.sqrt(np.mean(errors**2))), float(np.quantile(errors, QUANTILE))
    return VersionErrors(rms, p999, int((errors < others).sum()))


def _listed(scene: Scene, rows: Array) -> tuple[tuple[int, int], ...]:
    return tuple(pixel_of(scene, int(row)) for row in rows[:MAX_LISTED_PIXELS])


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
    return change.quantity, str(change.changed), *sizes, f"{b.nearer / decided:.0%}" if decided else NOTHING


def summary_text(run: VersionComparison) -> str:
    """How many scenes changed, how many pass with each version, and where only one passes."""
    scenes = run.scenes
    lines = [f"{plural(len(scenes), 'scene')}: {sum(bool(scene.changes) for scene in scenes)} differ in bits"]
    for i, name in enumerate(NAMES):
        about = ", ".join(f"{key} {value}" for key, value in run.versions[i].items())
        lines.append(f"{name}: {sum(scene.verdicts[i].ok for scene in scenes)} pass; {about}")
    lines += [f"FAIL  {scene.name}: only one version passes" for scene in scenes if not scene.ok]
    return "\n".join(lines)

"""Targets of our caster's speed beside the other rows, and whether a benchmark run reaches them."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from mitsuba_ref.bench.result import REFERENCE_ROW, Run, SceneResult

ALONE, MILLION = "one-sphere", "mesh-1m"  # scenes with targets of their own beside raw rays
SETS = {"": "depth, normal", "-smooth": "and shading normal", "-lit": "depth, normal, diffuse with a shadow"}


@dataclass(frozen=True)
class Outcome:
    """One target: how many times as fast as somebody we are to be, and how many times we are."""

    what: str
    target: float
    reached: float | None  # None: not measured
    where: str = ""  # the scene it is, where the least of several counts
    least: bool = True  # whether more is better

    @property
    def ok(self) -> bool | None:
        if self.reached is None:
            return None
        return self.reached >= self.target if self.least else self.reached <= self.target


Measure = Callable[[SceneResult], float | None]


def outcomes(run: Run) -> Iterator[Outcome]:
    """Every target, in the order of the page."""
    meshes = [scene.removesuffix("-lit") for scene in run.requested if scene.endswith("-lit")]
    meshes = [name for name in meshes if name != "kinds"]
    yield from of_meshes(run, meshes)
    films = [scene for scene in run.films if scene.name not in meshes]
    rest = [scene for scene in films if scene.name not in (ALONE, MILLION)]
    raw, integrator = times("raw-robust"), times("aov-robust")
    yield least("`ray_intersect`: each other scene", 1.5, rest, raw)
    yield least("`ray_intersect`: a million triangles", 1.5, named(run, MILLION), raw)
    yield least("`ray_intersect`: one sphere", 1.3, named(run, ALONE), raw)
    yield mean("AOV integrator: other scenes, geometric mean", 8.0, films, integrator)
    yield least("Open3D: any rays, coherent", 1.2, named(run, "rays-coherent"), times("open3d"))
    best = fastest("raw-robust", "raw-robust-incoherent")
    yield least("`ray_intersect`: any rays, coherent", 0.7, named(run, "rays-coherent"), best)
    yield least("`ray_intersect`: any rays, incoherent", 0.6, named(run, "rays-incoherent"), best)
    yield least("`ray_test`: shadow rays", 1.0, named(run, "rays-shadow"), best)
    lit = [scene for scene in run.scenes if scene.workload == "shading"]
    smooth = between("shade-smooth", "shade-normal")
    yield most("ours: a shading normal costs, beside depth and normal", 1.3, lit, smooth)
    diffuse = between("shade-unshadowed", "shade-normal")
    yield most("ours: diffuse without shadows, beside depth and normal", 1.6, lit, diffuse)
    whole = [scene for scene in run.scenes if scene.workload == "process"]
    command = [between("ours-process", other) for other in ("llvm-process", "scalar-process")]
    yield most("whole process: `caster render` beside `mitsuba`", 1.0, whole, largest(*command))


def of_meshes(run: Run, meshes: Sequence[str]) -> Iterator[Outcome]:
    """Targets of meshes that nothing was tuned for, in each set of AOVs."""
    figures = {"": (1.2, 1.6), "-smooth": (1.0, 1.4), "-lit": (1.0, 1.3)}
    for suffix, words in SETS.items():
        scenes = [scene for name in meshes for scene in named(run, name + suffix)]
        worst, average = figures[suffix]
        yield least(f"`ray_intersect`, meshes: {words}", worst, scenes, times("raw-robust"))
        yield mean("the same: geometric mean", average, scenes, times("raw-robust"))
        yield least("AOV integrator, the same", 2.5, scenes, times("aov-robust"))
        yield mean("the same: geometric mean", 4.0, scenes, times("aov-robust"))


def named(run: Run, name: str) -> list[SceneResult]:
    return [scene for scene in run.scenes if scene.name == name]


def times(key: str) -> Measure:
    """How many times as fast as this row we are."""
    return lambda scene: scene.ratio(key, REFERENCE_ROW)


def between(above: str, below: str) -> Measure:
    """How many times as long one of our rows takes as another."""
    return lambda scene: scene.ratio(above, below)


def fastest(*keys: str) -> Measure:
    """How many times as fast as the fastest of these rows we are."""
    return lambda scene: min((r for key in keys if (r := scene.ratio(key, REFERENCE_ROW)) is not None), default=None)


def largest(*measures: Measure) -> Measure:
    return lambda scene: max((r for each in measures if (r := each(scene)) is not None), default=None)


def measured(scenes: Sequence[SceneResult], measure: Measure) -> list[tuple[float, str]]:
    found = [(measure(scene), scene.name) for scene in scenes]
    return [(value, name) for value, name in found if value is not None]


def least(what: str, target: float, scenes: Sequence[SceneResult], measure: Measure) -> Outcome:
    value, where = min(measured(scenes, measure), default=(None, ""))
    return Outcome(what, target, value, where)


def most(what: str, target: float, scenes: Sequence[SceneResult], measure: Measure) -> Outcome:
    value, where = max(measured(scenes, measure), default=(None, ""))
    return Outcome(what, target, value, where, least=False)


def mean(what: str, target: float, scenes: Sequence[SceneResult], measure: Measure) -> Outcome:
    """The geometric mean: of ratios, the only mean that does not depend on which way round they are."""
    values = [value for value, _ in measured(scenes, measure)]
    if not values:
        return Outcome(what, target, None)
    return Outcome(what, target, math.exp(sum(map(math.log, values)) / len(values)), f"{len(values)} scenes")

"""Targets of our caster's speed beside the other rows, and whether a benchmark run reaches them."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from mitsuba_ref.bench.result import REFERENCE_ROW, Run, SceneResult

ALONE = "one-sphere"  # an image of almost nothing, with a target of its own beside raw rays


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
    films = run.films
    rest = [scene for scene in films if scene.name != ALONE]
    alone = [scene for scene in films if scene.name == ALONE]
    lit = [scene for scene in run.scenes if scene.workload == "shading"]
    yield least("Mitsuba LLVM, robust, AOV integrator: each scene", 5.0, films, times("aov-robust"))
    yield mean("Mitsuba LLVM, robust, AOV integrator: geometric mean", 7.0, films, times("aov-robust"))
    raw = "Mitsuba LLVM, robust, `ray_intersect`"
    yield least(f"{raw}: each scene but one sphere", 1.5, rest, times("raw-robust"))
    yield mean("the same: geometric mean", 2.2, rest, times("raw-robust"))
    yield least("the same: one sphere", 1.0, alone, times("raw-robust"))
    yield least("Open3D: each scene of triangles", 4.0, films, times("open3d"))
    yield least("trimesh + embreex: each scene of triangles", 10.0, films, times("trimesh"))
    yield least("Mitsuba scalar, AOV integrator: each scene", 40.0, films, times("scalar-aov"))
    yield least("Open3D: any rays, coherent", 1.0, named(run, "rays-coherent"), times("open3d"))
    yield least(
        f"{raw} without `coherent`: any rays, incoherent",
        0.5,
        named(run, "rays-incoherent"),
        times("raw-robust-incoherent"),
    )
    shadowed = between("shade-shadowed", "shade-unshadowed")
    yield most("ours: one shadowed light costs, beside one without shadows", 2.5, lit, shadowed)
    diffuse = between("shade-unshadowed", "shade-depth")
    yield least("ours: depth alone, beside depth, normal and diffuse without shadows", 1.3, lit, diffuse)


def named(run: Run, name: str) -> list[SceneResult]:
    return [scene for scene in run.scenes if scene.name == name]


def times(key: str) -> Measure:
    """How many times as fast as this row we are."""
    return lambda scene: scene.ratio(key, REFERENCE_ROW)


def between(above: str, below: str) -> Measure:
    """How many times as long one of our rows takes as another."""
    return lambda scene: scene.ratio(above, below)


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

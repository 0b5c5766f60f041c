"""One caster on the families of hard scenes: wrong rays, errors of t, rays per second, and one-ray reproducers."""

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from statistics import median

import numpy as np

from mitsuba_ref.hard.family import Family
from mitsuba_ref.hard.swept_families import SWEPT
from mitsuba_ref.judge.adjudication import prepare_scene
from mitsuba_ref.judge.checks import run_checks
from mitsuba_ref.reference.shared_input import shared_rays
from mitsuba_ref.reference.subprocess_runner import ResidentProcess, length_first
from mitsuba_ref.report.builtin_scenes import folders_of
from mitsuba_ref.runner.many_scenes import SceneEntry
from mitsuba_ref.stress.sweeps import Absent, PreparedSetting, Scorer, ask_candidate, prepare_setting
from mitsuba_ref.subjects.command import ServedCommand, mesh_bytes
from mitsuba_ref.subjects.subject import Answer

from . import exact

SWEEPS = (
    "watertight-edges",
    "watertight-vertices",
    "sliver",
    "grazing-rectangle",
    "scale-mesh",
    "offset-mesh",
    "distance-triangle",
    "length-mesh",
    "shadow-mesh",
)
COINCIDENT, BUILTIN = "coincident", "built-in"  # sheets at the same place; the other scenes of `validate --builtin`
COLUMNS = (*SWEEPS, COINCIDENT, BUILTIN)
SEED, RAYS, CLOSED_RAYS, FILM = 0, 200, 5_000, (12, 12)
SECONDS, SECONDS_OF_ALL = 60.0, 240.0  # for the answers to one setting, and to all of them
ULPS_AT = ("watertight-edges", 0.0)  # where errors of t are counted in ulps


@dataclass(frozen=True)
class Cell:
    """One caster in one setting."""

    column: str
    x: float | str  # of the sweep, or the built-in scene
    rays: int
    false_hits: int = 0
    false_misses: int = 0
    off: int = 0  # another surface, or t beyond the bound of the caster's arithmetic
    normals: int | None = None  # beyond their bound where t is right; None: no normals are returned
    first: int | None = None  # the first ray that is wrong
    absent: str = ""  # why there is no answer
    reproducer: str = ""

    @property
    def wrong(self) -> int:
        return self.false_hits + self.false_misses + self.off


@cache
def builtin() -> dict[str, SceneEntry]:
    (folder,) = folders_of("triangles")
    return {path.stem: SceneEntry(path.stem, str(path), FILM) for path in sorted(Path(folder).glob("*.toml"))}


@cache
def setting(column: str, x: float | str, rays: int | None = None) -> PreparedSetting:
    """The scene and rays of a cell. The same arguments give the same rays."""
    if column in (COINCIDENT, BUILTIN):
        scene = builtin()[x].load()
        shared = shared_rays(scene)
        ready = prepare_scene(scene, shared.o, shared.d)
        family = Family(column, "", make=lambda rng, value: None)
        return PreparedSetting(**vars(ready), family=family, x=x)
    family = next(each for each in SWEPT if each.name == column)
    return prepare_setting(family, SEED, x, rays or (CLOSED_RAYS if family.closed else RAYS))


def settings() -> Iterator[tuple[str, float | str]]:
    for family in SWEPT:
        if family.name in SWEEPS:
            yield from ((family.name, x) for x in family.values)
    yield from ((COINCIDENT if name == "pile" else BUILTIN, name) for name in builtin())


@cache
def exact_sample(column: str, x: float | str, rays: int | None) -> Scorer:
    ready = setting(column, x, rays)
    return Scorer(ready, np.zeros(len(ready.o), bool))


def judged(subject: ServedCommand, rays: int | None) -> Iterator[tuple[Cell, Answer | None]]:
    """Each cell of a caster, with its answer."""
    begin, given_up = time.monotonic(), dict[str, str]()
    for column, x in settings():
        ready = setting(column, x, rays)
        here = Cell(column, x, len(ready.o))
        if time.monotonic() > begin + SECONDS_OF_ALL:
            given_up[column] = f"not asked: {SECONDS_OF_ALL:g} s are over"
        if column in given_up:
            yield replace(here, absent=given_up[column]), None
            continue
        answer = ask_candidate(subject, ready)
        if isinstance(answer, Absent):
            late = "killed after" in answer.why
            if late:
                given_up[column] = answer.why.partition(";")[0]
            yield replace(here, absent=answer.why.partition("\n")[0][:100], first=None if late else 0), None
            continue
        answer = replace(answer, prim_id=None, shape_id=None)  # t and normals are judged, which all can return
        yield scored(here, answer, rays), answer


def scored(cell: Cell, answer: Answer, rays: int | None) -> Cell:
    """The cell with its counts: by t alone, then by normals. In a closed mesh every miss is a leak."""
    ready, kept = setting(cell.column, cell.x, rays), np.arange(cell.rays)
    scorer = exact_sample(cell.column, cell.x, rays)
    leaks = np.flatnonzero(~answer.hit) if ready.family.closed else kept[:0]
    if len(leaks):
        Scorer(ready, ~answer.hit)  # raises AssertionError where exact arithmetic misses, too
        kept = np.flatnonzero(answer.hit)
        answer = answer.rows(kept)
        scorer = Scorer(replace(ready, o=ready.o[kept], d=ready.d[kept]), np.zeros(len(kept), bool))
    plain = scorer.score(replace(answer, n=None))
    wrong, normals = [*leaks, *kept[list(plain.first_wrong)]], None
    if answer.n is not None:
        asked = answer.rows(scorer.rows)
        by_t, *by_both = ratios(scorer, asked, [None, asked.n, -asked.n])  # either side: some turn them to the ray
        tilted = kept[scorer.rows[(by_t <= 1.0) & (np.minimum(*by_both) > 1.0)]]
        wrong, normals = [*wrong, *tilted], len(tilted)
    counts = {"false_hits": plain.false_hits, "false_misses": len(leaks) + plain.false_misses, "off": plain.beyond}
    return replace(cell, **counts, normals=normals, first=int(wrong[0]) if wrong else None)


def ratios(scorer: Scorer, answer: Answer, normals: Sequence[np.ndarray | None]) -> np.ndarray:
    """Errors over bounds, a row for each of the normals."""
    return np.array([scorer.exact.ratios(replace(answer, n=n), answer.side) for n in normals])


def ulps(answer: Answer, rays: int | None) -> tuple[float, float]:
    """Median and maximum of the errors of t, in units of the last place of its type; inf for another surface."""
    scorer = exact_sample(*ULPS_AT, rays)
    t = answer.rows(scorer.rows).t
    kind = np.float32 if answer.precision == "float32" else np.float64
    off = scorer.exact.errors(t) / np.spacing(scorer.exact.t.astype(kind)).astype(np.float64)
    return float(np.nanmedian(off)), float(np.nanmax(off))


# ---- one ray


def reproduced(subject: ServedCommand, cell: Cell, ray: int, rays: int | None) -> tuple[bool, list[str]]:
    """(whether a ray is wrong again, the caster's answer and the exact one in lines): alone, else among the others."""
    whole = setting(cell.column, cell.x, rays)
    alone = replace(whole, o=whole.o[[ray]], d=whole.d[[ray]])
    lines = [f"{name} {a[0].tolist()}" for name, a in (("o", alone.o), ("d", alone.d))]
    again, found = compared(ask_candidate(subject, alone), alone)
    if not again:
        answer = ask_candidate(subject, whole)
        again, found = compared(answer if isinstance(answer, Absent) else answer.rows([ray]), alone)
        lines.append(f"among the {len(whole.o)} rays of its setting; alone it is right")
    return again, [*lines, *found]


def compared(answer: Answer | Absent, alone: PreparedSetting) -> tuple[bool, list[str]]:
    """(whether the answer to one ray is wrong, in lines) by exact.py and the bounds of the judge."""
    if isinstance(answer, Absent):
        return True, [f"caster: {answer.why.partition(chr(10))[0]}"]
    corners = np.concatenate([part.vertices[part.faces] for part in alone.model.packed.parts])
    t, prims = exact.first_hit(corners.tolist(), alone.o[0].tolist(), alone.d[0].tolist())
    given, hit = float(answer.t[0]), bool(answer.hit[0])
    lines = [f"caster: t {given!r} {given.hex()}" if hit else "caster: miss"]
    lines.append("exact:  miss" if t is None else f"exact:  t {float(t)!r} {float(t).hex()}, triangle {prims}")
    if t is None or not hit:
        return (t is None) == hit, lines
    ulp = float(np.spacing(np.float32(t) if answer.precision == "float32" else float(t)))
    scorer = Scorer(alone, ~answer.hit)
    off, bound = abs(given - float(t)) / ulp, scorer.exact.bounds(answer.side)[0] / ulp
    lines.append(f"t is off by {off:.3g} units in the last place of {answer.precision}, allowed are {bound:.3g}")
    if answer.n is None:
        return off > bound, lines
    n, right = (v / (np.linalg.norm(v) or 1.0) for v in (answer.n[0], exact.normal(corners[prims[0]].tolist())))
    tilt = min(np.linalg.norm(n - right), np.linalg.norm(n + right))
    lines.append(f"normal: {n.tolist()}, exact {right.tolist()}, off by {tilt:.3g} of its length")
    return bool(off > bound or ratios(scorer, answer, [answer.n, -answer.n]).min() > 1.0), lines


# ---- t_min and t_max, speed


def limits(subject: ServedCommand) -> str:
    """Whether t_min and t_max are heeded."""
    if not subject.takes_limits:
        return "not offered"
    (found,) = run_checks(subject)
    return found.what if found.ratio else f"heeded; {found.what}" if "hit" in found.what else "heeded"


ROUNDS, LEAST_SECONDS, MOST_RAYS = 5, 0.2, 2**18


def speeds(commands: Sequence[ServedCommand]) -> list[tuple[float, float]]:
    """(rays a second, MB of memory at most) of casters that take turns on one core: random rays at a scan.

    The time of a few rays, which is that of building the structure, is taken off. Raises ProcessEnded.
    """
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        programs = [ResidentProcess(each.words) for each in commands]
    finally:
        os.sched_setaffinity(0, cores)
    scan = setting(BUILTIN, "scan")
    mesh, (part,) = mesh_bytes(scan.model.packed), scan.model.packed.parts
    rng = np.random.default_rng(SEED)
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    inside = rng.uniform(low, high, (MOST_RAYS, 3))
    around = rng.normal(size=(MOST_RAYS, 3))
    o = (low + high) / 2 + around / np.linalg.norm(around, axis=1, keepdims=True) * np.linalg.norm(high - low)
    rows = np.column_stack([o, inside - o, np.zeros(MOST_RAYS), np.full(MOST_RAYS, np.inf)])

    def seconds(i: int, count: int) -> float:
        data = rows[:count].astype(commands[i].numbers).tobytes()
        request = length_first(mesh) + length_first(data)
        begin = time.perf_counter()
        programs[i].request(request, SECONDS)
        return time.perf_counter() - begin

    try:
        counts = []
        for i in range(len(programs)):
            seconds(i, 16)  # what is loaded or compiled at the first rays
            count, building = 64, seconds(i, 16)
            while count < MOST_RAYS and seconds(i, count) - building < max(LEAST_SECONDS, building):
                count *= 4
            counts.append(count)
        times = [[seconds(i, n) - seconds(i, 16) for i, n in enumerate(counts)] for _ in range(ROUNDS)]
        peaks = [peak_memory(program.process.pid) for program in programs]
    finally:
        for program in programs:
            program.close()
    rates = [n / max(median(column), 1e-9) for n, column in zip(counts, zip(*times, strict=True), strict=True)]
    return list(zip(rates, peaks, strict=True))


def peak_memory(pid: int) -> float:
    words = Path(f"/proc/{pid}/status").read_text().split()
    return int(words[words.index("VmHWM:") + 1]) / 1024.0

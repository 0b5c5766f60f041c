"""Sweeps of origins: the errors of several rules that place the origins of rays leaving a surface."""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import computed_field
from pydantic.dataclasses import dataclass

from caster.rendering.bounces import bounces
from caster.rendering.hits import trace_rays, validated_rays
from caster.system.atomic_files import check_folder
from caster.system.terminal import folded
from mitsuba_ref.hard.family import Family
from mitsuba_ref.judge.checks.secondary_rays import (
    MITSUBA,
    RULES,
    LeavingRays,
    OriginFindings,
    Rule,
    by_rule,
    judge_origins,
    rays_of_bounce,
)
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.oracle.spawned_origins import FINDINGS, OriginJudge
from mitsuba_ref.reference.mitsuba_process import send_request
from mitsuba_ref.reference.shared_input import packed_float32
from mitsuba_ref.report.reproducers import write_scene
from mitsuba_ref.report.results import NOTHING, aligned
from mitsuba_ref.subjects.subject import NoAnswer

OURS, CANDIDATE = "ours", "candidate"
DEFAULT_RAYS = 400  # of a setting


@dataclass(frozen=True)
class Absent:
    """The reason why a caster has no answer."""

    status: Literal["missing", "crash", "not applicable"]
    why: str

    @property
    def breaks(self) -> bool:
        return self.status == "crash"


@dataclass(frozen=True)
class OriginScore:
    """Counts of origins in one setting."""

    counts: Mapping[str, int]  # of all rays, and by finding
    wrong: int  # with any of the three errors
    unresolved: int  # of those, origins as close to the surface as float32 can tell
    example: str = ""
    status: str = "ok"

    @property
    def errors(self) -> dict[str, int]:
        """Self-hits, skipped surfaces and wrong sides."""
        return {name: self.counts[name] for name in FINDINGS[:-1]}

    @property
    def cell(self) -> str:
        """The errors in a table."""
        return "/".join(map(str, self.errors.values())) if self.wrong else "0"


@dataclass(frozen=True)
class OriginSetting:
    """Scores of all rules in one setting."""

    x: float
    rays: int
    rules: Mapping[str, OriginScore | Absent]
    file: str = ""  # the scene with the parent of the subject's first wrong ray


@dataclass(frozen=True)
class OriginSweep:
    """The results of one family."""

    name: str
    title: str
    quantity: str
    subject: str
    settings: tuple[OriginSetting, ...]
    seconds: float = 0.0
    declined: str = ""  # always empty: a rule answers every setting

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        return bool(self.settings) and not self.problems

    @computed_field  # type: ignore[prop-decorator]
    @property
    def problems(self) -> list[str]:
        """Why the sweep fails, in lines: settings without rays, and avoidable errors of the subject."""
        return list(self._problems())

    def _problems(self) -> Iterator[str]:
        for setting in self.settings:
            where, score = f"{self.name}, {self.quantity} {setting.x:g}", setting.rules[self.subject]
            if not setting.rays:
                yield f"{where}: no ray leaves a surface, so the setting tests nothing; more --rays may help"
            elif isinstance(score, Absent):
                yield f"{where}: {self.subject}: no answer: {score.why}"
            elif score.wrong > score.unresolved:
                words = ", ".join(f"{count} {name}" for name, count in score.errors.items() if count)
                lines = (f"{where}: {self.subject}:", words, score.example, f"parent ray: {setting.file}")
                yield "\n      ".join(lines)


def sweep_origins(family: Family, seed: int, rays: int | None, folder: Path, spawn: Rule | None = None) -> OriginSweep:
    """Sweep a family. spawn: a candidate's rule, judged in place of ours. folder: for the parents of wrong rays."""
    start, named = time.perf_counter(), {CANDIDATE: spawn} if spawn else {}
    rules: dict[str, Rule | str | None] = {**named, OURS: None, **{name: name for name in (MITSUBA, *RULES)}}
    (subject, *_), settings = rules, []
    for x in family.values:
        leaving = leaving_of(family, seed, x, rays)
        scores, count, file = dict[str, OriginScore | Absent]({subject: Absent("missing", "no rays")}), 0, ""
        if leaving is not None:
            judge, count = OriginJudge(Oracle(leaving.packed)), len(leaving.rays.q)
            for name, rule in rules.items():
                try:
                    found = judge_origins(by_rule(leaving, rule, send_request), judge)
                except NoAnswer as error:
                    scores[name] = Absent("crash", str(error))
                    continue
                wrong, avoidable, mine = found.wrong, found.avoidable, name == subject
                example = found.example(int([*avoidable, *wrong][0])) if len(wrong) else ""
                excused = len(wrong) - len(avoidable)
                scores[name] = OriginScore(found.counts(), len(wrong), excused, example)
                if mine and len(avoidable):
                    about = f"mitsuba-ref stress: {family.name}, {family.quantity} {x:g}"
                    file = write_parent(folder / f"{family.name}-{x:g}.toml", about, found, int(avoidable[0]))
        settings.append(OriginSetting(x, count, scores, file))
    seconds = round(time.perf_counter() - start, 3)
    return OriginSweep(family.name, family.title, family.quantity, subject, tuple(settings), seconds)


def leaving_of(family: Family, seed: int, x: float, count: int | None) -> LeavingRays | None:
    """The rays that leave what the rays of a setting hit; None without any."""
    made, rng = family.at(seed, x)
    scene = made.scene()
    packed = packed_float32(scene)
    aimed = made.aim(rng, packed, count or DEFAULT_RAYS)
    first = trace_rays(scene, packed, validated_rays(*aimed), np.zeros(len(aimed.o)))
    return next(map(rays_of_bounce, bounces(first, 1)), None)


def write_parent(path: Path, about: str, found: OriginFindings, row: int) -> str:
    """Write the scene of one wrong ray with its parent as the camera's ray; returns the file. Raises OutputError."""
    check_folder(path.parent)
    write_scene(path, found.scene_of(row), [about, found.example(row)])
    return str(path)


def as_text(sweep: OriginSweep) -> str:
    """The table of a sweep, with its failures."""
    (_, *names), *settings = rows(sweep)
    head = f"{'PASS' if sweep.ok else 'FAIL'}  {sweep.name}: {sweep.title}   {sweep.seconds:.1f} s"
    about = f"""x: {sweep.quantity}
of each rule: rays with self-hit/skipped surface/wrong side
unresolved: rays of {sweep.subject} with surfaces closer than float32 resolves"""
    absent = {
        f"{name}: {score.status}: {score.why}": None
        for setting in sweep.settings
        for name, score in setting.rules.items()
        if isinstance(score, Absent)
    }
    ends = (folded(line) for line in (*absent, *(f"FAIL  {line}" for line in sweep.problems)))
    return "\n".join([folded(head), about, *aligned([["x", *names], *settings]), *ends])


def rows(sweep: OriginSweep) -> list[list[str]]:
    """The head and one row a setting."""
    names = list(sweep.settings[0].rules) if sweep.settings else []
    found = [[sweep.quantity, "rays", *names, "unresolved"]]
    for setting in sweep.settings:
        scores = [setting.rules.get(name) for name in names]
        cells = [each.cell if isinstance(each, OriginScore) else getattr(each, "status", NOTHING) for each in scores]
        first = scores[0]
        excused = first.unresolved if isinstance(first, OriginScore) else NOTHING
        found.append([f"{setting.x:.4g}", str(setting.rays), *cells, str(excused)])
    return found

"""Sweeps of origins: the errors of several rules that place the origins of rays leaving a surface."""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import computed_field
from pydantic.dataclasses import dataclass

from caster.rendering.bounces import bounces
from caster.rendering.hits import trace_rays, validated_rays
from caster.system.atomic_files import check_folder
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
from mitsuba_ref.judge.verdict import Seconds
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.oracle.spawned_origins import FINDINGS, OriginJudge
from mitsuba_ref.reference.mitsuba_process import send_request
from mitsuba_ref.reference.shared_input import packed_float32
from mitsuba_ref.report.output import NOTHING
from mitsuba_ref.report.reproducers import write_scene
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
class Sweep:
    """The results of one family; a subclass has what was judged in each setting, and its table."""

    name: str
    title: str
    quantity: str
    settings: tuple[Any, ...]
    seconds: Seconds = 0.0
    declined: str = ""  # the candidate's own words, where it declined every setting
    ended: str = ""  # how the process that traced the family ended, where it did

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        return bool(self.settings) and not self.problems

    @computed_field  # type: ignore[prop-decorator]
    @property
    def problems(self) -> list[str]:
        """Why the sweep fails, in lines."""
        if self.ended:
            return [f"{self.name}: the process that casts and judges ended: {self.ended}"]
        if self.declined:
            return [f"{self.name}: the candidate declined every setting: {self.declined}"]
        return [
            f"{self.name}, {self.quantity} {setting.x:g}: {problem}"
            for setting in self.settings
            for problem in self.problems_in(setting)
        ]

    def problems_in(self, setting: Any) -> Iterator[str]:
        """Why a setting fails."""
        raise NotImplementedError


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


@dataclass(frozen=True, kw_only=True)
class OriginSweep(Sweep):
    """The results of one family by rule."""

    settings: tuple[OriginSetting, ...]
    subject: str

    def problems_in(self, setting: OriginSetting) -> Iterator[str]:
        """A setting without rays, and avoidable errors of the subject."""
        score = setting.rules[self.subject]
        if not setting.rays:
            yield "no ray leaves a surface, so the setting tests nothing; more --rays may help"
        elif isinstance(score, Absent):
            yield f"{self.subject}: no answer: {score.why}"
        elif score.wrong > score.unresolved:
            words = ", ".join(f"{count} {name}" for name, count in score.errors.items() if count)
            yield "\n      ".join((f"{self.subject}:", words, score.example, f"parent ray: {setting.file}"))

    def rows(self) -> list[list[str]]:
        names = list(self.settings[0].rules) if self.settings else []
        found = [[self.quantity, "rays", *names, "unresolved"]]
        for setting in self.settings:
            scores = [setting.rules.get(name) for name in names]
            cells = [
                each.cell if isinstance(each, OriginScore) else getattr(each, "status", NOTHING) for each in scores
            ]
            excused = getattr(scores[0], "unresolved", NOTHING)
            found.append([f"{setting.x:.4g}", str(setting.rays), *cells, str(excused)])
        return found

    def legend(self) -> str:
        return (
            "of each rule: rays with self-hit/skipped surface/wrong side\n"
            f"unresolved: rays of {self.subject} with surfaces closer than float32 resolves"
        )

    def footnotes(self) -> Iterator[str]:
        """Why a rule has no answer."""
        scores = (item for setting in self.settings for item in setting.rules.items())
        absent = (f"{name}: {score.status}: {score.why}" for name, score in scores if isinstance(score, Absent))
        yield from dict.fromkeys(absent)


def sweep_origins(family: Family, seed: int, rays: int | None, folder: Path, spawn: Rule | None) -> OriginSweep:
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
                scores[name] = OriginScore(found.counts(), len(wrong), len(wrong) - len(avoidable), example)
                if mine and len(avoidable):
                    about = f"mitsuba-ref stress: {family.name}, {family.quantity} {x:g}"
                    file = write_parent(folder / f"{family.name}-{x:g}.toml", about, found, int(avoidable[0]))
        settings.append(OriginSetting(x, count, scores, file))
    seconds = time.perf_counter() - start
    words = family.name, family.title, family.quantity
    return OriginSweep(*words, subject=subject, settings=tuple(settings), seconds=seconds)


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

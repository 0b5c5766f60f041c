"""Units of a campaign: calls of 0.1 to some seconds, each with a key that covers all its result depends on."""

import json
import os
import secrets
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from importlib.machinery import PathFinder
from itertools import product, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from caster.cli.shared_arguments import display_names
from caster.description.errors import SceneError
from caster.description.input_files import read_input
from caster.rendering.threads import set_default_threads
from caster.system.cluster import CallEnded
from mitsuba_ref.campaign.description import AnyJob, Campaign, Contender, FilmJob, FuzzJob, SceneJob
from mitsuba_ref.fuzz.findings import Tally
from mitsuba_ref.fuzz.fuzz_run import EXAMPLES_A_CALL, Drawing, Example, try_examples
from mitsuba_ref.hard import BY_NAME
from mitsuba_ref.hard.family import scene_of
from mitsuba_ref.hard.random_families import FILMS
from mitsuba_ref.judge.defect_lookup import defect_name
from mitsuba_ref.judge.verdict import AGREE, REFERENCE_WRONG, TIE, UNLISTED, SceneVerdict
from mitsuba_ref.reference.store import PROCESSOR, key_of, machine
from mitsuba_ref.report.reproducers import has_other_light, reproducer, rows_by_case
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry, judge_entry, problem_of, with_inputs_hash
from mitsuba_ref.runner.verdict_files import verdict_key, worker_identity
from mitsuba_ref.stress import sweeps
from mitsuba_ref.subjects.function import FUNCTION_PATTERN
from mitsuba_ref.subjects.requests import parse_candidate
from mitsuba_ref.subjects.subject import Subject

MAX_UNITS = 200_000
SUBJECT, REFERENCE = "subject", "reference"  # whose fault it is
SCENE_PLACE = "@scene"  # in a replay, for the file of the failure's own scene; no shell quotes it
UNNAMED = ("path", "content", "inputs")  # parameters that are no part of a unit's name


class Unit(NamedTuple):
    """One call."""

    kind: str  # type of its job
    subject: Contender
    parameters: dict[str, Any]
    key: str  # a hash of all that its result depends on
    files: str  # a hash of the subject's files

    @property
    def name(self) -> str:
        """Subject, kind and parameters: of all units of a campaign, no other has the same."""
        shown = {name: value for name, value in self.parameters.items() if name not in UNNAMED and value is not None}
        words = (f"{name}={_word(value)}" for name, value in shown.items())
        return " ".join([self.subject.name, self.kind, *words])

    @property
    def group(self) -> str:
        """What it is counted under over runs."""
        return " ".join([self.subject.name, self.kind, *filter(None, [self.parameters.get("family")])])


class Failure(NamedTuple):
    """Wrong answers of one kind in a unit."""

    side: str  # SUBJECT or REFERENCE; only the first fails the unit
    cause: str
    what: str
    times: int = 1
    replay: str = ""  # a command; "": the one that runs the unit alone
    scene: str = ""  # the text of the scene file it needs: one ray where possible


class Result(NamedTuple):
    """What came of a unit."""

    key: str
    rays: int = 0
    hits: int = 0
    agree: int = 0  # rays whose answers were compared and are right
    counts: Mapping[str, float] = {}  # classes of pixels, or tallies of fuzz and stress
    failures: tuple[Failure, ...] = ()
    seconds: float = 0.0
    processor: str = ""  # of the machine that ran it


def _word(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return "x".join(map(str, value))
    if isinstance(value, float) and float(short := f"{value:g}") == value:
        return short
    return str(value)


# ---- the units of a campaign ----


def units_of(campaign: Campaign) -> list[Unit]:
    """All units; those of different jobs alternate, so that a budget cuts all alike. Raises FileMissing, SceneError."""
    around = json.dumps(worker_identity(), sort_keys=True)
    own = {subject.name: _files_key(subject) for subject in campaign.subjects}
    found: dict[str, Unit] = {}
    for turn in zip_longest(*(_parameters(job, campaign.seeds) for job in campaign.jobs)):
        for job, each in zip(campaign.jobs, turn, strict=True):
            for subject in campaign.subjects if each else ():
                about = json.dumps([job.type, subject.model_dump(mode="json"), each], sort_keys=True)
                files = own[subject.name]
                unit = Unit(job.type, subject, each, key_of([around, about, files]), files)
                if found.setdefault(unit.name, unit).key != unit.key:
                    raise SceneError(f"two units are called '{unit.name}': put scenes of one name into one job")
        if len(found) > MAX_UNITS:
            raise SceneError(f"expected a campaign of at most {MAX_UNITS} units, got more: make its lists shorter")
    return list(found.values())


def _parameters(job: AnyJob, seeds: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    """Parameters of each unit of a job, of a scene file with hashes of its content."""
    if isinstance(job, SceneJob):
        for name, path in zip(display_names(job.scenes), job.scenes, strict=True):
            try:
                content = verdict_key(SceneEntry("", path).load(), path) or secrets.token_hex()  # never the same
            except SceneError:  # which its units report
                content = key_of([read_input(path, "scene file")])
            for size in job.sizes or (None,):
                inputs = with_inputs_hash(SceneEntry("", path, size)).inputs
                for bounce in range(job.bounces + 1):
                    yield {
                        "scene": name,
                        "path": path,
                        "content": content,
                        "inputs": inputs,
                        "size": size,
                        "bounce": bounce,
                    }
    elif isinstance(job, FilmJob):
        names = ("seed", "scene", "family", "size", "bounce")
        for values in product(seeds, range(job.scenes), job.families, job.sizes, range(job.bounces + 1)):
            yield dict(zip(names, values, strict=True))
    elif isinstance(job, FuzzJob):
        for seed, first, family, rays in product(
            seeds, range(0, job.examples, EXAMPLES_A_CALL), job.families, job.rays
        ):
            yield {
                "seed": seed,
                "family": family,
                "first": first,
                "examples": min(EXAMPLES_A_CALL, job.examples - first),
                "rays": rays,
                "judge_every": job.judge_every,
            }
    else:
        for seed, family, count in product(seeds, job.families, job.rays):
            for value in job.values or BY_NAME[family].values:
                yield {"seed": seed, "family": family, "value": value, "rays": count}


def _files_key(subject: Contender) -> str:
    """A hash of the files of a candidate: its module with those beside it in its package, or files among its words."""
    named = subject.candidate or ""
    files = set(subject.files)
    if FUNCTION_PATTERN.fullmatch(named):
        module = named.partition(":")[0].partition(".")[0]
        found = PathFinder.find_spec(module, [os.getcwd(), *sys.path])
        folders = found.submodule_search_locations if found else None
        files |= {str(each) for folder in folders or () for each in Path(folder).rglob("*.py")}
        files |= {found.origin} if found and found.origin and os.path.isfile(found.origin) else set()
    else:
        try:
            program, *words = shlex.split(named) or [""]
        except ValueError as error:
            raise SceneError(f"subject '{subject.name}': candidate {named!r}: {error}") from error
        files |= {word for word in (shutil.which(program) or program, *words) if os.path.isfile(word)}
    return key_of(part for file in sorted(files) for part in (file, read_input(file, "file of a candidate")))


# ---- running one ----


class SubjectError(SceneError):
    """A subject that cannot be used, so that no unit of it can be run."""


def run_unit(unit: Unit) -> Result:
    """Run a unit in this process. Raises SubjectError, and what casting and judging raise."""
    start = time.perf_counter()
    set_default_threads(1)
    try:
        subject = subject_of(unit.subject, unit.files)
    except SceneError as error:
        raise SubjectError(f"subject '{unit.subject.name}': {error}") from error
    found = RUNS[unit.kind](unit, subject)
    counts = {name: count for name, count in found.counts.items() if count}
    seconds = round(time.perf_counter() - start, 3)
    return found._replace(key=unit.key, counts=counts, seconds=seconds, processor=machine()[PROCESSOR])


@cache
def subject_of(contender: Contender, files: str) -> Subject | None:
    """The candidate, kept by this process for its next unit; None: our caster. files: as in Unit. Raises SceneError."""
    if contender.candidate is None:
        return None
    if _files_key(contender) != files:
        raise SceneError(
            f"the worker on {os.uname().nodename} has another version of {contender.candidate} than this run: "
            "copy its files there"
        )
    return parse_candidate(contender.candidate, contender.precision, contender.timeout, served=contender.serve)


def ended(unit: Unit, error: Exception) -> Result:
    """The result of a unit whose process ended, or that raised an exception."""
    cause = "crash" if isinstance(error, CallEnded) else "error"
    return Result(unit.key, failures=(Failure(SUBJECT, cause, problem_of(error)),), processor=machine()[PROCESSOR])


def _run_film(unit: Unit, subject: Subject | None) -> Result:
    """Judge a film: of a scene file, or of a random scene."""
    at, drawn = unit.parameters, unit.kind == "films"
    size, bounce = at["size"], at["bounce"]
    words = unit.subject.words() + (("--bounces", str(bounce)) if bounce else ())
    if drawn:
        family = FILMS if at["family"] == FILMS.name else BY_NAME[at["family"]]
        film = dict(zip(("width", "height"), size, strict=True))
        try:
            scene = scene_of({**Example(at["seed"], at["scene"], family).made.data, "film": film})
        except (SceneError, ValidationError):  # beyond what scenes may have
            return Result("", counts={"outside": 1})
        entry = SceneEntry(unit.name, SCENE_PLACE, options=words, given=scene, bounce=bounce)
    else:
        sized = ("--size", *map(str, size)) if size and bounce else ()  # a bounce has a film of its own
        options = (*sized, *words)
        entry = SceneEntry(at["scene"], at["path"], size, options=options, bounce=bounce, inputs=at["inputs"])
    found = judge_entry(entry, JudgeOptions(store=False, subject=subject, page_of=_one_ray_scenes))
    if found.unsupported:
        return Result("", counts={"declined": 1})
    rays = sum(sum(each.values()) for each in found.kinds.values()) if found.bounce else found.pixels
    agree = (
        found.evidence if found.bounce else rays - sum(found.counts.values()) + found.counts[AGREE] + found.counts[TIE]
    )
    failures = tuple(_failures(found, scene.to_toml() if drawn else ""))
    return Result("", rays, found.hit_pixels, agree, found.counts, failures)


def _failures(found: SceneVerdict, whole: str) -> Iterator[Failure]:
    """Failures of a judged film. whole: text of its scene; "" for a file, which replays name."""
    alone: dict[str, str] = found.seen or {}  # scenes of one ray
    if found.problem:
        yield Failure(SUBJECT, "no verdict", found.problem, 1, found.replay, whole)
    for check, worst in found.worst_by.items():
        if worst.verdict != REFERENCE_WRONG:
            text = f"{worst.reason}; subject: {worst.subject}; exact: {worst.exact}"
            shown = _alone(alone.get(check), worst.replay, whole)
            yield Failure(SUBJECT, check, text, found.failing_by[check], *shown)
    for made in found.checks:
        if not made.ok:
            yield Failure(SUBJECT, made.name, made.what, 1, found.replay, whole)
    for case, count in found.cases.items():
        side, name = (SUBJECT, UNLISTED) if case == UNLISTED else (REFERENCE, f"case {case}: {defect_name(int(case))}")
        one = alone.get(UNLISTED if case == UNLISTED else f"case-{case}")
        yield Failure(side, name, "", count, *_alone(one, found.replay, whole))
    if not (whole or found.problem or found.has_evidence):
        what = f"{found.evidence} pixels were compared and are right, {found.excused} excused"
        yield Failure(SUBJECT, "evidence", what, 1, found.replay)


def _alone(text: str | None, replay: str, whole: str) -> tuple[str, str]:
    """A replay and its scene: that of the ray alone, if there is one."""
    return (_probe(), text) if text else (replay, whole)


def _probe(*words: str) -> str:
    """The replay of a scene of one ray. words: options that name the candidate."""
    return shlex.join(["mitsuba-ref", "probe", SCENE_PLACE, "0", "0", *words])


def _one_ray_scenes(found: SceneVerdict) -> dict[str, str]:
    """Texts of scenes of one ray: of the worst pixel of each failing check, and of each case of the reference."""
    judge, judgement = found.seen.judge, found.seen.judgement
    if not judge.names_prims:
        return {}
    x0, y0, x1, y1 = judge.scene.film.window
    rows = {case: of_case[0] for case, of_case in rows_by_case(judgement).items()}
    for check, worst in found.worst_by.items():
        if y0 <= worst.y < y1:
            rows[check] = (worst.y - y0) * (x1 - x0) + worst.x - x0
    texts = {}
    for label, row in rows.items():
        if judge.t_max[row] >= 0.0:
            alone, notes = reproducer(judge, row, lit=has_other_light(judgement, row))
            texts[label] = "".join(f"# {line}\n" for line in (f"{label}: {found.name}", *notes)) + alone.to_toml()
    return texts


def _run_fuzz(unit: Unit, subject: Subject | None) -> Result:
    at = unit.parameters
    drawing = Drawing(at["seed"], (at["family"],), at["judge_every"], at["rays"], subject)
    total, failures = Tally(), list[Failure]()
    numbers = range(at["first"], at["first"] + at["examples"])
    for tried in try_examples(drawing, numbers):
        total.add(tried.tally)
        replay = shlex.join(["mitsuba-ref", "fuzz", *drawing.words(tried.number), *unit.subject.words()])
        failures += [Failure(SUBJECT, each.kind, each.what, 1, replay) for each in tried.findings]
    rays = total.pixels if subject else total.rays
    counts = {name: value for name, value in vars(total).items() if name not in ("kinds", "rays", "hits")}
    return Result("", rays, total.hits, rays - len(failures), counts, tuple(failures))


def _run_stress(unit: Unit, subject: Subject | None) -> Result:
    at, failures = unit.parameters, list[Failure]()
    family = replace(BY_NAME[at["family"]], values=(at["value"],))
    swept = sweeps.sweep(family, at["seed"], at["rays"], subject)
    if swept.declined:
        return Result("", counts={"declined": 1})
    (setting,) = swept.settings
    own = setting.witnesses[swept.casters[0].key]
    for caster in swept.casters:
        score = setting.witnesses[caster.key]
        if isinstance(score, sweeps.Score) and score.breaks and (score is own or caster.variant):
            side, cause = (SUBJECT, "wrong") if score is own else (REFERENCE, f"{caster.title}: {family.name}")
            replay = _probe(*unit.subject.words()) if score is own else _probe()
            failures.append(Failure(side, cause, score.example, score.wrong_masks + score.beyond, replay, score.scene))
    if not swept.ok and not any(each.side == SUBJECT for each in failures):  # no answer, or nothing to judge
        failures.append(Failure(SUBJECT, "not judged", swept.problems[0]))
    if not isinstance(own, sweeps.Score):
        return Result("", setting.rays, setting.hits, 0, {}, tuple(failures))
    agree = setting.rays - own.wrong_masks - own.beyond
    counts = {
        "false hits": own.false_hits,
        "false misses": own.false_misses,
        "beyond": own.beyond,
        "excused": own.excused,
    }
    return Result("", setting.rays, setting.hits, agree, counts, tuple(failures))


RUNS: dict[str, Callable[[Unit, Subject | None], Result]] = {
    "scenes": _run_film,
    "films": _run_film,
    "fuzz": _run_fuzz,
    "stress": _run_stress,
}

"""`mitsuba-ref fuzz`, `stress`, `bench` and `versions`: random scenes, sweeps, run time against error, two Mitsubas."""

import itertools
import os
import sys
from argparse import Namespace
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from caster.cli.shared_arguments import comma_separated, scene_files
from caster.description.errors import SceneError
from caster.system.cluster import CallEnded
from caster.system.process import DIFFERENCES, OK
from caster.system.terminal import ProgressBar, StatusLine
from mitsuba_ref.bench import casters
from mitsuba_ref.bench.drivers import AOVS, FILM
from mitsuba_ref.bench.machine import LOAD, REVISION, machine_properties
from mitsuba_ref.bench.measuring import time_scene
from mitsuba_ref.bench.result import CANDIDATE_ROW, REFERENCE_ROW, Run, SceneResult, as_text, overview, summary
from mitsuba_ref.bench.scenes import SCENES, BenchScene, scene_of_file, with_aovs
from mitsuba_ref.cli import options
from mitsuba_ref.cli.arguments import ScenePath, ServedProgram
from mitsuba_ref.cli.validate import selected_entries
from mitsuba_ref.fuzz import findings
from mitsuba_ref.fuzz.cases import read_kept
from mitsuba_ref.fuzz.checks import find
from mitsuba_ref.fuzz.fuzz_run import Drawing, FuzzRun
from mitsuba_ref.hard import BY_NAME, FAMILIES
from mitsuba_ref.hard.family import Family
from mitsuba_ref.hard.swept_families import SPAWNED, SWEPT
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.interpreter import PYTHON_VARIABLE, chosen, interpreter
from mitsuba_ref.reference.store import machine
from mitsuba_ref.report.output import aligned, libllvm, print_lines, write_result
from mitsuba_ref.runner.engine import LOCAL, opened, outcomes_of
from mitsuba_ref.runner.version_comparison import (
    LEGEND,
    SceneComparison,
    VersionComparison,
    compare_scene,
    scene_text,
    summary_text,
)
from mitsuba_ref.stress import origins, sweeps
from mitsuba_ref.stress.origins import OriginSweep
from mitsuba_ref.stress.sweeps import StressRun, SweepResult
from mitsuba_ref.subjects.function import spawn_rule
from mitsuba_ref.subjects.subject import OURS, Subject

# ---- fuzz ----

FUZZ_SECONDS = 60.0


def run_fuzz(args: Namespace) -> int:
    """Fuzz; 0 nothing found, 1 something found, 5 nothing selected, 130 interrupted."""
    if args.replay is not None:
        return replay_kept(args)
    families = options.select(FAMILIES, "family", args.family)
    limit = args.time if args.time is not None or args.examples is not None else FUZZ_SECONDS
    examples = itertools.count() if args.examples is None else args.examples
    names, candidate = tuple(family.name for family in families), options.requested_candidate(args)
    drawing = Drawing(args.seed, names, args.judge_every, args.rays, candidate)
    about = Path(args.out), args.keep, options.candidate_words(args), args.engine, args.workers
    running = FuzzRun(drawing, examples, limit, *about)
    if args.examples is not None and not args.examples:
        raise options.NothingSelected("nothing selected: --examples 0 selects no example")
    if args.judge_every or candidate:
        variants.require_variants()  # a wrong choice of variant fails before any work
    line = StatusLine()
    try:
        for done in running.run():
            total = done.total
            line.show(f"{total.examples} examples, {total.rays} rays, {total.findings} findings, {done.seconds:.0f} s")
    finally:  # what is found is kept, whatever ends the work
        line.erase()
        print_lines(findings.text(running.outcome), options.table_stream(args))
        write_result(running.outcome, args.json)
    return OK if running.outcome.ok else DIFFERENCES


def replay_kept(args: Namespace) -> int:
    """Check kept scenes again: 0 all pass today, 1 some fail, 2 a file is damaged, 4 missing, 5 an empty folder."""
    files = [each for each in scene_files([args.replay]) if not each.endswith(".json")]  # such as that of --json
    if not files:
        raise options.NothingSelected(f"nothing selected: no scene file in {args.replay}")
    kept = [(file, read_kept(Path(file))) for file in files]
    subject = options.requested_candidate(args) or OURS
    replays = [(file, kind, find(case, kind, subject=subject)) for file, (kind, case) in kept]
    print(findings.replay_text(replays))
    return DIFFERENCES if any(findings for *_, findings in replays) else OK


# ---- stress ----


def run_stress(args: Namespace) -> int:
    """Sweep the selected families; 0 right everywhere, 1 not, 5 nothing selected or judged, 130 interrupted."""
    known = SPAWNED if args.spawn else SWEPT if args.candidate else (*SWEPT, *SPAWNED)
    families = options.select(known, "family", args.families)
    if args.list:
        return options.print_list(families)
    candidate = options.requested_candidate(args, takes_rays=True)
    variants.variant_for(has_quadrics=True)  # without Mitsuba's columns a run would pass with its evidence missing
    if args.spawn:
        spawn_rule(args.spawn)  # its errors come before any work
    done, line = list[SweepResult | OriginSweep](), StatusLine()
    about = args.seed, args.rays, args.out, candidate, options.candidate_words(args), args.spawn
    calls = ((family.name, family.values, *about) for family in families)
    here = args.engine == LOCAL and (candidate or args.spawn)  # it runs in this process, alone
    workers = 1 if here else args.workers
    try:
        with closing(outcomes_of(args.engine, workers, sweep_family, calls, forks=not here)) as outcomes:
            for i, family in enumerate(families):
                line.show(f"stress: {i + 1}/{len(families)} {family.name}")
                outcome = next(outcomes)
                if isinstance(outcome.error, CallEnded):
                    done.append(SweepResult.of(family, ended=str(outcome.error)))
                else:
                    done.append(outcome.value())
                line.erase()
                found = done[-1]
                print_lines(f"{sweeps.as_text(found, args.skip_unsupported)}\n", options.table_stream(args))
    finally:  # what is done is kept, whatever ends the work
        run = report_sweeps(done, families, args)
    if not run.judged:
        raise options.NothingSelected("nothing judged: the candidate declined every family")
    return OK if run.ok else DIFFERENCES


def sweep_family(
    name: str,
    values: tuple[float, ...],
    seed: int,
    rays: int | None,
    folder: str,
    candidate: Subject | None,
    words: tuple[str, ...],
    spawn: str | None,
) -> SweepResult | OriginSweep:
    """Sweep a family in this process."""
    family = replace(BY_NAME[name], values=values)
    if any(name == each.name for each in SPAWNED):
        return origins.sweep_origins(family, seed, rays, Path(folder), spawn_rule(spawn) if spawn else None)
    return sweeps.sweep(family, seed, rays, candidate, Path(folder), words)


def report_sweeps(done: list[SweepResult | OriginSweep], families: list[Family], args: Namespace) -> StressRun:
    """Write the JSON file, if any, and print a last line; returns the result."""
    installed = {name: machine()[name] for name in ("mitsuba", "drjit", "numpy")} | {"libllvm": libllvm()}
    requested = tuple(family.name for family in families)
    run = StressRun(args.seed, installed, requested, tuple(done), args.skip_unsupported)
    write_result(run, args.json)
    declined = [sweep.name for sweep in done if sweep.declined]
    failing = [sweep.name for sweep in done if not sweep.ok and not sweep.declined]
    names = f": {', '.join(failing)}" if failing else ""
    text = f"{len(done)} of {len(families)} families, {len(failing)} fail{names}"
    if declined:
        waived = "" if args.skip_unsupported else "; they fail the run without --skip-unsupported"
        text += f"\n{len(declined)} declined by the candidate: {', '.join(declined)}{waived}"
    print_lines(f"{options.missing_variants()}{text}", options.table_stream(args))
    return run


# ---- bench ----


def run_bench(args: Namespace) -> int:
    """Time the selected scenes; 0, 1 where ours did not run, 2 unknown scene, 5 nothing selected, 130 interrupted."""
    scenes = requested_scenes(args)
    candidate = options.requested_candidate(args, takes_rays=True)
    if args.list:
        return options.print_list(scenes)
    if interpreter() != sys.executable:
        raise SceneError(f"{PYTHON_VARIABLE}: bench times the Mitsuba that is installed beside it; unset it")
    variants.variant_for(has_quadrics=True)  # raises before any work without Mitsuba
    settings = {"size": args.size, "alternations": args.alternations}
    caster = None
    if candidate:
        text, served = str(args.candidate), isinstance(args.candidate, ServedProgram)
        work = {"text": text, "precision": args.candidate_precision, "served": served, "folder": os.getcwd()}
        # Its film is made smaller until it is cast within MAX_CAST_S.
        caster = casters.TimedCaster(CANDIDATE_ROW, text, "drivers:Candidate", options=work, first=32)
    machine = machine_properties()
    done, calls = list[SceneResult](), [(scene, caster, settings) for scene in scenes]
    try:
        with (  # one scene at a time on each machine
            opened(args.engine, 1, SCENE_SECONDS, forks=False) as engine,
            closing(ProgressBar("bench", len(calls))) as bar,
            closing(engine.map(time_on_worker, calls)) as outcomes,
        ):
            if engine.cluster:
                engine.cluster.check_one_worker_a_machine()
            for outcome in outcomes:
                its_machine, result = outcome.value()
                machine = machine if done else its_machine
                for name in machine:
                    if name not in (LOAD, REVISION) and machine[name] != its_machine.get(name):
                        raise SceneError(f"--engine {args.engine}: expected equal machines, got two of another {name}")
                done.append(result)
                with bar.aside():
                    print_lines(f"{as_text(result)}\n", options.table_stream(args))
                bar.add(1, f"{len(done)} of {len(calls)} scenes")
    finally:  # what is done is kept, whatever ends the work
        recorded = settings | {"candidate": caster.title if caster else ""}
        run = Run(recorded, machine, tuple(scene.name for scene in scenes), tuple(done))
        write_result(run, args.json)
        head = "milliseconds of ours, and how many times as fast as each of the others it is"
        table = "\n".join([head, *aligned(overview(run), left=2)])
        text = f"{table}\n\n{options.missing_variants()}{summary(run)}"
        print_lines(text, options.table_stream(args))
    rows = [row for result in done for row in result.rows]
    ours_ran = all(row.ran for row in rows if row.key == REFERENCE_ROW)
    candidate_ran = any(row.ran for row in rows if row.key == CANDIDATE_ROW)  # whether it is right, `validate` says
    return OK if ours_ran and (candidate is None or candidate_ran) else DIFFERENCES


SCENE_SECONDS = 3600.0  # a limit of the time for one scene on a cluster


def time_on_worker(
    scene: BenchScene, caster: casters.TimedCaster | None, settings: dict[str, int]
) -> tuple[dict[str, str], SceneResult]:
    """The properties of this machine, and the times of a scene; a candidate gives depth and normal alone."""
    timed = [each for each in casters.CASTERS if scene.workload in each.workloads]
    timed += [caster] if caster and scene.aovs == AOVS else []
    return machine_properties(), time_scene(scene, timed, **settings)


def requested_scenes(args: Namespace) -> list[BenchScene]:
    """Scenes of the standard set and of files, with the AOVs of --aov. Raises SceneError, NothingSelected."""
    words = list(map(ScenePath, args.scenes))
    files = [word for word in words if Path(word).suffix]
    named = [word for word in words if word not in files]
    chosen = options.select(SCENES, "scene", named) if named or not files else []
    chosen += [scene_of_file(file, args.mesh_dir) for file in files]
    if args.candidate and not args.aov:  # it gives depth and normal
        chosen = [scene for scene in chosen if scene.aovs == AOVS]
    if args.aov:
        images = [scene for scene in chosen if scene.workload == FILM and scene.aovs == AOVS]
        chosen = [with_aovs(scene, comma_separated(args.aov)) for scene in images]
    if not chosen:
        raise options.NothingSelected("nothing selected: no scene fits the options")
    return chosen


# ---- versions ----


def run_versions(args: Namespace) -> int:
    """Print what changed; 1 if a scene passes with one version alone, 5 nothing was selected. Raises SceneError."""
    pythons = args.interpreters if len(args.interpreters) == 2 else [interpreter(), *args.interpreters]
    if len(pythons) != 2:
        raise SceneError(f"--mitsuba: expected it once or twice, got {len(args.interpreters)}")
    entries = selected_entries(args)
    found = []
    for python in pythons:  # their errors come before any work
        with chosen(python):
            variants.require_variants()
            found.append({name: machine()[name] for name in ("mitsuba", "drjit")} | {"python": interpreter()})
    out = options.table_stream(args)
    print(f"{LEGEND}\n", file=out)
    done, line = list[SceneComparison](), StatusLine()
    try:
        for i, entry in enumerate(entries):
            line.show(f"versions: {i + 1}/{len(entries)} {entry.name}: judging")
            task = Task(entry.load(), entry.name, entry.path, timeout=args.timeout)
            done.append(compare_scene(pythons, task))
            line.erase()
            print_lines(f"{scene_text(done[-1])}\n", out)
    finally:  # what is done is kept, whatever ends the work
        result = VersionComparison(tuple(found), tuple(done))
        write_result(result, args.json)
        print_lines(summary_text(result), out)
    return OK if result.ok else DIFFERENCES

"""`mitsuba-ref stress`, `bench` and `versions`: errors in sweeps, run time against error, two versions of Mitsuba."""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

from caster.cli.shared_arguments import comma_separated
from caster.description.errors import SceneError
from caster.rendering.threads import core_count
from caster.system.cluster import CallEnded
from caster.system.process import DIFFERENCES, OK
from caster.system.terminal import StatusLine
from mitsuba_ref.bench import casters
from mitsuba_ref.bench.drivers import AOVS, FILM
from mitsuba_ref.bench.machine import CORES, LOAD, machine_properties
from mitsuba_ref.bench.measuring import Settings, time_scene
from mitsuba_ref.bench.result import CANDIDATE_ROW, REFERENCE_ROW, Run, SceneResult, as_text, overview_text, summary
from mitsuba_ref.bench.scenes import SCENES, BenchScene, scene_of_file, with_aovs
from mitsuba_ref.cli import options
from mitsuba_ref.cli.arguments import ScenePath, ServedProgram
from mitsuba_ref.cli.validate import selected_entries
from mitsuba_ref.hard.family import Family
from mitsuba_ref.hard.swept_families import SPAWNED, SWEPT
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.interpreter import PYTHON_VARIABLE, chosen, interpreter
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.reference.store import machine
from mitsuba_ref.report.results import libllvm, print_lines, write_result
from mitsuba_ref.runner.engine import LOCAL, opened
from mitsuba_ref.runner.version_comparison import (
    LEGEND,
    SceneComparison,
    VersionComparison,
    compare_scene,
    scene_text,
    summary_text,
)
from mitsuba_ref.runner.workers import CALL_TIMEOUTS
from mitsuba_ref.stress import origins, sweeps
from mitsuba_ref.stress.origins import OriginSweep
from mitsuba_ref.stress.sweeps import StressRun, SweepResult
from mitsuba_ref.subjects.function import spawn_rule
from mitsuba_ref.subjects.subject import Subject

# ---- stress ----


def run_stress(args: argparse.Namespace) -> int:
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
    words = options.candidate_words(args)
    about = args.seed, args.rays, args.out, candidate, words, args.spawn
    calls = ((family, *about) for family in families)
    here = args.engine == LOCAL and (candidate or args.spawn)  # it runs in this process, alone
    limit = CALL_TIMEOUTS * DEFAULT_TIMEOUT
    try:
        with (
            opened(args.engine, 1 if here else args.workers, limit, forks=not here) as engine,
            closing(engine.map(sweep_family, calls)) as outcomes,
        ):
            for i, family in enumerate(families):
                line.show(f"stress: {i + 1}/{len(families)} {family.name}")
                outcome = next(outcomes)
                if isinstance(outcome.error, CallEnded):
                    done.append(SweepResult.of(family, ended=str(outcome.error)))
                else:
                    done.append(outcome.value())
                line.erase()
                found = done[-1]
                print(f"{sweeps.as_text(found, args.skip_unsupported)}\n", file=options.table_stream(args), flush=True)
    finally:  # what is done is kept, whatever ends the work
        run = report_sweeps(done, families, args)
    if not run.judged:
        raise options.NothingSelected("nothing judged: the candidate declined every family")
    return OK if run.ok else DIFFERENCES


def sweep_family(
    family: Family,
    seed: int,
    rays: int | None,
    folder: str,
    candidate: Subject | None,
    words: tuple[str, ...],
    spawn: str | None,
) -> SweepResult | OriginSweep:
    """Sweep a family in this process."""
    if family in SPAWNED:
        return origins.sweep_origins(family, seed, rays, Path(folder), spawn_rule(spawn) if spawn else None)
    return sweeps.sweep(family, seed, rays, candidate, Path(folder), words)


def report_sweeps(done: list[SweepResult | OriginSweep], families: list[Family], args: argparse.Namespace) -> StressRun:
    """Write the JSON file, if any, and print a last line; returns the result."""
    installed = {name: machine()[name] for name in ("mitsuba", "drjit", "numpy")} | {"libllvm": libllvm()}
    requested = tuple(family.name for family in families)
    run = StressRun(args.seed, installed, requested, tuple(done), args.skip_unsupported)
    if args.json:
        write_result(run, args.json)
    declined = [sweep.name for sweep in done if sweep.declined]
    failing = [sweep.name for sweep in done if not sweep.ok and not sweep.declined]
    names = f": {', '.join(failing)}" if failing else ""
    text = f"{len(done)} of {len(families)} families, {len(failing)} fail{names}"
    if declined:
        waived = "" if args.skip_unsupported else "; they fail the run without --skip-unsupported"
        text += f"\n{len(declined)} declined by the candidate: {', '.join(declined)}{waived}"
    print(f"{options.missing_variants()}{text}", file=options.table_stream(args))
    return run


# ---- bench ----


def run_bench(args: argparse.Namespace) -> int:
    """Time the selected scenes; 0, 1 where ours did not run, 2 unknown scene, 5 nothing selected, 130 interrupted."""
    scenes = requested_scenes(args)
    candidate = options.requested_candidate(args, takes_rays=True)
    if args.list:
        return options.print_list(scenes)
    here = args.engine == LOCAL
    threads = args.threads or (core_count() if here else ALL_CORES)
    if here and threads > core_count():
        raise SceneError(f"--threads {threads}: this process may use {core_count()}")
    if interpreter() != sys.executable:
        raise SceneError(f"{PYTHON_VARIABLE}: bench times the Mitsuba that is installed beside it; unset it")
    variants.variant_for(has_quadrics=True)  # raises before any work without Mitsuba
    settings = Settings(args.size, args.alternations, threads)
    caster = None
    if candidate:
        served = isinstance(args.candidate, ServedProgram)
        caster = casters.candidate_caster(str(args.candidate), args.candidate_precision, served=served)
    recorded = asdict(settings) | {"candidate": caster.title if caster else ""}
    machine: Mapping[str, str] = machine_properties()
    done, calls = list[SceneResult](), [(scene, caster, settings) for scene in scenes]
    try:
        for its_machine, result in timed_here(machine, calls) if here else timed_elsewhere(args.engine, calls):
            machine = machine if done else its_machine
            for name in machine:
                if name != LOAD and machine[name] != its_machine.get(name):
                    raise SceneError(f"--engine {args.engine}: expected equal machines, got two of another {name}")
            done.append(result)
            print(f"{as_text(result)}\n", file=options.table_stream(args), flush=True)
    finally:  # what is done is kept, whatever ends the work
        recorded["threads"] = threads or int(machine[CORES].partition(" ")[0])
        run = Run(recorded, machine, tuple(scene.name for scene in scenes), tuple(done))
        if args.json:
            write_result(run, args.json)
        text = f"{overview_text(run)}\n\n{options.missing_variants()}{summary(run)}"
        print(text, file=options.table_stream(args))
    rows = [row for result in done for row in result.rows]
    ours_ran = all(row.ran for row in rows if row.key == REFERENCE_ROW)
    candidate_ran = any(row.ran for row in rows if row.key == CANDIDATE_ROW)  # whether it is right, `validate` says
    return OK if ours_ran and (candidate is None or candidate_ran) else DIFFERENCES


BenchCall = tuple[BenchScene, casters.TimedCaster | None, Settings]
TimedScene = tuple[Mapping[str, str], SceneResult]  # with the properties of the machine
ALL_CORES = 0  # threads of a run elsewhere: those of the worker's machine
SCENE_SECONDS = 3600.0  # a limit of the time for one scene elsewhere


def timed_here(machine: Mapping[str, str], calls: Sequence[BenchCall]) -> Iterator[TimedScene]:
    line = StatusLine()
    for i, (scene, caster, settings) in enumerate(calls):
        progress = line.about(f"bench: {i + 1}/{len(calls)} {scene.name}")
        found = time_scene(scene, casters.casters_for(scene, caster), settings, progress)
        line.erase()
        yield machine, found


def timed_elsewhere(name: str, calls: Sequence[BenchCall]) -> Iterator[TimedScene]:
    """One scene at a time on each machine of a cluster. Raises ClusterError."""
    with opened(name, 1, SCENE_SECONDS) as engine:
        if engine.cluster:
            engine.cluster.check_one_worker_a_machine()
        with closing(engine.map(time_on_worker, calls)) as outcomes:
            yield from (outcome.value() for outcome in outcomes)


def time_on_worker(scene: BenchScene, caster: casters.TimedCaster | None, settings: Settings) -> TimedScene:
    every = replace(settings, threads=settings.threads or core_count())
    return machine_properties(), time_scene(scene, casters.casters_for(scene, caster), every)


def requested_scenes(args: argparse.Namespace) -> list[BenchScene]:
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


def run_versions(args: argparse.Namespace) -> int:
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
        if args.json:
            write_result(result, args.json)
        print_lines(summary_text(result), out)
    return OK if result.ok else DIFFERENCES

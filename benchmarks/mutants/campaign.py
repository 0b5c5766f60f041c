"""A campaign: the sampled mutants of the chosen modules, each tried in a copy of the tree, shortest tests first."""

import compileall
import fcntl
import hashlib
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any

import pytest
from mutants.operators import Mutant, keys_of, mutants_of
from mutants.trial import PACKAGES, Chosen, Measured, in_fork, load_libraries

ROOT = Path(__file__).resolve().parents[2]
GROUPS = {
    "kernels": ("caster/kernels/**/*.py",),
    "shapes": ("caster/shapes/*.py",),
    "cameras": ("caster/cameras/*.py",),
    "AOVs": ("caster/aovs/*.py",),
    "readers": ("caster/geometry/**/*.py", "caster/scene/*.py", "caster/description/parsing.py"),
    "judge": ("mitsuba_ref/judge/**/*.py",),
    "oracle": ("mitsuba_ref/oracle/*.py",),
    "error model": ("mitsuba_ref/error_model/*.py",),
    "reference shapes": ("mitsuba_ref/shapes/*.py", "mitsuba_ref/cameras/*.py"),
}
END_TO_END = "benchmarks/mutants/end_to_end.py"
SMALL_AGREEMENT = "benchmarks/mutants/small_agreement.py"
SMALL_RAYS = "benchmarks/mutants/small_rays.py"
# Quick without the compiler; most of tests/agreement is not, SMALL_AGREEMENT and SMALL_RAYS stand for it.
PLAIN = {
    "tests/agreement": """
        lanes wide_angle_cameras
    """,
    "tests/exact": """
        box_tree edge_cases oracle_filter oracle_kinds oracle_roots oracle_scenes
    """,
    "tests/reference": """
        adjudication detection_power error_models_hold excused_classes
    """,
    "tests/report": """
        pages records
    """,
    "tests/unit": """
        added_aov bias bracket builtin_scenes camera_references candidate_aimed
        error_bounds_of_kernels error_models exact_kernels explanations fuzz generated_meshes
        geometry_checked_in_both_precisions independent_transform judge_at_extremes knife_edges known_defects
        lambert_and_shadow_rays mesh_files mesh_normals plan primitive_properties quadric_normals ray_bounds
        ray_camera ray_sorting registries rejected_faces scene_docs scene_errors scene_files scene_lights
        scene_locate scene_model scene_numbers screen_bounds sliver_normals sphere_clouds stated_numbers tiles
        transform
    """,
}
# Of modules of the judge, for which the caster is compiled: what asks Mitsuba gets its stored answers.
WITH_COMPILER = {
    "tests/unit": """
        bias bracket camera_references candidate_aimed candidate_scene check_list defect_measurement
        description_round_trip error_models exact_kernels explanations exr_compare exr_files fuzz
        generated_meshes geometry_checked_in_both_precisions independent_transform judge_at_extremes
        knife_edges known_defects lambert_and_shadow_rays pixel_explanations ray_camera ray_conventions
        registries report_files result_schemas scene_options scene_rows
        stated_numbers stress surface_targets verdict_rules
    """,
    "tests/exact": """
        box_tree edge_cases oracle_filter oracle_kinds oracle_roots oracle_scenes
    """,
    "tests/reference": """
        adjudication bands candidate_probe candidates detection_power diagnosis error_models_hold
        excused_classes hypotheses judge_classes mesh_loader mistakes mitsuba_files new_shape probe_witnesses ray_lists
    """,
    "tests/report": """
        pages records
    """,
}


def files_of(listed: dict[str, str]) -> tuple[str, ...]:
    return tuple(f"{folder}/test_{name}.py" for folder, names in listed.items() for name in names.split())


TESTS, COMPILED_TESTS = files_of(PLAIN), files_of(WITH_COMPILER)
SLOWEST_TEST_S = 4.0  # CPU seconds without the compiler, lines recorded; a slower test is not used
FILE_LIMIT_S = 60.0  # CPU seconds for the measurement of one file of tests; what comes later in it is not used
FIRST_S, FIRST_FILES = 1.5, 5  # the tests that are tried first: CPU seconds, files
START_S = 20.0  # CPU seconds that a fork may take beside ten times its tests' own


@dataclass
class Test:
    """A test that passes, as it was measured."""

    test: str
    seconds: float
    lines: dict[str, set[int]]

    @property
    def file(self) -> str:
        return self.test.partition("::")[0]


@dataclass
class Outcome:
    """What became of one mutant."""

    key: str
    group: str
    module: str
    line: int
    where: str
    operator: str
    old: str
    new: str
    status: str = "survived"  # killed, timeout, survived or not executed
    by: str = ""  # the test that failed
    what: str = ""  # and how
    seconds: float = 0.0  # CPU
    tests: int = 0  # that were selected


@dataclass
class Settings:
    """Options of a campaign."""

    out: Path
    groups: Sequence[str] = tuple(GROUPS)
    module: str = ""  # part of a module's path
    sample: int = 40  # mutants a group; 0: all
    seed: int = 1
    budget: float = 10.0  # CPU seconds of tests a mutant
    jobs: int = 2
    again: bool = False  # survivors of an earlier run, but for equivalents, are tried once more
    root: Path = ROOT
    sources: dict[str, tuple[str, ...]] = field(default_factory=lambda: dict(GROUPS))
    tests: Sequence[str] = (END_TO_END, SMALL_AGREEMENT, SMALL_RAYS, *TESTS)
    compiled_tests: Sequence[str] = (END_TO_END, *COMPILED_TESTS)


class Tree:
    """A copy of the tree whose modules are edited one at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def plant(self, module: str, source: bytes) -> None:
        path = self.folder / module
        Path(cache_from_source(str(path))).unlink(missing_ok=True)
        path.write_bytes(source)


def copied_tree(source: Path, folder: Path) -> Tree:
    """Without .git and caches; modules compiled to bytecode."""
    ignore = shutil.ignore_patterns(".*", "build", "__pycache__", "*.egg-info")
    shutil.copytree(source, folder, ignore=ignore)
    for package in PACKAGES:
        if (folder / package).is_dir():
            compileall.compile_dir(folder / package, quiet=1)
    return Tree(folder)


def is_compiled(settings: Settings, group: str) -> bool:
    """Whether no mutant of a group edits the caster, whose kernels may then come from the cache."""
    return not any(pattern.startswith("caster/") for pattern in settings.sources[group])


def measured(settings: Settings, tree: Tree, compiled: bool) -> list[Test]:
    """Every test that passes in the copy, with its time and lines; measured once for each state of the sources."""
    os.environ["CASTER_JIT"] = str(int(compiled))
    patterns = settings.compiled_tests if compiled else settings.tests
    tests = set(tree.folder.glob("tests/**/test_*.py"))
    shared = {path for name in (*PACKAGES, "tests") for path in tree.folder.glob(f"{name}/**/*.py")} - tests
    folder = settings.out / ("measured-compiled" if compiled else "measured") / digest(shared)
    folder.mkdir(parents=True, exist_ok=True)
    files = sorted({path for pattern in patterns for path in tree.folder.glob(pattern)})
    parallel(settings.jobs, files, lambda path, job: _measure(tree, path, folder))
    found = []
    for path in files:
        for line in measurement(folder, path).read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            test = Test(row["test"], row["seconds"], {name: set(rows) for name, rows in row["lines"].items()})
            if test.seconds <= SLOWEST_TEST_S and test.lines:
                found.append(test)
    if not found:
        raise RuntimeError(f"{settings.root}: no test passes without a mutant, so none can find one")
    return found


def digest(paths: Iterable[Path]) -> str:
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(paths))).hexdigest()[:12]


def measurement(folder: Path, path: Path) -> Path:
    """The file of what was measured of a file of tests."""
    return folder / f"{path.stem}-{digest([path])}.jsonl"


def _measure(tree: Tree, path: Path, folder: Path) -> None:
    out = measurement(folder, path)
    if not out.exists():
        part = out.with_suffix(".part")
        part.write_text("")
        name = str(path.relative_to(tree.folder))
        plugin = Measured(tree.folder, part, SLOWEST_TEST_S)
        ended = in_fork(tree.folder, [name], plugin, FILE_LIMIT_S, folder / f"{path.stem}.failure")
        if ended.code == pytest.ExitCode.INTERRUPTED:
            raise RuntimeError(f"{name}: its tests cannot be collected, so none of them would find a mutant")
        part.rename(out)


def parallel(jobs: int, items: Sequence[Any], work: Callable[[Any, int], None]) -> None:
    """work(item, job) in `jobs` forks, each taking the next item. Raises RuntimeError where one fails."""
    children = []
    with tempfile.TemporaryFile() as queue:
        for job in range(jobs):
            child = os.fork()
            if child == 0:
                code = 1
                try:
                    while (i := _next(queue.fileno())) < len(items):
                        work(items[i], job)
                    code = 0
                except BaseException:
                    sys.excepthook(*sys.exc_info())
                finally:
                    sys.stderr.flush()
                    os._exit(code)
            children.append(child)
        codes = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
    if any(codes):
        raise RuntimeError(f"a process of the campaign ended with exit codes {codes}")


def _next(queue: int) -> int:
    """A number that no other process gets: the length of a file that grows by a byte each time."""
    fcntl.lockf(queue, fcntl.LOCK_EX)
    taken = os.fstat(queue).st_size
    os.ftruncate(queue, taken + 1)
    fcntl.lockf(queue, fcntl.LOCK_UN)
    return taken


def module_files(settings: Settings, group: str) -> list[str]:
    paths = sorted(path for pattern in settings.sources[group] for path in settings.root.glob(pattern))
    return [str(path.relative_to(settings.root)) for path in paths]


def sampled(settings: Settings, group: str) -> tuple[dict[str, int], list[tuple[str, Mutant, str]]]:
    """(how many mutants each module has, (module, mutant, key) of the sample)."""
    counts, every = {}, []
    for module in module_files(settings, group):
        source = (settings.root / module).read_bytes()
        found = mutants_of(source)
        counts[module] = len(found)
        if settings.module in module:
            every += [(module, mutant, key) for mutant, key in zip(found, keys_of(source, found), strict=True)]
    chosen = random.Random(f"{settings.seed} {group}").sample(every, len(every))
    return counts, chosen[: settings.sample or None]


def covering(tests: Sequence[Test], module: str, mutant: Mutant) -> tuple[list[Test], list[Test]]:
    """Tests that are known to execute a line of the mutant, and others that execute its module."""
    lines = set(range(mutant.line, mutant.last_line + 1))
    users = [test for test in tests if module in test.lines]
    found = users if mutant.at_import else [test for test in users if lines & test.lines[module]]
    names = {test.test for test in found}
    return found, [test for test in users if test.test not in names]


def ranked(tests: Sequence[Test], kills: Counter[tuple[str, str]], module: str) -> list[Test]:
    """By the kills to expect of a CPU second: earlier ones of all modules count 1, of this module 4 more."""
    of_all: Counter[str] = Counter()
    for (_, name), count in kills.items():
        of_all[name] += count

    def rate(test: Test) -> float:
        return (1 + of_all[test.test] + 4 * kills[module, test.test]) / (0.05 + test.seconds)

    return sorted(tests, key=lambda test: (-rate(test), test.test))


def batches(tests: Sequence[Test], budget: float) -> Iterator[list[Test]]:
    """In this order: a few tests, then all that the budget allows."""
    first: list[Test] = []
    for test in tests:
        files = {each.file for each in (*first, test)}
        if sum(each.seconds for each in first) + test.seconds <= FIRST_S and len(files) <= FIRST_FILES:
            first.append(test)
    chosen, spent = [], sum(test.seconds for test in first)
    names = {test.test for test in first}
    for test in tests:
        if test.test not in names and spent + test.seconds <= budget:
            chosen.append(test)
            spent += test.seconds
    yield from filter(None, (first, chosen))


def kills_in(out: Path) -> Counter[tuple[str, str]]:
    """(module, test) -> how many of the module's mutants the test has killed so far, in any process."""
    return Counter((row["module"], row["by"]) for row in results(out) if row["status"] == "killed")


def tried(tree: Tree, source: bytes, outcome: Outcome, mutant: Mutant, chosen: Iterator[list[Test]], out: Path) -> None:
    """Run the mutant's tests until one fails; the tree is as before afterwards."""
    tree.plant(outcome.module, mutant.applied(source))
    try:
        for batch in chosen:
            outcome.tests += len(batch)
            names, files = [test.test for test in batch], list(dict.fromkeys(test.file for test in batch))
            limit = START_S + 10.0 * sum(test.seconds for test in batch)
            report = out / f"failure-{os.getpid()}.json"
            ended = in_fork(tree.folder, files, Chosen(names, report), limit, report)
            outcome.seconds += ended.seconds
            if ended.code:
                outcome.status = "timeout" if ended.code < 0 else "killed"
                outcome.by, outcome.what = ended.report.get("test", "start"), ended.report.get("what", "")
                return
    finally:
        tree.plant(outcome.module, source)


def run(settings: Settings) -> dict[str, Any]:
    """Run, or continue, a campaign; its result, which is also in campaign.json."""
    out = settings.out.resolve()
    settings.out = out
    out.mkdir(parents=True, exist_ok=True)
    (out / "mitsuba").mkdir(exist_ok=True)
    os.environ.update(MUTANTS_MEMORY=str(out / "mitsuba"), OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    load_libraries()
    shutil.rmtree(out / "trees", ignore_errors=True)
    first = copied_tree(settings.root, out / "trees" / "0")
    ways = {is_compiled(settings, group) for group in settings.groups}
    tests = {compiled: measured(settings, first, compiled) for compiled in ways}
    trees = [first, *(copied_tree(first.folder, out / "trees" / str(job)) for job in range(1, settings.jobs))]
    populations, jobs = {}, []
    known = equivalents()
    open_ones = {row["key"] for row in results(out) if row["status"] in SURVIVED and row["key"] not in known}
    done = {row["key"] for row in results(out)} - (open_ones if settings.again else set())
    for group in settings.groups:
        populations[group], chosen = sampled(settings, group)
        jobs += [(group, *each) for each in chosen if f"{each[0]} {each[2]}" not in done]
    random.Random(settings.seed).shuffle(jobs)  # so that an interrupted campaign has some of each group

    def work(item: tuple[str, str, Mutant, str], job: int) -> None:
        group, module, mutant, key = item
        source = (settings.root / module).read_bytes()
        outcome = Outcome(
            f"{module} {key}", group, module, mutant.line, mutant.where, mutant.operator, mutant.old, mutant.new
        )
        compiled = is_compiled(settings, group)
        os.environ["CASTER_JIT"] = str(int(compiled))
        executing, others = covering(tests[compiled], module, mutant)
        kills = kills_in(out)
        order = [*ranked(executing, kills, module), *ranked(others, kills, module)]
        tried(trees[job], source, outcome, mutant, batches(order, settings.budget), out)
        if outcome.status == "survived" and not executing:
            outcome.status = "not executed"
        with (out / "results.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(outcome)) + "\n")

    parallel(settings.jobs, jobs, work)
    for group in settings.sources:
        populations.setdefault(
            group, {m: len(mutants_of((settings.root / m).read_bytes())) for m in module_files(settings, group)}
        )
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=settings.root, capture_output=True, text=True)
    result = {"commit": commit.stdout.strip(), "populations": populations, "outcomes": results(out)}
    (out / "campaign.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    return result


SURVIVED = ("survived", "not executed")


def results(out: Path) -> list[dict[str, Any]]:
    """The last outcome of each mutant."""
    path = out / "results.jsonl"
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    return list({row["key"]: row for row in rows}.values())


EQUIVALENTS = Path(__file__).with_name("equivalents.toml")


def equivalents(path: Path = EQUIVALENTS) -> dict[str, str]:
    """Key of a mutant -> why no input can tell it from the original."""
    entries = tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return {key: entry["reason"] for entry in entries.get("equivalent", []) for key in entry["keys"]}


def stale(known: Iterable[str], root: Path = ROOT) -> list[str]:
    """Keys of listed equivalents that are mutants no more: their line has changed, or is gone."""
    made: dict[str, set[str]] = {}
    for module in {key.split()[0] for key in known}:
        source = (root / module).read_bytes() if (root / module).is_file() else b""
        made[module] = set(keys_of(source, mutants_of(source)))
    return [key for key in known if key.split()[1] not in made[key.split()[0]]]

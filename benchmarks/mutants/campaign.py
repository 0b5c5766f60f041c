"""A campaign: the sampled mutants of the chosen modules, each tried in a copy of the tree, shortest tests first."""

import hashlib
import json
import os
import queue
import random
import re
import shutil
import signal
import subprocess
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from edited_tree import Forks, write_bytecode
from mutants.measuring import PACKAGES, SLOWEST_TEST_S
from mutants.operators import Mutant, keys_of, mutants_of

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
        any_rays lanes mirrors wide_angle_cameras
    """,
    "tests/exact": """
        box_tree edge_cases oracle_kinds oracle_roots oracle_scenes
    """,
    "tests/reference": """
        adjudication detection_power error_models_hold excused_classes
    """,
    "tests/report": """
        pages records
    """,
    "tests/unit": """
        added_aov bias bounces bracket builtin_scenes camera_references candidate_aimed
        error_bounds_of_kernels error_models exact_kernels fuzz generated_meshes
        geometry_checked_in_both_precisions independent_transform judge_at_extremes knife_edges known_defects
        lambert_and_shadow_rays mesh_files mesh_normals plan primitive_properties quadric_normals ray_bounds
        ray_camera registries rejected_faces scene_docs scene_errors scene_files scene_lights
        scene_locate scene_model scene_numbers screen_bounds sliver_normals sphere_clouds stated_numbers tiles
        transform uv_range
    """,
}
# Of modules of the judge, for which the caster is compiled: what asks Mitsuba gets its stored answers.
WITH_COMPILER = {
    "tests/unit": """
        bias bounces bracket camera_references candidate_aimed candidate_scene check_list defect_measurement
        description_round_trip error_models exact_kernels exr_compare exr_files fuzz
        generated_meshes geometry_checked_in_both_precisions independent_transform judge_at_extremes
        knife_edges known_defects lambert_and_shadow_rays pixel_explanations ray_camera ray_conventions
        registries report_files result_schemas scene_options scene_rows
        stated_numbers stress surface_targets verdict_rules
    """,
    "tests/exact": """
        box_tree edge_cases oracle_kinds oracle_roots oracle_scenes spawned_origins
    """,
    "tests/reference": """
        adjudication bands candidate_probe candidates detection_power diagnosis error_models_hold
        excused_classes function_interface judge_classes mesh_loader mistakes mitsuba_files new_shape probe_witnesses
        ray_lists spawn_rules textures
    """,
    "tests/report": """
        pages records
    """,
}


def files_of(listed: dict[str, str]) -> tuple[str, ...]:
    return tuple(f"{folder}/test_{name}.py" for folder, names in listed.items() for name in names.split())


TESTS, COMPILED_TESTS = files_of(PLAIN), files_of(WITH_COMPILER)
FILE_LIMIT_S = 60.0  # CPU seconds for the measurement of one file of tests; what comes later in it is not used
FIRST_S = 1.5  # CPU seconds of the tests that are tried first
EACH_S = 0.05  # CPU seconds of a test beside its own
START_S = 20.0  # CPU seconds that a fork may take beside ten times its tests' own
FAILURE = re.compile(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", re.MULTILINE)  # of pytest's summary


class Test(NamedTuple):
    """A test that passes, as it was measured."""

    test: str
    seconds: float
    functions: set[str]  # that it calls: "module function"


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
    """A copy of the tree, without .git and caches, whose modules are edited one at a time; and tests run in it."""

    def __init__(self, source: Path, folder: Path, memory: Path) -> None:
        ignore = shutil.ignore_patterns(".*", "build", "__pycache__", "*.egg-info")
        self.folder = shutil.copytree(source, folder / "tree", ignore=ignore)
        write_bytecode(self.folder)
        self.forks = Forks(folder)
        self.environment = {"MUTANTS_MEMORY": str(memory), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def plant(self, module: str, source: bytes) -> None:
        path = self.folder / module
        Path(cache_from_source(str(path))).unlink(missing_ok=True)
        path.write_bytes(source)

    def run(self, *words: str, compiled: bool, limit: float, out: Path | str = "") -> tuple[int, str]:
        """(pytest's exit code, negative if it was killed; what it printed). limit: CPU seconds; out: measurements."""
        path = f"{self.folder}{os.pathsep}{ROOT / 'benchmarks'}"
        environment = self.environment | {"CASTER_JIT": str(int(compiled)), "MUTANTS_OUT": str(out)}
        options = "-q", "-rfE", "--no-header", "-p", "mutants.measuring", "-p", "no:xdist"
        try:
            ended = self.forks.run(
                path, *options, *words, module="pytest", environment=environment, folder=self.folder, limit=limit
            )
        except AssertionError:  # it waited for ever
            return -signal.SIGKILL, ""
        return ended.returncode, ended.stdout


def is_compiled(settings: Settings, group: str) -> bool:
    """Whether no mutant of a group edits the caster, whose kernels may then come from the cache."""
    return not any(pattern.startswith("caster/") for pattern in settings.sources[group])


class Trees:
    """As many copies of the tree as there are jobs, and work that each does in one of them."""

    def __init__(self, settings: Settings, folder: Path) -> None:
        self.jobs, self.free = settings.jobs, queue.SimpleQueue[Tree]()
        for job in range(settings.jobs):
            self.free.put(Tree(settings.root, folder / str(job), settings.out / "mitsuba"))

    def each(self, work: Callable[[Tree, Any], None], items: Iterable[Any]) -> None:
        """work(tree, item) for every item."""

        def do(item: Any) -> None:
            tree = self.free.get()
            try:
                work(tree, item)
            finally:
                self.free.put(tree)

        with ThreadPoolExecutor(self.jobs) as pool:
            list(pool.map(do, items))


def measured(settings: Settings, trees: Trees, compiled: bool) -> list[Test]:
    """Every test that passes in a copy, with its time and functions; measured once for each state of the sources."""
    root, patterns = settings.root, settings.compiled_tests if compiled else settings.tests
    state = b"".join(path.read_bytes() for top in (*PACKAGES, "tests") for path in sorted(root.glob(f"{top}/**/*.py")))
    folder = settings.out / f"measured-{int(compiled)}-{hashlib.sha256(state).hexdigest()[:12]}"
    folder.mkdir(exist_ok=True)
    files = sorted({str(path.relative_to(root)) for pattern in patterns for path in root.glob(pattern)})

    def measure(tree: Tree, file: str) -> None:
        out = folder / f"{Path(file).stem}.jsonl"
        if not out.exists():
            part = out.with_suffix(".part")
            part.write_text("")
            code, said = tree.run(file, compiled=compiled, limit=FILE_LIMIT_S, out=part)
            if code == pytest.ExitCode.INTERRUPTED:
                raise RuntimeError(
                    f"{file}: its tests cannot be collected, so none of them would find a mutant\n{said}"
                )
            part.rename(out)

    trees.each(measure, files)
    rows = [json.loads(line) for file in folder.glob("*.jsonl") for line in file.read_text("utf-8").splitlines()]
    if not rows:
        raise RuntimeError(f"{root}: no test passes without a mutant, so none can find one")
    return [Test(row["test"], row["seconds"], {*row["functions"]}) for row in rows]


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
    """Tests that call the function of the mutant, and others that call one of its module."""
    users = [test for test in tests if any(name.startswith(f"{module} ") for name in test.functions)]
    if mutant.at_import:
        return users, []
    found = [test for test in users if f"{module} {mutant.where}" in test.functions]
    return found, [test for test in users if test not in found]


def ranked(tests: Sequence[Test], kills: Counter[tuple[str, str]], module: str) -> list[Test]:
    """By the kills to expect of a CPU second: earlier ones of all modules count 1, of this module 4 more."""
    of_all: Counter[str] = Counter()
    for (_, name), count in kills.items():
        of_all[name] += count

    def rate(test: Test) -> float:
        return (1 + of_all[test.test] + 4 * kills[module, test.test]) / (EACH_S + test.seconds)

    return sorted(tests, key=lambda test: (-rate(test), test.test))


def batches(tests: Sequence[Test], budget: float) -> Iterator[list[Test]]:
    """In this order: a few tests, then all others that the budget allows."""
    spent, rest = 0.0, list(tests)
    for limit in (FIRST_S, budget):
        chosen = []
        for test in rest:
            if spent + EACH_S + test.seconds <= limit:
                chosen.append(test)
                spent += EACH_S + test.seconds
        rest = [test for test in rest if test not in chosen]
        if chosen:
            yield chosen


def tried(tree: Tree, outcome: Outcome, mutant: Mutant, chosen: Iterator[list[Test]], compiled: bool) -> None:
    """Run the mutant's tests until one fails; the tree is as before afterwards."""
    source = (tree.folder / outcome.module).read_bytes()
    tree.plant(outcome.module, mutant.applied(source))
    try:
        for batch in chosen:
            outcome.tests += len(batch)
            limit = START_S + 10.0 * sum(test.seconds for test in batch)
            code, said = tree.run("-x", *(test.test for test in batch), compiled=compiled, limit=limit)
            if code:
                failure = FAILURE.search(said)
                outcome.status, outcome.by = "timeout" if code < 0 else "killed", failure[1] if failure else "start"
                break
    finally:
        tree.plant(outcome.module, source)


def run(settings: Settings) -> dict[str, Any]:
    """Run, or continue, a campaign; its result, which is also in campaign.json."""
    out = settings.out = settings.out.resolve()
    (out / "mitsuba").mkdir(parents=True, exist_ok=True)
    shutil.rmtree(out / "trees", ignore_errors=True)
    trees = Trees(settings, out / "trees")
    tests = {way: measured(settings, trees, way) for way in {is_compiled(settings, group) for group in settings.groups}}
    known, before = equivalents(), results(out)
    open_ones = {row["key"] for row in before if row["status"] in SURVIVED and row["key"] not in known}
    done = {row["key"] for row in before} - (open_ones if settings.again else set())
    kills = Counter((row["module"], row["by"]) for row in before if row["status"] == "killed")
    populations, jobs, sound = {}, [], set[str]()
    for group in settings.sources:
        populations[group], chosen = sampled(settings, group)
        if group in settings.groups:
            jobs += [(group, *each) for each in chosen if f"{each[0]} {each[2]}" not in done]
    random.Random(settings.seed).shuffle(jobs)  # so that an interrupted campaign has some of each group

    def work(tree: Tree, item: tuple[str, str, Mutant, str]) -> None:
        group, module, mutant, key = item
        outcome = Outcome(
            f"{module} {key}", group, module, mutant.line, mutant.where, mutant.operator, mutant.old, mutant.new
        )
        compiled = is_compiled(settings, group)
        calling, others = covering(tests[compiled], module, mutant)
        order = [*ranked(calling, kills, module), *ranked(others, kills, module)]
        tried(tree, outcome, mutant, batches(order, settings.budget), compiled)
        if outcome.status == "killed" and outcome.by in {test.test for test in order} - sound:
            code, said = tree.run(outcome.by, compiled=compiled, limit=START_S + 10.0 * SLOWEST_TEST_S)
            if code:
                raise RuntimeError(f"{outcome.by} fails without a mutant as well\n{said}")
            sound.add(outcome.by)
        if outcome.status == "survived" and not calling:
            outcome.status = "not executed"
        kills[module, outcome.by] += outcome.status == "killed"
        with (out / "results.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(outcome)) + "\n")

    trees.each(work, jobs)
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

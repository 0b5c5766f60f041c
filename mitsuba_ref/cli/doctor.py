"""`mitsuba-ref doctor`: what this machine has for the judge, and what each missing part would add; and `schema`.

Mitsuba is imported in a child process: a bad libLLVM aborts the process that loads it.
"""

import argparse
import importlib.metadata
import json
import shutil
import sys
from collections.abc import Sequence
from ctypes.util import find_library
from pkgutil import resolve_name
from typing import Any

from caster.cli import installation as caster_doctor
from caster.cli.installation import Finding, Package, exit_code, find_package, format_json, print_findings, usable
from caster.system.process import OK
from mitsuba_ref.reference import subprocess_runner

__all__ = ["Finding", "exit_code", "format_json", "report", "usable"]


# The versions whose arithmetic the bounds were derived for; Dr.Jit has to be the one Mitsuba was built with.
PINNED = {"mitsuba": "3.9.1", "drjit": "1.5.0"}
INSTALL_COMMAND = "pip install " + " ".join(f"{name}=={version}" for name, version in PINNED.items())
MATPLOTLIB = Package("matplotlib", "matplotlib", "3.9", "the plots of `make stress` and `make bench`", needed=False)
PEER_PURPOSE = "another ray caster for `bench --peers`"
PEERS = (
    Package("open3d", "open3d", "0.19", PEER_PURPOSE, needed=False),
    Package("embreex", "embreex", "4.4", PEER_PURPOSE, needed=False),
    Package("trimesh", "trimesh", "4.6", PEER_PURPOSE, needed=False),
)
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
BROWSERS = (*CHROMIUM, "firefox")
PROBE_TIMEOUT_SECONDS = 60  # an import takes well under a second; a Mitsuba that hangs is a finding, too
# describe_installation() -> {"variants": [the variants that work here], "libllvm": the path in use, or None, "why": ""}
PROBE_SCRIPT = """
import json
from mitsuba_ref.reference.mitsuba_calls import describe_installation
print(json.dumps(describe_installation()))
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="as JSON")


def run(args: argparse.Namespace) -> int:
    """Print the findings; 4 when something needed is missing."""
    return print_findings(report(), args.json)


def report() -> list[Finding]:
    """Find everything that the ray caster and the judge use."""
    return [*caster_doctor.report(), *judge_findings()]


def judge_findings(probe: Sequence[str] = (sys.executable, "-c", PROBE_SCRIPT)) -> list[Finding]:
    """Find what the judge uses on top of the ray caster. probe: a command that prints what PROBE_SCRIPT prints."""
    versions = [_pinned(name) for name in PINNED]
    missing = [finding.name for finding in versions if not finding.found]
    answer, problem = ({}, f"needs {' and '.join(missing)} first") if missing else _run_probe(probe)
    return [
        *versions,
        _variants(answer, problem),
        _llvm(answer),
        _gpu(),
        answer_store(),
        *map(find_package, (MATPLOTLIB, *PEERS)),
        browser(),
    ]


def browser() -> Finding:
    """The first browser on the path."""
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    detail = path or "none of " + ", ".join(BROWSERS)
    adds = "reports of `validate --html`, and their tests (Chromium)"
    return Finding("browser", path is not None, False, detail, adds)


def answer_store() -> Finding:
    """Where answers of Mitsuba are kept, how many and how large."""
    from mitsuba_ref.reference.answer_store import OFF, STORE_VARIABLE, local_store

    store, adds = local_store(), "`validate` without asking Mitsuba again about what has not changed"
    if store is None:
        return Finding("store", False, False, f"{STORE_VARIABLE} is {OFF}", adds)
    if why := store.refusal():
        return Finding("store", False, False, f"{store.folder}: not used: {why}", adds)
    answers, size = store.use()
    detail = f"{store.folder}: {answers} answers of Mitsuba, {size / 1e6:.0f} of {store.limit / 1e6:.0f} MB"
    return Finding("store", True, False, detail, adds)


def _pinned(name: str) -> Finding:
    uses = {"mitsuba": "the reference", "drjit": "the compiler Mitsuba is built on"}
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, False, True, "not installed", uses[name], INSTALL_COMMAND)
    if version == PINNED[name]:
        return Finding(name, True, True, version, uses[name])
    detail = f"{version}; the bounds belong to {PINNED[name]}"
    return Finding(name, name == "mitsuba", True, detail, uses[name], INSTALL_COMMAND)


def _run_probe(probe: Sequence[str]) -> tuple[dict[str, Any], str]:
    """(description of Mitsuba, why there is none)"""
    end = subprocess_runner.run(probe, PROBE_TIMEOUT_SECONDS)
    if end.code is None:
        return {}, f"no answer within {PROBE_TIMEOUT_SECONDS} s"
    return _parse_description(end.output) if end.code == 0 else ({}, _exit_description(end.code, end.output))


def _parse_description(output: str) -> tuple[dict[str, Any], str]:
    """Of the last line that is one; Mitsuba may have printed warnings beside it."""
    lines = output.splitlines() or [""]
    last = next((line for line in reversed(lines) if line.startswith("{")), lines[-1])
    try:
        return dict(json.loads(last)), ""
    except (ValueError, TypeError):
        return {}, f"the answer was not a description: {last!r}"


def _exit_description(code: int, output: str) -> str:
    return ": ".join(
        [f"importing Mitsuba ended with {subprocess_runner.exit_name(code)}", *output.strip().splitlines()[-1:]]
    )


def _variants(answer: dict[str, Any], problem: str) -> Finding:
    names = answer.get("variants", [])
    works = any(name.startswith("scalar") for name in names)  # spheres, disks and cylinders need that one
    detail = ", ".join(names) or problem or "Mitsuba loads, but no variant of it works"
    if not works and answer.get("why"):
        detail += f"; {answer['why']}"
    return Finding("variants", works, True, detail, "Mitsuba's own ray intersections")


def _llvm(answer: dict[str, Any]) -> Finding:
    path = answer.get("libllvm")
    why = answer.get("why")
    detail = path or "none that Mitsuba's LLVM variant works with" + (f": {why}" if why else "")
    adds = "speed: rays in batches, through Mitsuba's LLVM variant"
    return Finding("libLLVM", bool(path), False, detail, adds, "" if path else "apt install libllvm19")


def _gpu() -> Finding:
    """Reported, though unused: the reference runs on the CPU, whether there is a GPU or not."""
    library = find_library("cuda")
    adds = "nothing yet: the reference uses the CPU"
    return Finding("GPU", library is not None, False, library or "no CUDA driver", adds)


# ---- mitsuba-ref schema ----

# Result -> module and class of its model, for pkgutil.
RESULTS = {
    "verdict": "mitsuba_ref.judge.verdict:Verdict",  # validate --json, merge --json, verdict.json
    "scene-verdict": "mitsuba_ref.judge.verdict:SceneVerdict",  # a line of judged.jsonl
    "compare": "mitsuba_ref.exr_compare.comparison_result:FileComparison",
    "check": "mitsuba_ref.exr_compare.approved:ReferenceChecks",
    "bench": "mitsuba_ref.bench.result:Run",
    "stress": "mitsuba_ref.stress.sweeps:StressRun",
}


def add_schema_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("result", choices=RESULTS, help="whose --json the schema describes")


def run_schema(args: argparse.Namespace) -> int:
    """Print the JSON Schema of a result."""
    print(json.dumps(result_schema(args.result), indent=2))
    return OK


def result_schema(name: str) -> dict[str, Any]:
    """The JSON Schema of a result of RESULTS, as it is written."""
    from pydantic import TypeAdapter

    return TypeAdapter(resolve_name(RESULTS[name])).json_schema(mode="serialization")

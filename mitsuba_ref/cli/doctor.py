"""`mitsuba-ref doctor`: the parts of the judge found on this machine, and the effect of missing ones; and `schema`."""

import json
import sys
from argparse import Namespace
from pkgutil import resolve_name
from typing import Any

from caster.cli import installation as caster_doctor
from caster.cli.installation import Finding, print_findings
from caster.cli.shared_arguments import Adder
from caster.description.errors import SceneError
from caster.system.process import OK
from mitsuba_ref.reference.interpreter import interpreter
from mitsuba_ref.reference.store import OFF, STORE_VARIABLE, local_store, machine
from mitsuba_ref.reference.variants import (
    INSTALL_COMMAND,
    PINNED,
    VARIANT_NAMES,
    rgb_variants,
    usable_variants,
    why_not,
)


def add_arguments(add: Adder) -> None:
    add("--json", bool, "as JSON")


def run(args: Namespace) -> int:
    """Print the findings; 4 when something needed is missing."""
    return print_findings([*caster_doctor.report(), *judge_findings()], args.json)


def judge_findings() -> list[Finding]:
    """Find the parts that the judge uses in addition to the caster's."""
    try:
        versions = [_pinned(name) for name in PINNED]
    except SceneError as error:
        versions = [Finding("mitsuba", False, True, str(error), USES["mitsuba"])]
    if not all(finding.found for finding in versions):  # which the variants need
        return [*versions, kept_results()]
    found = [*versions, *_variants()]
    further = [name for name in rgb_variants() if name not in VARIANT_NAMES]
    for name in further:  # that only --variant takes, each tried in a child process
        why, adds = why_not(name), f"the reference in this variant: --variant {name}"
        found.append(Finding(name, not why, False, why or "works", adds))
    return [*found, kept_results()]


def _variants() -> list[Finding]:
    """The variants that work, each tried in a child process, and the libLLVM in use."""
    adds, llvm_adds = "Mitsuba's own ray intersections", "speed: rays in batches, through Mitsuba's LLVM variant"
    found = usable_variants()
    reasons = found.details or found.why
    detail = ", ".join(found.names) or "no variant of Mitsuba works"
    why = f"; {reasons}" if reasons and not found.scalar else ""
    without = "none that Mitsuba's LLVM variant works with" + (f": {reasons}" if reasons else "")
    way_out = "" if found.libllvm else "apt install libllvm19"
    return [
        Finding("variants", found.scalar, True, detail + why, adds),  # spheres need the scalar one
        Finding("libLLVM", bool(found.libllvm), False, found.libllvm or without, llvm_adds, way_out),
    ]


def kept_results() -> Finding:
    """Where results are kept between runs, how many and how large."""
    store, adds = local_store(), "`validate` without judging again what has not changed"
    if store is None:
        return Finding("store", False, False, f"{STORE_VARIABLE} is {OFF}", adds)
    if why := store.refusal():
        return Finding("store", False, False, f"{store.folder}: not used: {why}", adds)
    files, size = store.use()
    detail = f"{store.folder}: {files} results, {size / 1e6:.0f} of {store.limit / 1e6:.0f} MB"
    return Finding("store", True, False, detail, adds)


USES = {"mitsuba": "the reference", "drjit": "the compiler Mitsuba is built on"}


def _pinned(name: str) -> Finding:
    version, python = machine()[name], interpreter()
    if version == "none":
        return Finding(name, False, True, "not installed", USES[name], INSTALL_COMMAND)
    if python != sys.executable:
        return Finding(name, True, True, f"{version}, of {python}", USES[name])
    if version == PINNED[name]:
        return Finding(name, True, True, version, USES[name])
    detail = f"{version}; the bounds belong to {PINNED[name]}"
    return Finding(name, name == "mitsuba", True, detail, USES[name], INSTALL_COMMAND)


# ---- mitsuba-ref schema ----

# Result -> module and class of its model, for pkgutil.
RESULTS = {
    "verdict": "mitsuba_ref.judge.verdict:Verdict",  # validate --json, merge --json, verdict.json
    "compare": "mitsuba_ref.exr_compare.comparison_result:FileComparison",
    "bench": "mitsuba_ref.bench.result:Run",
    "versions": "mitsuba_ref.runner.version_comparison:VersionComparison",
    "stress": "mitsuba_ref.stress.sweeps:StressRun",
    "campaign": "mitsuba_ref.campaign.report:CampaignReport",
    "fuzz": "mitsuba_ref.fuzz.findings:Outcome",
}


def add_schema_arguments(add: Adder) -> None:
    add("result", str, f"whose --json the schema describes: {', '.join(RESULTS)}", choices=RESULTS, metavar="RESULT")


def run_schema(args: Namespace) -> int:
    """Print the JSON Schema of a result."""
    print(json.dumps(result_schema(args.result), indent=2))
    return OK


def result_schema(name: str) -> dict[str, Any]:
    """The JSON Schema of a result of RESULTS, as it is written."""
    from pydantic import TypeAdapter

    return TypeAdapter(resolve_name(RESULTS[name])).json_schema(mode="serialization")

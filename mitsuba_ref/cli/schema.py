"""`mitsuba-ref schema`: JSON Schemas of the results."""

import argparse
import json
from importlib import import_module
from typing import Any

from caster.cli.exit_codes import OK

# Result -> module and class of its model.
RESULTS = {
    "verdict": ("mitsuba_ref.judge.verdict", "Verdict"),  # validate --json, merge --json, verdict.json
    "scene-verdict": ("mitsuba_ref.judge.verdict", "SceneVerdict"),  # a line of judged.jsonl
    "compare": ("mitsuba_ref.exr_compare.comparison_result", "FileComparison"),
    "check": ("mitsuba_ref.exr_compare.approval", "ReferenceChecks"),
    "bench": ("mitsuba_ref.bench.result", "Run"),
    "stress": ("mitsuba_ref.stress.sweeps", "StressRun"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("result", choices=RESULTS, help="whose --json the schema describes")


def run(args: argparse.Namespace) -> int:
    """Print the JSON Schema of a result."""
    print(json.dumps(result_schema(args.result), indent=2))
    return OK


def result_schema(name: str) -> dict[str, Any]:
    """The JSON Schema of a result of RESULTS, as it is written."""
    from pydantic import TypeAdapter

    module, model = RESULTS[name]
    return TypeAdapter(getattr(import_module(module), model)).json_schema(mode="serialization")

"""What Mitsuba does in each case: measured, kept as data, and held to what is the same on every CPU."""

import json
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cases.case import FLOAT32, Case, Maker, Question
from cases.probes import probed
from mitsuba_ref.error_model.tolerances import KU
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.mitsuba_process import send_requests
from mitsuba_ref.reference.shared_input import SharedRays, export, model_of
from mitsuba_ref.reference.variants import usable_variants

DATA = Path(__file__).parent.parent / "mitsuba_behaviour.json"
MODES = {"robust": True, "default": False}
RAYS = 24  # of each question
U = 2.0**-24

# What is counted: rays; misses of what is there; hits of what is not; t that are no number; and the worst
# |t - exact| / |t| in units of 2^-24, over what both hit.
Counts = dict[str, Any]


def questions(case: Case) -> list[Question]:
    """Those that Mitsuba can be asked: float32 numbers, no t_min; few rays, spread over all."""
    found = []
    make = Maker(case.number, FLOAT32)
    make.more = 1.0  # the same rays in every run, however many ours is asked
    for question in case.questions(make):
        if question.t_min == 0.0 and question.scene.shapes:
            rows = np.unique(np.linspace(0, len(question.o) - 1, RAYS).astype(int))
            found.append(question._replace(o=question.o[rows], d=question.d[rows]))
    return found


class Asked:
    """Questions of one case, exported in both of Embree's modes, with the exact answers."""

    def __init__(self, case: Case, folder: Path) -> None:
        self.case, self.folder = case, folder
        self.exact: list[list[Any]] = []
        self.jobs: dict[str, list[TraceRequest]] = {mode: [] for mode in MODES}
        for i, question in enumerate(questions(case)):
            self._add(question, folder / f"{case.number}-{i}")

    def _add(self, question: Question, folder: Path) -> None:
        packed = question.scene.derived["packed"]
        t_max = np.full(len(question.o), question.t_max, np.float32)
        o, d = question.o.astype(np.float32), question.d.astype(np.float32)
        with np.errstate(all="ignore"):
            model = model_of(question.scene, packed, SharedRays(o, d, t_max, np.zeros(len(o))))
            for mode, robust in MODES.items():
                xml = export(question.scene, model, robust=robust).write(folder / mode)
                self.jobs[mode].append(TraceRequest(xml, "", o, d, t_max, lights=False, strict=False))
        self.exact.append(Oracle(packed, model.kinds).first_hits(question.o, question.d, 0.0, question.t_max))


def measured(cases: Sequence[Case], with_probes: bool = True) -> dict[str, dict[str, Counts]]:
    """{number: {"scalar robust": counts, ...}} of the variants that work here."""
    found: dict[str, dict[str, Counts]] = {str(case.number): {} for case in cases}
    with tempfile.TemporaryDirectory(prefix="edge-cases-") as folder:
        asked = [Asked(case, Path(folder)) for case in cases]
        for variant in usable_variants().names:
            short = variant.partition("_")[0]
            for mode in MODES:
                jobs = [job_of(job, variant) for one in asked for job in one.jobs[mode]]
                answers = iter(send_requests(jobs) if jobs else [])
                for one in asked:
                    pairs = [(exact, next(answers)) for exact in one.exact]
                    if pairs:
                        found[str(one.case.number)][f"{short} {mode}"] = counted(pairs)
            if with_probes:
                probes = probed([case.number for case in cases], variant, Path(folder) / variant)
                for number, told in probes.items():
                    found[number][f"{short} probes"] = told
    return {number: counts for number, counts in found.items() if counts}


def job_of(job: TraceRequest, variant: str) -> TraceRequest:
    return TraceRequest(job.xml, variant, job.o, job.d, job.t_max, lights=False, strict=False)


def counted(pairs: Sequence[tuple[list[Any], TraceResponse | Crash]]) -> Counts:
    counts: Counts = {"rays": 0, "missed": 0, "invented": 0, "no number": 0, "worst t": 0.0}
    refused = 0
    for exact, answer in pairs:
        counts["rays"] += len(exact)
        if isinstance(answer, Crash):
            refused += len(exact)
            continue
        for i, truth in enumerate(exact):
            count(counts, truth, float(answer.t[i]))
    counts["worst t"] = rounded(counts["worst t"])
    return counts | ({"refused": refused} if refused else {})


def count(counts: Counts, truth: Any, t: float) -> None:
    if math.isnan(t):
        counts["no number"] += 1
    elif truth.hit and t == math.inf:
        counts["missed"] += 1
    elif not truth.hit and t != math.inf:
        counts["invented"] += 1
    elif truth.hit:
        size = abs(float(truth.t))
        counts["worst t"] = max(counts["worst t"], truth.t.off(t) / size / U if size else 0.0)


def rounded(x: float) -> float:
    """Two digits: what is after them is the machine's."""
    return float(f"{x:.2g}")


def kept() -> Mapping[str, Any]:
    return json.loads(DATA.read_text(encoding="utf-8"))


def write(cases: Mapping[str, dict[str, Counts]]) -> None:
    lines = [
        f'    "{number}": {{\n'
        + ",\n".join(f'      "{name}": {json.dumps(counts)}' for name, counts in case.items())
        + "\n    }"
        for number, case in cases.items()
    ]
    head = f'{{\n  "mitsuba": "3.9.1",\n  "rays of each question": {RAYS},\n  "cases": {{\n'
    DATA.write_text(head + ",\n".join(lines) + "\n  }\n}\n", encoding="utf-8")


def on_any_cpu(name: str, counts: Counts) -> dict[str, Any]:
    """Of one variant's counts in one mode, what does not depend on the CPU in the cases that a test asks about.

    How many rays are missed or invented depends on whether operations are fused; a reciprocal, which is each CPU's own,
    comes behind these decisions and is part of t alone. In those cases it is the same with fused operations and without
    whether any ray is missed or invented, and whether rounding explains the errors of t; but not in the mode that lets
    rays slip through edges. Where few rays are missed, as in cases 6 and 50, even that differs.
    """
    fixed = {key: count for key, count in counts.items() if key in ("rays", "refused", "no number")}
    fixed["invented"] = counts["invented"] > 0
    if name.endswith("robust"):
        fixed |= {"missed": counts["missed"] > 0, "t within rounding": counts["worst t"] <= KU / U}
    return fixed


def differences(now: Mapping[str, Mapping[str, Counts]], before: Mapping[str, Mapping[str, Counts]]) -> Iterator[str]:
    """What is measured now and was measured otherwise, beyond what differs between CPUs."""
    for number, variants in now.items():
        for name, counts in variants.items():
            old = before.get(number, {}).get(name)
            if old is None or on_any_cpu(name, old) != on_any_cpu(name, counts):
                yield f"case {number}, {name}: now {counts}, kept {old}"

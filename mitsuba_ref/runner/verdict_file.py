"""verdict.json, read back: for reports of several runs together, and for what is kept of an earlier one."""

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

from caster.scene.errors import FileMissing
from mitsuba_ref.judge.scene_checks.bias import ErrorStatistics, KindBias
from mitsuba_ref.judge.scene_checks.scene_check import SceneCheck
from mitsuba_ref.judge.verdict import (
    CANDIDATE_WRONG,
    OURS_WRONG,
    VERDICT_FORMAT,
    Failure,
    Finding,
    SceneStatistics,
    SceneVerdict,
    Verdict,
)

MALFORMED = (AttributeError, KeyError, TypeError, ValueError)  # what a record of another shape raises
PLAIN_FIELDS = {field.name for field in fields(SceneVerdict)} - {
    "checks",
    "failures",
    "files",
    "findings",
    "made_of",
    "notes",
    "options",
    "ratios",
    "reproducers",
    "seen",
    "size",
    "statistics",
    "unjudged",
    "worst_by",
}
OF_CANDIDATES = {"candidate", "precision"}  # left out where ours was judged


class UnreadableVerdict(FileMissing):
    """A file that is there, but is no verdict of this version."""


def read_verdict(path: str | os.PathLike[str]) -> Verdict:
    """What `validate --json` wrote. Raises FileMissing, or UnreadableVerdict with what is wrong with it."""
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileMissing(
            f"{path}: expected what `mitsuba-ref validate --json` writes, found no file"
        ) from None
    except OSError as error:
        raise UnreadableVerdict(f"{path}: cannot read: {error.strerror or error}") from error
    except ValueError as error:
        raise UnreadableVerdict(f"{path}: expected JSON, got something else: {error}") from error
    if not isinstance(record, dict) or record.get("format") != VERDICT_FORMAT:
        found = record.get("format") if isinstance(record, dict) else type(record).__name__
        raise UnreadableVerdict(
            f"{path}: expected a verdict of format {VERDICT_FORMAT}, got {found!r}: judge these scenes again"
        )
    try:
        return verdict_of(record)
    except MALFORMED as error:
        raise UnreadableVerdict(f"{path}: not a whole verdict: {type(error).__name__}: {error}") from error


def verdict_of(record: dict[str, Any]) -> Verdict:
    """`Verdict.to_dict`, undone."""
    scenes = tuple(scene_of(each) for each in record["scenes"])
    names = (*(scene.name for scene in scenes), *record["not_judged"])
    about = record["shard"], tuple(record["selected"]), record["code"], dict(record.get("judged_with", {}))
    nobody_says = not any(scene.candidate for scene in scenes)
    on_trial = record.get("candidate", "") if nobody_says else ""
    found = Verdict(scenes, record["asked"], names, *about, on_trial=on_trial)
    if found.ok != record["ok"]:
        raise ValueError(f"it says ok: {record['ok']}, its scenes say {found.ok}")
    return found


def scene_of(record: dict[str, Any]) -> SceneVerdict:
    """`SceneVerdict.to_dict`, undone."""
    if record.get("candidate"):
        record = as_of_ours(record)
    plain: dict[str, Any] = {
        name: record[name] for name in PLAIN_FIELDS if name in record or name not in OF_CANDIDATES
    }
    found = SceneVerdict(
        **plain,
        checks=tuple(
            SceneCheck(each["name"], float(each["ratio"]), each["what"]) for each in record["checks"]
        ),
        failures=tuple(failure_of(each) for each in record["failures"]),
        files={file: file_told(each) for file, each in record.get("files", {}).items()},
        made_of=SceneStatistics(**record.get("made_of", {})),
        ratios={name: float(ratio) for name, ratio in record["ratios"].items()},
        reproducers=tuple(record["reproducers"]),
        size=tuple(record["size"]),
        statistics=statistics_of(record["statistics"]),
        worst_by={name: failure_of(each) for name, each in record["worst_by"].items()},
        unjudged=tuple(record.get("unjudged", ())),
        findings=tuple(Finding(**each) for each in record.get("findings", ())),
        notes=tuple(record.get("notes", ())),
        options=tuple(record.get("options", ())),
    )
    if found.ok != record["ok"]:
        raise ValueError(f"{found.name} says ok: {record['ok']}, its numbers say {found.ok}")
    return found


def as_of_ours(record: dict[str, Any]) -> dict[str, Any]:
    """The record of a candidate with the names that there are inside, whoever is judged."""
    ours = {CANDIDATE_WRONG: OURS_WRONG}
    failures = []
    for each in record["failures"]:
        said = {("ours" if name == "candidate" else name): value for name, value in each.items()}
        failures.append(said | {"verdict": ours.get(said["verdict"], said["verdict"])})
    counts = {ours.get(name, name): count for name, count in record["counts"].items()}
    return record | {"failures": failures, "counts": counts}


def file_told(record: dict[str, Any]) -> dict[str, Any]:
    """What a file was when it was written."""
    return {"bytes": int(record["bytes"]), "sha256": str(record["sha256"])}


def failure_of(record: dict[str, Any]) -> Failure:
    said = {name: value for name, value in record.items() if name != "replay"}  # it follows from the scene
    return Failure(**(said | {"ratio": float(record["ratio"])}))


def statistics_of(record: dict[str, Any] | None) -> ErrorStatistics | None:
    if record is None:
        return None
    t, normal = record["k_t"], record["k_normal"]
    biases = tuple(KindBias(each["kind"], each["groups"], each["z"]) for each in record["biases"])
    sizes = t["largest"], t["p99"], normal["largest"], normal["p99"], float(record["looseness"])
    return ErrorStatistics(record["pixels"], *sizes, biases)

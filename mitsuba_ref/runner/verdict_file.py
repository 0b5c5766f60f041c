"""Reading of verdict.json, to merge several runs and to reuse results of an earlier one."""

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from caster.description.errors import FileMissing
from mitsuba_ref.judge.verdict import VERDICT_FORMAT, SceneVerdict, Verdict

MALFORMED = (AttributeError, KeyError, TypeError, ValueError)  # exceptions of a record of another shape
NOT_RECORDED = {"seen"}  # fields of a scene that no file has


class UnreadableVerdict(FileMissing):
    """A file that exists, but is no verdict of this version."""


def read_verdict(path: str | os.PathLike[str]) -> Verdict:
    """The verdict that `validate --json` wrote. Raises FileMissing, or UnreadableVerdict with the reason."""
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
    """The verdict of a run from its JSON values. Raises one of MALFORMED."""
    found = TypeAdapter(Verdict).validate_python(record)
    if found.ok != record["ok"]:
        raise ValueError(f"it says ok: {record['ok']}, its scenes say {found.ok}")
    for each, scene in zip(record["scenes"], found.scenes, strict=True):
        check_ok(each, scene)
    return found


def scene_of(record: dict[str, Any]) -> SceneVerdict:
    """The verdict of one scene from its JSON values. Raises one of MALFORMED."""
    found = TypeAdapter(SceneVerdict).validate_python(record)
    check_ok(record, found)
    return found


def check_ok(record: dict[str, Any], scene: SceneVerdict) -> None:
    """Raise ValueError where a record lacks a field, or its own `ok` contradicts its numbers."""
    missing = {each.name for each in fields(SceneVerdict)} - NOT_RECORDED - record.keys()
    if missing:
        raise ValueError(f"{scene.name} lacks {', '.join(sorted(missing))}")
    if scene.ok != record["ok"]:
        raise ValueError(f"{scene.name} says ok: {record['ok']}, its numbers say {scene.ok}")

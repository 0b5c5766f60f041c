"""A run in several shards: the scenes of each, and their verdicts merged into one."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from caster.description.errors import SceneError
from caster.system.process import NOT_COMPARABLE
from mitsuba_ref.judge.verdict import SceneVerdict, Verdict
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.store import BUILD, PROCESSOR, key_of, machine
from mitsuba_ref.report.output import libllvm
from mitsuba_ref.runner.many_scenes import SceneEntry, with_inputs_hash
from mitsuba_ref.runner.verdict_files import code_hash


def run_identity(entries: Sequence[SceneEntry], shard: tuple[int, int] | None) -> dict[str, Any]:
    """Fields of a Verdict: what judged, and what was judged. entries: of all shards. Raises VariantError."""
    flat, quadrics = (variants.variant_for(has_quadrics=each) for each in (False, True))
    judged_with = {name: version for name, version in machine().items() if name not in ("system", "python", BUILD)}
    judged_with |= {"variant of triangles": flat, "variant of quadrics": quadrics}
    judged_with["libLLVM"] = libllvm() if variants.LLVM in (flat, quadrics) else "none"
    if shard is None:
        return {"code": code_hash(), "judged_with": judged_with}
    # Scenes are part of the hash, so that shards of other scenes with the same names are not merged.
    code = key_of([code_hash(), *(part for entry in entries for part in (entry.name, with_inputs_hash(entry).inputs))])
    names = tuple(entry.name for entry in entries)
    return {"code": code, "judged_with": judged_with, "shard": "{}/{}".format(*shard), "selected": names}


class DifferentRuns(SceneError):  # noqa: N818 - names a state
    """Verdicts that are not parts of one run."""

    exit_code = NOT_COMPARABLE


def merge_verdicts(parts: Sequence[tuple[str, Verdict]]) -> tuple[Verdict, str]:
    """(one verdict of all, how many shards are missing, "" if none is); parts: (file, verdict).

    A run that was not divided is shard 1/1. A scene of a missing shard counts as not judged. Raises DifferentRuns for
    parts of different runs.
    """
    first_place, first = parts[0]
    files: dict[int, str] = {}  # of each shard
    scenes: dict[str, SceneVerdict] = {}
    for place, part in parts:
        run, expected = _run_of(part), _run_of(first)
        for what in [name for name in run if run[name] != expected.get(name)]:
            raise DifferentRuns(
                f"{place}: expected a part of the same run as {first_place}: its {what} is {run[what]}, there it is "
                f"{expected.get(what)}"
            )
        number = _shard_of(part)[0]
        if number in files:
            raise DifferentRuns(f"{place}: shard {part.shard} once more; it is in {files[number]}")
        files[number] = place
        scenes |= {scene.name: scene for scene in part.scenes}
    names = first.selected or first.names
    processors = dict.fromkeys(part.judged_with.get(PROCESSOR, "?") for _, part in parts)
    whole = replace(
        first,
        shard="",
        selected=(),
        scene_count=len(names),
        names=names,
        judged_with={**first.judged_with, PROCESSOR: " and ".join(processors)},
        fixed=tuple(name for _, part in parts for name in part.fixed),
        checks=next((part.checks for _, part in parts if not all(each.ok for each in part.checks)), first.checks),
        scenes=tuple(scenes[name] for name in names if name in scenes),
    )
    count = _shard_of(first)[1]
    missing = next((number for number in range(1, count + 1) if number not in files), None)
    return whole, f"{count - len(files)} of {count} shards are missing: {missing}/{count} first" if missing else ""


def _shard_of(part: Verdict) -> tuple[int, int]:
    number, count = (part.shard or "1/1").split("/")
    return int(number), int(count)


def _run_of(part: Verdict) -> dict[str, object]:
    """What all parts of a run have in common."""
    return {
        "number of shards": _shard_of(part)[1],
        "selection": ", ".join(part.selected or part.names),
        "subject": part.candidate or "our caster",
        **{name: value for name, value in part.judged_with.items() if name != PROCESSOR},
        "hash of code and scenes": part.code,
    }

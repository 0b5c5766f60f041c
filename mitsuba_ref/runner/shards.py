"""A run in several shards: the scenes of each, and their verdicts merged into one."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from caster.description.errors import SceneError
from caster.system.process import NOT_COMPARABLE
from mitsuba_ref.judge.verdict import SceneVerdict, Verdict
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.store import BUILD, PROCESSOR, key_of, machine
from mitsuba_ref.report.results import libllvm
from mitsuba_ref.runner.many_scenes import SceneEntry, with_inputs_hash
from mitsuba_ref.runner.verdict_files import UnreadableVerdict, code_hash


def judged_with() -> dict[str, str]:
    """Versions, variants, architecture and processor of this run. Raises VariantError."""
    flat, quadrics = (variants.variant_for(has_quadrics=each) for each in (False, True))
    versions = {name: version for name, version in machine().items() if name not in ("system", "python", BUILD)}
    used = libllvm() if variants.LLVM in (flat, quadrics) else "none"
    return {**versions, "variant of triangles": flat, "variant of quadrics": quadrics, "libLLVM": used}


class Shard(NamedTuple):
    """Number `part` of `parts`, from 1."""

    part: int
    parts: int

    def __str__(self) -> str:
        return f"{self.part}/{self.parts}"


def parse_shard(text: str) -> Shard:
    """The shard "2/4". Raises argparse.ArgumentTypeError."""
    index, slash, count = text.partition("/")
    if slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count):
        return Shard(int(index), int(count))
    raise argparse.ArgumentTypeError(f"expected I/N with 1 <= I <= N, such as 2/4, got '{text}'")


def run_identity(entries: Sequence[SceneEntry], shard: Shard | None) -> dict[str, Any]:
    """Fields of a Verdict that identify what judged and what was judged. entries: of all shards."""
    if shard is None:
        return {"code": code_hash(), "judged_with": judged_with()}
    # Scenes are part of the hash, so that shards of other scenes with the same names are not merged.
    code = key_of([code_hash(), *(part for entry in entries for part in (entry.name, with_inputs_hash(entry).inputs))])
    names = tuple(entry.name for entry in entries)
    return {"code": code, "judged_with": judged_with(), "shard": str(shard), "selected": names}


class DifferentRuns(SceneError):  # noqa: N818 - names a state
    """Verdicts that are not parts of one run."""

    exit_code = NOT_COMPARABLE


def merge_verdicts(parts: Sequence[tuple[str, Verdict]]) -> tuple[Verdict, str]:
    """(one verdict of all, how many shards are missing, "" if none is); parts: (file, verdict).

    A run that was not divided is shard 1/1. A scene of a missing shard counts as not judged. Raises DifferentRuns for
    parts of different runs, UnreadableVerdict.
    """
    first_place, first = parts[0]
    files: dict[Shard, str] = {}
    scenes: dict[str, SceneVerdict] = {}
    for place, part in parts:
        try:
            shard = parse_shard(part.shard or "1/1")
        except argparse.ArgumentTypeError as error:
            raise UnreadableVerdict(f"{place}: shard: {error}") from error
        if shard in files:
            raise DifferentRuns(f"{place}: shard {shard} once more; it is in {files[shard]}")
        files[shard] = place
        run, expected = _run_of(part, shard), _run_of(first, next(iter(files)))
        for what in [name for name in run if run[name] != expected.get(name)]:
            raise DifferentRuns(
                f"{place}: expected a part of the same run as {first_place}: its {what} is {run[what]}, there it is "
                f"{expected.get(what)}"
            )
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
    count = next(iter(files)).parts
    missing = next((each for each in (Shard(part, count) for part in range(1, count + 1)) if each not in files), None)
    return whole, f"{count - len(files)} of {count} shards are missing: {missing} first" if missing else ""


def _run_of(part: Verdict, shard: Shard) -> dict[str, object]:
    """What all parts of a run have in common."""
    return {
        "number of shards": shard.parts,
        "selection": ", ".join(part.selected or part.names),
        "subject": part.candidate or "our caster",
        **{name: value for name, value in part.judged_with.items() if name != PROCESSOR},
        "hash of code and scenes": part.code,
    }

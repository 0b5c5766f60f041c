"""A run in several shards: the scenes of each, and their verdicts merged into one."""

import argparse
import heapq
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from caster.description.errors import SceneError
from caster.system.process import NOT_COMPARABLE
from mitsuba_ref.judge.verdict import SceneVerdict, Verdict
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.store import machine
from mitsuba_ref.runner.many_scenes import Entry
from mitsuba_ref.runner.verdict_files import UnreadableVerdict

PROCESSOR = "processor"  # of `judged_with`; parts of a run may have different ones
MAX_MISSING_LISTED = 50  # shards; --shard 1/100000000 is valid


def judged_with() -> dict[str, str]:
    """Versions, variants, architecture and processor of this run. Raises VariantError."""
    flat, quadrics = (variants.variant_for(has_quadrics=each) for each in (False, True))
    library = variants.usable_variants().libllvm if variants.LLVM in (flat, quadrics) else None
    versions = {name: version for name, version in machine().items() if name not in ("system", "python")}
    # libLLVM by the version in the name of its file, since folders differ between systems
    llvm = ".".join(re.findall(r"\d+", Path(library).name)) or library if library else "none"
    return {**versions, "variant of triangles": flat, "variant of quadrics": quadrics, "libLLVM": llvm}


class Shard(NamedTuple):
    """Number `part` of `parts`, from 1."""

    part: int
    parts: int

    def __str__(self) -> str:
        return f"{self.part}/{self.parts}"


def parse_shard(text: str) -> Shard:
    """Of "2/4". Raises argparse.ArgumentTypeError."""
    index, slash, count = text.partition("/")
    if slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count):
        return Shard(int(index), int(count))
    raise argparse.ArgumentTypeError(f"expected I/N with 1 <= I <= N, such as 2/4, got '{text}'")


def scenes_of_shard(entries: Sequence[Entry], shard: Shard) -> list[Entry]:
    """The entries of one shard, in their order. Each entry is in exactly one of the shards.

    The largest first, each to the shard with the fewest pixels so far: none has more than 4/3 of the optimum
    (Graham 1969). It depends only on names and film sizes.
    """
    pixels = [entry.pixels for entry in entries]
    order = sorted(range(len(entries)), key=lambda i: (-pixels[i], entries[i].name, i))
    used = min(shard.parts, len(entries))  # no shard gets a second scene before every one has its first
    loads = [(0, number) for number in range(1, used + 1)]
    mine = set()
    for i in order:
        load, number = heapq.heappop(loads)
        heapq.heappush(loads, (load + pixels[i], number))
        if number == shard.part:
            mine.add(i)
    return [entry for i, entry in enumerate(entries) if i in mine]


class DifferentRuns(SceneError):  # noqa: N818 - names a state
    """Verdicts that are not parts of one run."""

    exit_code = NOT_COMPARABLE


def merge_verdicts(parts: Sequence[tuple[str, Verdict]]) -> tuple[Verdict, list[str]]:
    """(one verdict of all, missing shards as text); parts: (file, verdict).

    A scene of a shard that is missing counts as not judged. Raises DifferentRuns for parts of different runs.
    """
    first_place, first = parts[0]
    files: dict[Shard, str] = {}
    scenes: dict[str, SceneVerdict] = {}
    for place, part in parts:
        shard = _shard_in(place, part, alone=len(parts) == 1)
        if shard in files:
            raise DifferentRuns(f"{place}: shard {shard} once more; it is in {files[shard]}")
        files[shard] = place
        run, expected = _run_of(part, shard), _run_of(first, next(iter(files)))
        for what in [name for name in run if name in expected and run[name] != expected[name]]:
            raise DifferentRuns(
                f"{place}: expected a part of the same run as {first_place}: its {what} is {run[what]}, there it is "
                f"{expected[what]}"
            )
        for scene in part.scenes:
            if scene.name in scenes or scene.name not in (first.selected or first.names):
                raise DifferentRuns(f"{place}: scene {scene.name} is in another shard, or was not selected")
            scenes[scene.name] = scene
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
        scenes=tuple(scenes[name] for name in names if name in scenes),
    )
    return whole, _missing(next(iter(files)).parts, {shard.part for shard in files})


def _missing(count: int, present: set[int]) -> list[str]:
    """A line for each shard that is missing, at most MAX_MISSING_LISTED; then how many more."""
    numbers = (number for number in range(1, count + 1) if number not in present)
    listed = [f"shard {number}/{count} is missing" for number in islice(numbers, MAX_MISSING_LISTED)]
    more = count - len(present) - len(listed)
    return [*listed, f"{more} more shards are missing"] if more else listed


def _shard_in(place: str, part: Verdict, *, alone: bool) -> Shard:
    """The shard of a verdict; a run that was not divided is 1/1."""
    if not part.shard:
        if not alone:
            raise DifferentRuns(f"{place}: expected a shard, got a run that was not divided")
        return Shard(1, 1)
    try:
        return parse_shard(part.shard)
    except argparse.ArgumentTypeError as error:
        raise UnreadableVerdict(f"{place}: shard: {error}") from error


def _run_of(part: Verdict, shard: Shard) -> dict[str, object]:
    """What all parts of a run have in common; films of a part without scenes are not known."""
    films = {f"{scene.size[0]} x {scene.size[1]}" if scene.resized else "the scenes' own" for scene in part.scenes}
    return {
        "number of shards": shard.parts,
        "selection": ", ".join(part.selected or part.names),
        "subject": part.candidate or "our caster",
        **({"size of films": " and ".join(sorted(films))} if films else {}),
        **{name: value for name, value in part.judged_with.items() if name != PROCESSOR},
        "hash of code and scenes": part.code,
    }

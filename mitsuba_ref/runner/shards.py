"""A run in several shards: scenes of each, the versions that judged them, and the merged verdict."""

import argparse
import heapq
import importlib.metadata
import platform
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from caster.description.errors import SceneError
from caster.system import processor
from caster.system.process import NOT_COMPARABLE
from mitsuba_ref.judge.verdict import SceneVerdict, Verdict
from mitsuba_ref.reference import variants
from mitsuba_ref.runner.many_scenes import Entry
from mitsuba_ref.runner.resume import UnreadableVerdict

# Python, OpenEXR and pydantic read and write; these compute.
COMPUTING_LIBRARIES = ("mitsuba", "drjit", "numpy", "numba", "llvmlite")
RECORDED_PER_SCENE = ("mitsuba", "drjit")  # versions in each answer of Mitsuba; variants differ between scenes
NONE = "none"
PROCESSOR = "processor"  # of `judged_with`; parts of a run may have different ones
MAX_MISSING_LISTED = 50  # shards; --shard 1/100000000 is valid


def judged_with() -> dict[str, str]:
    """Versions, variants, architecture and processor of this run. Raises VariantError."""
    flat, quadrics = (variants.variant_for(has_quadrics=each) for each in (False, True))
    library = variants.usable_variants().libllvm if variants.LLVM in (flat, quadrics) else None
    return {
        "machine": platform.machine(),
        PROCESSOR: processor.description(),
        **{name: _installed(name) for name in COMPUTING_LIBRARIES},
        "variant of triangles": flat,
        "variant of quadrics": quadrics,
        "libLLVM": version_in(library or NONE),
    }


def _installed(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return NONE


def version_in(library: str) -> str:
    """Version of libLLVM by the name of its file, since folders differ between systems: "19.1" of libLLVM.so.19.1."""
    return ".".join(re.findall(r"\d+", Path(library).name)) or library


def other_versions(parts: Sequence[tuple[str, Verdict]]) -> list[str]:
    """Differences between the versions of parts, a sentence each; parts: (file, verdict)."""
    return _differences([(place, _recorded_versions(part)) for place, part in parts])


def other_processors(parts: Sequence[tuple[str, Verdict]]) -> list[str]:
    """Differences between the processors of parts, likewise: merged all the same, as verdicts do not depend on it."""
    return _differences(
        [(place, ((PROCESSOR, part.judged_with[PROCESSOR]),)) for place, part in parts if PROCESSOR in part.judged_with]
    )


def _differences(parts: Sequence[tuple[str, Iterable[tuple[str, str]]]]) -> list[str]:
    known: dict[str, tuple[str, str]] = {}
    found: dict[str, None] = {}
    for place, recorded in parts:
        for what, version in recorded:
            first, before = known.setdefault(what, (place, version))
            if version != before:
                found[f"{place} was judged with {what} {version}, {first} with {before}"] = None
    return list(found)


def _recorded_versions(part: Verdict) -> Iterator[tuple[str, str]]:
    yield from ((what, version) for what, version in part.judged_with.items() if what != PROCESSOR)
    for scene in part.scenes:
        yield from ((name, scene.versions[name]) for name in RECORDED_PER_SCENE if name in scene.versions)
        library = scene.versions.get("libllvm", NONE)
        if library != NONE:
            yield "libLLVM", version_in(library)


def combined_versions(parts: Sequence[Verdict]) -> dict[str, str]:
    """`judged_with` of all parts; different versions joined by "and"."""
    kinds = dict.fromkeys(what for part in parts for what in part.judged_with)
    return {what: " and ".join(dict.fromkeys(part.judged_with.get(what, "?") for part in parts)) for what in kinds}


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


def merge_verdicts(parts: Sequence[tuple[str, Verdict]], *, any_versions: bool = False) -> tuple[Verdict, list[str]]:
    """(one verdict of all, missing shards as text); parts: (file, verdict).

    any_versions: parts that were judged with other versions are parts of one run, too. A scene of a shard that is
    missing counts as not judged. Raises DifferentRuns for parts of different runs.
    """
    first_place, first = parts[0]
    files: dict[int, str] = {}
    for place, part in parts:
        shard = shard_in(part, place, len(parts))
        if shard.parts != shard_in(first, first_place, len(parts)).parts or part.selected != first.selected:
            raise DifferentRuns(f"{place}: expected a shard of the same run as {first_place}, got one of another")
        if shard.part in files:
            raise DifferentRuns(f"{place}: shard {shard} once more; it is in {files[shard.part]}")
        files[shard.part] = place
    check_same_subject_and_film(
        parts
    )  # films and candidates first: they are a part of the code's hash, whose difference has no details
    for place, part in parts:
        if part.code != first.code:
            raise DifferentRuns(f"{place}: it is of other code or other scenes than {first_place}")
    if not any_versions and (others := other_versions(parts)):
        hint = "judge all shards with the same versions, or take them together with --other-versions"
        raise DifferentRuns("\n".join([*others, f"expected shards that were judged alike: {hint}"]))
    count = shard_in(first, first_place, len(parts)).parts
    scenes = {}
    for place, part in parts:
        for scene in part.scenes:
            if scene.name in scenes:
                raise DifferentRuns(f"{place}: scene {scene.name} is in another shard, too")
            scenes[scene.name] = scene
    names = first.selected or first.names
    strange = sorted(set(scenes) - set(names))
    if strange:
        raise DifferentRuns(f"scenes that the run did not select: {', '.join(strange)}")
    judged_with = combined_versions([part for _, part in parts])
    whole = replace(first, shard="", selected=(), scene_count=len(names), names=names, judged_with=judged_with)
    mended = tuple(name for _, part in parts for name in part.mended)
    whole = replace(whole, mended=mended, scenes=tuple(scenes[name] for name in names if name in scenes))
    return whole, missing_shards(count, files)


def missing_shards(count: int, present: Collection[int]) -> list[str]:
    """A line for each shard that is missing, at most MAX_MISSING_LISTED; then how many more."""
    missing = (number for number in range(1, count + 1) if number not in present)
    listed = [f"shard {number}/{count} is missing" for number in islice(missing, MAX_MISSING_LISTED)]
    more = count - len(present) - len(listed)
    return [*listed, f"{more} more shards are missing"] if more else listed


def check_same_subject_and_film(parts: Sequence[tuple[str, Verdict]]) -> None:
    """Raise DifferentRuns unless all scenes were judged with the same candidate, and with the same --size or none."""
    judged = [(place, f"judged {part.candidate or 'ours'}") for place, part in parts]  # or was about to
    films = [(place, f"has films of {film_of(scene)}") for place, part in parts for scene in part.scenes]
    for claims in (judged, films):
        for place, mine in claims:
            first_place, others = claims[0]
            if mine != others:
                raise DifferentRuns(f"{place}: it {mine}, and {first_place} {others}")


def film_of(scene: SceneVerdict) -> str:
    return f"{scene.size[0]} x {scene.size[1]}" if scene.resized else "the scenes' own sizes"


def shard_in(part: Verdict, place: str, parts: int) -> Shard:
    """The shard of a verdict; a run that was not divided is 1/1."""
    if not part.shard:
        if parts > 1:
            raise DifferentRuns(f"{place}: expected a shard, got a run that was not divided")
        return Shard(1, 1)
    try:
        return parse_shard(part.shard)
    except argparse.ArgumentTypeError as error:
        raise UnreadableVerdict(f"{place}: shard: {error}") from error

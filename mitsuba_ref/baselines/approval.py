"""Which references are to be written: missing ones, changed ones, or all."""

from dataclasses import dataclass
from pathlib import Path

from caster.exr import UnreadableExr
from mitsuba_ref.baselines.changes import changes, comparable, lines
from mitsuba_ref.baselines.reference_file import SCENE_HASH, Reference, RefusedReference, rendered, stored
from mitsuba_ref.campaign import Entry
from mitsuba_ref.jobs import Crash

MISSING, CHANGED, ALL = MODES = ("missing", "changed", "all")


@dataclass(frozen=True)
class Proposal:
    """One scene: what became of its reference, and what would be written."""

    name: str
    path: Path
    status: str  # missing, changed, stale, damaged, same, kept, failed
    write: bool
    details: tuple[str, ...] = ()
    fresh: Reference | None = None


def propose(entry: Entry, folder: Path, mode: str, variant: str | None, command: str) -> Proposal:
    """Render the scene unless nobody would write it, and hold it against what is stored."""
    path = folder / f"{entry.name}.exr"
    if mode == MISSING and path.exists():
        return Proposal(entry.name, path, "kept", False, ("it is there; --update missing looks no further",))
    fresh = rendered(entry.scene, entry.path, variant=variant, command=command)
    if isinstance(fresh, Crash):
        words = f"Mitsuba ended without an answer ({fresh.exit}): {fresh.headline}"
        return Proposal(entry.name, path, "failed", False, (words,))
    if not path.exists():
        hit = int((fresh.channels["A"] != 0.0).sum())
        what = f"{hit} of {fresh.channels['A'].size} pixels hit, {len(fresh.channels)} channels"
        return Proposal(entry.name, path, "missing", True, (what,), fresh)
    try:
        before = stored(path)
    except (RefusedReference, UnreadableExr) as error:
        return Proposal(entry.name, path, "damaged", True, (str(error),), fresh)
    return _held_against(before, fresh, entry.name, path, mode)


def _held_against(before: Reference, fresh: Reference, name: str, path: Path, mode: str) -> Proposal:
    found = tuple(lines(before, fresh))
    if before.about.get(SCENE_HASH) != fresh.about[SCENE_HASH]:
        same = "the scene has changed, no pixel has" if not found else "the scene has changed"
        return Proposal(name, path, "stale", True, (same, *found), fresh)
    if not comparable(before, fresh) or changes(before, fresh):
        return Proposal(name, path, "changed", True, found, fresh)
    return Proposal(name, path, "same", mode == ALL and before.digest() != fresh.digest(), found, fresh)


def orphans(folder: Path, names: set[str]) -> list[str]:
    """Files of the folder that are named after none of the scenes."""
    return (
        sorted(path.name for path in folder.glob("*.exr") if path.stem not in names)
        if folder.is_dir()
        else []
    )

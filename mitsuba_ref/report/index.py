"""What the list of scenes says of each."""

from typing import Any

from mitsuba_ref.replaying import replay, replay_around
from mitsuba_ref.table import failure
from mitsuba_ref.verdict import UNLISTED, SceneVerdict, number


def row(verdict: SceneVerdict, file: str, thumbnail: str) -> dict[str, Any]:
    """file: of its pictures in the folder data, "" without any."""
    first = verdict.failures[0] if verdict.failures else None
    check, ratio = (first.check, first.ratio) if first else verdict.worst
    return {
        "name": verdict.name,
        "path": verdict.path,
        "file": file,
        "thumbnail": thumbnail,
        "ok": verdict.ok,
        "crashed": bool(verdict.problem),
        "size": list(verdict.size),
        "hit": verdict.hit_pixels,
        "counts": {verdict.called(name): count for name, count in verdict.counts.items()},
        "unlisted": verdict.cases.get(UNLISTED, 0),
        "failing": verdict.failing,
        "asked": verdict.adjudicated,
        "worst": [check, number(ratio)],
        "ratios": {name: number(share) for name, share in verdict.ratios.items()},
        "seconds": round(verdict.seconds, 2),
        "kept": verdict.kept,
        "failed_at": sorted({each.check for each in verdict.failures} | _failed_checks(verdict)),
        "says": "" if verdict.ok else failure(verdict),
        "replay": replay(verdict),
        "replay_pixel": replay_around(verdict),
        "pixel": None if first is None else [first.x, first.y],
    }


def _failed_checks(verdict: SceneVerdict) -> set[str]:
    return {check.name for check in verdict.checks if not check.ok}

"""A verdict for the terminal: one row a scene, and where to look where one fails."""

import shlex
from collections.abc import Iterator

from mitsuba_ref.verdict import AGREE, CLASSES, EXPLAINED, OUT_OF_DOMAIN, UNDECIDED, SceneVerdict, Verdict

WORDS_SHOWN = 12  # lines of what Mitsuba said when it ended without an answer


WIDEST_CHECK = len("0.00 shading_normal")


def head(width: int) -> str:
    """The names of the columns; width: of the longest scene name."""
    classes = "".join(f"  {name.replace('_', ' '):>{room(name)}}" for name in CLASSES)
    return f"      {'scene':<{width}}  {'hit':>8}{classes}  {'worst':<{WIDEST_CHECK}}  seconds"


def row(scene: SceneVerdict, width: int) -> str:
    """PASS or FAIL, how many hit pixels in which class, the check that came nearest to its bound."""
    mark = "PASS" if scene.ok else "FAIL"
    classes = "".join(f"  {scene.counts[name]:>{room(name)}}" for name in CLASSES)
    check, ratio = scene.worst
    worst = f"{ratio:.2f} {check}" if check and scene.counts[AGREE] else "-"
    left = f"{mark}  {scene.name:<{width}}  {scene.hit_pixels:>8}{classes}"
    return f"{left}  {worst:<{WIDEST_CHECK}}  {scene.seconds:7.1f}"


def room(name: str) -> int:
    """Characters of the column of a class."""
    return max(8, len(name))


def failure(scene: SceneVerdict) -> str:
    """How many, how far, where to look, and the next command."""
    return "\n".join(_failure_lines(scene))


def _failure_lines(scene: SceneVerdict) -> Iterator[str]:
    if scene.problem:
        yield from _problem_lines(scene)
    elif not scene.has_evidence and not scene.counts[UNDECIDED]:
        yield f"FAIL  {scene.name}  {_lack_of_evidence(scene)}"
    for check in scene.checks:
        if not check.ok:
            yield f"FAIL  {scene.name}  {check.name}: {check.ratio:.3g}x its bound; {check.what}"
            yield f"      replay:    {replay(scene)}"
    if scene.failures:
        first = scene.failures[0]
        count, hit = scene.counts[UNDECIDED], scene.hit_pixels
        yield (
            f"FAIL  {scene.name}  {first.check}: {count} of {hit} hit pixels undecided, "
            f"worst {first.ratio:.3g}x its bound at ({first.x}, {first.y})"
        )
        yield f"      ours:      {first.ours}"
        yield f"      reference: {first.reference}"
        yield f"      why:       {first.reason}"
        yield f"      replay:    {replay(scene, (first.x, first.y))}"


def _lack_of_evidence(scene: SceneVerdict) -> str:
    if not scene.hit_pixels:
        return "no pixel hits anything, so nothing was compared"
    excused = scene.counts[EXPLAINED] + scene.counts[OUT_OF_DOMAIN]
    return f"too little evidence: {scene.counts[AGREE]} pixels agree, {excused} are only excused"


def _problem_lines(scene: SceneVerdict) -> Iterator[str]:
    first, *rest = scene.problem.splitlines()
    yield f"FAIL  {scene.name}  {first}"
    yield from (f"      {line}" for line in rest[:WORDS_SHOWN])


def replay(scene: SceneVerdict, pixel: tuple[int, int] | None = None) -> str:
    """The command that shows one pixel, or else the scene, again."""
    size = f" --size {scene.size[0]} {scene.size[1]}" if scene.resized else ""
    path = shlex.quote(scene.path or "SCENE")
    if pixel is None:
        return f"mitsuba-ref validate {path}{size}"
    return f"mitsuba-ref probe {path} {pixel[0]} {pixel[1]}{size}"


def summary(verdict: Verdict, seconds: float) -> str:
    """All scenes in three lines."""
    passed = sum(scene.ok for scene in verdict.scenes)
    counts = verdict.counts
    total = sum(counts.values()) or 1
    shares = ", ".join(
        f"{counts[name]} {name.replace('_', ' ')} ({share(counts[name], total)})" for name in CLASSES
    )
    lines = [
        f"{verdict.asked} scenes: {passed} pass, {len(verdict.scenes) - passed} fail"
        f"{_not_run(verdict)}, in {seconds:.1f} s",
        f"hit pixels: {shares}",
    ]
    lines += [
        f"note:       {scene.name} allows {_allowed(scene)}" for scene in verdict.scenes if scene.allowed
    ]
    return "\n".join([*lines, *(f"reference:  {versions}" for versions in verdict.versions)])


def _allowed(scene: SceneVerdict) -> str:
    return ", ".join(f"{share:g} of the bound of {name}" for name, share in scene.allowed.items())


def _not_run(verdict: Verdict) -> str:
    left = verdict.asked - len(verdict.scenes)
    return f", {left} not judged" if left else ""


def share(count: int, total: int) -> str:
    """A percentage that says 100 only when it is all."""
    percent = 100.0 * count / total
    return f"{percent:.4f} %" if 0 < count < total else f"{percent:.0f} %"

"""A verdict for continuous integration: Markdown for the summary page of a step, and JUnit XML for servers."""

import html
import math
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from caster.system.atomic_files import append_text
from caster.system.terminal import printable
from mitsuba_ref.judge.verdict import CLASSES, Failure, SceneVerdict, Verdict
from mitsuba_ref.report.reproducers import replay
from mitsuba_ref.report.verdict_text import (
    WAIVER_WORDS,
    candidate_lines,
    class_text,
    count_text,
    failure_text,
    group_lines,
    waiver_lines,
    worst_words,
)
from mitsuba_ref.scene_xml.elements import XmlElement

# ---- Markdown ----

# GitHub drops the whole summary of a step that is larger: https://docs.github.com/actions, "step isolation and limits".
SUMMARY_LIMIT_BYTES = 1024 * 1024

RESERVED_BYTES = 2048  # of it, for the list of omissions and the closing tags

PLAIN = re.compile(r"[A-Za-z0-9 .,:/()=+-]")  # characters without a meaning in Markdown, within a line


def append(path: str | os.PathLike[str], verdict: Verdict, seconds: float, limit: int = SUMMARY_LIMIT_BYTES) -> None:
    """Append the summary to a file such as $GITHUB_STEP_SUMMARY, which grows to `limit` bytes at most.

    Raises OutputError.
    """
    before = Path(path).stat().st_size if Path(path).exists() else 0
    append_text(path, markdown(verdict, seconds, limit - before))


def markdown(verdict: Verdict, seconds: float, limit: int = SUMMARY_LIMIT_BYTES) -> str:
    """The verdict, failing scenes with their worst pixel and replay first; no longer than limit bytes of UTF-8."""
    failing = [scene for scene in verdict.scenes if not (scene.ok or scene.waived)]
    passing = [scene for scene in verdict.scenes if scene.ok]
    head = "\n".join(_head(verdict, seconds)) + "\n"
    room = _ByteBudget(limit - RESERVED_BYTES - utf8_size(head))
    rows = room.take(_failing_row(scene) for scene in failing)
    texts = room.take(_failing_text(scene) for scene in failing)
    missing = room.take(f"- {escaped(name)}\n" for name in verdict.not_judged)
    good = room.take(_row(scene) for scene in passing)
    parts = [head]
    if rows:
        parts += [_table_head(verdict, "worst pixel", "replay"), *rows, "\n"]
    if missing:
        parts += [f"Not judged, {len(verdict.not_judged)} scenes:\n\n", *missing, "\n"]
    parts += texts
    if good:
        parts.append(f"<details><summary>{len(passing)} scenes pass</summary>\n\n")
        parts += [_table_head(verdict, "closest"), *good, "\n</details>\n"]
    wanted = (
        (failing, rows, "failing scenes"),
        (failing, texts, "texts of failing scenes"),
        (verdict.not_judged, missing, "scenes not judged"),
        (passing, good, "scenes that pass"),
    )
    left = [f"{len(every) - len(shown)} {what}" for every, shown, what in wanted if len(shown) < len(every)]
    if left:
        parts.append(f"\nLeft out, for the size that a summary may have: {', '.join(left)}. verdict.json has all.\n")
    text = "".join(parts)
    return text if utf8_size(text) <= limit else ""  # a file that is full already


class _ByteBudget:
    """A number of bytes to spend."""

    def __init__(self, left: int) -> None:
        self.left = left

    def take(self, texts: Iterable[str]) -> list[str]:
        """The first texts that fit."""
        taken = []
        for text in texts:
            if utf8_size(text) > self.left:
                break
            self.left -= utf8_size(text)
            taken.append(text)
        return taken


def utf8_size(text: str) -> int:
    return len(text.encode())


def _head(verdict: Verdict, seconds: float) -> Sequence[str]:
    passed = sum(scene.ok for scene in verdict.scenes)
    words = f"{verdict.scene_count} scenes: {passed} pass, {count_text(verdict)}"
    missing = verdict.scene_count - len(verdict.scenes)
    words += f", {missing} not judged" if missing else ""
    kept = sum(scene.kept for scene in verdict.scenes)
    counts = ", ".join(f"{verdict.counts[name]} {name.replace('_', ' ')}" for name in CLASSES)
    lines = [f"## {'PASS' if verdict.ok else 'FAIL'}: {words}", ""]
    lines += [f"mitsuba-ref validate, {seconds:.1f} s. Hit pixels: {counts}.", ""]
    if verdict.shard:
        lines += [f"Shard {verdict.shard}.", ""]
    if verdict.candidate:
        lines += [*(f"- {escaped(line)}" for line in candidate_lines(verdict)), ""]
    if kept:
        lines += [f"Kept from an earlier run, not judged anew: {kept} scenes.", ""]
    lines += [f"- {escaped(' '.join(line.split()))}" for line in waiver_lines(verdict)]
    lines += [f"- {escaped(' '.join(line.split()))}" for line in group_lines(verdict.scenes)]
    lines += [f"- {escaped(versions)}" for versions in verdict.versions]
    return [*lines, ""]


def _table_head(verdict: Verdict, *last: str) -> str:
    names = ["scene", "hit", *map(class_text, CLASSES), *last]
    aligned = ["---", *["---:"] * (1 + len(CLASSES)), *["---"] * len(last)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (names, aligned))


def _cells(scene: SceneVerdict) -> list[str]:
    name = escaped(scene.name) + (" (kept)" if scene.kept else "")
    return [name, str(scene.hit_pixels), *(str(scene.counts[name]) for name in CLASSES)]


def _row(scene: SceneVerdict) -> str:
    return f"| {' | '.join([*_cells(scene), escaped(worst_words(scene))])} |\n"


def _failing_row(scene: SceneVerdict) -> str:
    first = scene.failures[0] if scene.failures else None
    pixel = (first.x, first.y) if first else None
    where = f"({first.x}, {first.y}): {_far(first)}" if first else _first_line(scene)
    command = f"<code>{escaped(replay(scene, pixel))}</code>"
    return f"| {' | '.join([*_cells(scene), escaped(where), command])} |\n"


def _far(worst: Failure) -> str:
    return f"{worst.check} {worst.ratio:.3g}x its bound" if math.isfinite(worst.ratio) else f"{worst.check} is another"


def _first_line(scene: SceneVerdict) -> str:
    """The first line of the failure, without FAIL and the scene's name."""
    line = failure_text(scene).partition("\n")[0]
    return line.removeprefix(f"FAIL  {scene.name}  ")[:200]


SCENE_TEXT_LIMIT_BYTES = 16384  # of one scene: the output of Mitsuba may be long


def _failing_text(scene: SceneVerdict) -> str:
    """The terminal's text, folded; within <pre> only HTML's own characters need escapes."""
    words = html.escape(printable(failure_text(scene)))
    words = words.encode()[:SCENE_TEXT_LIMIT_BYTES].decode(errors="ignore")
    return f"<details><summary>{html.escape(one_line(scene.name))}</summary>\n\n<pre>\n{words}\n</pre>\n</details>\n\n"


def one_line(text: str) -> str:
    return printable(text, keep="")


def escaped(text: str) -> str:
    """Text on one line that Markdown and HTML show unchanged: special characters as numeric references."""
    return "".join(c if PLAIN.match(c) else f"&#{ord(c)};" for c in one_line(text))


# ---- JUnit XML ----

NAME = "mitsuba-ref validate"


def junit(verdict: Verdict) -> str:
    """A test case for each scene; a failing one holds its text of the terminal. A missing answer is an error, and so
    is a scene that was requested and not judged.
    """
    failed = [scene for scene in verdict.scenes if not (scene.ok or scene.waived)]
    errors = sum(bool(scene.problem) for scene in failed) + len(verdict.not_judged)
    counts = {
        "tests": str(len(verdict.scenes) + len(verdict.not_judged)),
        "failures": str(sum(not scene.problem for scene in failed)),
        "errors": str(errors),
        "skipped": str(sum(bool(scene.waived) for scene in verdict.scenes)),
        "time": f"{sum(spent(scene) for scene in verdict.scenes):.3f}",
    }
    top = Element("testsuites", {"name": NAME, **counts})
    suite = SubElement(top, "testsuite", {"name": NAME, **counts})
    about = {"shard": verdict.shard, "candidate": printable(verdict.candidate)}
    if any(about.values()):
        properties = SubElement(suite, "properties")
        for name, value in about.items():
            if value:
                SubElement(properties, "property", name=name, value=value)
    for scene in verdict.scenes:
        add_case(suite, scene)
    for name in verdict.not_judged:
        case = SubElement(suite, "testcase", classname="scenes", name=printable(name), time="0.000")
        words = f"{name}: not judged: the run ended earlier"
        SubElement(case, "error", message=printable(words), type="not_judged").text = printable(words)
    indent(top)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + tostring(top, encoding="unicode") + "\n"


def add_case(suite: XmlElement, scene: SceneVerdict) -> None:
    """One scene. `file` is where GitLab and others look for the place of a test."""
    about = {"classname": class_name(scene), "name": printable(scene.name), "time": f"{spent(scene):.3f}"}
    if scene.path:
        about["file"] = printable(scene.path)
    case = SubElement(suite, "testcase", about)
    if scene.waived:
        text = failure_text(scene)
        words = printable(f"{WAIVER_WORDS[scene.waived]}: {text.splitlines()[0]}")
        SubElement(case, "skipped", message=words).text = printable(text)
    elif not scene.ok:
        text = failure_text(scene)
        kind = "error" if scene.problem else "failure"
        found = SubElement(case, kind, message=printable(text.splitlines()[0]), type=what_fails(scene))
        found.text = printable(text)
    counts = " ".join(f"{name}={scene.counts[name]}" for name in CLASSES)
    judged = f"candidate={scene.candidate} " if scene.candidate else ""
    kept = "kept from an earlier run, not judged now; " if scene.kept else ""
    SubElement(case, "system-out").text = printable(
        f"{kept}{judged}hit={scene.hit_pixels} {counts} adjudicated={scene.adjudicated} cases={scene.cases} "
        f"{_errors(scene)}{scene.versions}{' (answered in an earlier run)' if scene.reference_stored else ''}"
    )


def spent(scene: SceneVerdict) -> float:
    """Seconds of this run."""
    return 0.0 if scene.kept else scene.seconds


def class_name(scene: SceneVerdict) -> str:
    """The scene's folder with dots, by which servers group: scenes, or tests.renders."""
    parts = [part for part in PurePath(scene.path).parent.parts if part not in ("/", ".", "..")]
    return printable(".".join(part.replace(".", "-") for part in parts[-2:])) or "scenes"


def what_fails(scene: SceneVerdict) -> str:
    """In one word."""
    if scene.problem:
        return "no_answer"
    if scene.failures:
        return scene.failures[0].verdict
    return "check" if not scene.checks_pass else "no_evidence"


def _errors(scene: SceneVerdict) -> str:
    found = scene.statistics
    return f"k_t={found.k_t.largest:.2f} k_normal={found.k_normal.largest:.2f} z={found.z:.1f} " if found else ""

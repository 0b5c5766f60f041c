"""A verdict for continuous integration: Markdown for the summary page of a step, and JUnit XML for servers."""

import os
import re
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path, PurePath
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from caster.system.atomic_files import append_text
from caster.system.terminal import printable
from mitsuba_ref.judge.verdict import SceneVerdict, Verdict
from mitsuba_ref.report.reproducers import replay
from mitsuba_ref.report.verdict_text import (
    COLUMNS,
    WAIVER_WORDS,
    failing_scenes,
    failure_text,
    group_lines,
    outcome_text,
    row_cells,
    summary_lines,
    table_head,
    table_row,
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
    """The verdict, failing scenes with their worst pixel and replay first; at most `limit` bytes of UTF-8."""
    failing = failing_scenes(verdict.scenes)
    passing = [scene for scene in verdict.scenes if scene.ok]
    failing_head, passing_head = _table_head("failure", "replay"), _table_head()
    not_judged_head = f"Not judged, {len(verdict.not_judged)} scenes:\n\n"
    folded = f"<details><summary>{len(passing)} scenes pass</summary>\n\n"
    sections = [  # what it lists, the text before, the items, and the text after
        ("failing scenes", failing_head, map(_failing_row, failing), "\n"),
        ("scenes not judged", not_judged_head, (f"- {escaped(name)}\n" for name in verdict.not_judged), "\n"),
        ("scenes that pass", folded + passing_head, (_table_row(_cells(scene)) for scene in passing), "\n</details>\n"),
    ]
    text, left_out = _head(verdict, seconds), []
    for what, before, items, after in sections:
        wanted = list(items)
        room = limit - RESERVED_BYTES - utf8_size(text + before + after)
        sizes = accumulate(map(utf8_size, wanted))
        shown = [item for item, size in zip(wanted, sizes, strict=True) if size <= room]
        if shown:
            text += "".join([before, *shown, after])
        if len(shown) < len(wanted):
            left_out.append(f"{len(wanted) - len(shown)} {what}")
    if left_out:
        text += f"\nLeft out, for the size that a summary may have: {', '.join(left_out)}. verdict.json has all.\n"
    return text if utf8_size(text) <= limit else ""  # a file that is full already


def utf8_size(text: str) -> int:
    return len(text.encode())


def _head(verdict: Verdict, seconds: float) -> str:
    lines = [f"mitsuba-ref validate, {seconds:.1f} s", *group_lines(verdict.scenes), *summary_lines(verdict)]
    items = "\n".join(f"- {escaped(' '.join(line.split()))}" for line in lines)
    return f"## {'PASS' if verdict.ok else 'FAIL'}: {outcome_text(verdict)}\n\n{items}\n\n"


def _table_head(*more: str) -> str:
    names = ("scene", *COLUMNS, *more)
    numbers = len(COLUMNS) - 1
    alignment = ["---", *["---:"] * numbers, *["---"] * (len(names) - numbers - 1)]
    return _table_row(names) + _table_row(alignment)


def _table_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


def _cells(scene: SceneVerdict) -> list[str]:
    return [escaped(cell) for cell in (scene.name, *row_cells(scene))]


def _failing_row(scene: SceneVerdict) -> str:
    """The first line of the failure, without FAIL and the scene's name, and the command that shows the worst pixel."""
    line = failure_text(scene).partition("\n")[0].removeprefix(f"FAIL  {scene.name}  ")[:MAX_FAILURE_CHARACTERS]
    pixel = (scene.failures[0].x, scene.failures[0].y) if scene.failures else None
    return _table_row([*_cells(scene), escaped(line), f"<code>{escaped(replay(scene, pixel))}</code>"])


MAX_FAILURE_CHARACTERS = 200  # of a row


def escaped(text: str) -> str:
    """One line that Markdown and HTML show unchanged: special characters become numeric references."""
    return "".join(c if PLAIN.match(c) else f"&#{ord(c)};" for c in printable(text, keep=""))


# ---- JUnit XML ----

NAME = "mitsuba-ref validate"


def junit(verdict: Verdict) -> str:
    """JUnit XML with a test case per scene; a failing one contains its text for the terminal.

    A missing answer is an error, and so is a scene that was requested and not judged.
    """
    top = Element("testsuites", name=NAME)
    suite = SubElement(top, "testsuite", name=NAME)
    about = {"shard": verdict.shard, "candidate": printable(verdict.candidate)}
    if any(about.values()):
        properties = SubElement(suite, "properties")
        for name, value in about.items():
            if value:
                SubElement(properties, "property", name=name, value=value)
    for check in verdict.checks:
        if not check.ok:
            add_case(suite, "candidate", check.name, "failure", check.what, check.name)
    for scene in verdict.scenes:
        add_scene(suite, scene)
    for name in verdict.not_judged:
        add_case(suite, "scenes", name, "error", f"{name}: not judged: the run ended earlier", "not_judged")
    for counted, tag in (("tests", "testcase"), ("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        for element in (top, suite):
            element.set(counted, str(len(list(suite.iter(tag)))))
    for element in (top, suite):
        element.set("time", f"{sum(spent(scene) for scene in verdict.scenes):.3f}")
    indent(top)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + tostring(top, encoding="unicode") + "\n"


def add_case(
    suite: XmlElement, folder: str, name: str, outcome: str = "", text: str = "", kind: str = "", **more: str
) -> XmlElement:
    """Add a test case. outcome: failure, error or skipped, with its text and kind; "" for one that passes."""
    case = SubElement(suite, "testcase", {"classname": folder, "name": printable(name), "time": "0.000"} | more)
    if outcome:
        text = printable(text)
        kinds = {"type": kind} if kind else {}
        SubElement(case, outcome, {"message": text.partition("\n")[0]} | kinds).text = text
    return case


def add_scene(suite: XmlElement, scene: SceneVerdict) -> None:
    """Add a scene, with its row of the table. GitLab and others read the place of a test from `file`."""
    outcome: tuple[str, ...] = ()
    if scene.waived:
        outcome = "skipped", f"{WAIVER_WORDS[scene.waived]}: {failure_text(scene)}"
    elif scene.problem:
        outcome = "error", failure_text(scene), "no_answer"
    elif not scene.ok:
        outcome = "failure", failure_text(scene), scene.failures[0].verdict if scene.failures else "check"
    more = {"time": f"{spent(scene):.3f}"} | ({"file": printable(scene.path)} if scene.path else {})
    case = add_case(suite, class_name(scene), scene.name, *outcome, **more)
    width = len(printable(scene.name, keep=""))
    SubElement(case, "system-out").text = printable(f"{table_head(width)}\n{table_row(scene, width)}")


def spent(scene: SceneVerdict) -> float:
    """Seconds of this run."""
    return 0.0 if scene.kept else scene.seconds


def class_name(scene: SceneVerdict) -> str:
    """The scene's folder with dots, such as tests.renders, by which servers group."""
    parts = [part for part in PurePath(scene.path).parent.parts if part not in ("/", ".", "..")]
    return printable(".".join(part.replace(".", "-") for part in parts[-2:])) or "scenes"

"""A verdict for continuous integration: Markdown for the summary page of a step, and JUnit XML for servers."""

import os
import re
from pathlib import Path, PurePath
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from caster.system.atomic_files import append_text
from caster.system.terminal import folded, printable
from mitsuba_ref.judge.verdict import SceneVerdict, Verdict
from mitsuba_ref.report.verdict_text import (
    WAIVER_WORDS,
    broken_checks,
    failure_text,
    failures_text,
    outcome_text,
    summary_text,
    table_head,
    table_row,
)
from mitsuba_ref.scene_xml.elements import XmlElement

# ---- Markdown ----

# GitHub drops the whole summary of a step that is larger: https://docs.github.com/actions, "step isolation and limits".
SUMMARY_LIMIT_BYTES = 1024 * 1024
CUT = "\n... cut off, for the size that a summary may have; verdict.json has all"


def append(path: str | os.PathLike[str], verdict: Verdict, seconds: float, limit: int = SUMMARY_LIMIT_BYTES) -> None:
    """Append the summary to a file such as $GITHUB_STEP_SUMMARY, which grows to `limit` bytes at most.

    Raises OutputError.
    """
    before = Path(path).stat().st_size if Path(path).exists() else 0
    append_text(path, markdown(verdict, seconds, limit - before))


def markdown(verdict: Verdict, seconds: float, limit: int = SUMMARY_LIMIT_BYTES) -> str:
    """The outcome as a heading, and the text of the log as a block of code; at most `limit` bytes of UTF-8."""
    width = max((len(scene.name) for scene in verdict.scenes), default=0)
    table = [table_head(width), *(table_row(scene, width) for scene in verdict.scenes)]
    missing = [f"FAIL  {name}  not judged" for name in verdict.not_judged]
    parts = failures_text(verdict), "\n".join(missing), summary_text(verdict, seconds), "\n".join(table)
    text = folded(printable("\n\n".join(filter(None, parts))))
    fence = "`" * max(3, 1 + max(map(len, re.findall("`+", text)), default=0))  # which no line of the text can close
    before, after = f"## {'PASS' if verdict.ok else 'FAIL'}: {outcome_text(verdict)}\n\n{fence}\n", f"\n{fence}\n\n"
    room = limit - len(f"{before}{after}".encode())
    if len(text.encode()) > room:
        text = text.encode()[: max(0, room - len(CUT))].decode(errors="ignore") + CUT
    found = f"{before}{text}{after}"
    return found if len(found.encode()) <= limit else ""  # a file that is full already


# ---- JUnit XML ----

NAME = "mitsuba-ref validate"


def junit(verdict: Verdict) -> str:
    """JUnit XML with a test case per scene; a failing one contains its text for the terminal.

    A missing answer is an error, and so is a scene that was requested and not judged.
    """
    top = Element("testsuites", name=NAME)
    suite = SubElement(top, "testsuite", name=NAME)
    for check in broken_checks(verdict):
        add_case(suite, "candidate", check.name, "failure", check.what, check.name)
    for scene in verdict.scenes:
        add_scene(suite, scene)
    for name in verdict.not_judged:
        add_case(suite, "scenes", name, "error", f"{name}: not judged: the run ended earlier", "not_judged")
    for counted, tag in (("tests", "testcase"), ("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        for element in (top, suite):
            element.set(counted, str(len(list(suite.iter(tag)))))
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
    folder = PurePath(scene.path).parent.name or "scenes"  # by which servers group
    case = add_case(suite, printable(folder), scene.name, *outcome, **more)
    width = len(printable(scene.name, keep=""))
    SubElement(case, "system-out").text = printable(f"{table_head(width)}\n{table_row(scene, width)}")


def spent(scene: SceneVerdict) -> float:
    """Seconds of this run."""
    return 0.0 if scene.kept else scene.seconds

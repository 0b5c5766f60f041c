"""A verdict as JUnit XML, for continuous integration servers."""

from pathlib import PurePath
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from caster.cli.printable_stream import printable
from mitsuba_ref.judge.verdict import CLASSES, SceneVerdict, Verdict
from mitsuba_ref.reference.xml_writer import XmlElement
from mitsuba_ref.report.terminal import failure_text

NAME = "mitsuba-ref validate"


def junit(verdict: Verdict) -> str:
    """A test case for each scene; a failing one holds its text of the terminal. A missing answer is an error, and so
    is a scene that was requested and not judged.
    """
    failed = [scene for scene in verdict.scenes if not scene.ok]
    errors = sum(bool(scene.problem) for scene in failed) + len(verdict.not_judged)
    counts = {
        "tests": str(len(verdict.scenes) + len(verdict.not_judged)),
        "failures": str(sum(not scene.problem for scene in failed)),
        "errors": str(errors),
        "skipped": "0",
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
    if not scene.ok:
        text = failure_text(scene)
        kind = "error" if scene.problem else "failure"
        found = SubElement(case, kind, message=printable(text.splitlines()[0]), type=what_fails(scene))
        found.text = printable(text)
    counts = " ".join(f"{name}={scene.counts[name]}" for name in CLASSES)
    judged = f"candidate={scene.candidate} " if scene.candidate else ""
    kept = "kept from an earlier run, not judged now; " if scene.kept else ""
    SubElement(case, "system-out").text = printable(
        f"{kept}{judged}hit={scene.hit_pixels} {counts} adjudicated={scene.adjudicated} cases={scene.cases} "
        f"{_errors(scene)}{scene.versions}"
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
    return (
        f"k_t={found.k_t.largest:.2f} k_normal={found.k_normal.largest:.2f} z={found.z:.1f} " if found else ""
    )

"""A verdict as JUnit XML, which continuous integration servers read."""

from xml.etree.ElementTree import Element, SubElement, indent, tostring

from mitsuba_ref.table import failure
from mitsuba_ref.verdict import CLASSES, SceneVerdict, Verdict


def junit(verdict: Verdict) -> str:
    """One test case a scene; a failing one holds what the terminal says of it. No answer at all is an error."""
    failed = [scene for scene in verdict.scenes if not scene.ok]
    errors = sum(bool(scene.problem) for scene in failed)
    suite = Element("testsuite", name="mitsuba-ref validate", tests=str(len(verdict.scenes)))
    suite.set("failures", str(len(failed) - errors))
    suite.set("errors", str(errors))
    suite.set("time", f"{sum(scene.seconds for scene in verdict.scenes):.3f}")
    for scene in verdict.scenes:
        case = SubElement(suite, "testcase", classname="scenes", name=scene.name, time=f"{scene.seconds:.3f}")
        if not scene.ok:
            text = failure(scene)
            kind = "error" if scene.problem else "failure"
            SubElement(case, kind, message=printable(text.splitlines()[0])).text = printable(text)
        counts = " ".join(f"{name}={scene.counts[name]}" for name in CLASSES)
        SubElement(case, "system-out").text = printable(
            f"hit={scene.hit_pixels} {counts} adjudicated={scene.adjudicated} cases={scene.cases} "
            f"{_errors(scene)}{scene.versions}"
        )
    indent(suite)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + tostring(suite, encoding="unicode") + "\n"


def _errors(scene: SceneVerdict) -> str:
    found = scene.statistics
    return f"k_t={found.t_largest:.2f} k_normal={found.normal_largest:.2f} z={found.z:.1f} " if found else ""


def printable(text: str) -> str:
    """Without the control characters that XML forbids."""
    return "".join(c if c in "\n\t" or c.isprintable() else "\ufffd" for c in text)

"""JUnit XML fits a short form of Jenkins' schema."""

from xml.etree import ElementTree

import pytest
from verdict_factory import scene, verdict

from mitsuba_ref.report.ci_summaries import junit
from mitsuba_ref.report.reproducers import replay

# What Jenkins, GitLab, GitHub actions and Azure read: element -> (attributes that must be there, that may, children in
# order). `file` is GitLab's. Everything else is refused.
SCHEMA = {
    "testsuites": ({"name", "tests", "failures", "errors", "time"}, {"skipped"}, ("testsuite",)),
    "testsuite": ({"name", "tests", "failures", "errors", "skipped", "time"}, set(), ("testcase",)),
    "testcase": ({"classname", "name", "time"}, {"file"}, ("skipped", "error", "failure", "system-out")),
    "failure": ({"message", "type"}, set(), ()),
    "error": ({"message", "type"}, set(), ()),
    "system-out": (set(), set(), ()),
}


def problems(element):
    """What breaks the schema, anywhere below."""
    if element.tag not in SCHEMA:
        yield f"<{element.tag}> is unknown"
        return
    needed, allowed, children = SCHEMA[element.tag]
    for name in needed - set(element.attrib):
        yield f"<{element.tag}> lacks {name}"
    for name in set(element.attrib) - needed - allowed:
        yield f"<{element.tag}> has {name}"
    for name in {"tests", "failures", "errors", "skipped"} & set(element.attrib):
        if not element.get(name).isdecimal():
            yield f"{name} is no count: {element.get(name)}"
    if "time" in element.attrib and not float(element.get("time")) >= 0.0:
        yield f"time is {element.get('time')}"
    places = [children.index(child.tag) if child.tag in children else -1 for child in element]
    if -1 in places or places != sorted(places):
        yield f"<{element.tag}> holds {[child.tag for child in element]}"
    if element.tag in ("testsuites", "testsuite"):
        for name, tag in (("tests", "testcase"), ("failures", "failure"), ("errors", "error")):
            if int(element.get(name, -1)) != len(list(element.iter(tag))):
                yield f"{name} of <{element.tag}> is not how many there are"
    for child in element:
        yield from problems(child)


def parsed(found):
    return ElementTree.fromstring(junit(found))


VERDICTS = {
    "passes": verdict(scene("a"), scene("b")),
    "fails": verdict(scene("a"), scene("b", ok=False)),
    "crash": verdict(scene("a", ok=False, problem="Mitsuba ended without an answer (SIGABRT)\nlast \x1b[31mwords\x00")),
    "not judged": verdict(scene("a"), names=("b", "c")),
    "nothing": verdict(),
    "nasty": verdict(scene('<a & "b">\x07\'\ud800', ok=False)),
}


@pytest.mark.parametrize("found", VERDICTS.values(), ids=VERDICTS)
def test_what_is_written_is_what_servers_read(found):
    text = junit(found)
    text.encode("utf-8")
    assert list(problems(ElementTree.fromstring(text))) == []


def test_a_failure_states_in_one_line_and_in_full_and_an_error_is_no_failure():
    top = parsed(verdict(scene("good"), scene("bad", ok=False), scene("gone", ok=False, problem="it crashed\nwords")))
    cases = {case.get("name"): case for case in top.iter("testcase")}
    failure, error = cases["bad"].find("failure"), cases["gone"].find("error")
    assert failure.get("message").startswith("FAIL  bad  depth: 1 wrong of 100 hit pixels")
    assert failure.get("type") == "wrong" and "replay:    mitsuba-ref probe scenes/bad.toml 3 4" in failure.text
    assert error.get("type") == "no_answer" and "words" in error.text and cases["gone"].find("failure") is None
    assert cases["good"].get("classname") == "scenes" and cases["good"].get("file") == "scenes/good.toml"
    assert float(cases["good"].get("time")) == 1.25


def test_what_was_not_judged_is_an_error_and_what_was_kept_took_no_time():
    top = parsed(verdict(scene("old", kept=True), names=("left",)))
    cases = {case.get("name"): case for case in top.iter("testcase")}
    assert cases["left"].find("error").get("type") == "not_judged"
    assert cases["old"].get("time") == "0.000"
    assert cases["old"].find("system-out").text.split()[-4:] == ["100", "100", "0.25", "kept"]
    assert (top.get("tests"), top.get("errors"), top.get("time")) == ("2", "1", "0.000")


def test_a_replay_repeats_what_was_requested():
    typed = ("--mesh-dir", "my meshes", "--candidate", "a {xml} -o {exr}", "--candidate-timeout", "5")
    told = replay(scene(candidate="a {xml} -o {exr}", precision="float32", resized=True, options=typed), (3, 4))
    assert told.endswith(
        "probe scenes/ball.toml 3 4 --size 12 10 --mesh-dir 'my meshes' --candidate 'a {xml} -o {exr}' "
        "--candidate-timeout 5"
    )
    from_python = replay(scene(candidate="trace", precision="float32"), (3, 4))
    assert from_python.endswith(" 3 4 --candidate MODULE:trace --candidate-precision float32")
    assert replay(scene(options=typed[:2])) == "mitsuba-ref validate scenes/ball.toml --mesh-dir 'my meshes'"

"""Where many scenes fail: which shapes they have, and which scene is the simplest."""

from dataclasses import replace
from unittest.mock import Mock

from places import scene_of
from pydantic import TypeAdapter
from verdict_factory import scene as made
from verdict_factory import verdict

import caster
from mitsuba_ref.judge.verdict import SceneStatistics, SceneVerdict
from mitsuba_ref.report.verdict_text import failures_text, simplest_failing
from mitsuba_ref.runner import many_scenes


def scene(name, shapes=("sphere",), *, ok=False, checks=("depth",), camera="pinhole", primitives=1, **more):
    """One that passes, or fails these checks."""
    one = made(name, ok=ok, **more)
    failing = {} if ok or one.problem else dict.fromkeys(checks, 3)
    of = SceneStatistics(camera, dict.fromkeys(shapes, 1), primitives)
    failures = tuple(replace(each, check=checks[0]) for each in one.failures)
    return replace(one, failing_by=failing, composition=of, failures=failures)


A, B = scene("a", ("sphere", "mesh"), checks=("depth", "exact")), scene("b", checks=("normal", "depth"))


def test_the_simplest_has_the_fewest_primitives_then_shapes_then_pixels():
    few, many = scene("few", primitives=2), scene("many", primitives=70_000)
    assert simplest_failing([many, few, scene("fewest", ok=True)]) is few
    assert simplest_failing([few, replace(few, name="a", pixels=few.pixels + 1)]) is few
    assert simplest_failing([few, scene("a", ("sphere", "disk"), primitives=2)]) is few
    assert simplest_failing([scene("unknown", primitives=0), many]) is many  # not told is not the fewest
    assert simplest_failing([few]) is None and simplest_failing([scene("a", ok=True)] * 3) is None


def test_the_summaries_say_it_with_the_command_and_leave_it_out_where_there_is_nothing_to_say():
    failing = verdict(A, replace(B, composition=replace(B.composition, primitives=9)), scene("p", ("disk",), ok=True))
    lines = failures_text(failing).splitlines()
    assert lines[0] == "by shape:   scenes that fail: sphere 2 of 2, mesh 1 of 1, disk 0 of 1"
    assert next(i for i, line in enumerate(lines) if line.startswith("FAIL  a  ")) > 3
    assert lines[1:3] == [
        "look first: a, the simplest of them (1 primitive, 120 pixels)",
        "            mitsuba-ref probe scenes/a.toml 3 4",
    ]
    for few in (verdict(A, scene("p", ok=True)), verdict(scene("p", ok=True), scene("q", ok=True))):
        assert not any(words in failures_text(few) for words in ("look first", "by shape"))


def test_a_verdict_has_the_composition_of_its_scene_also_without_comparison(monkeypatch):
    entry = many_scenes.SceneEntry("ball", "ball.toml", given=scene_of(caster.Sphere(), caster.Cube()))
    for found in (made("ball"), made("ball", problem="crash")):
        monkeypatch.setattr(many_scenes, "validate_scene", Mock(return_value=found))
        judged = many_scenes.judge_entry(entry, many_scenes.JudgeOptions())
        assert judged.composition == SceneStatistics("pinhole", {"sphere": 1, "cube": 1}, 13)
        assert TypeAdapter(SceneVerdict).validate_python(judged.to_dict()).composition == judged.composition

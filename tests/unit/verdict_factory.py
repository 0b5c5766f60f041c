"""Made-up verdicts for tests of their output."""

from mitsuba_ref.judge.verdict import CLASSES, Failure, SceneCheck, SceneVerdict, Verdict
from mitsuba_ref.report.reproducers import with_replay


def scene(name="ball", *, ok=True, problem="", path=None, **more):
    """A scene of 100 hit pixels: all agree, or one is wrong; or the reference gave no answer."""
    counts = dict.fromkeys(CLASSES, 0)
    failures = ()
    if not problem:
        counts["agree"] = 100 if ok else 99
        counts["wrong"] = 0 if ok else 1
    if not ok and not problem:
        exact = "ball, prim 0 (inside) at t 1.5 0x1.8p+0"
        told = ("ball at depth 1.0", "ball at depth 1.5", exact, "ours is not the exact answer")
        failures = (Failure(3, 4, "wrong", "depth", 41.0, *told),)
    made = SceneVerdict(
        name,
        f"scenes/{name}.toml" if path is None else path,
        120,
        100 if not problem else 0,
        counts,
        ratios={"depth": 0.25},
        checks=(SceneCheck("camera", 0.1, "origin at (1, 2)"),) if not problem else (),
        failures=failures,
        versions={"mitsuba": "3.9.1", "variant": "scalar_rgb"} if not problem else {},
        seconds=1.25,
        problem=problem,
        size=(12, 10),
        **more,
    )
    return with_replay(made)


def verdict(*scenes, scene_count=None, names=(), **more):
    """All of them; `names` beyond theirs were not judged."""
    every = (*(each.name for each in scenes), *names)
    return Verdict(tuple(scenes), len(every) if scene_count is None else scene_count, every, **more)

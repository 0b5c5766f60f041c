"""The textbook caster of docs/candidates, with its mistake, before the judge at a small size."""

import runpy
from typing import Any

import numpy as np
import planted
from places import ROOT, shipped

from caster.scene.model import Scene
from mitsuba_ref.judge.verdict import SceneVerdict

WIDTH, HEIGHT = 20, 16


def trace(scene: Scene, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return runpy.run_path(str(ROOT / "docs/candidates/textbook.py"))["trace"](scene, o, d)


def trace_depth_in_float32(scene: Scene, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, None]:
    return trace(scene, o, d)[0].astype(np.float32), None


RETURNED: dict[str, np.ndarray] = {}  # candidate -> its t, as it returned them


def remembered(name: str, call: planted.Trace) -> planted.Trace:
    def asked(*given: Any) -> tuple[np.ndarray, np.ndarray | None]:
        t, n = call(*given)
        RETURNED[name] = t.copy()
        return t, n

    return asked


NO_NORMAL, NO_T = (11, 9), (12, 9)  # x, y of planted.scene(), on the ball


def trace_with_gaps(scene: Scene, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    t, n = trace(scene, o, d)
    n = n.copy()
    n[planted.row_of(NO_NORMAL), 1] = np.inf
    t[planted.row_of(NO_T)] = np.nan
    return t, n


def inside_sphere() -> Scene:
    return shipped("inside-sphere", WIDTH, HEIGHT)


def verdicts() -> dict[str, SceneVerdict]:
    """The camera inside a sphere, which it does not see; a scene without that; no normals, in float32; no answer."""
    return {
        "inside": planted.judged_candidate("inside", remembered("inside", trace), inside_sphere()),
        "outside": planted.judged_candidate("outside", trace, planted.scene()),
        "single": planted.judged_candidate("single", remembered("single", trace_depth_in_float32), inside_sphere()),
        "silent": planted.judged_candidate("silent", lambda *given: None, planted.scene()),
    }

"""A small scene before the judge, without Mitsuba: its answers are ours as float32, with faults at known pixels."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from caster import Ambient, Diffuse, Film, Pinhole, Plane, Scene, Sphere
from caster.rendering.hits import RayHits
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.reference.messages import TraceRequest, TraceResponse
from mitsuba_ref.reference.shared_input import shape_ids, shared_rays
from mitsuba_ref.report.validation import validate_scene
from mitsuba_ref.subjects import subject
from mitsuba_ref.subjects.function import function_subject
from mitsuba_ref.subjects.subject import cast_ours

WIDTH, HEIGHT = 24, 20
OURS_WRONG, REFERENCE_MISSES, NAN, INFINITE = ((11, 9), (14, 6), (8, 12), (4, 17))  # x, y of pixels that are hit

Plant = Callable[[TraceResponse], None]
Trace = Callable[[Scene, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray | None]]


def scene() -> Scene:
    """A ball above a floor, in ambient light."""
    return Scene(
        film=Film(width=WIDTH, height=HEIGHT),
        camera=Pinhole(eye=(0.1, 0.4, 5.3), look_at=(0.0, 0.1, 0.0), fov=30.0),
        lights=[Ambient(radiance=(0.5, 0.75, 1.0))],
        materials={"red": Diffuse(reflectance=(0.6, 0.1, 0.1))},
        shapes=[
            Sphere(name="ball", center=(0.1, 0.2, 0.3), radius=1.1, material="red"),
            Plane(name="floor", point=(0.0, -1.1, 0.0), normal=(0.0, 1.0, 0.0)),
        ],
    )


def row_of(pixel: tuple[int, int]) -> int:
    return pixel[1] * WIDTH + pixel[0]


def bad(patch: pytest.MonkeyPatch) -> SceneVerdict:
    """Our t is too large by 1e-5 of itself at one pixel; at three more, Mitsuba's answer is none."""

    def wrong_view(*given: object) -> RayHits:
        view = cast_ours(*given)
        if view.nearest.t.size < WIDTH * HEIGHT:  # the small film by which kernels are compiled ahead
            return view
        t = view.nearest.t.copy()
        t[row_of(OURS_WRONG)] *= 1.0 + 1e-5
        return replace(view, nearest=view.nearest._replace(t=t))

    patch.setattr(subject, "cast_ours", wrong_view)
    return judged("bad & <worse>", plant)


def plant(answer: TraceResponse) -> None:
    miss = row_of(REFERENCE_MISSES)
    answer.t[miss], answer.shape[miss], answer.prim[miss] = np.inf, -1, -1
    answer.n[row_of(NAN), 1] = np.nan
    answer.p[row_of(INFINITE), 0] = -np.inf


def judged(name: str, plant: Plant = lambda answer: None, size: tuple[int, int] = (WIDTH, HEIGHT)) -> SceneVerdict:
    asked = scene().with_film(width=size[0], height=size[1])

    def send(job: TraceRequest, timeout: float) -> TraceResponse:
        answer = rounded_answer(asked)
        plant(answer)
        return answer

    return validate_scene(Task(asked, name, f"scenes/{name}.toml", send=send), keep=True)


def judged_candidate(name: str, trace: Trace, asked: Scene) -> SceneVerdict:
    """Somebody's ray caster in the place of ours, which is the reference, rounded."""
    candidate = function_subject(trace, f"docs.candidates.{name}:trace")
    task = Task(asked, name, f"scenes/{name}.toml", subject=candidate, send=lambda *job: rounded_answer(asked))
    return validate_scene(task, keep=True)


def rounded_answer(asked: Scene) -> TraceResponse:
    """What Mitsuba would say if it did nothing but round."""
    rays = shared_rays(asked)
    view = cast_ours(asked, rays)
    count = len(view.hit)
    single = {name: np.asarray(rows, np.float32) for name, rows in view.surfaces.items()}
    albedo = np.array([[0.6, 0.1, 0.1], [0.5, 0.5, 0.5], [0.0, 0.0, 0.0]], np.float32)[view.shape_id]
    return TraceResponse(
        t=np.where(view.hit, view.nearest.t, np.inf).astype(np.float32),
        n=single["normal"],
        sh_n=single["shading_normal"],
        p=single["position"],
        uv=single["uv"],
        prim_uv=np.zeros((count, 2), np.float32),
        shape=view.shape_id.astype(np.int32),
        prim=view.prim_id.astype(np.int32),
        names=shape_ids(asked),
        light_rgb=np.zeros((0, count, 3), np.float32),
        light_visible=np.zeros((0, count), bool),
        albedo=albedo,
        sensor=np.column_stack([rays.o, rays.d, rays.t_max]),
        origin=np.zeros((0, 3), np.float32),
        loaded=(),
        versions={"mitsuba": "none", "variant": "scalar, rounded"},
        seconds=0.0,
    )

"""Witnesses of a sweep: our caster by BVH and by rasterization, and three configurations of Mitsuba."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from caster.geometry.packing import Packed
from caster.rendering.hits import cast
from caster.rendering.images import camera_rays, film_window
from caster.rendering.rasterization import find_nearest_on_film
from caster.scene.model import Scene
from mitsuba_ref.experiment.exact_hits import PreparedScene, prepare_scene
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.rendering import export, shape_ids
from mitsuba_ref.reference.session import DEFAULT_TIMEOUT, send_requests
from mitsuba_ref.reference.variants import LLVM, SCALAR, usable_variants
from mitsuba_ref.stress.family import Setting


@dataclasses.dataclass(frozen=True)
class Witness:
    """A line of the plots. variant: of Mitsuba, "" for our caster."""

    key: str
    title: str
    variant: str = ""
    robust: bool = True


OURS = Witness("ours", "ours, by BVH")
SCREEN = Witness("screen", "ours, by rasterization")
REFERENCES = (
    Witness("scalar", "Mitsuba scalar, robust", SCALAR),
    Witness("llvm", "Mitsuba LLVM, default", LLVM, robust=False),
    Witness("llvm-robust", "Mitsuba LLVM, robust", LLVM),
)
WITNESSES = (OURS, SCREEN, *REFERENCES)

# A child process holds all rays of its scenes, and some hundred bytes of response for each.
MAX_RAYS_PER_PROCESS = 1 << 20


class Observation(NamedTuple):
    """Hits that one witness reports for the rays of a setting."""

    t: np.ndarray  # (n,) float64, lengths of d, inf on a miss
    prim: np.ndarray  # (n,) number of the primitive in the scene, -1 on a miss

    @property
    def hit(self) -> np.ndarray:
        """(n,) bool. A NaN counts as a hit, so that it is noticed."""
        return ~np.isposinf(self.t)


@dataclass(frozen=True)
class Absent:
    """A witness without an observation, and the reason."""

    status: Literal["missing", "crash", "not applicable"]
    why: str


@dataclasses.dataclass(frozen=True)
class PreparedSetting(PreparedScene):
    """A setting with its geometry packed, as float32 numbers."""

    setting: Setting


def prepare_setting(setting: Setting) -> PreparedSetting:
    return PreparedSetting(**vars(prepare_scene(setting.scene, setting.o, setting.d)), setting=setting)


def cast_by_bvh(ready: PreparedSetting) -> Observation:
    """The public cast, on the packed float32 geometry."""
    ready.scene.derived["packed"] = ready.packed
    hits = cast(ready.scene, ready.o, ready.d)
    return Observation(hits.t, scene_prim_ids(ready.packed, hits.shape_id, hits.prim_id))


def scene_prim_ids(packed: Packed, shape: np.ndarray, prim: np.ndarray) -> np.ndarray:
    """Numbers within the scene of primitives of shapes; -1 for shape -1."""
    return np.where(shape < 0, -1, packed.first[np.maximum(shape, 0)] + np.maximum(prim, 0))


def cast_by_raster(ready: PreparedSetting) -> Observation | Absent:
    """Our rasterization of the setting's rays, over the pixels of their cameras."""
    setting = ready.setting
    if not setting.camera_rays:
        return Absent("not applicable", "the rays of this sweep share no eye")
    t, prim = np.full(len(setting.o), np.nan), np.full(len(setting.o), -1)
    for camera, film, rows, pixels in setting.camera_rays:
        view = Scene(camera=camera, film=film)
        rays, window = camera_rays(view), film_window(view)
        rays.o[:], rays.t_max[:] = setting.o[rows[0]], -1.0  # no ray but those of the setting
        rays.d[pixels], rays.t_max[pixels] = setting.d[rows], np.inf
        packed_camera = camera.pack(film.width, film.height)
        nearest = find_nearest_on_film(
            ready.packed, rays, packed_camera, window, camera.shares_origin, max_center_offset=1.0
        )
        t[rows], prim[rows] = nearest.t[pixels], nearest.prim[pixels]
    return Observation(t, prim)


def ask_reference(
    witness: Witness, settings: Sequence[PreparedSetting], folder: Path
) -> list[Observation | Absent]:
    """One of Mitsuba's configurations for several settings, in as few child processes as they fit in."""
    found = usable_variants()
    if witness.variant not in found.names:
        return [Absent("missing", found.why)] * len(settings)
    jobs = [_job(witness, ready, folder / f"{witness.key}-{i}") for i, ready in enumerate(settings)]
    answers = [answer for group in grouped(jobs) for answer in send_requests(group, timeout_of(group))]
    return [_observation(ready, answer) for ready, answer in zip(settings, answers, strict=True)]


def timeout_of(jobs: Sequence[TraceRequest]) -> float:
    """Seconds to wait for responses: a ray takes some ten microseconds, more on a busy machine."""
    return DEFAULT_TIMEOUT + 1e-3 * sum(len(job.o) for job in jobs)


def grouped(jobs: Sequence[TraceRequest]) -> list[list[TraceRequest]]:
    """Runs of requests with at most MAX_RAYS_PER_PROCESS rays together, or one request with more."""
    groups: list[list[TraceRequest]] = []
    left = 0
    for job in jobs:
        if len(job.o) > left:
            groups.append([])
            left = MAX_RAYS_PER_PROCESS
        groups[-1].append(job)
        left -= len(job.o)
    return groups


def _job(witness: Witness, ready: PreparedSetting, folder: Path) -> TraceRequest:
    xml = export(ready.scene, ready.model, robust=witness.robust).write(folder)
    o, d = ready.o, ready.d
    endless = np.full(len(o), np.inf, np.float32)
    # Mitsuba warns of far milder things than these scenes, and takes a very large or small sphere for a stretched one.
    return TraceRequest(xml, witness.variant, o, d, endless, lights=False, strict=False)


def _observation(ready: PreparedSetting, answer: TraceResponse | Crash) -> Observation | Absent:
    if isinstance(answer, Crash):
        return Absent("crash", f"{answer.kind} ({answer.exit}) {answer.headline}".strip())
    place = {name: index for index, name in enumerate(shape_ids(ready.scene))}
    shapes = np.array([*(place.get(name, -1) for name in answer.names), -1])
    return Observation(
        answer.t.astype(np.float64), scene_prim_ids(ready.packed, shapes[answer.shape], answer.prim)
    )

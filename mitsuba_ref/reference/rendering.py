"""Trace the shared rays with Mitsuba; name its outputs like the caster's AOVs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from caster.aovs import AOVS, Aovs
from caster.rendering.images import check_names, film_window
from caster.scene.model import Scene
from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.error_model.intersections import Array, norm
from mitsuba_ref.error_model.lambert import ambient_radiance
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.reference.interpreter import as_in_file
from mitsuba_ref.reference.messages import Crash, MitsubaError, TraceRequest, TraceResponse
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, SendRequest, send_request
from mitsuba_ref.reference.originals import original_of
from mitsuba_ref.reference.shared_input import SharedRays, export, model_of, shape_ids, shared_rays
from mitsuba_ref.reference.variants import SCALAR, variant_for
from mitsuba_ref.shapes import reference_of

# AOVs that the reference can give.
REFERENCE_AOVS = (
    "hit",
    "depth",
    "normal",
    "shading_normal",
    "position",
    "uv",
    "albedo",
    "diffuse",
    "shape_id",
    "prim_id",
)


@dataclass(frozen=True)
class ReferenceResult:
    """Mitsuba's response with the scene's shape numbers and lights. Arrays are float64, one row per ray."""

    answer: TraceResponse
    t: Array  # (n,) lengths of d, inf on a miss
    shape_id: Array  # (n,) int32 index of the scene's shape, -1 on a miss
    unshadowed: Array  # (lights, n, 3) radiance from each light, without shadows
    visible: Array  # (lights, n) bool
    ambient: Array  # (n, 3)
    robust: bool = True  # Embree's mode, which keeps meshes closed

    @property
    def hit(self) -> Array:
        """(n,) bool. NaN counts as a hit, so that it is noticed."""
        return ~np.isposinf(self.t)

    @property
    def diffuse(self) -> Array:
        """(n, 3) radiance from all visible lights and the ambient light."""
        return np.where(self.visible[..., None], self.unshadowed, 0.0).sum(axis=0) + self.ambient


def variant_of(scene: Scene) -> str:
    """The variant that traces this scene."""
    if original := original_of(scene):
        return variant_for(original.opened.variant == SCALAR)  # by the shapes, unless one is chosen
    return variant_for(any(reference_of(shape).analytic for shape in scene.shapes))


def trace_reference(
    scene: Scene,
    model: SceneModel,
    rays: SharedRays,
    *,
    variant: str | None = None,
    lights: bool = True,
    robust: bool | None = None,
    mesh_files: Sequence[Path] = (),
    timeout: float = DEFAULT_TIMEOUT,
    send: SendRequest = send_request,
    leaving: Array | None = None,
) -> ReferenceResult | Crash:
    """Trace these rays with Mitsuba, in the process that `send` reaches. A crash is a result, too.

    Through the exported scene, or the Mitsuba file as it is.
    robust: Embree's mode that keeps meshes closed; None: unless --as-in-file is given. mesh_files: also read by its own
    loader, for a check. leaving: (n, 3) directions in which it is to spawn a ray at each hit.
    """
    robust = not as_in_file() if robust is None else robust  # our scenes do not request it
    original, variant = original_of(scene), variant or variant_of(scene)
    with ScratchFolder() as folder:
        xml = Path(original.request.file) if original else export(scene, model, robust=robust).write(Path(folder))
        request = TraceRequest(
            xml,
            variant,
            rays.o,
            rays.d,
            rays.t_max,
            lights=lights and not (original and original.coverage.unlit),
            sensor=leaving is None and (original is None or original.exact_camera),
            strict=leaving is None and original is None,
            mesh_files=[file.absolute() for file in mesh_files],
            original=vars(original.request) | {"robust": robust} if original else None,
            leaving=None if leaving is None else leaving.astype(np.float32),
        )
        answer = send(request, timeout)
    if isinstance(answer, Crash):
        return answer
    index_of = {name: index for index, name in enumerate(original.keys if original else shape_ids(scene))}
    table = np.array([*(index_of.get(name, -1) for name in answer.names), -1], np.int32)
    visible = answer.light_visible if scene.shading.shadows else np.ones_like(answer.light_visible)
    return ReferenceResult(
        answer,
        answer.t.astype(np.float64),
        table[answer.shape],
        answer.light_rgb.astype(np.float64),
        visible,
        answer.albedo.astype(np.float64) * ambient_radiance(scene.lights),
        original.opened.robust if original else robust,
    )


def aovs_of(result: ReferenceResult, rays: SharedRays, shape: tuple[int, int], names: Sequence[str]) -> Aovs:
    """Images (height, width) of a result, with the caster's values for misses."""
    answer, hit = result.answer, result.hit
    length = norm(rays.d.astype(np.float64))
    flat = {
        "hit": hit,
        "depth": rays.start + result.t * length,
        "normal": answer.n,
        "shading_normal": answer.sh_n,
        "position": answer.p,
        "uv": answer.uv,
        "albedo": answer.albedo,
        "diffuse": result.diffuse,
        "shape_id": result.shape_id,
        "prim_id": answer.prim,
    }
    misses = {aov.NAME: aov.MISS for aov in AOVS}
    images = {}
    for name in names:
        values = flat[name]
        if values.dtype.kind == "f":
            values = values.astype(np.float64)
        there = hit if values.ndim == 1 else hit[:, None]
        images[name] = np.where(there, values, misses[name]).astype(values.dtype).reshape(shape + values.shape[1:])
    return Aovs(images, hit.reshape(shape))


def render_reference(
    scene: Scene, aovs: Sequence[str] = REFERENCE_AOVS, *, variant: str | None = None, timeout: float = DEFAULT_TIMEOUT
) -> tuple[Aovs, dict[str, str]]:
    """Render a scene with Mitsuba: (images as from `caster.render`, versions). Raises MitsubaError, SceneError.

    aovs: of REFERENCE_AOVS. variant: of Mitsuba, default the one that works best here. timeout: in seconds.
    """
    check_names(aovs)
    rays = shared_rays(scene)
    lights = not {"diffuse", "albedo"}.isdisjoint(aovs)
    result = trace_reference(scene, model_of(scene, rays), rays, variant=variant, lights=lights, timeout=timeout)
    if isinstance(result, Crash):
        raise MitsubaError(result.message)
    window = film_window(scene)
    return aovs_of(result, rays, (window.height, window.width), aovs), result.answer.versions

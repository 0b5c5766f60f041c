"""What Mitsuba sees along our rays, in the type and under the names of our own pictures."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from caster.aovs import AOVS
from caster.rendering import Aovs
from caster.scene import Scene
from mitsuba_ref.export import export, shape_ids
from mitsuba_ref.jobs import Answer, Crash, Job
from mitsuba_ref.model import Model, reference_of
from mitsuba_ref.rays import SharedRays
from mitsuba_ref.variants import variant_for
from mitsuba_ref.worker import DEFAULT_TIMEOUT, Ask, ask

# What the reference can tell, of all that the caster can.
GIVEN = (
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
class Witness:
    """Mitsuba's answer about a scene. Arrays are float64, one row a ray."""

    answer: Answer
    t: np.ndarray  # (n,) lengths of d, inf on a miss
    shape_id: np.ndarray  # (n,) int32 index of the scene's shape, -1 on a miss
    unshadowed: np.ndarray  # (lights, n, 3) what each light would give without shadows
    visible: np.ndarray  # (lights, n) bool
    ambient: np.ndarray  # (n, 3)

    @property
    def hit(self) -> np.ndarray:
        """(n,) bool. A NaN counts as a hit: Mitsuba says so, and it has to be noticed."""
        return ~np.isposinf(self.t)

    @property
    def diffuse(self) -> np.ndarray:
        """(n, 3) radiance of all lights that are visible, and the ambient one."""
        return np.where(self.visible[..., None], self.unshadowed, 0.0).sum(axis=0) + self.ambient


def wants_light(aovs: Sequence[str]) -> bool:
    """Whether these AOVs need Mitsuba's lights or materials."""
    return "diffuse" in aovs or "albedo" in aovs


def variant_of(scene: Scene) -> str:
    """The variant to ask about this scene."""
    return variant_for(any(reference_of(shape).analytic for shape in scene.shapes))


def consult(
    scene: Scene,
    model: Model,
    rays: SharedRays,
    *,
    variant: str | None = None,
    lights: bool = True,
    timeout: float = DEFAULT_TIMEOUT,
    ask: Ask = ask,
) -> Witness | Crash:
    """Ask Mitsuba about these rays, by `ask`. A crash of it is an answer, too."""
    with tempfile.TemporaryDirectory(prefix="mitsuba-ref-") as folder:
        xml = export(scene, model).write(Path(folder))
        job = Job(xml, variant or variant_of(scene), rays.o, rays.d, rays.t_max, lights=lights, sensor=True)
        answer = ask(job, timeout)
    return answer if isinstance(answer, Crash) else witness(scene, answer)


def witness(scene: Scene, answer: Answer) -> Witness:
    """The answer in the scene's own terms."""
    place = {name: index for index, name in enumerate(shape_ids(scene))}
    table = np.array([*(place.get(name, -1) for name in answer.names), -1], np.int32)
    radiance = np.zeros(3)
    for light in scene.lights:
        if light.type == "ambient":
            radiance = radiance + np.array(light.radiance)
    visible = answer.light_visible if scene.shading.shadows else np.ones_like(answer.light_visible)
    return Witness(
        answer,
        answer.t.astype(np.float64),
        table[answer.shape],
        answer.light_rgb.astype(np.float64),
        visible,
        answer.albedo.astype(np.float64) * radiance,
    )


def aovs_of(witness: Witness, rays: SharedRays, shape: tuple[int, int], names: Sequence[str] = GIVEN) -> Aovs:
    """The witness as pictures of (height, width), misses as the caster writes them."""
    answer, hit = witness.answer, witness.hit
    length = np.linalg.norm(rays.d.astype(np.float64), axis=1)
    flat = {
        "hit": hit,
        "depth": rays.start + witness.t * length,
        "normal": answer.n,
        "shading_normal": answer.sh_n,
        "position": answer.p,
        "uv": answer.uv,
        "albedo": answer.albedo,
        "diffuse": witness.diffuse,
        "shape_id": witness.shape_id,
        "prim_id": answer.prim,
    }
    misses = {aov.NAME: aov.MISS for aov in AOVS}
    images = {}
    for name in names:
        values = flat[name] if flat[name].dtype.kind != "f" else flat[name].astype(np.float64)
        there = hit if values.ndim == 1 else hit[:, None]
        images[name] = (
            np.where(there, values, misses[name]).astype(values.dtype).reshape(shape + values.shape[1:])
        )
    return Aovs(images, hit.reshape(shape))

"""A scene brought before the judge: both sides' answers along the same rays."""

from caster.scene import Scene
from mitsuba_ref.jobs import Crash
from mitsuba_ref.judge import Judge
from mitsuba_ref.model import model_of
from mitsuba_ref.pair import our_view, pair_up
from mitsuba_ref.rays import SharedRays, share
from mitsuba_ref.reference import consult
from mitsuba_ref.worker import DEFAULT_TIMEOUT, Ask, ask


def judge_of(
    scene: Scene, *, whole: SharedRays | None = None, timeout: float = DEFAULT_TIMEOUT, ask: Ask = ask
) -> Judge | Crash:
    """The judge of the film's window, or how Mitsuba ended without an answer.

    whole: the rays that stand-ins are cut to, if they are others than the window's own. ask: the way to Mitsuba.
    Raises SceneError for a scene that cannot be judged.
    """
    rays = share(scene)
    view = our_view(scene, rays)
    model = model_of(scene, view.packed, rays if whole is None else whole)
    witness = consult(scene, model, rays, timeout=timeout, ask=ask)
    if isinstance(witness, Crash):
        return witness
    return Judge(scene, model, pair_up(scene, rays, view, witness))

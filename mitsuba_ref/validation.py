"""A scene through both sides to its verdict."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from caster.rendering import Aovs
from caster.scene import Scene, load_scene
from mitsuba_ref.jobs import Crash
from mitsuba_ref.judge import CODE, Judge, Judgement
from mitsuba_ref.model import model_of
from mitsuba_ref.pair import Pair, our_view, pair_up
from mitsuba_ref.pictures import write_pictures
from mitsuba_ref.pixels import flat
from mitsuba_ref.rays import share
from mitsuba_ref.reference import consult
from mitsuba_ref.scene_checks import CHECKS_WITHOUT_REFERENCE, check_sensor
from mitsuba_ref.verdict import AGREE, CLASSES, SHOWN, UNDECIDED, Failure, SceneVerdict, Verdict, pixel_of
from mitsuba_ref.worker import DEFAULT_TIMEOUT


def validate(scene: Scene | str | Path, *, timeout: float = DEFAULT_TIMEOUT) -> Verdict:
    """Compare our caster with Mitsuba on one scene, given as a Scene or as the path of its file.

    Raises SceneError for a scene that is not valid, FileMissing where there is none, MissingReferenceError for a shape
    without a reference. A crash of Mitsuba is a verdict that does not pass.
    """
    if isinstance(scene, Scene):
        return Verdict((validate_scene(scene, "scene", timeout=timeout),))
    return Verdict((validate_scene(load_scene(scene), Path(scene).stem, str(scene), timeout=timeout),))


def validate_scene(
    scene: Scene,
    name: str,
    path: str = "",
    *,
    folder: Path | None = None,
    timeout: float = DEFAULT_TIMEOUT,
) -> SceneVerdict:
    """The verdict of one scene that is loaded. folder: where the pictures of both sides go."""
    start = time.perf_counter()
    rays = share(scene)
    view = our_view(scene, rays)
    model = model_of(scene, view.packed, rays)
    checks = tuple(check(scene) for check in CHECKS_WITHOUT_REFERENCE)
    witness = consult(scene, model, rays, timeout=timeout)
    size = (scene.film.width, scene.film.height)
    if isinstance(witness, Crash):
        problem = f"Mitsuba ended without an answer ({witness.exit}): {witness.words}".strip()
        seconds = time.perf_counter() - start
        return SceneVerdict(
            name, path, len(rays.o), checks=checks, problem=problem, seconds=seconds, size=size
        )
    pair = pair_up(scene, rays, view, witness)
    judgement = Judge(scene, model, pair).judge()
    if folder:
        write_pictures(folder, name, scene, pair, judgement)
    hit = pair.ours.hit.ravel() | pair.witness.hit
    return SceneVerdict(
        name,
        path,
        len(rays.o),
        hit_pixels=int(hit.sum()),
        counts=_counts(judgement, hit),
        ratios=_ratios(judgement),
        checks=(*checks, check_sensor(scene, witness)),
        failures=tuple(_failures(scene, pair, judgement)),
        versions=witness.answer.versions,
        seconds=time.perf_counter() - start,
        reference_seconds=witness.answer.seconds,
        size=size,
        allowed={name: check.ratio for name, check in scene.checks.items()},
    )


def _counts(judgement: Judgement, hit: np.ndarray) -> dict[str, int]:
    """Hit pixels of each class; an undecided pixel counts, whether anybody hit there or not."""
    counted = hit | (judgement.classes == CODE[UNDECIDED])
    numbers = np.bincount(judgement.classes[counted], minlength=len(CLASSES))
    return dict(zip(CLASSES, map(int, numbers), strict=True))


def _ratios(judgement: Judgement) -> dict[str, float]:
    """The largest ratio of each check among the pixels that agree."""
    agreeing = judgement.classes == CODE[AGREE]
    return {name: float(judgement.ratio(name)[agreeing].max(initial=0.0)) for name in judgement.names}


def _failures(scene: Scene, pair: Pair, judgement: Judgement) -> Sequence[Failure]:
    """The worst of the pixels that nothing explains."""
    rows = np.flatnonzero(judgement.classes == CODE[UNDECIDED])
    excess = np.array([judgement.excess(name)[rows] for name in judgement.names])
    order = np.argsort(-excess.max(axis=0), kind="stable")[:SHOWN]
    return [_failure(scene, pair, judgement, int(rows[j]), int(np.argmax(excess[:, j]))) for j in order]


def _failure(scene: Scene, pair: Pair, judgement: Judgement, i: int, worst: int) -> Failure:
    x, y = pixel_of(scene, i)
    check = judgement.names[worst]
    ratio = float(judgement.ratio(check)[i])
    reason = "beyond what float32 rounding allows Mitsuba to answer"
    if ratio <= 1.0:
        reason = f"beyond the share of the bound that [check.{check}] allows"
    elif judgement.ours_fails[i]:
        reason = "beyond what float64 rounding allows our caster to answer"
    elif check == "diffuse":
        reason = "no shadow that rounding allows gives this value"
    ours, reference = (_words(scene, aovs, check, i) for aovs in (pair.ours, pair.reference))
    return Failure(x, y, check, ratio, ours, reference, reason)


def _words(scene: Scene, aovs: Aovs, check: str, i: int) -> str:
    """What one side says: the shape and its depth, and the value that was compared."""
    shape = int(flat(aovs, "shape_id")[i])
    name = scene.shape_names()[shape] if shape >= 0 else "miss"
    words = f"{name} at depth {float(flat(aovs, 'depth')[i])!r}"
    if check in ("normal", "shading_normal", "diffuse"):
        value = ", ".join(f"{v:.9g}" for v in flat(aovs, check)[i])
        words += f", {check} ({value})"
    return words

"""The registry of the checks of a scene other than those of pixels: each module here registers its own with `@check`.

The pipeline, the command line, the pytest plug-in and docs/method.md read names and properties from this registry.
"""

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, wraps
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from caster.scene.model import Scene
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.reference.shared_input import pixel_of

Found = tuple[float, str]  # ratio and text of a SceneCheck
Results = Found | Iterator[Found] | None  # of several, the worst counts
Make = Callable[..., SceneCheck | None]
Scope = Literal["run", "scene", "window"]

NOT_JUDGED = "not judged"  # begins the text of a check that could not be made, which becomes a note of the verdict
OURS, CANDIDATE = "ours", "candidate"  # whose answers a check is made of
ANSWERED = {"result", "loaded", "subject", "failing", "judge", "biases"}  # known once both sides have answered


class Check(NamedTuple):
    """A registered check. Its parameters name the inputs that it needs (judge/pipeline.py); it may return None."""

    name: str  # in a verdict
    make: Make
    needs: tuple[str, ...]
    of: tuple[str, ...]
    scope: Scope  # made once a run, once a scene, or for each window of a large film
    camera: bool  # needs the camera's rays: not made for a list of rays
    thorough: bool  # tests our caster beyond the judged film, by kernels that the film does not need

    @property
    def answered(self) -> bool:
        """Whether it needs the answers."""
        return not ANSWERED.isdisjoint(self.needs)


_registered: dict[str, Check] = {}


def check(
    *, of: tuple[str, ...] = (OURS, CANDIDATE), scope: Scope = "scene", camera: bool = False, thorough: bool = False
) -> Callable[[Callable[..., Results]], Make]:
    """Register a function `check_NAME` as the check NAME, which its result is given; it may yield several."""

    def register(function: Callable[..., Results]) -> Make:
        name = function.__name__.removeprefix("check_")
        needs = tuple(inspect.signature(function).parameters)

        @wraps(function)
        def make(*inputs: Any, **named: Any) -> SceneCheck | None:
            found = function(*inputs, **named)
            if isinstance(found, Iterator):
                found = worst_share(found)
            return found and SceneCheck(name, *found)

        _registered[name] = Check(name, make, needs, of, scope, camera, thorough)
        return make

    return register


@cache
def all_checks() -> tuple[Check, ...]:
    """Every check in the order of execution: of the scene alone, then of the answers."""
    for module in iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    return tuple(sorted(_registered.values(), key=lambda each: (each.answered, each.make.__module__)))


def checks_of(
    whose: str,
    scopes: Iterable[Scope] = get_args(Scope),
    *,
    thorough: bool = False,
    camera: bool = True,
    secondary: bool = False,
) -> tuple[Check, ...]:
    """The checks of OURS or a CANDIDATE.

    thorough: include those beyond the judged film; camera: include those that need the camera's rays. secondary: those
    of the rays of a bounce, and no others.
    """
    return tuple(
        each
        for each in all_checks()
        if whose in each.of
        and (thorough or not each.thorough)
        and each.scope in scopes
        and (camera or not each.camera)
        and secondary == ("bounce" in each.needs)
    )


def make_checks(checks: Iterable[Check], inputs: Mapping[str, Any]) -> tuple[SceneCheck, ...]:
    """The results of the checks, except None."""
    return tuple(filter(None, (each.make(**{name: inputs[name] for name in each.needs}) for each in checks)))


def run_checks(subject: Any) -> tuple[SceneCheck, ...]:
    """The checks of a candidate that are made once a run, whatever the scenes; none without a candidate."""
    return make_checks(checks_of(CANDIDATE, ["run"]), {"subject": subject}) if subject is not None else ()


# ---- what several checks share ----


def worst_share(shares: Iterable[Found]) -> Found:
    """The largest of the errors over their bounds and its place; one that is infinite or NaN ends the search."""
    worst: Found | None = None
    for share in shares:
        if worst is None or not share[0] <= worst[0]:
            worst = share
        if not share[0] < np.inf:
            break
    return worst or (0.0, "nothing to look at")


def bits_differ(a: Array, b: Array) -> Array:
    """Where two arrays of one shape and type have other bits, as bool."""
    return np.ascontiguousarray(a).view(f"u{a.itemsize}") != np.ascontiguousarray(b).view(f"u{b.itemsize}")


def worst_pixel(shares: dict[str, Array], scene: Scene, among: Array | bool = True) -> Found:
    """The largest of all shares, with its pixel; one that is not a number counts as infinite."""
    table = np.where(among, np.nan_to_num([*shares.values()], nan=np.inf, posinf=np.inf), 0.0)
    part, pixel = np.unravel_index(int(np.argmax(table)), table.shape)
    return float(table[part, pixel]), f"{list(shares)[part]} at {pixel_of(scene, int(pixel))}"

"""One pixel under the lens: both answers, the bound of each quantity, and every primitive that may be hit."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from caster.rendering import Aovs
from caster.scene import Scene
from caster.wording import SceneError
from mitsuba_ref.bracket import latest_hits
from mitsuba_ref.jobs import Crash
from mitsuba_ref.judge import Judge, Judgement
from mitsuba_ref.model import model_of
from mitsuba_ref.pair import COMPARED, our_view, pair_up
from mitsuba_ref.pixels import flat
from mitsuba_ref.rays import share
from mitsuba_ref.reference import consult
from mitsuba_ref.verdict import AGREE, CLASSES, EXPLAINED, OUT_OF_DOMAIN, UNDECIDED, number

SHOWN = 12  # primitives on the terminal; --json has all


@dataclass(frozen=True)
class Possible:
    """A primitive that float32 rounding may let the ray hit, and where."""

    shape: str
    prim: int  # within its shape
    t: float
    t_error: float
    certain: bool


@dataclass(frozen=True)
class PixelVerdict:
    """What became of one pixel, and why."""

    x: int
    y: int
    verdict: str
    ray: dict[str, Any]
    ours: dict[str, Any]
    reference: dict[str, Any]
    ratios: dict[str, float]
    possible: tuple[Possible, ...]
    versions: dict[str, str]
    problem: str = ""
    why: str = ""

    @property
    def ok(self) -> bool:
        return not self.problem and self.verdict != UNDECIDED

    def to_dict(self) -> dict[str, Any]:
        """For JSON; infinite numbers become text."""
        plain: dict[str, Any] = _json_safe({**asdict(self), "ok": self.ok})
        return plain


def probe(scene: Scene, x: int, y: int) -> PixelVerdict:
    """Judge one pixel. Raises SceneError for one outside the film."""
    film = scene.film
    if not (0 <= x < film.width and 0 <= y < film.height):
        inside = f"0 <= x < {film.width} and 0 <= y < {film.height}"
        raise SceneError(f"pixel ({x}, {y}): outside the film, expected {inside}")
    whole = share(scene.with_film(crop=(0, 0, film.width, film.height)))  # stand-ins are cut to all rays
    scene = scene.with_film(crop=(x, y, x + 1, y + 1))
    rays = share(scene)
    view = our_view(scene, rays)
    model = model_of(scene, view.packed, whole)
    witness = consult(scene, model, rays)
    ray = {name: _numbers(getattr(rays, name)[0]) for name in ("o", "d", "t_max", "start")}
    if isinstance(witness, Crash):
        problem = f"Mitsuba ended without an answer ({witness.exit}): {witness.words}"
        return PixelVerdict(x, y, UNDECIDED, ray, {}, {}, {}, (), {}, problem)
    pair = pair_up(scene, rays, view, witness)
    judge = Judge(scene, model, pair)
    judgement = judge.judge()
    return PixelVerdict(
        x,
        y,
        CLASSES[int(judgement.classes[0])],
        ray,
        _answer(scene, pair.ours, pair.t),
        _answer(scene, pair.reference, witness.t),
        _ratios(judgement),
        tuple(_possible(scene, judge)),
        witness.answer.versions,
        why=OURS_FAILS if judgement.ours_fails[0] else WHY[CLASSES[int(judgement.classes[0])]],
    )


WHY = {
    AGREE: "every quantity is within its bound",
    EXPLAINED: "rounding allows both answers: ours by the bracket of float64, Mitsuba's by that of float32",
    OUT_OF_DOMAIN: "float32 cannot resolve this pixel; ours is right by float64",
    UNDECIDED: "Mitsuba's answer is beyond what float32 allows, or no shadow gives our diffuse value",
}
OURS_FAILS = "ours is beyond what float64 rounding allows"


def _answer(scene: Scene, aovs: Aovs, t: np.ndarray) -> dict[str, Any]:
    shape = int(flat(aovs, "shape_id")[0])
    values = {name: _numbers(flat(aovs, name)[0]) for name in COMPARED if name != "shape_id"}
    return {"shape": scene.shape_names()[shape] if shape >= 0 else "miss", "t": _numbers(t[0]), **values}


def _ratios(judgement: Judgement) -> dict[str, float]:
    return {name: float(judgement.ratio(name)[0]) for name in judgement.names}


def _possible(scene: Scene, judge: Judge) -> Iterator[Possible]:
    """Every primitive that the reference may hit, nearest first."""
    rays, bracket, packed = judge.pair.rays, judge.theirs, judge.model.packed
    t_max = rays.t_max.astype(np.float64)
    found = bracket.possible_hits(rays.o.astype(np.float64), rays.d.astype(np.float64), t_max)
    certain = np.isfinite(latest_hits(found, t_max))
    shape, prim = packed.shape_of(found.prim), packed.number_in_shape(found.prim)
    names = scene.shape_names()
    for i in np.argsort(found.at.t, kind="stable"):
        yield Possible(
            names[shape[i]], int(prim[i]), float(found.at.t[i]), float(found.at.t_error[i]), bool(certain[i])
        )


def _numbers(values: Any) -> Any:
    return np.asarray(values, np.float64).tolist()


def as_text(found: PixelVerdict, path: str) -> str:
    """For a terminal."""
    return "\n".join(_lines(found, path))


def _lines(found: PixelVerdict, path: str) -> Iterator[str]:
    yield f"pixel ({found.x}, {found.y}) of {path}: {found.verdict}"
    if found.problem:
        yield found.problem
        return
    yield f"why        {found.why}"
    for name, value in found.ray.items():
        yield f"ray        {name:<16}{_both(value)}"
    for name in found.ours:
        yield f"ours       {name:<16}{_both(found.ours[name])}"
        yield f"reference  {'':<16}{_both(found.reference[name])}"
    for name, ratio in found.ratios.items():
        yield f"bound      {name:<16}{ratio:.3g} of it is used"
    yield f"possible   {len(found.possible)} primitives, t and how far float32 may be off in it:"
    for each in found.possible[:SHOWN]:
        mark = "certain" if each.certain else ""
        yield f"           {each.t!r:<22} +- {each.t_error:<10.3g} {each.shape}, prim {each.prim} {mark}".rstrip()
    if len(found.possible) > SHOWN:
        yield f"           and {len(found.possible) - SHOWN} more (--json lists them)"
    yield f"reference  {', '.join(f'{name} {version}' for name, version in found.versions.items())}"


def _both(value: Any) -> str:
    """Decimal, and hex to the bit."""
    if isinstance(value, str):
        return value
    values = value if isinstance(value, list) else [value]
    return f"{'  '.join(map(repr, values))}   {'  '.join(float(v).hex() for v in values)}"


def _json_safe(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _json_safe(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_safe(each) for each in value]
    return number(value) if isinstance(value, float) else value

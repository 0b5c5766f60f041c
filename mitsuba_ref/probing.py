"""One pixel under the lens: both answers, the bound of each quantity, and every primitive that may be hit."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from caster.rendering import Aovs
from caster.scene import Scene
from caster.wording import SceneError
from mitsuba_ref.bracket import latest_hits
from mitsuba_ref.exact import ExactAnswer
from mitsuba_ref.jobs import Crash
from mitsuba_ref.judge import Judge, Judgement
from mitsuba_ref.judging import judge_of
from mitsuba_ref.pair import COMPARED
from mitsuba_ref.pixels import flat
from mitsuba_ref.rays import SharedRays, share
from mitsuba_ref.reasons import reason
from mitsuba_ref.telling import TIES_SHOWN, asked, members
from mitsuba_ref.verdict import CLASSES, FAILING, UNDECIDED, UNLISTED, number
from mitsuba_ref.witnesses import Saying, lines, recorded, sayings

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
    exact: dict[str, Any]
    ratios: dict[str, float]
    possible: tuple[Possible, ...]
    versions: dict[str, str]
    problem: str = ""
    why: str = ""
    case: str = ""  # where the reference is wrong: the number of the known case, or "unlisted"
    witnesses: tuple[Saying, ...] = ()  # ours, exact, and Mitsuba in each of its variants and modes

    @property
    def ok(self) -> bool:
        return not self.problem and self.verdict not in FAILING and self.case != UNLISTED

    def to_dict(self) -> dict[str, Any]:
        """For JSON; infinite numbers become text."""
        witnesses = [recorded(each) for each in self.witnesses]
        plain: dict[str, Any] = _json_safe({**asdict(self), "witnesses": witnesses, "ok": self.ok})
        return plain


class Probed(NamedTuple):
    """What a pixel's verdict rests on: a picture of this one pixel."""

    judge: Judge
    judgement: Judgement


def probe(scene: Scene, x: int, y: int) -> PixelVerdict:
    """Judge one pixel. Raises SceneError for one outside the film."""
    return examine(scene, x, y)[0]


def examine(scene: Scene, x: int, y: int) -> tuple[PixelVerdict, Probed | Crash]:
    """The same, with what it rests on."""
    film = scene.film
    if not (0 <= x < film.width and 0 <= y < film.height):
        inside = f"0 <= x < {film.width} and 0 <= y < {film.height}"
        raise SceneError(f"pixel ({x}, {y}): outside the film, expected {inside}")
    whole = share(scene.with_film(crop=(0, 0, film.width, film.height)))  # stand-ins are cut to all rays
    scene = scene.with_film(crop=(x, y, x + 1, y + 1))
    judge = judge_of(scene, whole=whole)
    if isinstance(judge, Crash):
        problem = f"Mitsuba ended without an answer ({judge.exit}): {judge.words}"
        return PixelVerdict(x, y, UNDECIDED, _ray(share(scene)), {}, {}, {}, {}, (), {}, problem), judge
    pair, judgement = judge.pair, judge.judge()
    exact = asked(judge, judgement, 0)
    found = PixelVerdict(
        x,
        y,
        CLASSES[int(judgement.classes[0])],
        _ray(pair.rays),
        _answer(scene, pair.ours, pair.t),
        _answer(scene, pair.reference, pair.witness.t),
        _exact(judge, exact),
        _ratios(judgement),
        tuple(_possible(scene, judge)),
        pair.witness.answer.versions,
        why=reason(judge, judgement, 0),
        case=_case(judgement),
        witnesses=sayings(judge, exact) if judge.t_max[0] >= 0.0 else (),
    )
    return found, Probed(judge, judgement)


def _case(judgement: Judgement) -> str:
    if 0 not in judgement.cases:
        return ""
    case = judgement.cases[0]
    return UNLISTED if case is None else str(case)


def _ray(rays: SharedRays) -> dict[str, Any]:
    return {name: _numbers(getattr(rays, name)[0]) for name in ("o", "d", "t_max", "start")}


def _exact(judge: Judge, answer: ExactAnswer | None) -> dict[str, Any]:
    """The third witness; empty where there is no ray or no answer."""
    if answer is None:
        return {}
    ties = [each._asdict() for each in members(judge.scene, judge.model.packed, answer)]
    t = np.inf if answer.t is None else float(answer.t)
    return {"hit": answer.hit, "t": t, "t_hex": t.hex(), "ties": ties, "flags": sorted(answer.flags)}


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
    yield from _exact_lines(found.exact)
    yield from lines(found.witnesses)
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


def _exact_lines(exact: dict[str, Any]) -> Iterator[str]:
    """What exact arithmetic says: t, what is hit there, and what else the ray met."""
    if not exact:
        yield "exact      no answer"
        return
    yield f"exact      t               {_both(exact['t'])}" if exact["hit"] else "exact      miss"
    for tie in exact["ties"][:TIES_SHOWN]:
        yield f"           hit             {tie['shape']}, prim {tie['prim']} ({tie['where']})"
    if len(exact["ties"]) > TIES_SHOWN:
        yield f"           and {len(exact['ties']) - TIES_SHOWN} more at the same t (--json lists them)"
    if exact["flags"]:
        yield f"           on the way      {', '.join(exact['flags'])}"


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

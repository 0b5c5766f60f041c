"""The verdict on one pixel with its evidence, as JSON and as text for a terminal."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from typing import Any

from caster.system.terminal import folded
from mitsuba_ref.judge.explanations import decimal_and_hex
from mitsuba_ref.judge.verdict import AGREE, FAILING, UNLISTED, json_number
from mitsuba_ref.probe.witnesses import WIDEST_NAME, WitnessAnswer, witness_lines

Json = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Explained:
    """The class of one ray, and why."""

    verdict: str
    why: str = ""
    case: str = ""  # where the reference is wrong: the number of the known case, or "unlisted"
    problem: str = ""  # why there is nothing to judge

    @property
    def ok(self) -> bool:
        return not self.problem and self.verdict not in FAILING and self.case != UNLISTED


@dataclass(frozen=True, kw_only=True)
class CandidatePixel(Explained):
    """The verdict on one pixel of a candidate."""

    name: str
    precision: str = ""  # by whose bounds it is judged
    says: Mapping[str, Any] = field(default_factory=dict)  # hit, t, depth, normal, if given
    notes: tuple[str, ...] = ()
    witness: WitnessAnswer | None = None  # its row among the witnesses


@dataclass(frozen=True, kw_only=True)
class PathRay(Explained):
    """One secondary ray and its verdict."""

    path: str  # a letter for each bounce, such as RTS
    answers: tuple[str, ...] = ()  # as text: the subject's, the reference's, the exact one


@dataclass(frozen=True, kw_only=True)
class PixelVerdict(Explained):
    """The verdict on one pixel, and its reasons."""

    x: int
    y: int
    ray: Json
    ours: Json = field(default_factory=dict)
    reference: Json = field(default_factory=dict)
    exact: Json = field(default_factory=dict)
    ratios: dict[str, float] = field(default_factory=dict)  # error over bound, of what was judged
    versions: dict[str, str] = field(default_factory=dict)
    witnesses: tuple[WitnessAnswer, ...] = ()  # a candidate, ours, exact, Mitsuba in each of its variants and modes
    candidate: CandidatePixel | None = None  # if one was requested
    path: tuple[PathRay, ...] | None = None  # its secondary rays, if they were requested

    def __str__(self) -> str:
        """The text of `mitsuba-ref probe`."""
        return as_text(self, "the scene")

    @property
    def ok(self) -> bool:
        """Whether our answer, Mitsuba's and the candidate's, if there is one, are explained."""
        return super().ok and all(each.ok for each in (self.candidate, *(self.path or ())) if each is not None)

    def to_dict(self) -> Json:
        """For JSON; infinite numbers become text."""
        return dict(_json_value(self))


def _json_value(value: Any) -> Any:
    if is_dataclass(value):
        value = vars(value) | ({"ok": value.ok} if isinstance(value, Explained) else {})
    if isinstance(value, Mapping):
        return {key: _json_value(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_value(each) for each in value]
    return json_number(value) if isinstance(value, float) else value


# ---- for a terminal


def as_text(found: PixelVerdict, path: str, *, brief: bool = False) -> str:
    """The verdict as text for a terminal. brief: without the numbers behind it."""
    return folded("\n".join(_lines(found, path, brief)))


def _lines(found: PixelVerdict, path: str, brief: bool) -> Iterator[str]:
    yield from _head(found, path)
    if found.problem:
        yield found.problem
        return
    yield "\nwho is right"
    yield f"  exact: {found.exact.get('text', 'no answer')}"
    yield from witness_lines(found.witnesses)
    yield from (f"  note: {note}" for note in (found.candidate.notes if found.candidate else ()))
    if found.path is not None:
        yield from path_lines(found.path)
    if brief:
        return
    yield "\nthe ray"
    for name, value in found.ray.items():
        yield from _value_lines(name, value)
    yield "\nt, in lengths of d"
    hits = [each for each in found.witnesses if math.isfinite(each.t)]
    yield from (f"  {each.who:<{WIDEST_NAME}}  {decimal_and_hex(each.t)}" for each in hits)
    sides: dict[str, Mapping[str, Any]] = {"ours": found.ours, "reference": found.reference}
    sides |= {"candidate": found.candidate.says} if found.candidate else {}
    for name in [name for name in found.ours if name not in ("hit", "shape", "t")]:
        yield f"\n{name}"
        for who, values in sides.items():
            if name in values:
                yield from _value_lines(who, values[name])
    yield "\nshare of each bound that our error uses"
    for name, ratio in found.ratios.items():
        yield f"  {name:<16}{ratio:.3g}" if math.isfinite(ratio) else f"  {name:<16}no bound allows this"
    yield f"\nreference: {', '.join(f'{name} {version}' for name, version in found.versions.items())}"


def _head(found: PixelVerdict, path: str) -> Iterator[str]:
    """Classes with their reasons, the candidate's first if there is one."""
    place, theirs = f"pixel ({found.x}, {found.y}) of {path}", found.candidate
    yield f"{place}: {(theirs or found).verdict}"
    if theirs is None:
        if not found.problem:
            yield f"why:       {found.why}"
        return
    held = f", held to the bounds of {theirs.precision}" if theirs.precision else ""
    yield f"candidate: {theirs.name}{held}"
    first, *rest = (theirs.problem or theirs.why).splitlines() or [""]
    yield f"why:       {first}"
    yield from (f"           {line}" for line in rest)
    yield f"ours:      {found.verdict}: {found.why}"


def _value_lines(name: str, value: Any) -> Iterator[str]:
    """Decimal, and hex to the bit, which has a line of its own unless there is just one number."""
    values = value if isinstance(value, list) else [value]
    decimals, bits = " ".join(map(repr, values)), " ".join(float(each).hex() for each in values)
    gap = "  " if len(values) == 1 else "\n    "
    yield f"  {name:<11}{decimals}{gap}{bits}"


LEGEND = "\nsecondary rays by their paths: R reflected, T refracted, S to a light"


def path_lines(rays: Sequence[PathRay]) -> Iterator[str]:
    """A line for each ray; where the answers do not agree, all of them."""
    yield LEGEND if rays else "\nno secondary rays"
    width = max((len(each.path) for each in rays), default=0)
    for each in rays:
        answer, *others = *each.answers, each.problem or each.why
        yield f"  {each.path:<{width}}  {each.verdict.replace('_', ' ')}: {answer}"
        if each.verdict != AGREE:
            names = ("Mitsuba:", "exact:", "why:")
            yield from (f"  {'':<{width}}    {name:<8} {words}" for name, words in zip(names, others, strict=False))

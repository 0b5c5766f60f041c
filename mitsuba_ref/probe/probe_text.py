"""One pixel under the lens, for a terminal."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from mitsuba_ref.judge.formatting import MAX_TIES_SHOWN
from mitsuba_ref.probe.candidate_pixel import CANDIDATE_QUANTITIES, CandidatePixel
from mitsuba_ref.probe.pixel import PixelVerdict
from mitsuba_ref.probe.witnesses import witness_lines

MAX_PRIMS_SHOWN = 12  # primitives; --json has all


def as_text(found: PixelVerdict, path: str) -> str:
    """What --json has, in lines."""
    return "\n".join(_lines(found, path))


def _lines(found: PixelVerdict, path: str) -> Iterator[str]:
    yield from _head(found, path)
    if found.problem:
        yield found.problem
        return
    for name, value in found.ray.items():
        yield f"ray        {name:<16}{_decimal_and_hex(value)}"
    yield from _exact_lines(found.exact)
    yield from witness_lines(found.witnesses)
    for name in found.ours:
        for who, value in _sides(found, name).items():
            yield f"{who:<11}{name if who == 'ours' else '':<16}{_decimal_and_hex(value)}"
    if found.candidate is not None and not found.candidate.problem:
        yield from _candidate_lines(found.candidate)
    yield from _bound_lines("bound", found.ratios, found.not_judged)
    yield f"possible   {len(found.possible)} primitives, t and how far float32 may be off in it:"
    for each in found.possible[:MAX_PRIMS_SHOWN]:
        mark = "certain" if each.certain else ""
        yield f"           {each.t!r:<22} +- {each.t_error:<10.3g} {each.shape}, prim {each.prim} {mark}".rstrip()
    if len(found.possible) > MAX_PRIMS_SHOWN:
        yield f"           and {len(found.possible) - MAX_PRIMS_SHOWN} more (--json lists them)"
    yield f"reference  {', '.join(f'{name} {version}' for name, version in found.versions.items())}"


def _head(found: PixelVerdict, path: str) -> Iterator[str]:
    """The classes, and why: the candidate's first, where there is one."""
    place, theirs = f"pixel ({found.x}, {found.y}) of {path}", found.candidate
    if theirs is None:
        yield f"{place}: {found.verdict}"
        if not found.problem:
            yield f"why        {found.why}"
        return
    yield f"{place}: {theirs.verdict}"
    held = f", held to the bounds of {theirs.precision}" if theirs.precision else ""
    yield f"candidate  {theirs.name}{held}"
    first, *rest = (theirs.problem or theirs.why).splitlines() or [""]
    yield f"why        {first}"
    yield from (f"           {line}" for line in rest)
    yield f"ours       {found.verdict}: {found.why}"


def _sides(found: PixelVerdict, name: str) -> dict[str, Any]:
    """One quantity as each witness has it."""
    theirs = found.candidate.says if found.candidate is not None else {}
    sides = {"ours": found.ours[name], "reference": found.reference[name]}
    if name == "shape" and theirs:
        sides["candidate"] = "a hit" if theirs["hit"] else "miss"
    elif name in CANDIDATE_QUANTITIES and name in theirs:
        sides["candidate"] = theirs[name]
    return sides


def _candidate_lines(theirs: CandidatePixel) -> Iterator[str]:
    """How far it is from the exact answer, and what of its bounds that is."""
    off = theirs.off
    if off:
        ulps = "" if off["t_ulps"] is None else f", {off['t_ulps']:+.3g} ulps of {theirs.precision}"
        yield f"off        t               {off['t']:.3g}{ulps}, {off['t_share']:.3g} of its bound"
    if "normal" in off:
        yield f"off        normal          {off['normal']:.3g} of its length, {off['normal_share']:.3g} of its bound"
        yield f"exact hit  normal          {_decimal_and_hex(off['exact_normal'])}"
    if theirs.alone:
        first, *rest = theirs.alone.splitlines()
        yield f"alone      for this ray alone, the candidate returns {first}"
        yield from (f"           {line}" for line in rest)
    yield from _bound_lines("its bound", theirs.ratios, theirs.not_judged)
    yield from (f"note       {note}" for note in theirs.notes)


def _bound_lines(head: str, ratios: Mapping[str, float], not_judged: Mapping[str, str]) -> Iterator[str]:
    for name, ratio in ratios.items():
        used = f"{ratio:.3g} of it is used" if math.isfinite(ratio) else "no bound allows this"
        yield f"{head:<11}{name:<16}{used}"
    for name, why in not_judged.items():
        yield f"{head:<11}{name:<16}not judged: {why}"


def _exact_lines(exact: dict[str, Any]) -> Iterator[str]:
    """The exact answer: t, what is hit there, and the other intersections of the ray."""
    if not exact:
        yield "exact      no answer"
        return
    yield f"exact      t               {_decimal_and_hex(exact['t'])}" if exact["hit"] else "exact      miss"
    for tie in exact["ties"][:MAX_TIES_SHOWN]:
        yield f"           hit             {tie['shape']}, prim {tie['prim']} ({tie['where']})"
    if len(exact["ties"]) > MAX_TIES_SHOWN:
        yield f"           and {len(exact['ties']) - MAX_TIES_SHOWN} more at the same t (--json lists them)"
    if exact["flags"]:
        yield f"           on the way      {', '.join(exact['flags'])}"


def _decimal_and_hex(value: Any) -> str:
    """Decimal, and hex to the bit."""
    if isinstance(value, str):
        return value
    values = value if isinstance(value, list) else [value]
    return f"{'  '.join(map(repr, values))}   {'  '.join(float(v).hex() for v in values)}"

"""Mitsuba in a child process: an abort, a hang or a refusal in there is a result here."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mitsuba_ref.reference import subprocess_runner, variants
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse

DEFAULT_TIMEOUT = 300.0  # seconds; a scene of 256 x 256 pixels takes one to three


# A way to Mitsuba: (what is asked, seconds it may take) -> what came of it.
SendRequest = Callable[[TraceRequest, float], TraceResponse | Crash]


def send_request(job: TraceRequest, timeout: float = DEFAULT_TIMEOUT) -> TraceResponse | Crash:
    """Ask Mitsuba about one scene; returns within `timeout` seconds, and leaves neither process nor file."""
    return subprocess_runner.run_request(job, timeout, variants.environment_for(job.variant))


def send_requests(
    jobs: Sequence[TraceRequest], timeout: float = DEFAULT_TIMEOUT
) -> list[TraceResponse | Crash]:
    """Ask about several scenes in one child; only what ends without an answer is asked again, by halves.

    jobs: of one variant, without lights and sensor. `seconds` of each answer are those of the whole child.
    """
    if len(jobs) == 1:
        return [send_request(jobs[0], timeout)]
    answer = send_request(merge_requests(jobs), timeout)
    if isinstance(answer, TraceResponse):
        return split_response(answer, [len(job.o) for job in jobs])
    half = len(jobs) // 2
    return [*send_requests(jobs[:half], timeout), *send_requests(jobs[half:], timeout)]


def merge_requests(jobs: Sequence[TraceRequest]) -> TraceRequest:
    """One job of several."""
    firsts = np.cumsum([len(job.o) for job in jobs]).tolist()
    more = tuple((job.xml, first) for job, first in zip(jobs[1:], firsts, strict=False))
    rays: dict[str, Any] = {
        name: np.concatenate([getattr(job, name) for job in jobs]) for name in TraceRequest.ROWS
    }
    return replace(jobs[0], more=more, **rays)


def merge_responses(answers: Sequence[TraceResponse]) -> TraceResponse:
    """One answer of several; with more than one, names begin with the number of the scene."""
    first, *rest = answers
    if not rest:
        return first
    rows: dict[str, Any] = {
        name: np.concatenate([getattr(answer, name) for answer in answers]) for name in TraceResponse.ROWS
    }
    starts = np.cumsum([0, *(len(answer.names) for answer in answers)])
    owner = np.repeat(np.arange(len(answers)), [len(answer.t) for answer in answers])
    rows["shape"] = np.where(rows["shape"] < 0, -1, rows["shape"] + starts[owner]).astype(np.int32)
    names = [f"{i}:{name}" for i, answer in enumerate(answers) for name in answer.names]
    lit: dict[str, Any] = {
        name: np.concatenate([getattr(answer, name) for answer in answers], axis=1) for name in LIGHT_ARRAYS
    }
    seconds = sum(answer.seconds for answer in answers)
    return replace(first, names=names, seconds=seconds, **rows, **lit)


LIGHT_ARRAYS = ("light_rgb", "light_visible")  # (lights, n, ...): their second axis counts the rays


def split_response(answer: TraceResponse, counts: Sequence[int]) -> list[TraceResponse | Crash]:
    """`joined`, undone: the answers about so many rays each."""
    found: list[TraceResponse | Crash] = []
    scene_of = np.array([int(name.partition(":")[0]) for name in answer.names], int)
    for i, stop in enumerate(np.cumsum(counts).tolist()):
        rows = slice(stop - counts[i], stop)
        own = np.flatnonzero(scene_of == i)
        arrays: dict[str, Any] = {name: getattr(answer, name)[rows] for name in TraceResponse.ROWS}
        first = own[0] if len(own) else 0
        arrays["shape"] = np.where(arrays["shape"] < 0, -1, arrays["shape"] - first).astype(np.int32)
        names = [answer.names[j].partition(":")[2] for j in own]
        lit: dict[str, Any] = {name: getattr(answer, name)[:, rows] for name in LIGHT_ARRAYS}
        found.append(replace(answer, names=names, **arrays, **lit))
    return found


def main(folder: Path) -> int:
    """The child's side: read the job in `folder`, write the answer there. 1 where Mitsuba says no."""
    _die_with_parent()
    try:
        from mitsuba_ref.reference import (
            mitsuba_process,  # here, so that asking needs no Mitsuba in this process
        )

        answer = merge_responses(
            [mitsuba_process.trace_request(piece) for piece in TraceRequest.read(folder).per_scene()]
        )
    except (RuntimeError, ImportError) as refusal:
        print(refusal, file=sys.stderr)
        return 1
    answer.write(folder)
    return 0


def _die_with_parent() -> None:
    """Linux kills this process with the one that asked, even if that one was killed itself."""
    import ctypes
    import signal

    if sys.platform == "linux":
        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))

"""Mitsuba sessions: requests to child processes, in which an abort, a hang or a refusal is a result."""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from caster.system.atomic_files import ScratchFolder
from mitsuba_ref.reference import messages, variants
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse, crash_of, response_in
from mitsuba_ref.reference.subprocess_runner import (
    ProcessEnd,
    ProcessEnded,
    ResidentProcess,
    die_with_parent,
    import_path,
    serve,
)

DEFAULT_TIMEOUT = 300.0  # seconds; a scene of 256 x 256 pixels takes one to three
START_SECONDS = 60.0  # allowed for importing Mitsuba, beside the time of the first scene

SERVE = "--serve"  # of the child's command line: a resident one
DONE, REFUSED = "done", "refused"  # its replies

# A way to Mitsuba: (request, timeout in seconds) -> response
SendRequest = Callable[[TraceRequest, float], TraceResponse | Crash]


def send_request(request: TraceRequest, timeout: float = DEFAULT_TIMEOUT) -> TraceResponse | Crash:
    """Trace rays through one scene; returns within `timeout` seconds, and leaves neither process nor file."""
    return messages.run_request(request, timeout, variants.environment_for(request.variant))


def send_requests(
    requests: Sequence[TraceRequest], timeout: float = DEFAULT_TIMEOUT
) -> list[TraceResponse | Crash]:
    """Trace rays through several scenes in one child; what ends without a response is sent again, by halves.

    requests: of one variant, without lights and sensor. `seconds` of each response are those of the whole child.
    """
    if len(requests) == 1:
        return [send_request(requests[0], timeout)]
    response = send_request(merge_requests(requests), timeout)
    if isinstance(response, TraceResponse):
        return split_response(response, [len(request.o) for request in requests])
    half = len(requests) // 2
    return [*send_requests(requests[:half], timeout), *send_requests(requests[half:], timeout)]


def merge_requests(requests: Sequence[TraceRequest]) -> TraceRequest:
    """One request of several."""
    firsts = np.cumsum([len(request.o) for request in requests]).tolist()
    more = tuple((request.xml, first) for request, first in zip(requests[1:], firsts, strict=False))
    rays: dict[str, Any] = {
        name: np.concatenate([getattr(request, name) for request in requests]) for name in TraceRequest.ROWS
    }
    return replace(requests[0], more=more, **rays)


def merge_responses(responses: Sequence[TraceResponse]) -> TraceResponse:
    """One response of several; with more than one, names begin with the number of the scene."""
    first, *rest = responses
    if not rest:
        return first
    rows: dict[str, Any] = {
        name: np.concatenate([getattr(response, name) for response in responses])
        for name in TraceResponse.ROWS
    }
    starts = np.cumsum([0, *(len(response.names) for response in responses)])
    owner = np.repeat(np.arange(len(responses)), [len(response.t) for response in responses])
    rows["shape"] = np.where(rows["shape"] < 0, -1, rows["shape"] + starts[owner]).astype(np.int32)
    names = [f"{i}:{name}" for i, response in enumerate(responses) for name in response.names]
    lit: dict[str, Any] = {
        name: np.concatenate([getattr(response, name) for response in responses], axis=1)
        for name in LIGHT_ARRAYS
    }
    seconds = sum(response.seconds for response in responses)
    return replace(first, names=names, seconds=seconds, **rows, **lit)


LIGHT_ARRAYS = ("light_rgb", "light_visible")  # (lights, n, ...): their second axis counts the rays


def split_response(response: TraceResponse, counts: Sequence[int]) -> list[TraceResponse | Crash]:
    """The inverse of `merge_responses`: responses to so many rays each."""
    found: list[TraceResponse | Crash] = []
    scene_of = np.array([int(name.partition(":")[0]) for name in response.names], int)
    for i, stop in enumerate(np.cumsum(counts).tolist()):
        rows = slice(stop - counts[i], stop)
        own = np.flatnonzero(scene_of == i)
        arrays: dict[str, Any] = {name: getattr(response, name)[rows] for name in TraceResponse.ROWS}
        first = own[0] if len(own) else 0
        arrays["shape"] = np.where(arrays["shape"] < 0, -1, arrays["shape"] - first).astype(np.int32)
        names = [response.names[j].partition(":")[2] for j in own]
        lit: dict[str, Any] = {name: getattr(response, name)[:, rows] for name in LIGHT_ARRAYS}
        found.append(replace(response, names=names, **arrays, **lit))
    return found


class ResidentSession:
    """One process of each variant that stays, for many small scenes: starting one takes ten times as long as a scene.

    A process may die at any scene; then that scene's response is a Crash, and the next scene gets a new process.
    Usable as a context.
    """

    def __init__(self) -> None:
        self.processes: dict[str, ResidentProcess] = {}

    def __enter__(self) -> "ResidentSession":
        return self

    def __exit__(self, *_: object) -> None:
        for process in self.processes.values():
            process.close()
        self.processes = {}

    def send(self, request: TraceRequest, timeout: float = 60.0) -> TraceResponse | Crash:
        """The response to one request; a first one may take START_SECONDS more."""
        process = self.processes.get(request.variant)
        allowed = timeout
        with ScratchFolder() as name:
            request.write(Path(name))
            try:
                if process is None or not process.alive:
                    process, allowed = self._started(request.variant), timeout + START_SECONDS
                begin = time.monotonic()
                reply = process.request(name, allowed)
            except ProcessEnded as ended:
                return crash_of(ended.end, timeout)
            end = ProcessEnd(0 if reply == DONE else 1, process.output, time.monotonic() - begin)
            return response_in(Path(name), request, end) if reply == DONE else crash_of(end, timeout)

    def _started(self, variant: str) -> ResidentProcess:
        if variant in self.processes:
            self.processes[variant].close()
        environment = {**variants.environment_for(variant), "PYTHONPATH": import_path()}
        process = ResidentProcess([*messages.CHILD_COMMAND, SERVE], environment=environment)
        self.processes[variant] = process
        return process


def main(folder: Path) -> int:
    """The child's side of one request: read it in `folder`, write the response there. 1 where Mitsuba refuses it."""
    try:
        from mitsuba_ref.reference import mitsuba_process

        pieces = TraceRequest.read(folder).per_scene()
        response = merge_responses([mitsuba_process.trace_request(piece) for piece in pieces])
    except (RuntimeError, ImportError) as refusal:
        print(refusal, file=sys.stderr, flush=True)
        return 1
    response.write(folder)
    return 0


def serve_folders(replies: int) -> None:
    """The child's side of a ResidentSession: answer folder after folder. replies: the pipe's descriptor."""
    serve(lambda folder: REFUSED if main(Path(folder)) else DONE, replies)


if __name__ == "__main__":
    if sys.argv[1] == SERVE:
        serve_folders(int(sys.argv[2]))
    else:
        die_with_parent()
        sys.exit(main(Path(sys.argv[1])))

"""Mitsuba processes: where Mitsuba is started, and where an abort, a hang or a refusal is the result of a request.

A process that stays answers request after request: starting one takes ten times as long as a small scene. Nothing
that it says but a whole response counts: after a crash, a time-out, a refusal or garbage the request is sent once
more, to a process of its own, and the end of that one is the result.
"""

import atexit
import contextlib
import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from caster.system.atomic_files import ScratchFolder
from caster.system.process import die_with_parent
from mitsuba_ref.reference import messages, variants
from mitsuba_ref.reference.answer_store import local_store, request_key, stored_response
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.subprocess_runner import ProcessEnded, ResidentProcess, import_path, serve

DEFAULT_TIMEOUT = 300.0  # seconds; a scene of 256 x 256 pixels takes one to three

SERVE = "--serve"  # of the child's command line: a resident one
DONE, REFUSED = "done", "refused"  # its replies, each before the folder of the request
IDLE_SECONDS = 60.0  # without a request, after which a resident process ends by itself
RESIDENT_BYTES = 1 << 30  # of memory, above which it is replaced; 200 MB are usual

# Of the environment: what changes without any part in what Mitsuba does. pytest sets it anew for every test.
UNUSED_VARIABLES = frozenset({"PYTEST_CURRENT_TEST"})

# A way to Mitsuba: (request, timeout in seconds) -> response
SendRequest = Callable[[TraceRequest, float], TraceResponse | Crash]


def send_alone(request: TraceRequest, timeout: float = DEFAULT_TIMEOUT) -> TraceResponse | Crash:
    """Trace rays in a process of their own; returns within `timeout` seconds, and leaves neither process nor file."""
    return messages.run_request(request, timeout, variants.environment_for(request.variant))


def send_request(request: TraceRequest, timeout: float = DEFAULT_TIMEOUT) -> TraceResponse | Crash:
    """Trace rays through one scene, in a resident process that no other thread uses meanwhile.

    Residents are of this process alone, not of its forks, and end with it or after IDLE_SECONDS. `timeout` is for each
    of the two processes that may be needed.
    """
    session = _idle_sessions.pop() if _idle_sessions else ResidentSession()
    try:
        return session.send(request, timeout)
    finally:
        _idle_sessions.append(session)


def send_stored(request: TraceRequest, timeout: float = DEFAULT_TIMEOUT) -> TraceResponse | Crash:
    """The stored response to the same request, marked so, or else that of `send_request`, which is then stored."""
    store = local_store()
    key = request_key(request) if store else ""
    if store is None or not key:
        return send_request(request, timeout)
    stored = stored_response(store, key, len(request.o))
    if stored is not None:
        return stored
    response = send_request(request, timeout)
    if isinstance(response, TraceResponse):
        store.put(key, response.to_bytes())
    return response


_idle_sessions: list["ResidentSession"] = []


@atexit.register
def close_residents() -> None:
    """End the resident processes of `send_request` that are idle."""
    while _idle_sessions:
        _idle_sessions.pop().close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle_sessions.clear)


def send_requests(requests: Sequence[TraceRequest], timeout: float = DEFAULT_TIMEOUT) -> list[TraceResponse | Crash]:
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
        name: np.concatenate([getattr(response, name) for response in responses]) for name in TraceResponse.ROWS
    }
    starts = np.cumsum([0, *(len(response.names) for response in responses)])
    owner = np.repeat(np.arange(len(responses)), [len(response.t) for response in responses])
    rows["shape"] = np.where(rows["shape"] < 0, -1, rows["shape"] + starts[owner]).astype(np.int32)
    names = [f"{i}:{name}" for i, response in enumerate(responses) for name in response.names]
    lit: dict[str, Any] = {
        name: np.concatenate([getattr(response, name) for response in responses], axis=1) for name in LIGHT_ARRAYS
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
    """One process of each variant that stays; it is replaced when it ends, when it is large, or in another environment.

    Usable as a context.
    """

    def __init__(self) -> None:
        self.processes: dict[str, ResidentProcess] = {}
        self._environments: dict[str, dict[str, str]] = {}  # that the processes were started in

    def __enter__(self) -> "ResidentSession":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all processes."""
        for process in self.processes.values():
            process.close()
        self.processes = {}

    def send(self, request: TraceRequest, timeout: float = 60.0) -> TraceResponse | Crash:
        """The response to one request; each of the two processes that may be needed may take `timeout`."""
        response = self._resident_response(request, timeout)
        return send_alone(request, timeout) if response is None else response

    def _resident_response(self, request: TraceRequest, timeout: float) -> TraceResponse | None:
        """What the resident process responds; None for a refusal, or where it is closed because it did not respond."""
        with ScratchFolder() as name, contextlib.ExitStack() as on_failure:
            request.write(Path(name))
            try:
                process = self._process(request.variant)
                on_failure.callback(process.close)  # also after Ctrl-C: it may be amid a request
                status, _, of = process.request(name, timeout).partition(" ")
                if of != name or status not in (DONE, REFUSED):
                    return None
                response = TraceResponse.read(Path(name), len(request.o)) if status == DONE else None
            except (ProcessEnded, ValueError):
                return None
            on_failure.pop_all()
            return response

    def _process(self, variant: str) -> ResidentProcess:
        """The resident process of a variant, started if need be. Raises ProcessEnded while starts are refused."""
        environment = {**variants.environment_for(variant), "PYTHONPATH": import_path()}
        complete = {name: os.environ[name] for name in os.environ.keys() - UNUSED_VARIABLES} | environment
        process = self.processes.get(variant)
        if process and process.alive and self._environments[variant] == complete:
            return process
        if process:
            process.close()
        process = ResidentProcess([*messages.CHILD_COMMAND, SERVE], environment=environment)
        self.processes[variant], self._environments[variant] = process, complete
        return process


def main(folder: Path) -> int:
    """The child's side of one request: read it in `folder`, write the response there. 1 where Mitsuba refuses it."""
    try:
        from mitsuba_ref.reference import mitsuba_calls

        pieces = TraceRequest.read(folder).per_scene()
        response = merge_responses([mitsuba_calls.trace_request(piece) for piece in pieces])
    except (RuntimeError, ImportError) as refusal:
        print(refusal, file=sys.stderr, flush=True)
        return 1
    response.write(folder)
    return 0


def replies(folders: Iterator[str]) -> Iterator[str]:
    """The child's side of a ResidentSession: one reply a folder, until its memory has grown."""
    for folder in folders:
        yield f"{REFUSED if main(Path(folder)) else DONE} {folder}"
        gc.collect()
        if resident_bytes() > RESIDENT_BYTES:
            return


def resident_bytes() -> int:
    """Memory of this process; where the system does not show it, the most that it ever had."""
    import resource  # POSIX alone

    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def run_child(arguments: Sequence[str]) -> int:
    """The whole of a child process: requests until none comes, or the one in a folder; its exit code."""
    if arguments[0] == SERVE:
        serve(replies, int(arguments[1]), IDLE_SECONDS)
        return 0
    die_with_parent()
    return main(Path(arguments[0]))


if __name__ == "__main__":
    code = run_child(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    # Without the end of the interpreter: what Dr.Jit does there has been seen to run on, with all said and written.
    os._exit(code)

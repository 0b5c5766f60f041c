"""Mitsuba processes: where Mitsuba is started, and where an abort, a hang or a refusal becomes the result of a request.

A resident process answers request after request: starting one takes ten times as long as a small scene. After a crash,
a time-out, a refusal or a malformed response, the request is sent once more, to a new process, and the end of that
process is the result.
"""

import atexit
import contextlib
import gc
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from mitsuba_ref.reference import messages, variants
from mitsuba_ref.reference.interpreter import PYTHON_VARIABLE, file_stamp
from mitsuba_ref.reference.messages import Crash, OpenRequest, TraceRequest, TraceResponse, start
from mitsuba_ref.reference.store import REFERENCE_SETTINGS, environment_settings, key_of, local_store, machine
from mitsuba_ref.reference.subprocess_runner import ProcessEnded, ResidentProcess, serve

DEFAULT_TIMEOUT = 300.0  # seconds; a scene of 256 x 256 pixels takes one to three

IDLE_SECONDS = 60.0  # without a request, after which a resident process ends by itself
RESIDENT_BYTES = 1 << 30  # of memory, above which it is replaced; 200 MB are usual

Request = TraceRequest | OpenRequest

# A way to Mitsuba: (request, timeout in seconds) -> response
SendRequest = Callable[[TraceRequest, float], TraceResponse | Crash]


def send_request(request: Request, timeout: float = DEFAULT_TIMEOUT) -> Any:
    """The response to one request, or a Crash, of a resident process that no other thread uses at the same time.

    Resident processes belong to this process, not to its forks, and end with it or after IDLE_SECONDS. `timeout` holds
    for each of the two processes that may be needed.
    """
    response = ask_resident(request, timeout)
    return response or messages.run_request(request, timeout, variants.environment_for(request.variant))


def ask_resident(request: Request, timeout: float) -> Any:
    """The response of a resident process of the same variant and environment; None if it gave none and has ended."""
    environment = variants.environment_for(request.variant)
    key = f"{request.variant} {environment} {environment_settings(*REFERENCE_SETTINGS, 'PYTHONPATH', PYTHON_VARIABLE)}"
    idle, process = _idle.setdefault(key, []), None
    with contextlib.suppress(IndexError):  # another thread may take the last one
        process = idle.pop()
    try:
        if process and not process.alive:
            process.close()
            process = None
        process = process or start(environment)
        response = messages.message_of(process.ask(request.to_bytes(), timeout))
    except (ProcessEnded, ValueError):
        if process:
            process.close()
        return None
    idle.append(process)
    return response


def send_stored(request: TraceRequest, timeout: float = DEFAULT_TIMEOUT) -> TraceResponse | Crash:
    """The stored response to an equal request, marked as stored, else that of `send_request`, which is then stored."""
    store = local_store()
    if store is None:
        return send_request(request, timeout)
    key = request_key(request)
    content = store.get(key)
    with contextlib.suppress(ValueError):
        if content is not None:
            return replace(messages.message_of(content), stored=True, seconds=0.0)
    response = send_request(request, timeout)
    if isinstance(response, TraceResponse):
        store.put(key, response.to_bytes())
    return response


# The child's side: an edit may change responses.
SOURCES = tuple(Path(__file__).with_name(name) for name in ("mitsuba_calls.py", "file_calls.py", "messages.py"))


def request_key(request: TraceRequest) -> str:
    """A hash of all that the response depends on. The files of the scene lie in its folder, as exported."""
    library = variants.environment_for(request.variant).get(variants.LIBLLVM_ENVIRONMENT_VARIABLE, "")
    exported = [] if request.original else request.xml.parent.rglob("*")  # the files of an original are in its digest
    files = [*request.mesh_files, *sorted(path for path in exported if path.is_file())]
    named = replace(request, xml=Path(request.xml.name), mesh_files=[Path(file.name) for file in request.mesh_files])
    return key_of(
        [
            repr(machine()),
            environment_settings(*REFERENCE_SETTINGS),
            *(source.read_bytes() for source in SOURCES),
            file_stamp(library),
            named.to_bytes(),
            *(part for file in files for part in (file.name, file.read_bytes())),
        ]
    )


_idle: dict[str, list[ResidentProcess]] = {}  # by variant and environment


@atexit.register
def close_residents() -> None:
    """End the resident processes that are idle."""
    for process in [process for idle in _idle.values() for process in idle]:
        process.close()
    _idle.clear()


os.register_at_fork(after_in_child=_idle.clear)


# ---- the child's side ----


def respond(content: bytes) -> bytes:
    """The response to a request. If Mitsuba refuses it, the process ends with its message on stderr."""
    try:
        from mitsuba_ref.reference import mitsuba_calls

        return mitsuba_calls.answer(messages.message_of(content)).to_bytes()
    except (RuntimeError, ImportError, UnicodeDecodeError) as refusal:
        print(refusal, file=sys.stderr, flush=True)
        os._exit(1)  # without the interpreter's cleanup, in which Dr.Jit has been seen to hang


def is_large() -> bool:
    """Whether the memory of this process has grown so much that it has to be replaced."""
    import resource  # POSIX alone

    gc.collect()
    try:
        used = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except OSError:  # where the system does not show it, the largest it ever had, or that of its parent
        used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return used > RESIDENT_BYTES


if __name__ == "__main__":
    serve(respond, IDLE_SECONDS, is_large)
    os._exit(0)

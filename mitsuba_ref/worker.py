"""Mitsuba in a child process: an abort, a hang or a refusal in there is a result here."""

import sys
from pathlib import Path

from mitsuba_ref import child, variants
from mitsuba_ref.jobs import Answer, Crash, Job

DEFAULT_TIMEOUT = 300.0  # seconds; a scene of 256 x 256 pixels takes one to three


def ask(job: Job, timeout: float = DEFAULT_TIMEOUT) -> Answer | Crash:
    """Ask Mitsuba about one scene; returns within `timeout` seconds, and leaves neither process nor file."""
    return child.put(job, timeout, variants.settings(job.variant))


def main(folder: Path) -> int:
    """The child's side: read the job in `folder`, write the answer there. 1 where Mitsuba says no."""
    _die_with_parent()
    try:
        from mitsuba_ref import door  # here, so that asking needs no Mitsuba in this process

        answer = door.answer(Job.read(folder))
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

"""Memory that judging a film needs, and memory that this process may still take."""

import resource
from collections.abc import Iterator
from pathlib import Path

from caster.description.errors import SceneError
from caster.scene.model import Scene

# Resident size of `validate` on large films, divided by the pixels of their windows: rays, answers of both sides,
# bounds and classes, in float64.
BYTES_PER_PIXEL = 1400
CGROUP_LIMITS = (
    (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")),
    (
        Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
        Path("/sys/fs/cgroup/memory/memory.usage_in_bytes"),
    ),
)


def check_memory(scene: Scene) -> None:
    """Raise SceneError with the numbers for a film that cannot be judged in the memory that is left."""
    x0, y0, x1, y1 = scene.film.window
    needed, left = (x1 - x0) * (y1 - y0) * BYTES_PER_PIXEL, available_bytes()
    if needed > left:
        raise SceneError(
            f"film: {x1 - x0} x {y1 - y0} pixels need some {needed / 1e9:.1f} GB ({BYTES_PER_PIXEL} bytes each), and "
            f"{left / 1e9:.1f} GB are left: judge a crop or a smaller film (--size W H), or fewer scenes at a time (-j)"
        )


def available_bytes() -> float:
    """The least of free memory, the limit of the control group and that of the process; inf where none is known."""
    return min(_limits(), default=float("inf"))


def _limits() -> Iterator[float]:
    for line in _text(Path("/proc/meminfo")).splitlines():
        if line.startswith("MemAvailable:"):
            yield int(line.split()[1]) * 1024.0
    for limit, used in CGROUP_LIMITS:
        numbers = _text(limit).strip(), _text(used).strip()
        if all(number.isdecimal() for number in numbers):
            yield max(float(numbers[0]) - float(numbers[1]), 0.0)
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    pages = _text(Path("/proc/self/statm")).split()
    if soft != resource.RLIM_INFINITY and pages:
        yield max(soft - int(pages[0]) * float(resource.getpagesize()), 0.0)


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""

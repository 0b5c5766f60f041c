"""The memory that is left, and the processor, as far as Mitsuba's last bits depend on it.

Embree and Dr.Jit take reciprocals from tables (rcpps, rsqrtps, rcp14) that differ between vendors and models, by code
that they choose by the features of the processor. Mitsuba's results are therefore stored with its name.
"""

import platform
from functools import cache
from pathlib import Path

__all__ = ["available_bytes", "description"]

CPUINFO = Path("/proc/cpuinfo")
CGROUP_LIMIT, CGROUP_USED = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")

# Best first, by Linux's flag names. AVX without AVX2 is no official level, but Embree has code of its own for it.
LEVELS = {
    "x86-64-v4": "avx2 fma avx512f avx512bw avx512cd avx512dq avx512vl",
    "x86-64-v3": "avx2 fma bmi1 bmi2 f16c movbe",
    "x86-64-v2 with AVX": "avx sse4_2",
    "x86-64-v2": "sse4_2 ssse3 popcnt",
    "x86-64": "",
}


@cache
def description() -> str:
    """Vendor, family, model and level, such as "AuthenticAMD family 25 model 17 (x86-64-v4)".

    Without /proc/cpuinfo: the architecture and the system's name for the processor, which may not identify the model.
    """
    cpuinfo = _text(CPUINFO)
    name = "" if cpuinfo else platform.processor()
    return described(cpuinfo, platform.machine()) + (f" ({name})" if name else "")


def described(cpuinfo: str, machine: str) -> str:
    """The same from the first processor in the text of /proc/cpuinfo, and the architecture."""
    lines = (line.partition(":") for line in cpuinfo.partition("\n\n")[0].splitlines())
    found = {key.strip(): value.strip() for key, _, value in lines}
    if "vendor_id" in found and "flags" in found:
        flags = set(found["flags"].split())
        level = next(level for level, needed in LEVELS.items() if flags.issuperset(needed.split()))
        return f"{found['vendor_id']} family {found.get('cpu family')} model {found.get('model')} ({level})"
    if "CPU implementer" in found:
        return f"{machine} implementer {found['CPU implementer']} part {found.get('CPU part')}"
    return f"{machine}, unknown model"


def available_bytes() -> float:
    """The least of the machine's available memory and of the control group's; inf if neither is known."""
    lines = (line.split() for line in _text(Path("/proc/meminfo")).splitlines())
    left = [int(words[1]) * 1024.0 for words in lines if words[:1] == ["MemAvailable:"]]
    limit, used = _text(CGROUP_LIMIT).strip(), _text(CGROUP_USED).strip()
    if limit.isdecimal() and used.isdecimal():
        left.append(max(float(limit) - float(used), 0.0))
    return min(left, default=float("inf"))


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""

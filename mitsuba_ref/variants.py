"""Which of Mitsuba's variants work on this machine, found by trying them in a child process."""

import glob
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from caster.wording import SceneError
from mitsuba_ref.smoke_test import smoke_test

SCALAR, LLVM = KNOWN = ("scalar_rgb", "llvm_ad_rgb")
CHOICE = "MITSUBA_REF_VARIANT"  # environment variable: use this one for every scene
LIBRARY = "DRJIT_LIBLLVM_PATH"  # environment variable of Dr.Jit

SOURCES = tuple(Path(__file__).with_name(name) for name in ("variants.py", "smoke_test.py"))

# Dr.Jit takes the first it finds, which may be one whose code generator aborts. Newest first instead.
LIBRARIES = (
    f"{sys.prefix}/lib/libLLVM*.so*",
    "/usr/lib/*-linux-gnu*/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
)


class VariantError(SceneError):
    """The variant that was chosen does not exist or does not work here."""


@dataclass(frozen=True)
class Variants:
    """What works here. `libllvm`: the library that the LLVM variant works with; `why`: why others do not."""

    scalar: bool
    llvm: bool
    libllvm: str | None
    why: str

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for name, works in zip(KNOWN, (self.scalar, self.llvm), strict=True) if works)


_known_here: dict[str, Variants] = {}


def usable() -> Variants:
    """What works on this machine; tried once, then remembered in the user's cache folder."""
    candidates = list(_candidates())
    key = _key(candidates)
    if key not in _known_here:
        _known_here[key] = _recall(key) or _find_out(candidates, key)
    return _known_here[key]


def variant_for(has_quadrics: bool) -> str:
    """The variant to ask about a scene: with spheres, cylinders or disks the scalar one, float64 inside.

    Raises VariantError where MITSUBA_REF_VARIANT chooses one that does not exist or does not work here.
    """
    chosen = os.environ.get(CHOICE)
    if chosen:
        return checked(chosen, CHOICE)
    return LLVM if not has_quadrics and usable().llvm else SCALAR


def settings(variant: str) -> dict[str, str]:
    """The environment variables under which a child process finds the libLLVM that works."""
    library = usable().libllvm if variant == LLVM else None
    return {LIBRARY: library} if library else {}


def checked(chosen: str, option: str) -> str:
    """The variant that an option or environment variable chose. Raises VariantError if it is none or does not work."""
    if chosen not in KNOWN:
        raise VariantError(f"{option} {chosen!r}: expected {' or '.join(KNOWN)}")
    if chosen not in usable().names:
        raise VariantError(f"{option} {chosen!r}: it does not work here: {usable().why}")
    return chosen


def _candidates() -> Iterator[str]:
    """Paths to try: only the user's own, if there is one; else every libLLVM, the newest first."""
    if os.environ.get(LIBRARY):
        return iter([os.environ[LIBRARY]])
    own = filter(None, os.environ.get("LD_LIBRARY_PATH", "").split(":"))
    places = [*LIBRARIES, *(f"{folder}/libLLVM*.so*" for folder in own)]
    found = {os.path.realpath(path) for place in places for path in glob.glob(place)}
    return iter(sorted(filter(_is_library, found), key=_version, reverse=True))


def _is_library(path: str) -> bool:
    """Whether it is the whole of LLVM, and not a part or a fork of it."""
    name = re.fullmatch(r"libLLVM([-.][\d.]+)?\.(so|dylib)[\d.]*", Path(path).name)
    return name is not None and os.path.isfile(path)


def _version(path: str) -> tuple[list[int], str]:
    return [int(number) for number in re.findall(r"\d+", Path(path).name)], path


def _key(candidates: list[str]) -> str:
    """Everything that the outcome depends on."""
    parts = [*(file.read_text(encoding="utf-8") for file in SOURCES), platform.node(), platform.machine()]
    parts += [os.environ.get(LIBRARY, ""), _installed("mitsuba"), _installed("drjit")]
    for path in candidates:
        parts += [path, *_stamp(path)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _installed(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def _stamp(path: str) -> list[str]:
    try:
        status = os.stat(path)
    except OSError:
        return ["missing"]
    return [str(status.st_size), str(status.st_mtime_ns)]


def _find_out(candidates: list[str], key: str) -> Variants:
    """Try scalar, then LLVM with one library after the other. A time-out is not remembered."""
    scalar = smoke_test(SCALAR, {})
    problems = [f"{SCALAR}: {scalar}"] if scalar else []
    library = None
    for path in candidates:
        problem = smoke_test(LLVM, {LIBRARY: path})
        if not problem:
            library = path
            break
        problems.append(f"{path}: {problem}")
    if not candidates:
        problems.append("no libLLVM found")
    found = Variants(not scalar, library is not None, library, "; ".join(problems))
    if found.scalar and "timeout" not in found.why:  # a busy machine, perhaps
        _remember(key, found)
    return found


def _file(key: str) -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(home) / "caster" / "variants" / f"{key}.json"


def _recall(key: str) -> Variants | None:
    """What was found last time; None where that is not known, or cannot be read."""
    try:
        values: dict[str, Any] = json.loads(_file(key).read_text(encoding="utf-8"))
        found = Variants(**values)
    except (OSError, ValueError, TypeError):
        return None
    return found if found.scalar is True and _sensible(found) else None


def _sensible(found: Variants) -> bool:
    return isinstance(found.why, str) and found.llvm is isinstance(found.libllvm, str)


def _remember(key: str, found: Variants) -> None:
    file = _file(key)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{os.getpid()}")
        part.write_text(json.dumps(asdict(found)), encoding="utf-8")
        os.replace(part, file)
    except OSError:  # it costs the next process a second or two
        pass

"""Store of Mitsuba's responses: what was answered once to the very same request is not asked again.

A response is kept under a hash of all that it depends on: rays, the exported scene to the byte, variant, what is asked
for, the processor, the versions of Mitsuba, Dr.Jit and libLLVM, and the sources that ask. Each is checked when it is
read; one that is damaged is asked anew. Only whole responses are kept, no crash and no time-out.
"""

import contextlib
import hashlib
import os
import platform
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple, Protocol

from caster.system import processor
from caster.system.atomic_files import distrust, read_sealed, write_sealed
from mitsuba_ref.reference import messages, variants
from mitsuba_ref.reference.messages import TraceRequest, TraceResponse

STORE_VARIABLE = "MITSUBA_REF_STORE"  # a folder, or OFF
LIMIT_VARIABLE = "MITSUBA_REF_STORE_MB"  # how large it may become, in 10^6 bytes
OFF = "off"
DEFAULT_LIMIT_MB = 1000  # 130 films of 256 x 256
SUFFIX = ".answer"

# The child's side, whose edits are other answers.
SOURCES = (Path(__file__).with_name("mitsuba_calls.py"), Path(messages.__file__))
OUTSIDE = re.compile(r'="(/|~|[A-Za-z]:|[^"]*\.\.[/\\])')  # a value of XML that may name a file of another folder


class AnswerStore(Protocol):
    """Where answers are kept. Neither method raises; a store of several machines needs no more than these two."""

    def get(self, key: str) -> bytes | None:
        """What was kept under a key, to the bit; None where there is nothing, or nothing to be trusted."""

    def put(self, key: str, content: bytes) -> None:
        """Keep content under a key; it may be dropped at any time."""


class StoreUse(NamedTuple):
    """What a folder of answers holds."""

    answers: int
    size: int  # bytes


class StoreFolder:
    """Answers as sealed files of one folder, of this user alone. The least recently used ones make room for others."""

    def __init__(self, folder: Path, limit: int) -> None:
        """limit: bytes of all files."""
        self.folder, self.limit = folder, limit

    def get(self, key: str) -> bytes | None:
        path = self.folder / f"{key}{SUFFIX}"
        try:
            content = None if self.refusal() else read_sealed(path)
            os.utime(path)  # used
        except FileNotFoundError:
            return None
        except (OSError, ValueError):  # another user's, or damaged: asked anew
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        return content

    def put(self, key: str, content: bytes) -> None:
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError:
            return
        if not self.refusal() and len(content) < self.limit:
            self._make_room(len(content))
            write_sealed(self.folder / f"{key}{SUFFIX}", content)

    def refusal(self) -> str:
        """Why nothing in it is used, "" where it may be: what another user may have written is no answer."""
        with contextlib.suppress(FileNotFoundError):
            return distrust(self.folder.stat())
        return ""

    def use(self) -> StoreUse:
        files = list(self._files())
        return StoreUse(len(files), sum(size for _, size, _ in files))

    def _files(self) -> Iterator[tuple[int, int, Path]]:
        """(time of the last use, bytes, path) of each, in any order."""
        with contextlib.suppress(OSError):
            for path in self.folder.glob(f"*{SUFFIX}"):
                with contextlib.suppress(OSError):  # another process removes it
                    found = path.stat()
                    yield found.st_mtime_ns, found.st_size, path

    def _make_room(self, needed: int) -> None:
        files = sorted(self._files())
        excess = sum(size for _, size, _ in files) + needed - self.limit
        for _, size, path in files:
            if excess <= 0:
                return
            with contextlib.suppress(OSError):
                path.unlink()
                excess -= size


def local_store() -> StoreFolder | None:
    """The store of this machine; None where STORE_VARIABLE is OFF."""
    chosen = os.environ.get(STORE_VARIABLE)
    if chosen == OFF:
        return None
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    megabytes = os.environ.get(LIMIT_VARIABLE, "")
    limit = int(megabytes) if megabytes.isdecimal() else DEFAULT_LIMIT_MB
    return StoreFolder(Path(chosen) if chosen else Path(home) / "caster" / "answers", limit * 10**6)


def stored_response(store: AnswerStore, key: str, rays: int) -> TraceResponse | None:
    """The response under a key, marked as stored; None where there is none."""
    content = store.get(key)
    try:
        found = None if content is None else TraceResponse.from_bytes(content, rays)
    except ValueError:
        return None
    return None if found is None else replace(found, stored=True, seconds=0.0)


def request_key(request: TraceRequest) -> str:
    """A hash of all that the response depends on; "" where a scene may name a file outside of its own folder."""
    digest = hashlib.sha256(request_dependencies().encode())

    def add(name: object, content: bytes) -> None:
        digest.update(f"\n{name} {len(content)}\n".encode() + content)

    library = variants.environment_for(request.variant).get(variants.LIBLLVM_ENVIRONMENT_VARIABLE, "")
    add("library", f"{library} {os.path.getsize(library) if os.path.exists(library) else ''}".encode())
    add("asked", repr((request.variant, request.lights, request.sensor, request.strict)).encode())
    for name in TraceRequest.ROWS:
        array = getattr(request, name)
        add(f"{name} {array.dtype} {array.shape}", array.tobytes())
    folders: dict[Path, int] = {}
    for xml, first in ((request.xml, 0), *request.more):
        if OUTSIDE.search(xml.read_text(encoding="utf-8")):
            return ""
        add("scene", f"{folders.setdefault(xml.parent, len(folders))} {xml.name} {first}".encode())
    for folder, number in folders.items():
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            add(f"{number} {path.relative_to(folder).as_posix()}", path.read_bytes())
    for file in request.mesh_files:
        add(f"mesh {file.name}", file.read_bytes())
    return digest.hexdigest()


@cache
def request_dependencies() -> str:
    """Versions, processor and sources that every answer depends on."""
    parts = [platform.system(), platform.machine(), processor.description()]
    parts += [variants.installed_version(name) for name in ("mitsuba", "drjit", "numpy")]
    return "\0".join([*parts, *(source.read_text(encoding="utf-8") for source in SOURCES)])

"""Verdicts of one run of pytest: each scene is judged once, whichever of xdist's workers runs its tests."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from caster.wording import SceneError

if TYPE_CHECKING:
    from mitsuba_ref.verdict import SceneVerdict


class Store:
    """folder: of this run alone, that other processes share; None where there are none."""

    def __init__(self, judge: Callable[[Path, str], SceneVerdict], folder: Path | None) -> None:
        self.judge, self.folder = judge, folder
        self.known: dict[Path, SceneVerdict | str] = {}

    def verdict_of(self, path: Path) -> SceneVerdict | str:
        """The verdict, or what is wrong with the scene file."""
        if path not in self.known:
            self.known[path] = self._judged(path) if self.folder is None else self._shared(path, self.folder)
        return self.known[path]

    def _judged(self, path: Path) -> SceneVerdict | str:
        try:
            return self.judge(path, path.stem)
        except SceneError as error:
            return str(error)

    def _shared(self, path: Path, folder: Path) -> SceneVerdict | str:
        """From the file that another process wrote, or judged and written while others wait."""
        from caster.whole_files import write_text
        from mitsuba_ref.ci.reading import scene_of

        place = folder / hashlib.sha256(str(path).encode(errors="surrogateescape")).hexdigest()
        with alone(place.with_suffix(".lock")):
            if place.exists():
                record = json.loads(place.read_text(encoding="utf-8"))
                return record if isinstance(record, str) else scene_of(record)
            found = self._judged(path)
            write_text(place, json.dumps(found if isinstance(found, str) else found.to_dict()))
            return found


@contextlib.contextmanager
def alone(path: Path) -> Iterator[None]:
    """Held by one process at a time; where the system has no such locks, everybody goes on and may judge twice."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield

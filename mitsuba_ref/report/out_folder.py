"""The folder of --out: verdict.json, images and reproducers; obsolete files of the judged scenes are removed."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

from caster.description.errors import SceneError
from caster.description.input_files import read_text
from caster.system.atomic_files import check_folder, write_text
from mitsuba_ref.judge.verdict import Verdict
from mitsuba_ref.report.results import json_text, plural

VERDICT = "verdict.json"


class OutFolder:
    """The folder of --out during a run. Raises OutputError or OSError if it cannot be written."""

    def __init__(self, folder: Path) -> None:
        """Removes the verdict of an earlier run, so that a killed run leaves none."""
        self.folder = check_folder(folder)
        self.earlier = dict(self._listed())  # scene -> its files, by the verdict.json of an earlier run
        (self.folder / VERDICT).unlink(missing_ok=True)

    def _listed(self) -> Any:
        with suppress(SceneError, ValueError, TypeError, KeyError, RecursionError):
            for scene in json.loads(read_text(self.folder / VERDICT, "verdict"))["scenes"]:
                yield str(scene["name"]), list(scene["files"])

    def finish(self, verdict: Verdict) -> str:
        """Write verdict.json and remove obsolete files of the judged scenes, such as reproducers of pixels that are no
        longer wrong; a sentence on their number. Files of other scenes stay."""
        write_text(self.folder / VERDICT, json_text(verdict))
        removed = 0
        for scene in verdict.scenes:
            for name in self.earlier.get(scene.name, ()):
                path = self.folder / str(name)
                its = name == path.name and name.startswith(f"{scene.name}.")
                if its and name not in scene.files and path.is_file():
                    path.unlink()
                    removed += 1
        return f"{self.folder}: removed {plural(removed, 'file')} of an earlier run, now obsolete" if removed else ""

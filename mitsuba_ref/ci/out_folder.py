"""The folder of --out: what a run writes there is recorded with its verdicts, what earlier runs left there goes."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from mitsuba_ref.campaign import Entry, JudgeEntry
from mitsuba_ref.verdict import SceneVerdict, Verdict
from mitsuba_ref.written import Digest, Swept, Written, remove

PICTURES = ("ours", "reference", "verdict")
VERDICT = "verdict.json"


class OutFolder:
    """Which files of the folder are of this run. Raises OutputError where nothing can be written."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.written = folder, Written(folder)

    def begin(self) -> None:
        """The verdict of an earlier run goes, since its files are about to; --resume has read it.

        A run that is killed leaves none, and not one that looks like its own. Raises OutputError.
        """
        remove(self.folder / VERDICT)

    def recorded(self, judge: JudgeEntry) -> JudgeEntry:
        """The same way to a verdict, which then says what was written for it: bytes and sha256 of each file."""

        def work(entry: Entry, folder: Path | None) -> SceneVerdict:
            return self.record(judge(entry, folder))

        return work

    def record(self, verdict: SceneVerdict) -> SceneVerdict:
        """The verdict with the files that are there for it."""
        found = self.written.add(verdict.name, files_of(verdict))
        return replace(verdict, files={file: digest.to_dict() for file, digest in found.items()})

    def has_files(self, verdict: SceneVerdict) -> bool:
        """Whether all that was written for a verdict is there to the bit; a verdict that does not say so has not."""
        return all(
            file in verdict.files and Digest(**verdict.files[file]).fits(self.folder / file)
            for file in files_of(verdict)
        )

    def sweep(self, verdict: Verdict, selected: Collection[str] | None) -> Swept:
        """Remove what earlier runs left. Spared: scenes that are not judged yet, and those of the other shards.

        selected: names of the scenes of all shards; None for a run of some scenes, which says nothing of others.
        """
        judged = {scene.name for scene in verdict.scenes}
        return self.written.sweep(
            lambda scene: scene not in judged and (selected is None or scene in selected)
        )


def files_of(verdict: SceneVerdict) -> tuple[str, ...]:
    """Names of the files that a verdict comes with; none if there was no comparison."""
    if verdict.problem:
        return ()
    pictures = ("candidate" if verdict.candidate and which == "ours" else which for which in PICTURES)
    return (*(f"{verdict.name}.{which}.exr" for which in pictures), *verdict.reproducers)

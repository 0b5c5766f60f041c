"""Public Mitsuba files judged as they are: `python benchmarks/mitsuba_files.py FOLDER...` prints a table.

Each .xml below the folders is loaded by plain Mitsuba, as a whole, and judged at 64 x 64 pixels.
"""

import subprocess
import sys
from collections import Counter
from pathlib import Path

from caster.description.errors import SceneError
from mitsuba_ref.reference.original_files import NothingToJudgeError, Opening
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry, judge_entry

PARAMETERS = ({}, {"spp": "1"})  # what include files of a sampler ask for
LOAD = """import sys, mitsuba as mi
mi.set_variant("scalar_rgb")
mi.load_file(sys.argv[1], **dict(word.split("=") for word in sys.argv[2:]))"""


def is_loaded(file: Path, parameters: dict[str, str]) -> bool:
    """Whether Mitsuba by itself loads a file, textures and all."""
    words = [f"{name}={value}" for name, value in parameters.items()]
    return subprocess.run([sys.executable, "-c", LOAD, file, *words], capture_output=True, check=False).returncode == 0


def outcome(file: Path) -> tuple[str, Counter[str]]:
    """What becomes of a file, and the classes of its pixels."""
    for parameters in PARAMETERS:
        entry = SceneEntry(file.stem, str(file), (64, 64), opening=Opening(parameters))
        try:
            scene = judge_entry(entry, JudgeOptions(store=False))
        except NothingToJudgeError:
            return "no shape", Counter()
        except SceneError as error:
            why = str(error)
            continue
        shapes = "in part" if scene.coverage and scene.coverage.partial else "all shapes"
        return f"{'pass' if scene.ok else 'FAIL'}, {shapes}", Counter(scene.counts)
    print(f"{file}: {why.splitlines()[0]}", file=sys.stderr)
    return "refused", Counter()


def main(folders: list[str]) -> None:
    rows, pixels = Counter[tuple[bool, str]](), Counter[str]()
    for file in sorted(file for folder in folders for file in Path(folder).rglob("*.xml")):
        if "<scene" in file.read_text(errors="replace"):
            loaded = any(is_loaded(file, parameters) for parameters in PARAMETERS)
            what, classes = outcome(file)
            rows[loaded, what] += 1
            pixels += classes
    for (loaded, what), count in sorted(rows.items(), reverse=True):
        print(f"{count:5} {'Mitsuba loads' if loaded else 'Mitsuba refuses'}: {what}")
    print(dict(pixels))


if __name__ == "__main__":
    main(sys.argv[1:])

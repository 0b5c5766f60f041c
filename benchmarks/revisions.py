"""Two revisions of the caster on the same scenes, taking turns: the ratio of their run times.

    python benchmarks/revisions.py REVISION [SCENE ...]

times rendering the depth of each scene (one thread, both cullings) by the sources of REVISION, a commit of this
repository, and by those of this folder. Each has a process of its own; they take turns, so that what else the machine
does hits both, and the median of the ratios counts. Time is the processor's, not the clock's.
"""

import argparse
import statistics
import subprocess
import tempfile
from contextlib import ExitStack
from pathlib import Path

from turns import DEPTH, HERE, SCENES, seconds, worker

TURNS = 9


def sources_of(revision: str, folder: Path) -> Path:
    """The caster of a commit, unpacked."""
    archive = subprocess.run(
        ["git", "archive", revision, "caster"], cwd=HERE, stdout=subprocess.PIPE, check=False
    )
    if archive.returncode:
        raise SystemExit(f"{revision}: no commit of {HERE}")
    subprocess.run(["tar", "xf", "-", "-C", str(folder)], input=archive.stdout, check=True)
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("revision")
    parser.add_argument("scenes", nargs="*")
    args = parser.parse_args()
    scenes = args.scenes or [str(HERE / "scenes" / f"{name}.toml") for name in SCENES]
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        old = stack.enter_context(worker(sources_of(args.revision, folder)))
        new = stack.enter_context(worker(HERE))
        print(f"{'scene':<24}{'culling':<10}{args.revision[:12] + ' ms':>16}{'here ms':>12}{'here / it':>12}")
        for scene in scenes:
            for culling in ("screen", "bvh"):
                pairs = [
                    (seconds(old, scene, DEPTH, culling), seconds(new, scene, DEPTH, culling))
                    for _ in range(TURNS)
                ]
                before, here = (1e3 * statistics.median(times) for times in zip(*pairs, strict=True))
                ratio = statistics.median(b / a for a, b in pairs)
                print(
                    f"{Path(scene).stem:<24}{culling:<10}{before:16.1f}{here:12.1f}{ratio:12.2f}", flush=True
                )


if __name__ == "__main__":
    main()

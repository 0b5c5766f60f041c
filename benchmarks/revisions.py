"""Two revisions of the caster on the same scenes, taking turns: the ratio of their run times.

    python benchmarks/revisions.py REVISION [SCENE ...]

times casting the camera rays of each scene (one thread, both cullings) by the sources of REVISION, a commit of this
repository, and by those of this folder. Each has a process of its own; they take turns, so that what else the machine
does hits both, and the median of the ratios counts. Time is the processor's, not the clock's.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
SCENES = (
    "one-sphere",
    "cylinders",
    "every-shape",
    "cornell-box",
    "teapot",
    "hills-131072-triangles",
    "flat-shapes",
    "two-thousand-spheres",
    "ellipsoids",
)
SIZE = 512  # pixels a side
TURNS = 9

WORKER = """
import json, sys, time
import caster
from caster.rendering import look
for line in sys.stdin:
    path, size, culling = json.loads(line)
    scene = caster.load_scene(path).with_film(width=size, height=size)
    look(scene, culling=culling, threads=1)
    start = time.thread_time()
    look(scene, culling=culling, threads=1)
    print(time.thread_time() - start, flush=True)
"""


@contextmanager
def worker(sources: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that times scenes by the caster in `sources`."""
    environment = os.environ | {"PYTHONPATH": str(sources), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-c", WORKER]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment) as process:
        yield process
        assert process.stdin
        process.stdin.close()


def seconds(process: subprocess.Popen[str], scene: str, culling: str) -> float:
    """What one process takes for one scene."""
    assert process.stdin and process.stdout
    process.stdin.write(json.dumps([scene, SIZE, culling]) + "\n")
    process.stdin.flush()
    answer = process.stdout.readline()
    if not answer:
        raise SystemExit(f"{scene}: the caster ended without an answer; its words are above")
    return float(answer)


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
                pairs = [(seconds(old, scene, culling), seconds(new, scene, culling)) for _ in range(TURNS)]
                before, here = (1e3 * statistics.median(times) for times in zip(*pairs, strict=True))
                ratio = statistics.median(b / a for a, b in pairs)
                print(
                    f"{Path(scene).stem:<24}{culling:<10}{before:16.1f}{here:12.1f}{ratio:12.2f}", flush=True
                )


if __name__ == "__main__":
    main()

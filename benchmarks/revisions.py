"""Two revisions of the caster on the same scenes, taking turns: the ratio of their run times.

    python benchmarks/revisions.py REVISION [SCENE ...] [--limit 1.25] [--turns 9]

times rendering the depth of each scene (one thread, both cullings) by the sources of REVISION, a commit of this
repository, and by those of this folder. Each has a process of its own; they take turns, so that what else the machine
does hits both, and the median of the ratios counts. Time is the processor's, not the clock's. Whatever takes more than
the limit times as long as before is timed once more, and counts as slower if it does so again.

Exit codes: 0 nothing is slower, 1 something is, 2 wrong usage, 70 a caster gave no answer.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parents[1]
SCENES = (
    "one-sphere",
    "two-thousand-spheres",
    "ellipsoids",
    "cylinders",
    "flat-shapes",
    "every-shape",
    "cornell-box",
    "teapot",
    "hills-131072-triangles",
)
SIZE = 512  # pixels a side

TURNS = 9
LIMIT = 1.25  # medians of 9 ratios on a busy machine stay within some 10 % of each other
CULLINGS = ("raster", "bvh")
OK, SLOWER, USAGE, INTERNAL = 0, 1, 2, 70

WORKER = """
import json, os, sys, time
import caster
assert caster.__file__.startswith(sys.argv[1]), caster.__file__
for line in sys.stdin:
    path, size, culling = json.loads(line)
    if culling == "raster" and not os.path.isdir(os.path.join(os.path.dirname(caster.__file__), "jit")):
        culling = "screen"  # its name in older revisions
    scene = caster.load_scene(path).with_film(width=size, height=size)
    def render():
        caster.render(scene, ("depth",), culling=culling, threads=1)
    render()
    start = time.thread_time()
    render()
    print(time.thread_time() - start, flush=True)
"""


class NoAnswer(Exception):  # noqa: N818 - what happened, whoever is to blame
    """A caster that gave no time."""


@contextmanager
def worker(sources: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that times scenes by the caster in `sources`."""
    environment = os.environ | {"PYTHONPATH": str(sources), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-c", WORKER, str(sources)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment) as process:
        assert process.stdin
        try:
            yield process
        finally:
            with suppress(BrokenPipeError):  # it died with a question unread
                process.stdin.close()


def seconds(process: subprocess.Popen[str], scene: str, culling: str) -> float:
    """What one process takes for the depth of one scene, one thread."""
    assert process.stdin and process.stdout
    with suppress(BrokenPipeError):  # no answer will come, which is reported below
        process.stdin.write(json.dumps([scene, SIZE, culling]) + "\n")
        process.stdin.flush()
    answer = process.stdout.readline()
    if not answer:
        raise NoAnswer(f"{scene}: the caster ended without an answer; its words are above")
    return float(answer)


Pairs = Sequence[tuple[float, float]]  # seconds before and here, turn by turn


class Compared(NamedTuple):
    """One scene with one culling."""

    scene: str
    culling: str
    pairs: Pairs
    again: Pairs = ()  # of the second time, where the first was beyond the limit

    def slower(self, limit: float) -> bool:
        """Whether it takes more than `limit` times as long, and so once more."""
        return ratio(self.pairs) > limit and bool(self.again) and ratio(self.again) > limit


def ratio(pairs: Pairs) -> float:
    """Here over before: the median of the turns' ratios."""
    return statistics.median(here / before for before, here in pairs)


def compare(scene: str, culling: str, limit: float, measure: Callable[[], Pairs]) -> Compared:
    """Measure, and beyond the limit once more. A NaN would pass every limit, so it is refused."""
    pairs = measure()
    if not ratio(pairs) > 0.0:
        raise NoAnswer(f"{scene}: times have to be above 0, got {list(pairs)}")
    return Compared(scene, culling, pairs, measure() if ratio(pairs) > limit else ())


def verdict(every: Sequence[Compared], limit: float) -> tuple[int, str]:
    """The exit code and the last line."""
    slower = [f"{each.scene} ({each.culling}) {ratio(each.pairs):.2f}" for each in every if each.slower(limit)]
    if not every:
        return USAGE, "nothing was compared"
    if slower:
        return SLOWER, f"slower than {limit:g} times: {', '.join(slower)}"
    return OK, f"{len(every)} comparisons, none slower than {limit:g} times"


def line(each: Compared) -> str:
    before, here = (1e3 * statistics.median(times) for times in zip(*each.pairs, strict=True))
    again = f"  again {ratio(each.again):.2f}" if each.again else ""
    return f"{Path(each.scene).stem:<24}{each.culling:<10}{before:16.1f}{here:12.1f}{ratio(each.pairs):12.2f}{again}"


def sources_of(revision: str, folder: Path) -> Path:
    """The caster of a commit, unpacked. Raises ValueError for what is none."""
    archive = subprocess.run(
        ["git", "archive", "--", revision, "caster"], cwd=HERE, stdout=subprocess.PIPE, check=False
    )
    if archive.returncode:
        raise ValueError(f"{revision}: no commit of {HERE}")
    subprocess.run(["tar", "xf", "-", "-C", str(folder)], input=archive.stdout, check=True)
    return folder


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision")
    parser.add_argument("scenes", nargs="*")
    parser.add_argument("--limit", type=float, default=LIMIT)
    parser.add_argument("--turns", type=int, default=TURNS)
    args = parser.parse_args(argv)
    if not args.limit > 0.0 or args.turns < 1:
        parser.error("--limit has to be above 0 and --turns at least 1")
    scenes = args.scenes or [str(HERE / "scenes" / f"{name}.toml") for name in SCENES]
    try:
        code, words = verdict(compared(args, scenes), args.limit)
    except ValueError as error:
        parser.error(str(error))
    except NoAnswer as error:
        code, words = INTERNAL, str(error)
    print(words, file=sys.stderr if code else sys.stdout)
    return code


def compared(args: argparse.Namespace, scenes: Sequence[str]) -> list[Compared]:
    """Every scene with both cullings, a line for each as soon as it is known."""
    every: list[Compared] = []
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        old = stack.enter_context(worker(sources_of(args.revision, folder)))
        new = stack.enter_context(worker(HERE))
        print(f"{'scene':<24}{'culling':<10}{args.revision[:12] + ' ms':>16}{'here ms':>12}{'here / it':>12}")
        for scene in scenes:
            for culling in CULLINGS:

                def measure(scene: str = scene, culling: str = culling) -> Pairs:
                    return [(seconds(old, scene, culling), seconds(new, scene, culling)) for _ in range(args.turns)]

                every.append(compare(scene, culling, args.limit, measure))
                print(line(every[-1]), flush=True)
    return every


if __name__ == "__main__":
    sys.exit(main())

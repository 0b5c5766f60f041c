"""Processes that render scenes by the caster of some folder, alternating, and time it."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

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

WORKER = """
import json, os, sys, time
import caster
assert caster.__file__.startswith(sys.argv[1]), caster.__file__
for line in sys.stdin:
    path, size, culling, aovs = json.loads(line)
    if culling == "raster" and not os.path.isdir(os.path.join(os.path.dirname(caster.__file__), "jit")):
        culling = "screen"  # its name in older revisions
    scene = caster.load_scene(path).with_film(width=size, height=size)
    def render():
        caster.render(scene, aovs, culling=culling, threads=1)
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


DEPTH = ("depth",)
BY_DEFAULT = ("hit", "depth", "normal", "position", "diffuse")  # what `caster render` writes unasked


def seconds(process: subprocess.Popen[str], scene: str, aovs: Sequence[str], culling: str | None = None) -> float:
    """What one process takes for the AOVs of one scene, one thread; no culling: as planned."""
    assert process.stdin and process.stdout
    with suppress(BrokenPipeError):  # no answer will come, which is reported below
        process.stdin.write(json.dumps([scene, SIZE, culling, aovs]) + "\n")
        process.stdin.flush()
    answer = process.stdout.readline()
    if not answer:
        raise NoAnswer(f"{scene}: the caster ended without an answer; its words are above")
    return float(answer)

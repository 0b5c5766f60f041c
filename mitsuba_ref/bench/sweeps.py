"""Time against triangles, against pixels, and against threads."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median

from caster.scene import Scene
from mitsuba_ref.bench import meshes, scenes
from mitsuba_ref.bench.contestants import BY_KEY, Contestant
from mitsuba_ref.bench.measuring import Progress, Settings, Start, start_process, time_scene
from mitsuba_ref.bench.result import SceneResult, Series, Sweep
from mitsuba_ref.bench.scenes import BenchScene

TRIANGLES = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
PIXELS = (64, 128, 256, 512, 1024, 2048, 4096)  # a side
ALWAYS, PEERS = ("ours", "raw-robust", "aov-robust"), ("open3d",)


@dataclass(frozen=True)
class Family:
    """One sweep: its settings, each a scene to time and how."""

    name: str
    quantity: str
    points: Callable[[Settings], Iterator[tuple[float, BenchScene, Settings]]]


def over_triangles(settings: Settings) -> Iterator[tuple[float, BenchScene, Settings]]:
    for count in TRIANGLES:
        scene = BenchScene(f"hills-{count}", "hills", partial(hills, count))
        yield float(count), scene, settings


def hills(triangles: int, folder: Path) -> Scene:
    return scenes.looking(meshes.hills(folder, triangles))


def over_pixels(settings: Settings) -> Iterator[tuple[float, BenchScene, Settings]]:
    for side in PIXELS:
        yield float(side * side), BenchScene("ring", "ring", scenes.ring), replace(settings, size=side)


def over_threads(settings: Settings) -> Iterator[tuple[float, BenchScene, Settings]]:
    """Powers of two, and at last all that there are."""
    counts = {2**k for k in range(settings.threads.bit_length()) if 2**k < settings.threads}
    for count in sorted(counts | {settings.threads}):
        yield float(count), BenchScene("ring", "ring", scenes.ring), replace(settings, threads=count)


FAMILIES = (
    Family("triangles", "triangles of hills", over_triangles),
    Family("pixels", "pixels of a picture of 70,224 triangles", over_pixels),
    Family("threads", "threads, for a picture of 70,224 triangles", over_threads),
)


def sweep(
    family: Family, settings: Settings, say: Progress = lambda words: None, start: Start = start_process
) -> Sweep:
    """Every setting, by the few contestants that matter most."""
    asked = [BY_KEY[key] for key in ALWAYS + (PEERS if settings.peers else ())]
    found: list[tuple[float, SceneResult]] = []
    for x, scene, here in family.points(settings):
        told = partial(_say, say, f"{family.name} {x:g}")
        found.append((x, time_scene(scene, asked, here, told, start, judged=False)))
    return Sweep(family.name, family.quantity, tuple(series(each, found) for each in asked))


def _say(say: Progress, where: str, words: str) -> None:
    say(f"{where}: {words}")


def series(contestant: Contestant, found: Sequence[tuple[float, SceneResult]]) -> Series:
    """One contestant's medians, where it ran."""
    rows = [(x, result.row(contestant.key)) for x, result in found]
    ran = [(x, row) for x, row in rows if row is not None and row.ran]
    why = "; ".join(dict.fromkeys(row.why for _, row in rows if row is not None and row.why))
    return Series(
        contestant.key,
        contestant.title,
        x=tuple(x for x, _ in ran),
        seconds=tuple(median(row.seconds) for _, row in ran),
        build=tuple(row.build or 0.0 for _, row in ran),
        why=why,
    )

"""Judge the origins of many secondary rays: ours, and of one in SHARE those of Mitsuba and of two rules of textbooks.

python benchmarks/spawned_origins.py [RAYS]: prints a table for docs/method.md; 1e7 rays of ours by default, six bounces
in scenes/glass-and-mirror.toml as it is, smaller, farther from the origin, and with a second wall in its ball of glass.
"""

import copy
import sys
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from caster.rendering.bounces import bounces
from caster.scene.model import Scene
from mitsuba_ref.judge.checks.secondary_rays import MITSUBA, RULES, LeavingRays, by_rule, judge_origins, rays_of_bounce
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.oracle.spawned_origins import OriginJudge
from mitsuba_ref.reference.mitsuba_process import send_request
from mitsuba_ref.reference.shared_input import packed_float32, shared_rays
from mitsuba_ref.subjects.subject import cast_ours

SCENE = Path(__file__).parent.parent / "scenes" / "glass-and-mirror.toml"
DEPTH, WIDTH, HEIGHT, ROWS, SHARE = 6, 2048, 1536, 8, 20
SMALL, FAR, WALL = 1e-3, 1e4, 4e-5
Data = dict[str, Any]


def placed(data: Data, scale: float, move: float) -> Data:
    """The scene scaled and then moved along x."""
    data = copy.deepcopy(data)
    points = [(data["camera"], "eye"), (data["camera"], "look_at")]
    for record, name in [*points, *((light, "position") for light in data["light"] if "position" in light)]:
        record[name] = (scale * np.array(record[name]) + [move, 0.0, 0.0]).tolist()
    for shape in data["shape"]:
        shape["to_world"] = [*shape.get("to_world", []), {"scale": scale}, {"translate": [move, 0.0, 0.0]}]
    return data


def with_wall(data: Data) -> Data:
    (ball,) = (shape for shape in data["shape"] if shape["name"] == "ball")
    return data | {"shape": [*data["shape"], ball | {"name": "wall-of-ball", "radius": ball["radius"] - WALL}]}


def main(wanted: float) -> None:
    data = tomllib.loads(SCENE.read_text(encoding="utf-8"))
    scenes = {
        "as it is": data,
        f"{SMALL:g} times as large": placed(data, SMALL, 0.0),
        f"{FAR:g} away": placed(data, 1.0, FAR),
        f"a wall of {WALL:g}": with_wall(data),
    }
    print("| scene | rule | rays | self-hit | skipped surface | wrong side | undecided |")
    print("|---|---|---:|---:|---:|---:|---:|")
    for name, scene in scenes.items():
        for rule, found in counts_in(Scene.model_validate(scene), wanted / len(scenes)).items():
            numbers = (found[what] for what in ("rays", "self-hit", "skipped surface", "wrong side", "undecided"))
            print(f"| {name} | {rule} | {' | '.join(f'{count:,}' for count in numbers)} |", flush=True)


def counts_in(scene: Scene, wanted: float) -> dict[str, Counter[str]]:
    """Counts by rule of about so many rays of ours, in bands of the film that are spread over it."""
    counts: dict[str, Counter[str]] = {name: Counter() for name in ("ours", MITSUBA, *RULES)}
    judge, bands = OriginJudge(Oracle(packed_float32(scene))), HEIGHT // ROWS
    for number in range(bands):
        first = number * 37 % bands * ROWS
        window = scene.with_film(width=WIDTH, height=HEIGHT, crop=(0, first, WIDTH, first + ROWS))
        for bounce in bounces(cast_ours(window, shared_rays(window)), DEPTH):
            leaving = rays_of_bounce(bounce)
            few = every(leaving, SHARE)
            tally(counts["ours"], leaving, judge)
            for name in (MITSUBA, *RULES):
                tally(counts[name], by_rule(few, name, send_request), judge)
        if counts["ours"]["rays"] >= wanted:
            break
    return counts


def every(leaving: LeavingRays, share: int) -> LeavingRays:
    return leaving._replace(rays=leaving.rays.rows(slice(None, None, share)))


def tally(counts: Counter[str], leaving: LeavingRays, judge: OriginJudge) -> None:
    counts.update(judge_origins(leaving, judge).counts())


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1e7)

"""Judge the origins of many secondary rays: ours, and of one in SHARE those of Mitsuba and of two rules of textbooks.

python benchmarks/spawned_origins.py [RAYS [FIRST]]: prints a table for docs/method.md, of about RAYS of ours (1e7 by default) from
band FIRST of the film on, so that a long run can be made in pieces.
"""

import sys
from collections import Counter
from pathlib import Path

import numpy as np

from caster.rendering.bounces import bounces
from caster.scene.files import load_scene
from mitsuba_ref.judge.origin_rules import RULES, LeavingRays, judge_origins, rays_of_bounce, reference_rays
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.oracle.spawned_origins import OriginJudge
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import send_request
from mitsuba_ref.reference.shared_input import packed_float32, shared_rays
from mitsuba_ref.subjects.subject import cast_ours

SCENE = Path(__file__).parent.parent / "scenes" / "glass-and-mirror.toml"
DEPTH, ROWS, SHARE = 6, 8, 20


def main(wanted: float, first: int = 0) -> None:
    counts: dict[str, Counter[str]] = {name: Counter() for name in ("ours", "mitsuba", *RULES)}
    scene, width = load_scene(SCENE), 2048
    height, row = 3 * width // 4, first
    judge = OriginJudge(Oracle(packed_float32(scene)))
    while counts["ours"]["rays"] < wanted and row < height // ROWS:
        band = row * 37 % (height // ROWS)  # spread over the film
        window = scene.with_film(width=width, height=height, crop=(0, band * ROWS, width, (band + 1) * ROWS))
        for bounce in bounces(cast_ours(window, shared_rays(window)), DEPTH):
            leaving = rays_of_bounce(bounce)
            few = every(leaving, SHARE)
            tally(counts["ours"], leaving, judge)
            if isinstance(by_mitsuba := reference_rays(few, send_request), Crash):
                raise SystemExit(by_mitsuba.message)
            tally(counts["mitsuba"], by_mitsuba, judge)
            for name, rule in RULES.items():
                tally(counts[name], few.by(rule), judge)
        row += 1
        print(f"{row} bands, {counts['ours']['rays']} rays", file=sys.stderr, flush=True)
    print("| rule | rays | self-hit | skipped surface | wrong side | undecided |\n|---|---:|---:|---:|---:|---:|")
    for name, found in counts.items():
        cells = (found[what] for what in ("rays", "self-hit", "skipped surface", "wrong side", "undecided"))
        print(f"| {name} | {' | '.join(f'{count:,}' for count in cells)} |")


def every(leaving: LeavingRays, share: int) -> LeavingRays:
    rows = np.arange(0, len(leaving.t), share)
    return leaving._replace(rays=leaving.rays.rows(rows), t=leaving.t[rows], normals=leaving.normals[rows])


def tally(counts: Counter[str], leaving: LeavingRays, judge: OriginJudge) -> None:
    found = judge_origins(leaving, judge)
    counts.update({"rays": len(leaving.t), **found.judged.counts()})


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1e7, int(sys.argv[2]) if len(sys.argv) > 2 else 0)

"""`mitsuba-ref judge --spawned`: where rays start that leave the hits of other rays."""

import argparse
import sys
from pathlib import Path

import numpy as np

from caster.description.errors import SceneError
from caster.kernels.nearest import Rays
from caster.scene.files import load_scene
from caster.system.atomic_files import check_folder, write_text
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK
from mitsuba_ref.judge.origin_rules import RULES, LeavingRays, judge_origins, leaving_rays, reference_rays
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.oracle.spawned_origins import UNDECIDED
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.shared_input import packed_float32
from mitsuba_ref.report.results import folded, write_result
from mitsuba_ref.subjects.function import spawn_rule
from mitsuba_ref.subjects.ray_files import UnreadableArray, checked_rays, read_arrays, read_rays
from mitsuba_ref.subjects.subject import NoAnswer

MITSUBA = "mitsuba"


def run_spawned(args: argparse.Namespace) -> int:
    """Judge the origins and print their errors; 0 none, 1 some or no answer, 5 nothing to judge."""
    for name in ("hits", "html", "junit", "summary_md", "rows", "precision"):
        if getattr(args, name) is not None:
            raise SceneError(f"--{name.replace('_', '-')}: not together with --spawned")
    try:
        leaving = by_rule(listed_rays(args), args.spawn)
    except NoAnswer as error:
        print(f"FAIL  {error}", file=sys.stderr)
        return DIFFERENCES
    found = judge_origins(leaving)
    judged = int(np.sum(found.judged.found != UNDECIDED))
    if args.json:
        write_result({"rays": len(leaving.rays.q), **found.judged.counts(), "wrong": found.wrong.tolist()}, args.json)
    if not judged:
        print(f"nothing judged: {found.text()}: their parents hit nothing, or graze it", file=sys.stderr)
        return NOTHING_SELECTED
    lines = [f"{'FAIL' if len(found.wrong) else 'PASS'}  {found.text()}"]
    if len(found.wrong):
        row = int(found.wrong[0])
        lines.append(folded(f"      ray {row}: {found.example(row)}"))
        if args.out:
            path = check_folder(args.out) / f"{Path(args.scene).stem}.spawned-origin.{row}.toml"
            head = f"# The parent of ray {row} of {args.spawned}.\n# {found.example(row)}\n\n"
            write_text(path, head + found.scene_of(row).to_toml())
            lines.append(f"      parent ray: {path}")
    print("\n".join(lines))
    return DIFFERENCES if len(found.wrong) else OK


def listed_rays(args: argparse.Namespace) -> LeavingRays:
    """The rays of --spawned after the exact hits of their parents in --rays. Raises SceneError, UnreadableArray."""
    scene, parents = load_scene(args.scene, args.mesh_dir), read_rays(args.rays).rows.astype(np.float64)
    arrays = read_arrays(args.spawned, ("rays", "parent"))
    if missing := {"rays", "parent"} - arrays.keys():
        raise UnreadableArray(f"{args.spawned}: expected arrays rays and parent, got no {' and no '.join(missing)}")
    rows, parent = checked_rays(arrays["rays"], args.spawned).rows.astype(np.float64), arrays["parent"]
    if parent.shape != (len(rows),) or parent.dtype.kind not in "iu":
        raise SceneError(
            f"{args.spawned}: parent: expected {len(rows)} whole numbers, got {parent.shape} {parent.dtype}"
        )
    if len(bad := np.flatnonzero((parent < 0) | (parent >= len(parents)))):
        known = f"a ray of {args.rays}, 0 to {len(parents) - 1}"
        raise SceneError(f"{args.spawned}: parent[{bad[0]}]: expected {known}, got {int(parent[bad[0]])}")
    packed = packed_float32(scene)
    used, of = np.unique(parent, return_inverse=True)
    o, d, t_min, t_max = parents[used, :3], parents[used, 3:6], parents[used, 6], parents[used, 7]
    answers = Oracle(packed).first_hits(o, d, t_min, t_max)
    prim = np.array([answer.prim for answer in answers], np.int64)
    t = np.array([np.inf if answer.t is None else float(answer.t) for answer in answers])
    rays = Rays(o[of], d[of], t_min[of], t_max[of])
    return leaving_rays(scene, packed, rays, (prim[of], t[of]), rows[:, 3:6], rows[:, :3])


def by_rule(leaving: LeavingRays, rule: str | None) -> LeavingRays:
    """The rays from where a rule lets them start; None: from where they do. Raises SceneError, NoAnswer."""
    if rule is None:
        return leaving
    if rule != MITSUBA:
        return leaving.by(RULES[rule] if rule in RULES else spawn_rule(rule))
    found = reference_rays(leaving)
    if isinstance(found, Crash):
        raise NoAnswer(found.message)
    return found

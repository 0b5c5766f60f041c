"""`mitsuba-ref rays` and `mitsuba-ref judge`: rays for other programs, and their answers against Mitsuba."""

from argparse import Namespace
from pathlib import Path

import numpy as np

from caster.description.errors import SceneError
from caster.rendering.bounces import bounces
from caster.rendering.hits import trace_rays, validated_rays
from caster.scene.files import load_scene
from caster.scene.model import Scene
from caster.system.atomic_files import check_folder
from caster.system.process import DIFFERENCES, OK
from mitsuba_ref.cli.arguments import REFERENCE_OPTIONS
from mitsuba_ref.cli.options import NothingSelected, given_words, load_scene_or_original, refuse, table_stream
from mitsuba_ref.cli.validate import judge_entries, without_earlier_results
from mitsuba_ref.error_model.intersections import Array, Rays
from mitsuba_ref.hard import rays
from mitsuba_ref.judge.adjudication import prims_and_t
from mitsuba_ref.judge.checks.secondary_rays import LeavingRays, judge_origins, leaving_rays
from mitsuba_ref.oracle.oracle import Oracle
from mitsuba_ref.oracle.spawned_origins import UNDECIDED
from mitsuba_ref.reference.shared_input import packed_float32, pixel_of, shared_rays
from mitsuba_ref.report.output import print_lines, write_result
from mitsuba_ref.runner.many_scenes import JudgeOptions, entries_of_hits
from mitsuba_ref.stress.origins import write_parent
from mitsuba_ref.subjects.ray_files import RayList, answer_of_hits, checked_rays, read_arrays, read_rays, write_rays
from mitsuba_ref.subjects.subject import NoAnswer

# ---- rays of a scene, as a file ----

CAMERA = "camera"
AIMED_RAYS = 4096  # by default


def run_rays(args: Namespace) -> int:
    """Write the rays and print their number."""
    kind = args.kind or CAMERA
    if args.bounces:
        refuse(args, "not together with --bounces, whose first rays are the camera's", "kind")
    if kind == CAMERA:
        refuse(args, "expected --kind of aimed rays beside it", "count", "seed")
    scene = load_scene_or_original(args)
    if args.bounces:
        return write_bounces(scene, args)
    with np.errstate(over="ignore"):
        rows, pixels = camera_rows(scene) if kind == CAMERA else (aimed_rows(scene, args), None)
        rows = rows.astype(np.float32)
    whole = pixels is not None and len(pixels) == scene.film.width * scene.film.height
    rays = checked_rays(rows, args.output, scene.film.width if whole else 0)
    write_rays(args.output, rays, **({} if pixels is None else {"pixels": pixels}))
    print(f"{args.output}: {len(rows)} rays")
    return OK


def write_bounces(scene: Scene, args: Namespace) -> int:
    """Write bounce-0.npz, the camera's rays, and bounce-1.npz ..., whose `parent` counts in the file before."""
    folder = check_folder(args.output)
    rows, pixels = camera_rows(scene)
    first = trace_rays(scene, packed_float32(scene), validated_rays(*batch_of(rows)), rows[:, 6])
    write_rays(folder / "bounce-0.npz", RayList(rows.astype(np.float32)), pixels=pixels)
    for bounce in bounces(first, args.bounces):
        rays = bounce.rays
        listed = RayList(np.column_stack(rays[:4]).astype(np.float32))
        path = folder / f"bounce-{bounce.number}.npz"
        write_rays(path, listed, parent=rays.parent, kind=rays.kind, pixels=pixels[rays.pixel])
        print(f"{path}: {len(rays.kind)} rays")
    return OK


def batch_of(rows: Array) -> Rays:
    return Rays(rows[:, :3], rows[:, 3:6], rows[:, 6], rows[:, 7])


def camera_rows(scene: Scene) -> tuple[Array, Array]:
    """(n, 8) the rays that `validate` shares with Mitsuba, and (n, 2) their pixels."""
    rays = shared_rays(scene)
    there = np.flatnonzero(rays.t_max >= 0.0)
    rows = np.column_stack([rays.o, rays.d, np.zeros(len(rays.t_max)), rays.t_max])[there]
    return rows, np.array([pixel_of(scene, int(row)) for row in there], np.int32).reshape(-1, 2)


def aimed_rows(scene: Scene, args: Namespace) -> Array:
    """Rays by an aim of the fuzzer, (n, 8). Raises SceneError for a scene without primitives."""
    targets = rays.Targets(packed_float32(scene), np.random.default_rng(args.seed or 0))
    if not targets.counts.sum():
        raise SceneError(f"--kind {args.kind}: {args.scene} has no primitive to aim at")
    targets.fit_frame()
    aims = {"features": rays.at_features, "silhouettes": rays.tangents, "surface": rays.from_surface}
    o, d = aims.get(args.kind, rays.anywhere)(targets, args.count or AIMED_RAYS)
    return np.column_stack(rays.endless(o, d))


# ---- answers to any rays ----


def run_judge(args: Namespace) -> int:
    """Judge the answers; 0 they pass, 1 they do not."""
    if args.spawned:
        return run_spawned(args)
    if not args.hits:
        raise SceneError("judge: expected --hits, or --spawned")
    out = without_earlier_results(args)
    scene, found, hits = load_scene(args.scene, args.mesh_dir), read_rays(args.rays), read_arrays(args.hits)
    words = given_words(args, "scene", "rays", "hits", "precision", "mesh_dir", *REFERENCE_OPTIONS)
    entries = entries_of_hits(
        Path(args.scene).stem, args.scene, scene, found, hits, args.hits, args.precision, args.row, words
    )
    for name in hits.keys() & {"t", "any_hit"}:  # arrays of a wrong shape or type
        try:
            answer_of_hits(hits, np.ones(len(found.rows), bool), any_hit=name == "any_hit")
        except NoAnswer as error:
            raise SceneError(f"{args.hits}: {error}") from error
    return judge_entries(args, entries, JudgeOptions(subject=entries[0].subject), out)


# ---- origins of rays that leave surfaces ----


def run_spawned(args: Namespace) -> int:
    """Judge the origins and print their errors; 0 none, 1 some, 5 nothing to judge."""
    refuse(args, "not together with --spawned", "hits", "html", "junit", "summary_md", "row", "precision")
    found = judge_origins(listed_rays(args))
    write_result({**found.counts(), "wrong": found.wrong.tolist()}, args.json)
    if (found.found == UNDECIDED).all():
        raise NothingSelected(f"nothing judged: {found.text()}: their parents hit nothing, or graze it")
    lines = [f"{'FAIL' if len(found.wrong) else 'PASS'}  {found.text()}"]
    if len(found.wrong):
        row = int(found.wrong[0])
        lines.append(f"      ray {row}: {found.example(row)}")
        if args.out:
            path = Path(args.out) / f"{Path(args.scene).stem}.spawned-origin.{row}.toml"
            about = f"The parent of ray {row} of {args.spawned}."
            lines.append(f"      parent ray: {write_parent(path, about, found, row)}")
    print_lines("\n".join(lines), table_stream(args))
    return DIFFERENCES if len(found.wrong) else OK


def listed_rays(args: Namespace) -> LeavingRays:
    """The rays of --spawned after the exact hits of their parents in --rays. Raises SceneError, FileMissing."""
    scene, parents = load_scene(args.scene, args.mesh_dir), read_rays(args.rays).rows.astype(np.float64)
    arrays = read_arrays(args.spawned, names := ("rays", "parent"), names)
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
    lines = batch_of(parents[used])
    prim, t = prims_and_t(Oracle(packed).first_hits(*lines))
    return leaving_rays(scene, packed, lines.take(of), prim[of], t[of], rows[:, 3:6], rows[:, :3])

"""`mitsuba-ref rays`: rays of a scene as a file, for `judge`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from caster.cli.exit_codes import OK
from caster.cli.path_arguments import OutputFile
from caster.cli.scene_arguments import add_scene, load
from caster.description.errors import SceneError
from mitsuba_ref.cli.options import positive_int

if TYPE_CHECKING:
    import numpy as np

    from caster.scene.model import Scene

KINDS = ("camera", "random", "edges", "vertices", "silhouettes", "surface", "mixed", "shadow")
SHADOW_T_MIN = 2.0**-10  # lengths of d, the way to a point light: a shadow ray leaves its own surface


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add = parser.add_argument
    add(
        "-o",
        "--output",
        metavar="RAYS",
        type=OutputFile,
        required=True,
        help=".npz, or .npy for the rows alone",
    )
    help_ = "camera (default); random; aimed at edges, vertices or silhouettes; from surfaces; mixed; shadow: from "
    help_ += "what the camera sees to a light"
    add("--kind", choices=KINDS, default="camera", help=help_)
    add("--count", metavar="N", type=positive_int, default=4096, help="of rays that are aimed; default 4096")
    add("--seed", metavar="S", type=int, default=0, help="of random numbers; default 0")
    add("--light", metavar="I", type=int, default=0, help="number of the light of shadow rays; default 0")
    add("--t-min", metavar="T", type=float, help="t_min of every ray, in lengths of d")
    add("--t-max", metavar="T", type=float, help="t_max of every ray")
    add("--float64", action="store_true", help="write the same numbers, of float32, as float64")


def run(args: argparse.Namespace) -> int:
    """Write the rays; the number of them goes to standard output."""
    scene = load(args)
    import numpy as np

    from mitsuba_ref.subjects.ray_files import checked_rays, write_rays

    make = {"camera": camera_rows, "shadow": shadow_rows}.get(args.kind, aimed_rows)
    with np.errstate(over="ignore"):
        rows, pixels = make(scene, args)
        for column, limit in ((6, args.t_min), (7, args.t_max)):
            if limit is not None:
                rows[:, column] = limit
        rows = rows.astype(np.float32)
    whole = pixels is not None and len(pixels) == scene.film.width * scene.film.height
    rays = checked_rays(rows, args.output, scene.film.width if whole else 0)
    if args.float64:
        rays = rays._replace(rows=rays.rows.astype(np.float64))
    write_rays(args.output, rays, **({} if pixels is None else {"pixels": pixels}))
    print(f"{args.output}: {len(rows)} rays")
    return OK


def camera_rows(scene: Scene, args: argparse.Namespace) -> tuple[np.ndarray, np.ndarray | None]:
    """(the rays that `validate` shares with Mitsuba (n, 8), their pixels (n, 2))."""
    import numpy as np

    from mitsuba_ref.reference.rays import pixel_of, shared_rays

    rays = shared_rays(scene)
    there = np.flatnonzero(rays.t_max >= 0.0)
    rows = np.column_stack([rays.o, rays.d, np.zeros(len(rays.t_max)), rays.t_max])[there]
    return rows, np.array([pixel_of(scene, int(row)) for row in there], np.int32).reshape(-1, 2)


def shadow_rows(scene: Scene, args: argparse.Namespace) -> tuple[np.ndarray, np.ndarray | None]:
    """Rays from what the camera hits to a light, d all the way to one that is a point. Raises SceneError."""
    import numpy as np

    from caster.rendering.hits import cast
    from mitsuba_ref.error_model.lambert import direction_to_light

    lights = [light for light in scene.lights if light.type != "ambient"]
    if not 0 <= args.light < len(lights):
        raise SceneError(f"--light {args.light}: the scene has {len(lights)} lights that cast shadows")
    rows, pixels = camera_rows(scene, args)
    hits = cast(scene, rows[:, :3], rows[:, 3:6])
    hit = np.isfinite(hits.t) & (hits.t <= rows[:, 7])
    p = hits.surface.p[hit].astype(np.float32).astype(np.float64)
    to_light, reach = direction_to_light(lights[args.light], p)
    some = hit.nonzero()[0]
    shadow = np.column_stack([p, to_light, np.full(len(p), SHADOW_T_MIN), reach])
    return shadow, None if pixels is None else pixels[some]


def aimed_rows(scene: Scene, args: argparse.Namespace) -> tuple[np.ndarray, np.ndarray | None]:
    """Rays at what the kind says, from around the scene. Raises SceneError for a scene without primitives."""
    import numpy as np

    from caster.geometry.packing import pack
    from caster.geometry.world_space import as_float32
    from mitsuba_ref.judge.independent_checks import aims
    from mitsuba_ref.shapes.targets import random_directions

    targets, rng = aims.Targets(pack(scene, as_float32)), np.random.default_rng(args.seed)
    if not targets.counts.sum():
        raise SceneError(f"--kind {args.kind}: {args.scene} has no primitive to aim at")
    sort = {"random": "inside", "edges": "edge", "vertices": "corner"}.get(args.kind)
    at = targets.points(rng, targets.pick(rng, args.count), sort)
    size = float(np.ptp(at.p, axis=0).max()) or 1.0
    if args.kind == "silhouettes":
        o, d = aims.tangents(
            rng, targets, aims.Setting(center=tuple(at.p.mean(axis=0)), size=size), args.count
        )
    elif args.kind == "surface":
        o, d = at.p, random_directions(rng, args.count)
    else:
        distance = size * rng.uniform(0.5, 4.0, (args.count, 1))
        o = at.p + distance * random_directions(rng, args.count)
        d = at.p - o
    end = np.full(args.count, np.inf)
    return np.column_stack([o, d, np.zeros(args.count), end]), None

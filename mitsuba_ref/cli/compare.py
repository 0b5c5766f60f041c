"""`mitsuba-ref compare`: two EXR files, pixel by pixel."""

import argparse

from caster.cli.path_arguments import InputPath, OutputFile

NUMBERS = {
    "depth_rtol": "of depth and position, instead of the derived bound",
    "normal_atol": "of normals, instead of the derived bound",
    "uv_atol": "of uv, instead of the derived bound",
    "color_rtol": "of every channel that is not geometry, relative",
    "color_atol": "of every channel that is not geometry, absolute",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("ours", metavar="OURS.exr", type=InputPath)
    add("reference", metavar="REF.exr", type=InputPath)
    add(
        "-o",
        "--output",
        metavar="DIFF.exr",
        type=OutputFile,
        help="write the differences, and a class for each pixel",
    )
    for name, what in NUMBERS.items():
        add(f"--{name.replace('_', '-')}", type=float, metavar="TOL", help=f"tolerance {what}")
    add(
        "--max-pixels",
        type=int,
        default=0,
        metavar="N",
        help="so many pixels may differ (never by NaN or inf)",
    )
    add(
        "--ignore",
        type=str,
        action="append",
        default=[],
        metavar="CHANNEL",
        help="leave a channel or group of them out",
    )
    add("--other-scene", action="store_true", help="compare images of different scenes, too")
    add("--allow-empty", action="store_true", help="two images that hit nothing pass")
    add("--json", action="store_true", help="as JSON")
    group = parser.add_argument_group(
        "files of other programs, where their numbers do not decide (docs/candidates.md)"
    )
    add = group.add_argument
    add(
        "--map",
        type=str,
        action="append",
        default=[],
        metavar="OURS=THEIRS",
        help="a channel or group by its name there, such as depth=ViewLayer.Depth.Z or normal=N; any number of them",
    )
    add(
        "--depth",
        choices=("distance", "z", "near"),
        help="what depth is: along the ray, along z, or from the near plane",
    )
    add("--miss", type=str, metavar="VALUE", help="the depth of a miss, such as 0, inf, 1e10 or FLT_MAX")
    add(
        "--near",
        type=float,
        metavar="N",
        help="of the near plane, along the view axis, if depth counts from there",
    )
    add("--scene", metavar="SCENE", type=InputPath, help="the scene whose camera rendered the images")


def run(args: argparse.Namespace) -> int:
    """Print the comparison; 0 pass, 1 differences, 3 not comparable, 5 nothing to compare."""
    from mitsuba_ref.exr_compare.two_files import Reading, Tolerances, compare_exr

    numbers = {name: getattr(args, name) for name in NUMBERS}
    tolerances = Tolerances(
        **numbers,
        max_pixels=args.max_pixels,
        ignore=tuple(args.ignore),
        allow_empty=args.allow_empty,
        other_scene=args.other_scene,
    )
    scene = None
    if args.scene:
        from caster.scene.files import load_scene

        scene = load_scene(args.scene)
    reading = Reading(tuple(args.map), args.depth, args.miss, args.near, scene)
    result = compare_exr(args.ours, args.reference, tolerances, diff=args.output, reading=reading)
    print(result.model_dump_json(indent=2) if args.json else result.format_table())
    return result.exit_code

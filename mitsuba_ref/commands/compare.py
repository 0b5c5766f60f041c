"""`mitsuba-ref compare`: two EXR files, pixel by pixel."""

import argparse
import json

HELP = "compare two EXR files; NaN, inf, another size or one missed pixel never pass"

NUMBERS = {
    "depth_rtol": "of depth and position, instead of the derived bound",
    "normal_atol": "of normals, instead of the derived bound",
    "uv_atol": "of uv, instead of the derived bound",
    "color_rtol": "of every channel that is not geometry, relative",
    "color_atol": "of every channel that is not geometry, absolute",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("ours", metavar="OURS.exr")
    add("reference", metavar="REF.exr")
    add("-o", "--output", metavar="DIFF.exr", help="write the differences, and a class for each pixel")
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
        action="append",
        default=[],
        metavar="CHANNEL",
        help="leave a channel or group of them out",
    )
    add("--other-scene", action="store_true", help="compare images of different scenes, too")
    add("--allow-empty", action="store_true", help="two images that hit nothing pass")
    add("--json", action="store_true", help="as JSON")


def run(args: argparse.Namespace) -> int:
    """Print the comparison; 0 pass, 1 differences, 3 not comparable, 5 nothing to compare."""
    from mitsuba_ref.exr.compare import Tolerances, compare_exr

    numbers = {name: getattr(args, name) for name in NUMBERS}
    tolerances = Tolerances(
        **numbers,
        max_pixels=args.max_pixels,
        ignore=tuple(args.ignore),
        allow_empty=args.allow_empty,
        other_scene=args.other_scene,
    )
    result = compare_exr(args.ours, args.reference, tolerances, diff=args.output)
    print(json.dumps(result.to_dict(), indent=2) if args.json else result.format_table())
    return result.exit_code

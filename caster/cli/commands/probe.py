"""`caster probe`: one pixel's ray, in numbers that can be copied to the bit."""

import argparse
import json

from caster.cli.scene_arguments import add_pixel, add_scene, error_prefix, load

HELP = "one pixel: its ray, its hit, and what it meets of each shape, in decimal and hex"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add_pixel(parser)
    parser.add_argument("--json", action="store_true", help="as JSON, with every shape that is hit")


def run(args: argparse.Namespace) -> int:
    """Print what the pixel's ray meets. Raises SceneError for a pixel outside the film."""
    scene = load(args)
    from caster.cli.probe_format import probe_to_json, probe_to_text
    from caster.rendering.pixel_probe import probe

    with error_prefix(args.scene):
        found = probe(scene, args.x, args.y)
    print(
        json.dumps(probe_to_json(found, args.scene), indent=2)
        if args.json
        else probe_to_text(found, args.scene)
    )
    return 0

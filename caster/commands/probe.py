"""`caster probe`: one pixel's ray, in numbers that can be copied to the bit."""

import argparse
import json

from caster.commands.scene_arguments import add_pixel, add_scene, blamed_on, load

HELP = "one pixel: its ray, its hit, and what it meets of each shape, in decimal and hex"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add_pixel(parser)
    parser.add_argument("--json", action="store_true", help="as JSON, with every shape that is hit")


def run(args: argparse.Namespace) -> int:
    """Print what the pixel's ray meets. Raises SceneError for a pixel outside the film."""
    scene = load(args)
    from caster.probe_text import as_data, as_text
    from caster.probing import probe

    with blamed_on(args.scene):
        found = probe(scene, args.x, args.y)
    print(json.dumps(as_data(found, args.scene), indent=2) if args.json else as_text(found, args.scene))
    return 0

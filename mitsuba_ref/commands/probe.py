"""`mitsuba-ref probe`: both witnesses side by side for one pixel."""

import argparse
import json

from caster.commands.scene_arguments import add_pixel, add_scene, blamed_on, load
from caster.exits import DIFFERENCES, OK

HELP = "one pixel: what ours and Mitsuba say, the bounds, and every primitive that may be hit"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add_pixel(parser)
    parser.add_argument("--json", action="store_true", help="as JSON")


def run(args: argparse.Namespace) -> int:
    """Print the pixel's verdict and what it rests on; 1 when nothing explains the pixel."""
    scene = load(args)
    from mitsuba_ref.probing import as_text, probe

    with blamed_on(args.scene):
        found = probe(scene, args.x, args.y)
    print(json.dumps(found.to_dict(), indent=2) if args.json else as_text(found, args.scene))
    return OK if found.ok else DIFFERENCES

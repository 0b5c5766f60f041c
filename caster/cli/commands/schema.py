"""`caster schema`: what an editor needs to complete and check scene files."""

import argparse
import json

HELP = "print the JSON Schema of scene files, for editors"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """None."""


def run(args: argparse.Namespace) -> int:
    """Print the schema."""
    from caster.scene.files import scene_schema

    print(json.dumps(scene_schema(), indent=2))
    return 0

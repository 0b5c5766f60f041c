"""`mitsuba-ref export`: the XML and the meshes that plain Mitsuba loads."""

import argparse
from pathlib import Path

from caster.cli.exit_codes import OK
from caster.cli.scene_arguments import add_scene, load


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument(
        "-o", "--output", metavar="DIR", required=True, help="folder to write into; made if need be"
    )


def run(args: argparse.Namespace) -> int:
    """Write the files and say which. Raises SceneError, FileMissing, OutputError."""
    scene = load(args)
    from mitsuba_ref.reference.rendering import export_scene

    exported = export_scene(scene)
    path = exported.write(Path(args.output))
    print(f"{path}: {len(scene.shapes)} shapes, {len(exported.meshes)} mesh files")
    for note in exported.notes:
        print(f"note: {note}")
    return OK

"""`caster check`: whether scene files can be used, and everything that is wrong with them."""

import argparse

from caster.cli.exit_codes import FILE, OK, USAGE
from caster.cli.scene_arguments import SCENE_FILE, add_mesh_dirs, error_prefix
from caster.description.errors import SceneError

HELP = "validate scene files: every error with file:line:col"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenes", metavar="SCENE", nargs="+", help=SCENE_FILE)
    add_mesh_dirs(parser)


def run(args: argparse.Namespace) -> int:
    """Print one line for a good scene, all errors of a bad one. 2 if any is invalid, 4 if any is missing."""
    codes = {check_file(scene, args.mesh_dir) for scene in args.scenes}
    return next(code for code in (USAGE, FILE, OK) if code in codes)


def check_file(path: str, mesh_dirs: list[str]) -> int:
    """Check one scene file, with its meshes."""
    from caster.geometry.packing import pack
    from caster.geometry.rejected import in_words
    from caster.scene.files import load_scene

    try:
        scene = load_scene(path, mesh_dirs)
        with error_prefix(path):
            pack(scene)  # what is only seen when shapes are put into place
            never_hit = in_words(scene)
    except SceneError as error:
        print(error)
        return error.exit_code
    print(
        f"{path}: ok, {len(scene.shapes)} shapes" + (f"; faces never hit: {never_hit}" if never_hit else "")
    )
    return OK

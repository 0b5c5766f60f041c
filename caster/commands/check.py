"""`caster check`: whether scene files can be used, and everything that is wrong with them."""

import argparse

from caster.commands.scene_arguments import SCENE_FILE, add_mesh_dirs, blamed_on
from caster.exits import FILE, OK, USAGE
from caster.wording import SceneError

HELP = "validate scene files: every error with file:line:col"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenes", metavar="SCENE", nargs="+", help=SCENE_FILE)
    add_mesh_dirs(parser)


def run(args: argparse.Namespace) -> int:
    """Print one line for a good scene, all errors of a bad one. 2 if any is invalid, 4 if any is missing."""
    codes = {checked(scene, args.mesh_dir) for scene in args.scenes}
    return next(code for code in (USAGE, FILE, OK) if code in codes)


def checked(path: str, mesh_dirs: list[str]) -> int:
    """Check one scene file, with its meshes."""
    from caster.left_out import in_words
    from caster.packing import pack
    from caster.scene_files import load_scene

    try:
        scene = load_scene(path, mesh_dirs)
        with blamed_on(path):
            pack(scene)  # what is only seen when shapes are put into place
            never_hit = in_words(scene)
    except SceneError as error:
        print(error)
        return error.exit_code
    print(
        f"{path}: ok, {len(scene.shapes)} shapes" + (f"; faces never hit: {never_hit}" if never_hit else "")
    )
    return OK

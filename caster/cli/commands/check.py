"""`caster check` and `caster schema`: validate scene files, print their JSON Schema."""

import argparse
import json

from caster.cli.exit_codes import FILE, OK, USAGE
from caster.cli.path_arguments import InputPath
from caster.cli.scene_arguments import SCENE_FILE, add_mesh_dirs, error_prefix
from caster.description.errors import SceneError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenes", metavar="SCENE", type=InputPath, nargs="+", help=SCENE_FILE)
    add_mesh_dirs(parser)


def run(args: argparse.Namespace) -> int:
    """Print one line for a valid scene, all errors of an invalid one. 2 if any is invalid, 4 if any is missing."""
    codes = {check_file(scene, args.mesh_dir) for scene in args.scenes}
    return next(code for code in (USAGE, FILE, OK) if code in codes)


def check_file(path: str, mesh_dirs: list[str]) -> int:
    """Validate one scene file with its meshes and print the outcome; its exit code."""
    from caster.geometry.packing import in_words, pack
    from caster.scene.files import load_scene

    try:
        scene = load_scene(path, mesh_dirs)
        with error_prefix(path):
            pack(scene)  # some errors appear only in world space
            never_hit = in_words(scene)
    except SceneError as error:
        print(error)
        return error.exit_code
    print(
        f"{path}: ok, {len(scene.shapes)} shapes" + (f"; faces never hit: {never_hit}" if never_hit else "")
    )
    return OK


def no_arguments(parser: argparse.ArgumentParser) -> None:
    """`caster schema` takes none."""


def print_schema(args: argparse.Namespace) -> int:
    """Print the JSON Schema of scene files."""
    from caster.scene.files import scene_schema

    print(json.dumps(scene_schema(), indent=2))
    return OK

"""What the commands that read a scene share."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from caster.wording import SceneError

if TYPE_CHECKING:
    from caster.scene import Scene

SCENE_FILE = "a scene file, .toml or .json"


def add_scene(parser: argparse.ArgumentParser) -> None:
    """SCENE, --mesh-dir and --size."""
    parser.add_argument("scene", metavar="SCENE", help=SCENE_FILE)
    add_mesh_dirs(parser)
    parser.add_argument(
        "--size", nargs=2, type=int, metavar=("W", "H"), help="film in pixels, instead of the scene's own"
    )


def add_mesh_dirs(parser: argparse.ArgumentParser) -> None:
    """--mesh-dir, as often as one likes."""
    parser.add_argument(
        "--mesh-dir",
        action="append",
        default=[],
        metavar="DIR",
        help="a folder beyond the scene's own whose meshes it may use; may be given several times",
    )


def add_pixel(parser: argparse.ArgumentParser) -> None:
    """X and Y."""
    parser.add_argument("x", metavar="X", type=int, help="column of the pixel, 0 at the left")
    parser.add_argument("y", metavar="Y", type=int, help="row of the pixel, 0 at the top")


def load(args: argparse.Namespace) -> Scene:
    """The scene that was asked for, at the size that was asked for."""
    from caster.scene_files import load_scene

    scene = load_scene(args.scene, args.mesh_dir)
    if args.size is None:
        return scene
    with blamed_on("--size", *args.size):
        return scene.with_film(width=args.size[0], height=args.size[1])


@contextlib.contextmanager
def blamed_on(*words: object) -> Iterator[None]:
    """Let an error begin with the words it comes from: an option with its numbers, or a file."""
    try:
        yield
    except SceneError as error:
        raise type(error)(f"{' '.join(map(str, words))}: {error}") from None

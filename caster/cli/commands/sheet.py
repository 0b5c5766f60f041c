"""`caster sheet`: many scenes on one picture."""

import argparse
import sys

from caster.cli.commands.render import positive_int
from caster.cli.exit_codes import NOTHING_SELECTED, OK
from caster.cli.scene_arguments import add_mesh_dirs, display_names, error_prefix, scene_files

HELP = "render scene files as small pictures on one labelled sheet"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("scenes", metavar="SCENE|DIR", nargs="+", help="scene files, or folders of them")
    add("-o", "--output", metavar="PNG", default="sheet.png", help="default: sheet.png")
    add(
        "--aov", metavar="A", default="diffuse", help="default: diffuse, and normals of scenes without lights"
    )
    add(
        "--side",
        type=positive_int,
        metavar="N",
        default=160,
        help="longer side of each, in pixels; default: 160",
    )
    add(
        "--columns", type=positive_int, metavar="N", help="default: so many that the sheet is wider than high"
    )
    add("--threads", type=positive_int, metavar="N", help="default: as many as there are cores")
    add_mesh_dirs(parser)


def run(args: argparse.Namespace) -> int:
    """Render and write. Raises SceneError, FileMissing, OutputError."""
    from caster.cli.progress import announce_compilation, type_names
    from caster.image.atomic_files import check_writable
    from caster.image.image_files import check_image_name, write_image
    from caster.image.previews import sheet, sheet_columns, thumbnail
    from caster.rendering.images import check_names
    from caster.scene.files import load_scene

    check_image_name("-o", args.output)
    check_names([args.aov])
    check_writable(args.output)
    files = scene_files(args.scenes)
    if not files:
        print(f"nothing selected: no scene file in {', '.join(args.scenes)}", file=sys.stderr)
        return NOTHING_SELECTED
    scenes = [load_scene(file, args.mesh_dir) for file in files]  # all errors before any picture
    pictures = []
    for file, scene, name in zip(files, scenes, display_names(files), strict=True):
        with error_prefix(file), announce_compilation(type_names(scene)):
            pictures.append(thumbnail(scene, name, args.side, args.aov, args.threads))
    about = {"Description": ", ".join(picture.name for picture in pictures)}
    write_image(args.output, sheet(pictures, args.columns or sheet_columns(len(pictures))), about)
    print(f"{args.output}: {len(pictures)} scenes")
    return OK

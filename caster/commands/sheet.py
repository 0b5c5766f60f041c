"""`caster sheet`: many scenes on one picture."""

import argparse
import sys

from caster.commands.render import thread_count
from caster.commands.scene_arguments import add_mesh_dirs, blamed_on, names_of, scene_files
from caster.exits import NOTHING_SELECTED, OK

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
        type=thread_count,
        metavar="N",
        default=160,
        help="longer side of each, in pixels; default: 160",
    )
    add(
        "--columns", type=thread_count, metavar="N", help="default: so many that the sheet is wider than high"
    )
    add("--threads", type=thread_count, metavar="N", help="default: as many as there are cores")
    add_mesh_dirs(parser)


def run(args: argparse.Namespace) -> int:
    """Render and write. Raises SceneError, FileMissing, OutputError."""
    from caster.pictures.contact import columns_for, thumbnail
    from caster.pictures.files import check_picture_name, write_picture
    from caster.pictures.layout import sheet
    from caster.progress import announced, kinds_in
    from caster.rendering import check_names
    from caster.scene_files import load_scene
    from caster.whole_files import check_writable

    check_picture_name("-o", args.output)
    check_names([args.aov])
    check_writable(args.output)
    files = scene_files(args.scenes)
    if not files:
        print(f"nothing selected: no scene file in {', '.join(args.scenes)}", file=sys.stderr)
        return NOTHING_SELECTED
    scenes = [load_scene(file, args.mesh_dir) for file in files]  # all errors before any picture
    pictures = []
    for file, scene, name in zip(files, scenes, names_of(files), strict=True):
        with blamed_on(file), announced(kinds_in(scene)):
            pictures.append(thumbnail(scene, name, args.side, args.aov, args.threads))
    about = {"Description": ", ".join(picture.name for picture in pictures)}
    write_picture(args.output, sheet(pictures, args.columns or columns_for(len(pictures))), about)
    print(f"{args.output}: {len(pictures)} scenes")
    return OK

"""`mitsuba-ref render`: a reference EXR by Mitsuba, along our rays, in our channels."""

from __future__ import annotations

import argparse

from caster.cli.exit_codes import DIFFERENCES, OK
from caster.cli.scene_arguments import AOV_NAMES, DEFAULT_AOV_LIST, add_scene, check_exr_suffix, load
from caster.description.errors import SceneError, suggestion

KNOWN = AOV_NAMES.split(", ")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add = parser.add_argument
    add("-o", "--output", metavar="REF.exr", required=True)
    add(
        "--aov",
        metavar="A,B,...",
        default=DEFAULT_AOV_LIST,
        help=f"of {', '.join(KNOWN)}; default: {DEFAULT_AOV_LIST}",
    )
    add("--variant", metavar="V", help="scalar_rgb or llvm_ad_rgb; default: what suits the scene")


def run(args: argparse.Namespace) -> int:
    """Render with Mitsuba and write the file; 1 when Mitsuba ends without an answer."""
    names = tuple(dict.fromkeys(args.aov.split(",")))
    for name in names:
        if name not in KNOWN:
            raise SceneError(
                f"--aov {name!r}: unknown{suggestion(name, KNOWN)}; known are {', '.join(KNOWN)}"
            )
    if args.variant:
        from mitsuba_ref.reference.variants import check_variant

        check_variant(args.variant, "--variant")
    scene = load(args)
    from caster.image.atomic_files import check_writable
    from caster.image.channels import write_render
    from mitsuba_ref.reference.messages import Crash
    from mitsuba_ref.reference.rendering import render_reference

    check_exr_suffix(args.output)
    check_writable(args.output)
    rendered = render_reference(scene, names, variant=args.variant)
    if isinstance(rendered, Crash):
        print(f"{args.scene}: {rendered.message}")
        return DIFFERENCES
    images, versions = rendered
    more = {f"caster/reference/{name}": version for name, version in versions.items()}
    write_render(args.output, scene, images, args.scene, more)
    height, width = images.hit.shape
    print(f"{args.output}: {width} x {height} pixels, {int(images.hit.sum())} hit; {', '.join(names)}")
    print(", ".join(f"{name} {version}" for name, version in versions.items()))
    return OK

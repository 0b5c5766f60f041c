"""The commands of `caster`, in the order of `caster --help`.

An entry names the module that implements the command (see caster/cli/application.py). The modules import what is slow
to load inside `run`, so that `--help` is quick.
"""

from caster.cli.application import Command

_HERE = "caster.cli"

COMMANDS = (
    Command(
        "render",
        "render a scene to an EXR file",
        f"{_HERE}.scene_commands",
        example="caster render scene.toml --aov depth,normal -o ours.exr",
    ),
    Command(
        "probe",
        "one pixel: its ray, its hit and the intersections of each shape, in decimal and hex",
        f"{_HERE}.probe_pixel",
        example="caster probe scene.toml 160 110",
    ),
    Command(
        "check",
        "validate scene files: every error with file:line:col",
        f"{_HERE}.scene_commands",
        run="run_check",
        arguments="add_check_arguments",
        example="caster check scenes/*.toml",
    ),
    Command(
        "schema",
        "print the JSON Schema of scene files, for editors",
        f"{_HERE}.scene_commands",
        run="print_schema",
        arguments="",
        example="caster schema > scene.schema.json",
    ),
    Command(
        "info",
        "describe an EXR file: size, parts, channels, count of hits, provenance",
        f"{_HERE}.viewing",
        run="info",
        arguments="add_info_arguments",
        example="caster info ours.exr",
    ),
    Command(
        "preview",
        "show an AOV or the class map of an EXR file as a PNG image",
        f"{_HERE}.viewing",
        run="preview",
        arguments="add_preview_arguments",
        example="caster preview ours.exr --aov normal -o ours.png",
    ),
    Command(
        "6837",
        "render a scene file of MIT 6.837, with that course's options and images (mitsuba-ref docs classroom)",
        f"{_HERE}.course_6837",
        example="caster 6837 -input scene.txt -output out.png -size 200 200",
    ),
    Command(
        "doctor",
        "list the packages found on this machine, and the use of each missing one",
        f"{_HERE}.installation",
        example="caster doctor --warm",
    ),
)

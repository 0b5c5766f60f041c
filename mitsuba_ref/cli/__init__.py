"""The commands of `mitsuba-ref`, in the order of `mitsuba-ref --help`; see caster/cli/application.py."""

from caster.cli.application import Command

_HERE = "mitsuba_ref.cli"


def _command(name: str, about: str, module: str, run: str = "run", starts_with: str = "") -> Command:
    """A command with arguments in cli/arguments.py."""
    return Command(name, about, f"{_HERE}.{module}", run, f"add_{name}_arguments", starts_with, f"{_HERE}.arguments")


COMMANDS = (
    Command(
        "init",
        "write a ray caster to begin with, in Python, C, Rust or JavaScript, and what judges it",
        f"{_HERE}.starter",
    ),
    _command(
        "validate",
        "compare our caster or a candidate with Mitsuba on scenes: every pixel gets a class",
        "validate",
        starts_with="loading the judge and the scenes",
    ),
    _command(
        "judge",
        "judge hits of any rays that were computed elsewhere",
        "judge",
        starts_with="loading the judge and the rays",
    ),
    _command(
        "rays",
        "write rays of a scene to a file for `judge`: camera rays, shadow rays, random or aimed ones",
        "judge",
        "run_rays",
    ),
    _command("merge", "merge the verdicts of all shards of a run; a missing one fails", "validate", "run_merge"),
    _command(
        "render",
        "render a scene with Mitsuba to an EXR file, along the rays that our caster traces",
        "scene_exchange",
        "run_render",
    ),
    _command(
        "approve",
        "render images with Mitsuba, show what changed in them, and write them once approved",
        "exr_comparison",
        "run_approve",
        starts_with="loading the renderer and the approved images",
    ),
    _command(
        "check",
        "compare our render with approved images, without Mitsuba; stale or altered ones fail",
        "exr_comparison",
        "run_check",
        starts_with="loading the renderer and the approved images",
    ),
    _command(
        "export", "write a scene as Mitsuba XML with its meshes, for plain Mitsuba", "scene_exchange", "run_export"
    ),
    _command(
        "import",
        "convert Mitsuba XML or a scene file of MIT 6.837 to a scene file, and list what was left out",
        "scene_exchange",
        "run_import",
    ),
    _command(
        "compare",
        "compare two EXR files; NaN, inf, another size or one missed pixel never pass",
        "exr_comparison",
        "run_compare",
    ),
    _command(
        "probe",
        "explain one pixel: answers of our caster, Mitsuba, exact arithmetic and a candidate, with their bounds",
        "probe",
        starts_with="loading the judge and the scene",
    ),
    _command(
        "fuzz",
        "random and adversarial scenes and rays; each failure is shrunk to a minimal scene file and kept",
        "fuzz",
        starts_with="loading the judge",
    ),
    _command(
        "stress",
        "numerical stability: errors and wrong hits, against exact answers, along sweeps of growing difficulty",
        "experiments",
        "run_stress",
        starts_with="loading the judge",
    ),
    _command(
        "bench",
        "run time against error: our caster beside Mitsuba and others, in alternating processes",
        "experiments",
        "run_bench",
        starts_with="loading the judge",
    ),
    Command(
        "schema",
        "print the JSON Schema of a result, such as verdict.json",
        f"{_HERE}.doctor",
        run="run_schema",
        arguments="add_schema_arguments",
    ),
    Command("doctor", "list what was found on this machine, and the effect of each missing part", f"{_HERE}.doctor"),
)

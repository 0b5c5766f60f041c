"""The commands of `mitsuba-ref`, in the order of `mitsuba-ref --help`; see caster/cli/application.py."""

from caster.cli.application import Command

_HERE = "mitsuba_ref.cli"


def _command(name: str, about: str, example: str, module: str, starts_with: str = "") -> Command:
    """A command, run_NAME of its module, with arguments in cli/arguments.py. example: without the program."""
    arguments = f"add_{name}_arguments", starts_with, f"{_HERE}.arguments"
    return Command(name, about, f"{_HERE}.{module}", f"run_{name}", *arguments, f"mitsuba-ref {example}")


COMMANDS = (
    Command(
        "init",
        "write a ray caster to begin with, in Python, C, Rust or JavaScript, and what judges it",
        f"{_HERE}.starter",
        example="mitsuba-ref init c mine",
    ),
    _command(
        "validate",
        "compare our caster or a candidate with Mitsuba on scenes: every pixel gets a class",
        "validate --builtin triangles --candidate mine:trace --html report",
        "validate",
        "loading the judge and the scenes",
    ),
    _command(
        "judge",
        "judge hits of any rays that were computed elsewhere",
        "judge --scene scene.toml --rays rays.npz --hits hits.npz",
        "judge",
        "loading the judge and the rays",
    ),
    _command(
        "rays",
        "write rays of a scene to a file for `judge`: camera rays, shadow rays, random or aimed ones",
        "rays bunny.ply --kind features --count 10000 -o rays.npz",
        "judge",
    ),
    _command(
        "merge",
        "merge the verdicts of all shards of a run; a missing one fails",
        "merge shard-1 shard-2 --json verdict.json",
        "validate",
    ),
    _command(
        "render",
        "render a scene with Mitsuba to an EXR file, along the rays that our caster traces",
        "render scene.toml --aov depth,normal -o ref.exr",
        "scene_exchange",
    ),
    _command(
        "export",
        "write a scene as Mitsuba XML with its meshes, for plain Mitsuba",
        "export scene.toml -o exported",
        "scene_exchange",
    ),
    _command(
        "import",
        "convert Mitsuba XML or a scene file of MIT 6.837 to a scene file, and list what was left out",
        "import scene.xml -o scene.toml",
        "scene_exchange",
    ),
    _command(
        "compare",
        "compare two EXR files, or two folders of them; NaN, inf, another size or one missed pixel never pass",
        "compare ours.exr reference.exr --html difference",
        "exr_comparison",
    ),
    _command(
        "probe",
        "explain one pixel: answers of our caster, Mitsuba, exact arithmetic and a candidate, with their bounds",
        "probe builtin:scan 21 2 --size 48 48 --candidate mine:trace",
        "probe",
        "loading the judge and the scene",
    ),
    _command(
        "versions",
        "judge scenes with two versions of Mitsuba: what changed in bits, and which one is nearer to exact",
        "versions scenes --mitsuba old/bin/python --mitsuba new/bin/python",
        "experiments",
        "loading the judge and the scenes",
    ),
    _command(
        "fuzz",
        "random and adversarial scenes and rays; each failure is shrunk to a minimal scene file and kept",
        "fuzz --time 5m --candidate mine:trace",
        "experiments",
        "loading the judge",
    ),
    _command(
        "stress",
        "numerical stability: errors and wrong hits, against exact answers, along sweeps of growing difficulty",
        "stress sliver --candidate mine:trace",
        "experiments",
        "loading the judge",
    ),
    _command(
        "campaign",
        "run scenes, random films, fuzz and stress by a file, continue where a run stopped, report what is new",
        "campaign nightly.toml --html nightly.html",
        "campaign",
        "loading the judge",
    ),
    _command(
        "bench",
        "run time against error: our caster beside Mitsuba and others, in alternating processes",
        "bench bunny.ply --aov depth,normal --candidate mine:trace",
        "experiments",
        "loading the judge",
    ),
    Command(
        "schema",
        "print the JSON Schema of a result, such as verdict.json",
        f"{_HERE}.doctor",
        run="run_schema",
        arguments="add_schema_arguments",
        example="mitsuba-ref schema verdict",
    ),
    Command("docs", "read a page of the documentation", f"{_HERE}.pages", example="mitsuba-ref docs candidates"),
    Command(
        "doctor",
        "list what was found on this machine, and the effect of each missing part",
        f"{_HERE}.doctor",
        example="mitsuba-ref doctor",
    ),
)

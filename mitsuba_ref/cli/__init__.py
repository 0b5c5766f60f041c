"""The commands of `mitsuba-ref`, in the order of `mitsuba-ref --help`; see caster/cli/application.py."""

from caster.cli.application import Command

_HERE = "mitsuba_ref.cli"

COMMANDS = (
    Command(
        "validate",
        "compare our caster with Mitsuba on scenes: every pixel gets a class, the exit code says pass or fail",
        f"{_HERE}.validate",
    ),
    Command("merge", "merge the verdicts of all shards; a missing one fails", f"{_HERE}.merge"),
    Command(
        "render",
        "render a scene with Mitsuba to an EXR file, along the rays that our caster traces",
        f"{_HERE}.render",
    ),
    Command(
        "approve",
        "render reference EXRs with Mitsuba, show what changed in them, and write them once that is approved",
        f"{_HERE}.approve",
    ),
    Command(
        "check",
        "compare our render with approved reference EXRs, without Mitsuba; stale or altered ones fail",
        f"{_HERE}.check",
    ),
    Command("export", "write a scene as Mitsuba XML with its meshes, for plain Mitsuba", f"{_HERE}.export"),
    Command(
        "import",
        "make a scene file of Mitsuba XML or of a scene text of MIT 6.837, and list what was left out",
        f"{_HERE}.import_scene",
    ),
    Command(
        "compare",
        "compare two EXR files; NaN, inf, another size or one missed pixel never pass",
        f"{_HERE}.compare",
    ),
    Command(
        "probe",
        "one pixel: the answers of ours, Mitsuba, exact arithmetic and a candidate, their bounds, and possible hits",
        f"{_HERE}.probe",
    ),
    Command(
        "fuzz",
        "adversarial random scenes and rays; each failure is shrunk to a minimal scene file and kept",
        f"{_HERE}.fuzz",
    ),
    Command(
        "stress",
        "numerical stability: errors and wrong hits against exact answers, as one parameter gets harder",
        f"{_HERE}.stress",
    ),
    Command(
        "bench",
        "run time against error: ours, Mitsuba and others, in alternating processes",
        f"{_HERE}.bench",
    ),
    Command(
        "doctor",
        "list what was found on this machine, and what each missing package would add",
        f"{_HERE}.doctor",
    ),
)

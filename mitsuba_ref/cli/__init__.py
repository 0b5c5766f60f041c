"""The commands of `mitsuba-ref`, in the order of `mitsuba-ref --help`; see caster/cli/application.py."""

from caster.cli.application import Command

COMMANDS = (
    Command(
        "init",
        "write a ray caster to begin with, in Python, C, Rust or JavaScript, and what judges it",
        "mitsuba_ref.cli.starter",
    ),
    Command(
        "validate",
        "compare our caster or a candidate with Mitsuba on scenes: every pixel gets a class",
        "mitsuba_ref.cli.validate",
        starts_with="loading the judge and the scenes",
    ),
    Command(
        "judge",
        "judge answers that were computed elsewhere: hits of any rays, or an EXR file",
        "mitsuba_ref.cli.judge",
        starts_with="loading the judge and the rays",
    ),
    Command(
        "rays",
        "write rays of a scene to a file for `judge`: camera rays, shadow rays, random or aimed ones",
        "mitsuba_ref.cli.judge",
        run="run_rays",
        arguments="add_rays_arguments",
    ),
    Command(
        "merge",
        "merge the verdicts of all shards of a run; a missing one fails",
        "mitsuba_ref.cli.validate",
        run="run_merge",
        arguments="add_merge_arguments",
    ),
    Command(
        "render",
        "render a scene with Mitsuba to an EXR file, along the rays that our caster traces",
        "mitsuba_ref.cli.scene_exchange",
        run="run_render",
        arguments="add_render_arguments",
    ),
    Command(
        "approve",
        "render images with Mitsuba, show what changed in them, and write them once approved",
        "mitsuba_ref.cli.exr_comparison",
        run="run_approve",
        arguments="add_approve_arguments",
        starts_with="loading the renderer and the approved images",
    ),
    Command(
        "check",
        "compare our render with approved images, without Mitsuba; stale or altered ones fail",
        "mitsuba_ref.cli.exr_comparison",
        run="run_check",
        arguments="add_check_arguments",
        starts_with="loading the renderer and the approved images",
    ),
    Command(
        "export",
        "write a scene as Mitsuba XML with its meshes, for plain Mitsuba",
        "mitsuba_ref.cli.scene_exchange",
        run="run_export",
        arguments="add_export_arguments",
    ),
    Command(
        "import",
        "convert Mitsuba XML or a scene file of MIT 6.837 to a scene file, and list what was left out",
        "mitsuba_ref.cli.scene_exchange",
        run="run_import",
        arguments="add_import_arguments",
    ),
    Command(
        "compare",
        "compare two EXR files; NaN, inf, another size or one missed pixel never pass",
        "mitsuba_ref.cli.exr_comparison",
        run="run_compare",
        arguments="add_compare_arguments",
    ),
    Command(
        "probe",
        "explain one pixel: answers of our caster, Mitsuba, exact arithmetic and a candidate, with their bounds",
        "mitsuba_ref.cli.probe",
        starts_with="loading the judge and the scene",
    ),
    Command(
        "fuzz",
        "random and adversarial scenes and rays; each failure is shrunk to a minimal scene file and kept",
        "mitsuba_ref.cli.fuzz",
        starts_with="loading the judge",
    ),
    Command(
        "stress",
        "numerical stability: errors and wrong hits, against exact answers, along sweeps of growing difficulty",
        "mitsuba_ref.cli.experiments",
        run="run_stress",
        arguments="add_stress_arguments",
        starts_with="loading the judge",
    ),
    Command(
        "bench",
        "run time against error: our caster beside Mitsuba and others, in alternating processes",
        "mitsuba_ref.cli.experiments",
        run="run_bench",
        arguments="add_bench_arguments",
        starts_with="loading the judge",
    ),
    Command(
        "schema",
        "print the JSON Schema of a result, such as verdict.json",
        "mitsuba_ref.cli.doctor",
        run="run_schema",
        arguments="add_schema_arguments",
    ),
    Command(
        "doctor", "list what was found on this machine, and the effect of each missing part", "mitsuba_ref.cli.doctor"
    ),
)

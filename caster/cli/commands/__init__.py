"""The registry of commands, in the order of `caster --help`. Each says how it is called and what it does.

A command is a module with HELP (one line), `add_arguments(parser)` and `run(args)`, which gives an exit code; NAME,
where it is called otherwise than its module.
It imports what is slow to load inside `run`, so that `--help` answers at once.
"""

from types import ModuleType

from caster.cli.commands import check, course_6837, doctor, info, preview, probe, render, schema, sheet

COMMANDS: tuple[ModuleType, ...] = (
    render,
    probe,
    check,
    schema,
    info,
    preview,
    sheet,
    course_6837,
    doctor,
)

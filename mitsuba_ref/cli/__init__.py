"""The registry of commands, in the order of `mitsuba-ref --help`; see caster/commands for what one is."""

from types import ModuleType

from mitsuba_ref.cli import (
    approve,
    bench,
    check,
    compare,
    doctor,
    export,
    fuzz,
    import_scene,
    merge,
    render,
    stress,
    validate,
)
from mitsuba_ref.cli import probe as probe

COMMANDS: tuple[ModuleType, ...] = (
    validate,
    merge,
    render,
    approve,
    check,
    export,
    import_scene,
    compare,
    probe,
    fuzz,
    stress,
    bench,
    doctor,
)

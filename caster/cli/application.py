"""The command framework of `caster` and `mitsuba-ref`: a registry of commands, loaded when they are used."""

import argparse
import contextlib
import re
import signal
import sys
import textwrap
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple, NoReturn

from caster import __version__
from caster.cli.shared_arguments import Adder, checked_paths
from caster.description.errors import suggestion
from caster.system import NOT_HERE, terminal
from caster.system.process import FILE, INTERRUPTED, USAGE, end_process, report_error, run_command

__all__ = ["Command"]


class Command(NamedTuple):
    """An entry of a registry. Its module defines functions `arguments(add)` and `run(args) -> exit code`."""

    name: str  # as typed
    help: str  # one line
    module: str  # dotted
    run: str = "run"
    arguments: str = "add_arguments"  # "": it has none
    starts_with: str = ""  # the first status line of a command that loads slowly
    arguments_in: str = ""  # another module that has `arguments`, of a command that loads slowly
    example: str = ""  # a command line, or several

    def load(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments to the parser of the command. The module of `run` is imported when it runs."""
        if self.arguments:
            getattr(import_module(self.arguments_in or self.module), self.arguments)(Adder(parser))
        parser.set_defaults(run=lambda args: getattr(import_module(self.module), self.run)(args))


def main(
    name: str, about: str, commands: Sequence[Command], codes: Mapping[int, str], argv: Sequence[str] | None
) -> int:
    """Run one of the commands and return its exit code. codes: their meanings, for --help.

    argv: the words after the program's name, default those of this process. Only the command's own module is imported.
    """
    if NOT_HERE:
        print(f"{name}: {NOT_HERE}", file=sys.stderr)
        return FILE

    def run() -> int:
        words = sys.argv[1:] if argv is None else list(argv)
        chosen = next((word for word in words if not word.startswith("-")), "")
        parser = build_parser(name, about, commands, codes, (chosen,))
        if not words:
            parser.print_help(sys.stderr)
            return USAGE
        args = parser.parse_args(words)
        with checked_paths(args):
            if argv is None:
                announce(name, commands, chosen)
            with terminal.compilation_reported():
                return int(args.run(args))

    code = run_command(run)
    if code == INTERRUPTED and argv is None:
        end_process()  # threads may still be in compiled code, for which Python would wait
    if argv is None and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends the end of the process without a traceback
    return code


def announce(name: str, commands: Sequence[Command], chosen: str) -> None:
    """Write the command's starting line, if it has one, to standard error before slow imports."""
    for text in (command.starts_with for command in commands if command.name == chosen):
        if text:
            with contextlib.suppress(OSError):  # standard error may be closed
                print(f"{name} {chosen}: {text}", file=sys.stderr, flush=True)


class _Parser(argparse.ArgumentParser):
    """A parser that suggests what a misspelt word may mean.

    It has no colours of Python 3.14, whose escapes `printable` would show.
    """

    color = False

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As in argparse; a command's parser, not the program's, reports options that it does not know."""
        found, extra = super().parse_known_args(args, namespace)
        if extra and self._subparsers is None:
            options = self._option_string_actions
            hints = [suggestion(word.partition("=")[0], options) for word in extra if word.startswith("-")]
            hints += [f"; an output follows -o, as in -o {word}" for word in extra[:1] if not hints and "-o" in options]
            self.error(f"unrecognized arguments: {' '.join(extra)}{next(filter(None, hints), '')}")
        return found, extra

    def error(self, message: str) -> NoReturn:
        """Exit with 2 after the message, with a suggestion for a choice that does not exist, and where to look."""
        if choice := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            known = re.findall(r"[^\s,']+", choice[2])
            message = message.replace(f"'{choice[1]}' (", f"'{choice[1]}'{suggestion(choice[1], known)} (", 1)
        self.exit(report_error(f"{self.prog}: error: {message}\n{self.prog} --help lists what it takes", USAGE))


def build_parser(
    name: str, about: str, commands: Sequence[Command], codes: Mapping[int, str], loaded: Sequence[str] | None = None
) -> argparse.ArgumentParser:
    """The parser of a program. loaded: the commands whose arguments it needs, default all."""
    shared: dict[str, Any] = {"allow_abbrev": False, "formatter_class": argparse.RawDescriptionHelpFormatter}
    exit_codes = _filled("exit codes: " + ", ".join(f"{code} {meaning}" for code, meaning in codes.items()))
    top = _Parser(name, description=_filled(about), epilog=exit_codes, **shared)
    top.add_argument("--version", action="version", version=f"{name} {__version__}")
    group = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for command in commands:
        example = "\n".join(["example:", *(f"  {line}" for line in command.example.splitlines()), "", ""])
        epilog = (example if command.example else "") + exit_codes
        about = _filled(command.help)
        parser = group.add_parser(command.name, help=command.help, description=about, epilog=epilog, **shared)
        if loaded is None or command.name in loaded:
            command.load(parser)
    return top


HELP_CHARACTERS = 78  # of a line, as argparse has them on a terminal of 80


def _filled(text: str) -> str:
    """Text in lines, the later ones indented as far as what follows a label."""
    label, colon, _ = text.partition(": ")
    indent = " " * len(label + colon) if len(label) < HELP_CHARACTERS // 4 else ""
    return textwrap.fill(text, HELP_CHARACTERS, subsequent_indent=indent if colon else "")

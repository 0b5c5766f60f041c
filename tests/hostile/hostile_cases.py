"""Seeded hostile cases: a command line over samples, of which one file or one option is broken."""

import argparse
import random
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from hostile_mutations import NUMBERS, WORDS, mutated
from hostile_samples import READERS, WITHOUT_FILES

import caster.cli
import mitsuba_ref.cli
from caster.cli.application import build_parser
from caster.cli.shared_arguments import InputPath, OutputFile, OutputFolder, output_file_unless_number
from mitsuba_ref.cli.arguments import ScenePath

COMMANDS = {"caster": caster.cli.COMMANDS, "mitsuba-ref": mitsuba_ref.cli.COMMANDS}
OUTPUTS = (OutputFile, OutputFolder, output_file_unless_number)

# What a path may be instead of a file. "sparse": a terabyte without content; "unreadable": not for root.
NO_FILES = ("missing", "folder", "fifo", "loop", "zero", "null", "full", "sparse", "unreadable", "empty")

VALUES = [
    *(value for value in (*NUMBERS, *WORDS) if "\0" not in value),
    "3",
    "100000000",
    "100000000/100000000",
    "0/0",
    "2/1",
    "1..99999999999",
    "9..1",
    "99999999999999s",
    "(" * 5000,
    "not " * 5000 + "a",
    "a and " * 5000 + "a",
    "\udc80",
    "-",
    "--",
    "a,b,a",
    "depth,depth",
    "1:0",
    "0:99999999999999",
    "10000 10000",
    "os:system",
    "no.such:thing",
    "sh",
    "x=y=z",
    "a\nb",
    " 1 ",
    "+1",
]
PATHS = [
    "",
    "in",
    "out",
    "in/scene.toml/x",
    "out/no/such/folder/x",
    "/dev/full",
    "/dev/null/x",
    "/proc/self/x",
    "in/mesh.obj",
    "out/" + "x" * 300,
    "out/a\nb",
    "out/\x1b[2J",
    "out/\udc80",
    "in/fifo",
    "in/loop",
    "-",
    "out/../in/image.exr",
    "/dev/zero",
    "in/image.exr",
    "in/rays.npz",
    "out/x.html",
    "out/x.unknown",
    "/nowhere/x",
]


@dataclass(frozen=True)
class Case:
    """One run: the words, which file is replaced by what, and the limit of a file's size, if any."""

    number: int
    program: str
    words: tuple[str, ...]
    file: str = ""  # that is replaced
    data: bytes | None = None  # its content; None: by `no_file`
    no_file: str = ""  # of NO_FILES
    disk: int | None = None  # bytes that a file may have
    what: str = ""
    outputs: tuple[str, ...] = ()  # given by a hostile option, and no input of the same line
    process: bool = False  # in a process of its own, not a fork

    def line(self) -> str:
        words = (word if len(word) < 80 else f"{word[:40]}...({len(word)})" for word in self.words)
        return f"case {self.number}: {self.program} {shlex.join(words)} # {self.file} {self.what}".rstrip()


def lines() -> Iterator[tuple[str, str]]:
    """(file, command line) of all samples, then those without a file."""
    for file, found in READERS.items():
        yield from ((file, line.replace("FILE", file)) for line in found)
    yield from (("", line) for line in WITHOUT_FILES)


def split(line: str) -> tuple[str, tuple[str, ...]]:
    program, *words = shlex.split(line)
    return program, tuple(words)


@cache
def parsers() -> dict[tuple[str, str], argparse.ArgumentParser]:
    """Of all commands of both programs."""
    found = {}
    for program, commands in COMMANDS.items():
        top = build_parser(program, "", commands, {})
        (sub,) = (each for each in top._actions if isinstance(each, argparse._SubParsersAction))
        found |= {(program, name): parser for name, parser in sub.choices.items()}
    return found


def cases(seed: int, count: int) -> list[Case]:
    """The same for the same seed; the first n of a longer list are another list, as all kinds have their share."""
    order = random.Random(f"{seed}")
    pools = {
        "mutated": shuffled(order, [(file, line) for file, line in lines() if file]),
        "option": shuffled(order, list(options())),
        "no file": shuffled(
            order, [(*pair, kind) for pair in lines() if pair[0] for kind in NO_FILES if is_possible(pair[0], kind)]
        ),
        "disk": shuffled(order, [line for _, line in lines() if "out/" in line]),
    }
    turns = ("mutated", "mutated", "option", "mutated", "no file", "mutated", "option", "mutated", "mutated", "disk")
    found: list[Case] = []
    for number in range(count):
        rng = random.Random(f"{seed} {number}")
        kind = turns[number % len(turns)]
        pool = pools[kind]
        chosen = pool[(number // len(turns) * turns.count(kind) + turns[: number % len(turns)].count(kind)) % len(pool)]
        found.append(MAKERS[kind](number, rng, chosen))
    return found


def is_possible(file: str, kind: str) -> bool:
    """Whether the command is at fault where such a file takes long: a candidate's own `cp` is not."""
    return not ("answer" in file and kind in ("fifo", "zero", "full", "sparse"))


def shuffled(order: random.Random, pool: list) -> list:  # type: ignore[type-arg]
    return order.sample(pool, len(pool))


def options() -> Iterator[tuple[str, argparse.Action]]:
    """Every option and argument with a value, and a command line of its command."""
    for key, parser in parsers().items():
        base = [line for _, line in lines() if split(line)[0] == key[0] and split(line)[1][0] == key[1]]
        for action in parser._actions:
            if action.nargs != 0:
                yield from ((line, action) for line in base[:2])


def mutated_case(number: int, rng: random.Random, chosen: tuple[str, str]) -> Case:
    """The content is filled in where the samples are (`with_content`)."""
    file, line = chosen
    program, words = split(line)
    return Case(number, program, words, file, what="mutated", process=number % 50 == 0)


def with_content(case: Case, seed: int, samples: Path) -> Case:
    """The case with the mutated content of its file."""
    if case.what != "mutated":
        return case
    done = mutated(random.Random(f"{seed} {case.number} content"), (samples / case.file).read_bytes(), case.file)
    return replace(case, data=done.data, what=done.what)


def option_case(number: int, rng: random.Random, chosen: tuple[str, argparse.Action]) -> Case:
    line, action = chosen
    program, words = split(line)
    is_path = action.type in (InputPath, ScenePath, *OUTPUTS)
    pool = (PATHS if is_path else VALUES) if rng.random() < 0.85 else [*PATHS[:9], *VALUES]
    if action.type in OUTPUTS:
        pool = [value for value in PATHS if not value.startswith("/dev/z")]
    count = action.nargs if isinstance(action.nargs, int) else 1
    values = [rng.choice(pool) for _ in range(count)]
    if action.type in OUTPUTS and rng.random() < 0.3:
        values = [rng.choice([word for word in words if word.startswith("in/")] or ["in"])]
    outputs = tuple(value for value in values if action.type in OUTPUTS and value not in words)
    if action.option_strings:
        name = action.option_strings[-1]
        given = [*words[: 1 if name not in words else words.index(name)]]
        rest = words[len(given) :] if name not in words else words[words.index(name) + 1 + count :]
        return Case(number, program, (*given, name, *values, *rest), what=f"option {name}", outputs=outputs)
    at = rng.randrange(1, len(words) + 1)
    return Case(number, program, (*words[:at], *values, *words[at:]), what=f"argument {action.dest}")


def no_file_case(number: int, rng: random.Random, chosen: tuple[str, str, str]) -> Case:
    file, line, kind = chosen
    program, words = split(line)
    return Case(number, program, words, file, no_file=kind, what=f"is {kind}")


def disk_case(number: int, rng: random.Random, line: str) -> Case:
    program, words = split(line)
    return Case(number, program, words, disk=rng.choice((0, 1, 100)), what="full disk")


MAKERS = {"mutated": mutated_case, "option": option_case, "no file": no_file_case, "disk": disk_case}

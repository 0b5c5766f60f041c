"""Command lists: kernel calls that run for rows of numbers without Python code in between.

Python runs in one thread at a time, and waiting for its lock costs more than the code itself. A list is recorded once,
as in graphics interfaces; arguments that change from row to row are read from the row.
"""

from collections.abc import Callable, Iterable
from itertools import accumulate, chain
from typing import Any, NamedTuple

import numpy as np

from caster.jit.arguments import describe
from caster.jit.decorators import Kernel, jit
from caster.jit.machine_code import DONE, PLACE_OF_ANSWER, call_entry, fail, load_word, store_word


class BoundCall:
    """A kernel bound to its arguments, except those at the places `given`: integers or tuples of integers.

    A list calls its machine code with a block of words; `answered` is the condition that its last answer is not 0. Only
    one thread may call it at a time.
    """

    def __init__(self, function: Callable[..., Any], *args: Any, given: tuple[int, ...]) -> None:
        # the arguments are kept, since the block holds addresses of arrays
        self._function, self._args, self._given = function, args, given
        self.code: Any = function.code(args) if isinstance(function, Kernel) else None
        self.block = np.zeros(1, np.int64)
        self.places: list[range] = []  # where the given arguments are in the block
        if self.code is not None:
            described = [describe((arg,)) for arg in args]
            words = [each.words[PLACE_OF_ANSWER + 1 :] for each in described if each is not None]
            ends = [*accumulate(map(len, words), initial=PLACE_OF_ANSWER + 1)]
            self.block = np.array([0, *chain(*words)], np.int64)
            self.places = [range(ends[n], ends[n + 1]) for n in given]
        self.address = self.block.ctypes.data
        self.answered = self.block, PLACE_OF_ANSWER

    def __call__(self, *numbers: int | tuple[int, ...]) -> None:
        """Call the function where there is no machine code."""
        every = list(self._args)
        for n, those in zip(self._given, numbers, strict=True):
            every[n] = those
        answer = self._function(*every)
        self.block[PLACE_OF_ANSWER] = answer if isinstance(answer, int | np.integer) else 0


Condition = int | tuple[np.ndarray, int]
"""A number of the row, or an element of an int64 array; where it is 0, a command is skipped."""


class Command(NamedTuple):
    """A call in a command list."""

    call: Any  # a BoundCall, or a Python function of the same arguments
    given: tuple[int | slice, ...]  # for each argument, its number in the row, or a slice for a tuple
    when: Condition | None = None


class Column(int):
    """The number of a column of the rows, which holds an argument; a slice of columns holds a tuple."""


def command(function: Callable[..., Any], *args: Any, when: Condition | None = None) -> Command:
    """Call a kernel with these arguments, of which columns are read from the row."""
    given = tuple(n for n, arg in enumerate(args) if type(arg) in (Column, slice))
    values, columns = list(args), tuple(args[n] for n in given)
    for n, those in zip(given, columns, strict=True):
        values[n] = 0 if isinstance(those, Column) else (0,) * (those.stop - those.start)
    return Command(BoundCall(function, *values, given=given), columns, when)


# A program is a list of words. Each command has the addresses of its entry and block; its condition: the address of a
# number, ~(the place of one in the row), or ALWAYS; the count of numbers that are copied from the row to the block, and
# for each its place in the row and its address. PAUSE in place of an entry returns to Python, for a call without
# machine code.
PAUSE, ALWAYS = 0, 0
FINISHED, FAILED = -1, -2


@jit
def run_commands(program: Any, rows: Any, state: Any) -> int:
    """Run a program from word state[2] on, for rows state[0] to state[1].

    Returns FINISHED, FAILED, or the number of the command that Python has to run before the program goes on.
    """
    at, row = state[2], state[0]
    while row < state[1]:
        while at < len(program):
            entry, block, when, copies = program[at], program[at + 1], program[at + 2], program[at + 3]
            first, at = at + 4, at + 4 + 2 * copies
            if (when > 0 and load_word(when) == 0) or (when < 0 and rows[row, ~when] == 0):
                continue
            if entry == PAUSE:
                state[0], state[2] = row, at
                return block
            for n in range(first, at, 2):
                store_word(program[n + 1], rows[row, program[n]])
            status = call_entry(entry, block)
            if status != DONE[0] and status != DONE[1]:
                return FAILED
        at, row = 0, row + 1
    return FINISHED


class CommandList:
    """Commands that run one after the other for each row of numbers; for one thread at a time."""

    def __init__(self, commands: Iterable[Command], rows: np.ndarray) -> None:
        """rows: (n, width) int64, C-ordered; they may change between runs."""
        assert rows.dtype == np.int64 and rows.flags.c_contiguous
        self._commands, self._rows = tuple(commands), rows
        words = [word for number, command in enumerate(self._commands) for word in self._words(number, command)]
        self._program = np.array(words, np.int64)

    def run(self, start: int, stop: int) -> None:
        """Run all commands for each of rows start..stop."""
        state = np.array([start, stop, 0])
        while (number := run_commands(self._program, self._rows, state)) != FINISHED:
            if number == FAILED:
                fail()
            command, row = self._commands[number], self._rows[state[0]].tolist()
            command.call(*(tuple(row[g]) if isinstance(g, slice) else row[g] for g in command.given))

    def _words(self, number: int, command: Command) -> list[int]:
        when, call = _condition_word(command.when), command.call
        if not isinstance(call, BoundCall) or call.code is None:
            return [PAUSE, number, when, 0]
        copies: list[int] = []
        columns = range(self._rows.shape[1])
        for place, taken in zip(call.places, command.given, strict=True):
            of_row = columns[taken] if isinstance(taken, slice) else (taken,)
            for word, n in zip(place, of_row, strict=True):
                copies += (n, call.address + word * call.block.itemsize)
        return [call.code.address, call.address, when, len(copies) // 2, *copies]


def _condition_word(when: Condition | None) -> int:
    if when is None:
        return ALWAYS
    if isinstance(when, int):
        return ~when
    return int(when[0].ctypes.data) + when[1] * when[0].itemsize

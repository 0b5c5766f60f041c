"""Lists of kernel calls that are carried out for rows of numbers without a step of Python between them.

Python's steps are taken by one thread at a time, and waiting for one's turn costs more than they do. A list is recorded
once, as command lists of graphics interfaces are: what changes from one row to the next is read from the row.
"""

import ctypes
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from caster.jit import machine_code
from caster.jit.arguments import DONE, INTEGER, C, add_words, fail

__all__ = ["BoundCall", "Command", "CommandList", "Condition"]


class BoundCall:
    """A kernel with its arguments, but for those of the places `given`, integers or tuples of integers.

    One thread's at a time.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        args: tuple[Any, ...],
        given: tuple[int, ...],
        code: machine_code.ObjectCode | None,
    ) -> None:
        """code: None where only Python or Numba can call the kernel."""
        # the block has addresses of arrays among the arguments
        self._function, self._args, self._given = function, args, given
        self.code = code
        self.answer = C[(code.gives if code is not None else "") or INTEGER]()
        if code is not None:
            self._gives = bool(code.gives)
            self.block, self.places = _block_of(ctypes.addressof(self.answer), args, given)
            self.block_address = ctypes.addressof(self.block)

    def __call__(self, *numbers: int | tuple[int, ...]) -> Any:
        if self.code is None:
            return self._call_plainly(numbers)
        block = self.block
        for place, those in zip(self.places, numbers, strict=True):
            block[place] = list(those) if isinstance(those, tuple) else [those]
        if self.code.block_entry(self.block_address) not in DONE:
            fail()
        return self.answer.value if self._gives else None

    def _call_plainly(self, numbers: tuple[int | tuple[int, ...], ...]) -> Any:
        every = list(self._args)
        for n, those in zip(self._given, numbers, strict=True):
            every[n] = those
        answer = self._function(*every)
        self.answer.value = int(answer) if isinstance(answer, int | np.integer) else 0
        return answer


def _block_of(answer: int, args: tuple[Any, ...], given: tuple[int, ...]) -> tuple[Any, list[slice]]:
    """(words of an entry: the address for its answer, then the arguments; where those that are given stand)."""
    words, places = [answer], []
    for n, arg in enumerate(args):
        start = len(words)
        add_words((arg,), words)
        if n in given:
            places.append(slice(start, len(words)))
    return (ctypes.c_int64 * len(words))(*words), places


Condition = int | BoundCall | tuple[np.ndarray, int]
"""A number of the row, an earlier call's last answer, or an element of int64; a command is skipped where it is 0."""


class Command(NamedTuple):
    """A call of a command list."""

    call: Callable[..., Any]  # a BoundCall, or any function of such arguments
    given: tuple[int | slice, ...]  # numbers of the row for each argument: one, or several as a tuple
    when: Condition | None = None


class CommandList:
    """Commands that are carried out one after the other for each row of numbers; one thread's at a time."""

    def __init__(self, commands: Iterable[Command], rows: np.ndarray) -> None:
        """rows: (n, width) int64, row by row; they may change between runs."""
        assert rows.dtype == np.int64 and rows.flags.c_contiguous
        self._commands, self._rows, self._program = tuple(commands), rows, None
        if any(_is_machine_code(command.call) for command in self._commands):
            self._program = _Program(self._commands, rows)

    def run(self, start: int, stop: int) -> None:
        """For rows start..stop."""
        if self._program is not None:
            self._program.run(start, stop)
            return
        for row in self._rows[start:stop].tolist():
            for command in self._commands:
                if _holds(command.when, row):
                    _call(command, row)


def _is_machine_code(call: Callable[..., Any]) -> bool:
    return isinstance(call, BoundCall) and call.code is not None


def _holds(when: Condition | None, row: Sequence[int]) -> bool:
    if isinstance(when, BoundCall):
        return when.answer.value != 0
    return when is None or bool(row[when] if isinstance(when, int) else when[0][when[1]])


def _call(command: Command, row: Sequence[int]) -> None:
    command.call(*(tuple(row[g]) if isinstance(g, slice) else row[g] for g in command.given))


WORD = ctypes.sizeof(ctypes.c_int64)


class _Program:
    """Commands as `machine_code.RUN_COMMANDS` reads them."""

    def __init__(self, commands: tuple[Command, ...], rows: np.ndarray) -> None:
        self._commands, self._width = commands, rows.shape[1]
        self._row = (ctypes.c_int64 * self._width)()
        self._row_at, self._first = ctypes.addressof(self._row), rows.ctypes.data
        words = [word for number, command in enumerate(commands) for word in self._words(number, command)]
        words.append(machine_code.END_OF_COMMANDS)
        self._words_of_all = (ctypes.c_int64 * len(words))(*words)
        self._state = (ctypes.c_int64 * machine_code.COMMAND_STATE_SIZE)(
            ctypes.addressof(self._words_of_all), 0, 0, self._width, self._row_at
        )
        self._state_at, self._go = ctypes.addressof(self._state), machine_code.command_runner()

    def _words(self, number: int, command: Command) -> list[int]:
        when, call = self._address_of(command.when), command.call
        if not isinstance(call, BoundCall) or call.code is None:
            return [machine_code.PAUSE, number, when, 0]
        copies: list[int] = []
        numbers = range(self._width)
        for place, taken in zip(call.places, command.given, strict=True):
            of_row = numbers[taken] if isinstance(taken, slice) else (taken,)
            for word, n in zip(range(place.start, place.stop), of_row, strict=True):
                copies += (self._row_at + n * WORD, call.block_address + word * WORD)
        return [call.code.block_address, call.block_address, when, len(copies) // 2, *copies]

    def _address_of(self, when: Condition | None) -> int:
        """0 for none."""
        if when is None:
            return 0
        if isinstance(when, int):
            return self._row_at + when * WORD
        if isinstance(when, BoundCall):
            return ctypes.addressof(when.answer)
        return int(when[0].ctypes.data) + when[1] * when[0].itemsize

    def run(self, start: int, stop: int) -> None:
        state, step = self._state, self._width * WORD
        state[1], state[2], state[5] = self._first + start * step, self._first + stop * step, 0
        while status := self._go(self._state_at):
            if status != machine_code.PAUSED:
                fail()
            _call(self._commands[state[6]], list(self._row))

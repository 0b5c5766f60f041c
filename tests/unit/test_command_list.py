"""Command lists make the same calls, in order, with machine code and in plain Python."""

from typing import Any

import numpy as np
import pytest

from caster.jit.command_list import BoundCall, Command, CommandList
from caster.jit.decorators import jit
from caster.kernels.raster.tile import BOX, COUNT, HEIGHT, LINES, WIDTH, kind_numbers, tile_boxes, tile_rows
from caster.rendering.rasterization import MAX_TILES_PER_PIECE, parallel_for_tiles


@jit
def append(record: Any, name: int, box: Any, number: int) -> int:
    """Append (name, box, number) to the record; returns whether the number is odd."""
    at = record[0]
    record[0] = at + 4
    record[at], record[at + 1], record[at + 2], record[at + 3] = name, box[0], box[1], number
    return number % 2


@jit
def count_down(flags: Any) -> None:
    flags[1] -= 1


@jit
def overflow(numbers: Any, at: int) -> None:
    if at > 3:
        raise ValueError("too far")
    numbers[at] += 1


def plainly(record: np.ndarray) -> Any:
    """The same as `append` of that record, in Python alone."""

    def call(name: int, box: tuple[int, int], number: int) -> None:
        at = int(record[0])
        record[at : at + 4] = (name, *box, number)
        record[0] = at + 4

    return call


ROWS = np.array([[10, 11, 1, 0], [20, 21, 2, 1], [30, 31, 3, 1], [40, 41, 4, 0]], np.int64)
PAIR, NUMBER, FLAG = slice(0, 2), 2, 3


def recorded(kinds: str, start: int = 0, stop: int = 4) -> list[list[int]]:
    """What commands write that are machine code (m) or a function of Python (p), one a letter."""
    record, flags = np.zeros(200, np.int64), np.array([7, 3], np.int64)
    record[0] = 1

    def write(place: int, when: Any = None) -> Command:
        machine = BoundCall(append, record, place, (0, 0), 0, given=(2, 3))
        if kinds[place] == "m":
            return Command(machine, (PAIR, NUMBER), when)
        return Command(lambda box, number: plainly(record)(place, box, number), (PAIR, NUMBER), when)

    odd = BoundCall(append, record, 9, (0, 0), 0, given=(2, 3))
    commands = CommandList(
        [
            write(0),
            write(1, FLAG),
            Command(odd, (PAIR, NUMBER), FLAG),  # where it is skipped, its last answer stands
            write(2, odd.answered),
            write(3, (flags, 1)),
            Command(BoundCall(count_down, flags, given=()), ()),
            write(4),
        ],
        ROWS,
    )
    commands.run(start, stop)
    assert flags.tolist() == [7, 3 - (stop - start)]
    return record[1 : record[0]].reshape(-1, 4).tolist()


def expected(start: int, stop: int) -> list[list[int]]:
    found, odd = [], 0
    for n, row in enumerate(ROWS[start:stop].tolist()):
        flag, number = row[FLAG], row[NUMBER]
        names = [0, *([1, 9] if flag else [])]
        odd = number % 2 if flag else odd
        names += [*([2] if odd else []), *([3] if n != 3 else []), 4]
        found += [[name, *row[:3]] for name in names]
    return found


@pytest.mark.parametrize("kinds", ["mmmmm", "ppppp", "pmpmp", "mpmpm", "pmmmp", "mmppm"])
@pytest.mark.parametrize(("start", "stop"), [(0, 4), (1, 3), (2, 2), (3, 4)])
def test_commands_are_carried_out_in_order_for_each_row_where_their_condition_holds(kinds, start, stop):
    assert recorded(kinds, start, stop) == expected(start, stop)


def test_a_failing_kernel_and_a_failing_function_end_the_list_which_can_be_run_again():
    rows, numbers, seen = np.arange(8, dtype=np.int64).reshape(-1, 1), np.zeros(10), []

    def refuse(n: int) -> None:
        seen.append(n)
        if n == 2:
            raise KeyError(n)

    commands = CommandList([Command(refuse, (0,)), Command(BoundCall(overflow, numbers, 0, given=(1,)), (0,))], rows)
    with pytest.raises(KeyError):
        commands.run(0, 4)
    assert seen == [0, 1, 2] and numbers.tolist() == [1, 1] + [0] * 8
    with pytest.raises((RuntimeError, ValueError)):
        commands.run(3, 8)
    assert seen == [0, 1, 2, 3, 4] and numbers.tolist() == [1, 1, 0, 1] + [0] * 6
    commands.run(0, 2)
    assert numbers.tolist() == [2, 2, 0, 1] + [0] * 6


@pytest.mark.parametrize(("width", "height"), [(1, 1), (WIDTH, HEIGHT), (WIDTH + 1, 3), (300, 200)])
def test_rows_of_tiles_have_their_boxes_and_what_there_is_of_each_kind(width, height):
    boxes = list(tile_boxes(width, height))
    rng, count = np.random.default_rng(230), len(boxes)
    runs = [np.concatenate([[5], 5 + np.cumsum(rng.integers(0, 2, count))]) for _ in range(3)]
    for given in (runs, None):
        rows = tile_rows(width, height, 3, given)
        assert rows.dtype == np.int64 and rows.flags.c_contiguous and len(rows) == count
        for n, (row, box) in enumerate(zip(rows.tolist(), boxes, strict=True)):
            lines = box[3] - box[1]
            assert (tuple(row[BOX]), row[LINES], row[COUNT]) == (box, lines, lines * WIDTH)
            present = [True] * 3 if given is None else [bool(run[n] < run[n + 1]) for run in runs]
            for k, at in enumerate(map(kind_numbers, range(3))):
                assert bool(row[at.present]) == present[k]
                assert row[at.run] == ([0, 1] if given is None else [runs[k][n], runs[k][n + 1] - runs[k][n]])


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("count", [1, 5, 200, 5000])
def test_tiles_of_a_large_film_are_carried_out_in_small_pieces_and_all_of_them(count, threads):
    """Between pieces, signals are handled and progress is reported."""
    rows, seen, reported = tile_rows(WIDTH, HEIGHT * count, 0), [], []
    parallel_for_tiles(lambda: [Command(seen.append, (BOX,))], rows, threads, reported.append)
    assert sorted(seen) == sorted(tile_boxes(WIDTH, HEIGHT * count))
    assert sum(reported) == WIDTH * HEIGHT * count
    assert max(reported) <= MAX_TILES_PER_PIECE * WIDTH * HEIGHT

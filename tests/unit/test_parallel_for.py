"""parallel_for does each piece once, raises errors, and begins nothing after one."""

import threading
from collections.abc import Callable

import pytest

from caster.rendering.threads import (
    core_count,
    even_pieces,
    parallel_for,
    parallel_for_pieces,
    set_default_threads,
    thread_count,
)


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
@pytest.mark.parametrize("count", [0, 1, 2, 97])
def test_every_piece_is_done_once_and_reported_of_once_after_it(workers, count):
    done: list[int] = []
    told: list[tuple[int, bool]] = []
    pieces = list(range(count))
    parallel_for_pieces(lambda: done.append, pieces, workers, lambda piece: told.append((piece, piece in done)))
    assert sorted(done) == pieces and sorted(told) == [(piece, True) for piece in pieces]


@pytest.mark.parametrize("threads", [1, 2, 7])
def test_bands_cover_everything(threads):
    done: list[range] = []
    parallel_for(lambda start, stop: done.append(range(start, stop)), 1000, threads)
    assert sorted(i for band in done for i in band) == list(range(1000))
    parallel_for(lambda start, stop: pytest.fail("nothing to do"), 0, threads)


def test_too_little_for_a_second_thread_stays_on_this_one():
    where = set()
    parallel_for(lambda start, stop: where.add(threading.get_ident()), 99, 4, least=50)
    assert where == {threading.get_ident()}


@pytest.mark.parametrize(("count", "pieces"), [(1, 1), (50, 1), (99, 2), (100, 8), (101, 8), (400, 16)])
def test_too_little_for_a_second_thread_is_no_more_pieces_than_needed(count, pieces):
    done: list[tuple[int, int]] = []
    parallel_for(lambda *band: done.append(band), count, 4, least=50)
    assert len(done) == pieces and sum(stop - start for start, stop in done) == count


def test_a_thread_prepares_itself_only_for_a_piece():
    """If the first thread does all pieces, the others allocate no buffers."""
    begun: list[int] = []

    def begin() -> Callable[[int], None]:
        begun.append(threading.get_ident())
        return lambda piece: None

    parallel_for_pieces(begin, [], 3)
    assert begun == []
    parallel_for_pieces(begin, [1, 2], 1)
    assert begun == [threading.get_ident()]


def test_an_error_is_raised_and_what_has_not_begun_is_not_begun():
    begun: list[int] = []

    def work(piece: int) -> None:
        begun.append(piece)
        if piece == 3:
            raise ValueError("planted")

    with pytest.raises(ValueError, match="planted"):
        parallel_for_pieces(lambda: work, list(range(10**6)), 1)
    assert begun == [0, 1, 2, 3]


def test_an_error_of_another_thread_is_raised():
    mine, caught = threading.get_ident(), threading.Event()

    def work(piece: int) -> None:
        if threading.get_ident() != mine:
            caught.set()
            raise ValueError("planted elsewhere")
        caught.wait(0.01)

    with pytest.raises(ValueError, match="planted elsewhere"):
        parallel_for_pieces(lambda: work, list(range(1000)), 2)
    assert caught.is_set()


def test_work_within_work_ends():
    """Nested loops do not deadlock: the calling thread does the remaining pieces."""
    done: list[int] = []

    def outer(piece: int) -> None:
        parallel_for_pieces(lambda: done.append, list(range(10)), 2)

    parallel_for_pieces(lambda: outer, list(range(8)), 2)
    assert len(done) == 80


def test_a_default_is_for_those_who_request_no_number():
    assert thread_count(3) == 3 and thread_count() == core_count() >= 1
    set_default_threads(5)
    try:
        assert thread_count() == 5 and thread_count(2) == 2
    finally:
        set_default_threads(None)
    assert thread_count() == core_count()


@pytest.mark.parametrize(("stop", "count"), [(0, 0), (7, 7), (17, 4), (5, 8), (0, 3)])
def test_even_pieces_are_all_of_a_range_and_of_about_the_same_length(stop, count):
    pieces = even_pieces(stop, count)
    assert len(pieces) == count
    assert [n for piece in pieces for n in range(*piece)] == list(range(stop))
    lengths = [b - a for a, b in pieces]
    assert not lengths or max(lengths) - min(lengths) <= 1

"""The guard against slower revisions decides by ratios of planted times."""

import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def revisions(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import revisions

    yield revisions
    for name in ("revisions", "turns"):
        sys.modules.pop(name, None)


def pairs(*ratios: float) -> list[tuple[float, float]]:
    return [(0.1, 0.1 * ratio) for ratio in ratios]


def decided(revisions, *measured: list[tuple[float, float]]) -> tuple[int, str]:
    """What is said of one scene, if it takes these times whenever it is measured."""
    times = iter(measured)
    one = revisions.compare("scenes/teapot.toml", "bvh", 1.25, lambda: next(times))
    assert next(times, None) is None, "measured less often than it had to be"
    return revisions.verdict([one], 1.25)


def test_what_is_slower_twice_fails(revisions):
    code, words = decided(revisions, pairs(1.3, 1.3, 1.4), pairs(1.3, 1.3, 1.3))
    assert code == 1
    assert words == "slower than 1.25 times: scenes/teapot.toml (bvh) 1.30"


def test_what_is_slower_once_was_the_machine(revisions):
    assert decided(revisions, pairs(1.3, 1.3, 1.4), pairs(1.0, 1.1, 1.3))[0] == 0


def test_a_quarter_more_is_still_allowed(revisions):
    assert decided(revisions, pairs(1.24, 1.24, 9.0)) == (0, "1 comparisons, none slower than 1.25 times")
    assert decided(revisions, pairs(0.5, 0.5, 0.5))[0] == 0


def test_a_load_that_hits_both_changes_nothing(revisions):
    """Ratios of each turn, and not a ratio of medians: here the medians are 3 times apart."""
    both = [(0.1, 0.1), (0.1, 0.11), (0.3, 0.3), (0.1, 0.31), (0.3, 0.3)]
    assert revisions.ratio(both) == pytest.approx(1.0)


def test_times_of_nothing_are_no_pass(revisions):
    for broken in (pairs(float("nan"), float("nan"), 1.0), [(0.1, 0.0)] * 3):
        with pytest.raises(revisions.NoAnswer, match="have to be above 0"):
            decided(revisions, broken)


def test_nothing_compared_is_no_pass(revisions):
    assert revisions.verdict([], 1.25)[0] == 2


@pytest.mark.parametrize("words", [["no-such-revision"], ["HEAD", "--limit", "nan"], ["HEAD", "--turns", "0"]])
def test_a_mistake_is_not_a_slower_caster(revisions, words, capfd, monkeypatch):
    def nobody(*_: object) -> None:
        raise ValueError("no-such-revision: no commit")

    monkeypatch.setattr(revisions, "sources_of", nobody)
    with pytest.raises(SystemExit) as end:
        revisions.main(words)
    assert end.value.code == 2


def test_a_caster_that_dies_is_not_a_slower_one(revisions, monkeypatch, capsys, tmp_path):
    """Both casters are real processes, of sources that are none."""
    (tmp_path / "caster").mkdir()
    (tmp_path / "caster" / "__init__.py").write_text("raise SystemExit(5)\n")
    monkeypatch.setattr(revisions, "sources_of", lambda *_: tmp_path)
    monkeypatch.setattr(revisions, "HERE", tmp_path)
    assert revisions.main(["HEAD", "scenes/teapot.toml"]) == 70
    assert "ended without an answer" in capsys.readouterr().err


def test_a_planted_delay_is_distinguished_from_none(revisions, monkeypatch, capsys, tmp_path):
    """The whole command between two casters whose times are planted: one takes twice as long as the other."""
    for name, seconds in (("before", 0.01), ("here", 0.02)):
        folder = tmp_path / name / "caster"
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text(PLANTED.format(seconds=seconds))
    monkeypatch.setattr(revisions, "sources_of", lambda *_: tmp_path / "before")
    monkeypatch.setattr(revisions, "HERE", tmp_path / "here")
    assert revisions.main(["HEAD", "scenes/teapot.toml", "--turns", "1"]) == 1
    out = capsys.readouterr()
    assert "slower than 1.25 times: scenes/teapot.toml (raster) 2.00" in out.err
    monkeypatch.setattr(revisions, "sources_of", lambda *_: tmp_path / "here")
    assert revisions.main(["HEAD", "scenes/teapot.toml", "--turns", "1"]) == 0


# A caster that does nothing, and a clock that says how long that took.
PLANTED = """
import time
def load_scene(path):
    return Scene()
class Scene:
    def with_film(self, **size):
        return self
now = [0.0]
time.thread_time = lambda: now[0]
def render(scene, aovs, **more):
    now[0] += {seconds}
"""

"""A family through all witnesses."""

import importlib.metadata
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from mitsuba_ref import child
from mitsuba_ref.stress import witnesses
from mitsuba_ref.stress.family import Family
from mitsuba_ref.stress.result import OWN, Outcome, Sweep
from mitsuba_ref.stress.score import Scorer, judged
from mitsuba_ref.stress.truth import find_truth
from mitsuba_ref.stress.witnesses import OURS, REFERENCES, SCREEN, Absent, Prepared, Sight
from mitsuba_ref.variants import usable

Progress = Callable[[str], None]
Sights = dict[str, Sight | Absent]  # by witness
CHILDREN = 2  # at a time: each takes a core


def sweep(family: Family, seed: int, rays: int | None, say: Progress = lambda words: None) -> Sweep:
    """Every setting of a family. The same seed and number of rays give the same result, but for the seconds."""
    start = time.perf_counter()
    say("aiming")
    settings = prepared(family, seed, rays)
    outcomes = []
    for i, (ready, said) in enumerate(zip(settings, heard(settings, say), strict=True)):
        say(f"exact answers {i + 1}/{len(settings)}")
        outcomes.append(outcome(ready, said))
    return Sweep(family, tuple(outcomes), time.perf_counter() - start)


def prepared(family: Family, seed: int, rays: int | None) -> list[Prepared]:
    return [witnesses.prepare(setting) for setting in family.settings(seed, rays)]


def heard(settings: Sequence[Prepared], say: Progress) -> list[Sights]:
    """What all witnesses say of each setting. Mitsuba works in its own processes, while we do here."""
    pool = ThreadPoolExecutor(CHILDREN)
    try:
        with tempfile.TemporaryDirectory(prefix="mitsuba-ref-") as folder:
            asked = {
                witness.key: pool.submit(witnesses.reference, witness, settings, Path(folder) / witness.key)
                for witness in REFERENCES
            }
            own = []
            for i, ready in enumerate(settings):
                say(f"ours {i + 1}/{len(settings)}")
                own.append({OURS.key: witnesses.ours(ready), SCREEN.key: witnesses.on_screen(ready)})
            say("waiting for Mitsuba")
            theirs = {key: future.result() for key, future in asked.items()}
    finally:  # also on Ctrl-C: no child is left behind
        child.stop_all()
        pool.shutdown(wait=True, cancel_futures=True)
        child.start_again()
    return [sights | {key: each[i] for key, each in theirs.items()} for i, sights in enumerate(own)]


def outcome(ready: Prepared, said: Sights) -> Outcome:
    """The scores of one setting."""
    missed = [~sight.hit for sight in said.values() if isinstance(sight, Sight)]
    truth = find_truth(ready, np.any(missed, axis=0))
    scorer = Scorer(ready, truth)
    scores = {key: judged(scorer, sight, ours=key in OWN) for key, sight in said.items()}
    hits = int(truth.hit.sum())
    ties = sum(len(answer.ties) > 1 for answer in truth.answers)
    count = len(ready.setting.o)
    closed = ready.setting.closed
    return Outcome(
        ready.setting.x, count, hits, count - hits, len(truth.rows), closed, ties, scorer.bound, scores
    )


def versions() -> dict[str, str]:
    """What was asked."""
    found = {name: installed(name) for name in ("mitsuba", "drjit", "numpy")}
    library = usable().libllvm
    return found | {"libllvm": Path(library).name if library else "none"}


def installed(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"

"""Nobody's caster: arrays as large as the images of depth and normal, copied. What writing them costs at least."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from mitsuba_ref.bench.entries.ours import BYTES
from mitsuba_ref.bench.work import Work

CHANNELS = 4  # depth and the three of a normal


class Copying:
    def __init__(self, work: Work) -> None:
        self.threads = work.threads
        self.pool = ThreadPoolExecutor(work.threads)

    def build(self, size: int) -> None:
        self.count = size * size
        self.source = np.ones(CHANNELS * self.count * BYTES, np.uint8)
        self.target = np.zeros_like(self.source)

    def take_rays(self) -> None:
        """There are none."""

    def cast(self) -> int:
        pairs = zip(*(np.array_split(a, self.threads) for a in (self.target, self.source)), strict=True)
        list(self.pool.map(lambda pair: np.copyto(*pair), pairs))
        return self.count

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """It has no t to be wrong about."""
        return np.full(len(o), np.nan)

"""The command `caster`; its commands are in caster/cli."""

import gc
import os
import sys
from collections.abc import Sequence

from caster.cli import COMMANDS, application
from caster.system import process

ABOUT = "A ray caster in float64."
CODES = {
    code: meaning
    for code, meaning in process.MEANINGS.items()
    if code not in (process.DIFFERENCES, process.NOT_COMPARABLE)
}


# Allocations between runs of the garbage collector: Python's 700 mean a hundred runs while modules load.
COLLECTION_THRESHOLDS = (50_000, 20, 20)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code. argv: default sys.argv, in a process that runs nothing else."""
    if argv is None:
        gc.set_threshold(*COLLECTION_THRESHOLDS)
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is loaded
    return application.main("caster", ABOUT, COMMANDS, CODES, argv)


if __name__ == "__main__":
    sys.exit(main())

"""`python tests/exact/edge_cases.py`: measure what Mitsuba does with the edge cases, and write it down.

Writes mitsuba_behaviour.json beside this file and docs/edge-cases.md; `--page` writes the page alone.
"""

import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS), str(TESTS / "exact")]

from cases import CASES, behaviour  # noqa: E402 - found by the line above
from cases.page import page  # noqa: E402


def main(arguments: list[str]) -> int:
    if "--page" not in arguments:
        behaviour.write(behaviour.measured(CASES))
    text = page(CASES, behaviour.kept()["cases"])
    (TESTS.parent / "docs" / "edge-cases.md").write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

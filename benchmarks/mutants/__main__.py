"""Command line: run or continue a campaign, and print the score of each group with the survivors."""

import argparse
import sys
from pathlib import Path

from mutants.campaign import GROUPS, ROOT, SURVIVED, Settings, equivalents, run, stale
from mutants.page import write_page


def main() -> int:
    parser = argparse.ArgumentParser(prog="make mutants", description=__doc__)
    parser.add_argument("--group", action="append", choices=GROUPS, help="only these groups of modules")
    parser.add_argument("--module", default="", help="only modules whose path contains this text")
    parser.add_argument("--sample", type=int, default=40, help="mutants a group; 0: all (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the sample (default: %(default)s)")
    parser.add_argument(
        "--budget", type=float, default=10.0, help="CPU seconds of tests a mutant (default: %(default)s)"
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--again", action="store_true", help="try survivors of the earlier run once more")
    parser.add_argument(
        "--out", type=Path, default=ROOT / "build/mutants", help="folder of results, which are continued"
    )
    parser.add_argument("--page", type=Path, help="write the page of scores and survivors to this file")
    args = parser.parse_args()
    settings = Settings(
        args.out, args.group or tuple(GROUPS), args.module, args.sample, args.seed, args.budget, args.jobs, args.again
    )
    result = run(settings)
    known = equivalents()
    for key in stale(known):
        print(f"equivalents.toml: {key}: its line has changed; drop it, or judge the new mutant")
    for row in result["outcomes"]:
        if row["status"] in SURVIVED and row["key"] not in known:
            place = f"{row['module']}:{row['line']}"
            print(f"{place}: {row['operator']}: {row['old']!r} -> {row['new']!r}  {row['status']}  [{row['key']}]")
    if args.page:
        write_page(result, known, args.page)
    return 0


if __name__ == "__main__":
    sys.exit(main())

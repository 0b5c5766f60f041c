"""`mitsuba-ref check`: hold a fresh render of ours, or of Mitsuba, against reference EXRs that were approved."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from caster.cli.exit_codes import DIFFERENCES, FILE, NOTHING_SELECTED, OK

if TYPE_CHECKING:
    from mitsuba_ref.exr_compare.approval import ReferenceCheck
    from mitsuba_ref.runner.scene_runner import SceneEntry

Found = TypeVar("Found")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from mitsuba_ref.cli.approve import add_selection

    add_selection(parser)
    add = parser.add_argument
    add("--fresh", action="store_true", help="compare a fresh render of Mitsuba, to the bit, instead of ours")
    may = "so many pixels a scene may differ (never by NaN or inf)"
    add("--max-pixels", type=int, default=0, metavar="N", help=may)
    add("--json", action="store_true", help="as JSON")


def run(args: argparse.Namespace) -> int:
    """A row for each scene; 0 all pass, 1 some do not, 4 some have no reference that can be read, and no other fails,
    5 nothing was selected."""
    entries, code = selection(args)
    if not entries:
        return code
    from mitsuba_ref.exr_compare.approval import check_scene

    with tempfile.TemporaryDirectory(prefix="mitsuba-ref-check-") as place:

        def of(entry: SceneEntry) -> ReferenceCheck:
            return check_scene(entry, args, Path(place))

        out = sys.stdout  # itself: readers of EXR files put another one in its place while they read
        found = []
        for checked in proceed(of, entries, args.workers):
            found.append(checked)
            if not args.json:
                print("\n".join(checked.lines()), file=out, flush=True)
    failed = [checked for checked in found if not checked.ok]
    if args.json:
        print(json.dumps({"ok": not failed, "scenes": [vars(checked) for checked in found]}, indent=1))
    else:
        missing = sum(checked.missing for checked in failed)
        counts = f"{len(found) - len(failed)} pass, {len(failed) - missing} fail"
        unchecked = f", {missing} not checked: no reference that can be read" if missing else ""
        print(f"\n{len(found)} scenes: {counts}{unchecked}")
        for line in hint(args, failed):
            print(line)
    return code_of(failed)


def code_of(failed: Sequence[ReferenceCheck]) -> int:
    """A difference that was found says more than a file that is not there, and either is no pass."""
    if not failed:
        return OK
    return FILE if all(checked.missing for checked in failed) else DIFFERENCES


def hint(args: argparse.Namespace, failed: Sequence[ReferenceCheck]) -> Iterator[str]:
    """The command that shows the changes, and writes them once they are approved."""
    import shlex

    words = ["mitsuba-ref", "approve", *args.scenes, "--references", args.references]
    words += ["--size", *map(str, args.size)] if args.size else []
    words += ["--variant", args.variant] if args.variant else []
    words += [word for folder in args.mesh_dir for word in ("--mesh-dir", folder)]
    names = [checked.name for checked in failed if checked.refused]
    if names:
        words += ["-k", " or ".join(names)] if len(names) < 5 and all(map(plain, names)) else []
        yield f"to look at what is new and approve it: {shlex.join(words)}"


def plain(name: str) -> bool:
    """Whether -k reads it as one word."""
    return not any(c.isspace() or c in "()" for c in name) and name not in ("and", "or", "not")


def selection(args: argparse.Namespace) -> tuple[list[SceneEntry], int]:
    """The scenes, loaded, and the exit code where there are none. Raises SceneError."""
    from mitsuba_ref.cli.validate import selected

    if args.variant:
        from mitsuba_ref.reference.variants import VARIANT_NAMES, VariantError

        if args.variant not in VARIANT_NAMES:
            raise VariantError(f"--variant {args.variant!r}: expected {' or '.join(VARIANT_NAMES)}")
    entries = selected(args)
    if not entries:
        fits = f" that fits -k {args.expression!r}" if args.expression else ""
        print(f"nothing selected: no scene file{fits} in {', '.join(args.scenes)}", file=sys.stderr)
    return entries, NOTHING_SELECTED


def proceed(
    work: Callable[[SceneEntry], Found], entries: Sequence[SceneEntry], workers: int | None
) -> Iterator[Found]:
    """work(entry) for each, several at a time, in order. What is left is not begun when somebody stops it."""
    from concurrent.futures import ThreadPoolExecutor

    from mitsuba_ref.reference import subprocess_runner
    from mitsuba_ref.runner.scene_runner import default_workers

    pool = ThreadPoolExecutor(workers or default_workers())
    try:
        for future in [pool.submit(work, entry) for entry in entries]:
            yield future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        subprocess_runner.kill_subprocesses()
        pool.shutdown(wait=True)
        subprocess_runner.allow_subprocesses()

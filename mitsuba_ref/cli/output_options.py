"""The options of `mitsuba-ref validate` that continuous integration uses."""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from caster.description.errors import SceneError

if TYPE_CHECKING:
    from mitsuba_ref.judge.verdict import Verdict
    from mitsuba_ref.report.html.html_report import HtmlReport
    from mitsuba_ref.runner.resume import OutFolder
    from mitsuba_ref.runner.scene_runner import JudgeScene, SceneEntry
    from mitsuba_ref.runner.shards import Shard


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add_summary(parser)
    add(
        "--shard", metavar="I/N", type=shard, help="judge part I of N of the scenes, balanced by their pixels"
    )
    add(
        "--resume",
        action="store_true",
        help="take over from --out what was judged of the very same scene, code, variant and options",
    )


def add_summary(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--summary-md",
        metavar="FILE",
        help="add a summary in Markdown to the end of this file, such as $GITHUB_STEP_SUMMARY",
    )


def shard(text: str) -> Shard:
    """The type of --shard; what it needs is loaded only where the option is given."""
    from mitsuba_ref.runner.shards import parse_shard

    return parse_shard(text)


def check_outputs(args: argparse.Namespace) -> None:
    """Raise OutputError now, and not after all the work."""
    from caster.image.atomic_files import check_writable

    if args.summary_md:
        check_writable(args.summary_md)
    if args.resume and not args.out:
        raise SceneError("--resume: expected --out DIR beside it, the folder of the run that is to go on")


def part_of(entries: list[SceneEntry], args: argparse.Namespace) -> list[SceneEntry]:
    """The scenes of this shard; all of them without --shard."""
    if not args.shard:
        return entries
    from mitsuba_ref.runner.shards import scenes_of_shard

    return scenes_of_shard(entries, args.shard)


def out_folder(args: argparse.Namespace) -> OutFolder | None:
    """What --out names. Raises OutputError where nothing can be written."""
    if not args.out:
        return None
    from mitsuba_ref.runner.resume import OutFolder

    return OutFolder(Path(args.out))


def judge_of(
    args: argparse.Namespace, judge: JudgeScene, out: OutFolder | None, html: HtmlReport | None
) -> JudgeScene:
    """How to come to a verdict: by what is kept in --out, and keeping it there; without --out, the given way."""
    if out is None:
        return judge
    from mitsuba_ref.runner.resume import ResumableResults

    if html is None:
        return ResumableResults(out, judge, resume=args.resume).judge
    return ResumableResults(out, judge, resume=args.resume, has_page=html.holds).judge


def about(args: argparse.Namespace, every: Sequence[SceneEntry]) -> dict[str, Any]:
    """What a verdict says of its run. every: the scenes of all shards."""
    from mitsuba_ref.runner.resume import code_hash
    from mitsuba_ref.runner.shards import judged_with

    if not args.shard:
        return {"code": code_hash(), "judged_with": judged_with()}
    # The scenes are a part of it, so that shards of other scenes of the same names are not put together.
    told = hashlib.sha256(code_hash().encode())
    for entry in every:
        told.update(f"\0{entry.name}\0{entry.scene.sha256()}".encode())
    names = tuple(entry.name for entry in every)
    shard = {"shard": str(args.shard), "selected": names}
    return {"code": told.hexdigest(), "judged_with": judged_with(), **shard}


def report(verdict: Verdict, args: argparse.Namespace, seconds: float) -> None:
    """The files that were asked for."""
    if args.summary_md:
        from mitsuba_ref.report.markdown import append

        append(args.summary_md, verdict, seconds)


def close(args: argparse.Namespace) -> None:
    """The journal has done its duty once verdict.json is there."""
    if args.out:
        from mitsuba_ref.runner.resume import JOURNAL

        (Path(args.out) / JOURNAL).unlink(missing_ok=True)

"""The options of `validate` and `probe` that bring somebody's ray caster before the judge."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from caster.description.errors import SceneError

if TYPE_CHECKING:
    from mitsuba_ref.runner.scene_runner import JudgeScene
    from mitsuba_ref.subjects.subject import Candidate

# Named here too, since loading the judge loads the kernels (tests/unit/test_cli_help.py compares).
SECONDS = 300.0
PRECISIONS = ("float32", "float64")


IN_OUR_PLACE = "somebody's ray caster in the place of ours (docs/candidates.md)"


def add_arguments(parser: argparse.ArgumentParser, title: str = IN_OUR_PLACE) -> None:
    group = parser.add_argument_group(title)
    group.add_argument(
        "--candidate",
        metavar="X",
        help="package.module:function, called as function(scene, o, d) -> (t, n); or a command that reads our scene "
        "and writes an EXR file, such as 'my-renderer {xml} -o {exr}' ({toml}, {width}, {height})",
    )
    group.add_argument(
        "--candidate-precision",
        metavar="P",
        choices=PRECISIONS,
        help="what it computes in, which its bounds follow from; default: the type of what it returns",
    )
    group.add_argument(
        "--candidate-timeout",
        metavar="S",
        type=seconds,
        default=SECONDS,
        help=f"seconds that a command may take for one scene; default {SECONDS:g}",
    )


def seconds(text: str) -> float:
    """A number > 0, or an error in argparse's way."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a number of seconds > 0, got '{text}'")
    return value


def asked(args: argparse.Namespace) -> Candidate | None:
    """The candidate that was asked for; None: ours is judged. Raises SceneError for one that cannot be asked."""
    if args.candidate is None:
        for option, given in _alone(args).items():
            if given:
                raise SceneError(f"{option}: expected --candidate X beside it, whose {option[12:]} it is")
        return None
    if getattr(args, "resume", False):
        raise SceneError(
            "--resume: not with --candidate, whose program may have changed since; judge all scenes, or take shards"
        )
    from mitsuba_ref.subjects.subject import parse_candidate

    return parse_candidate(args.candidate, args.candidate_precision, args.candidate_timeout)


def _alone(args: argparse.Namespace) -> dict[str, bool]:
    """Options that say nothing without --candidate -> whether they are given."""
    return {
        "--candidate-precision": args.candidate_precision is not None,
        "--candidate-timeout": args.candidate_timeout != SECONDS,
    }


def again(args: argparse.Namespace) -> tuple[str, ...]:
    """The words of these options, for a command that is to ask the same candidate; none of a command without them."""
    if getattr(args, "candidate", None) is None:
        return ()
    words = ["--candidate", args.candidate]
    if args.candidate_precision is not None:
        words += ["--candidate-precision", args.candidate_precision]
    if args.candidate_timeout != SECONDS:
        words += ["--candidate-timeout", repr(args.candidate_timeout).removesuffix(".0")]
    return tuple(words)


def judge_of(candidate: Candidate, *, keep: bool) -> JudgeScene:
    """How a scene is judged with a candidate in our place. keep: with what the verdict rests on."""
    from dataclasses import replace
    from functools import partial

    from mitsuba_ref.runner.candidate_validation import validate_candidate
    from mitsuba_ref.runner.scene_runner import judge_entry

    judge = partial(judge_entry, validate=partial(validate_candidate, candidate), keep=keep)
    return lambda entry, folder: replace(judge(entry, folder), candidate=candidate.name)

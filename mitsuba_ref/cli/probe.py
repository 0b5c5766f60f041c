"""`mitsuba-ref probe`: explain one pixel by every answer at it."""

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from caster.description.errors import error_prefix
from caster.system.process import DIFFERENCES, OK
from caster.system.terminal import printable
from mitsuba_ref.cli.options import candidate_words, load_scene_or_original, requested_candidate
from mitsuba_ref.probe.pixel import ProbeEvidence, probe_with_evidence
from mitsuba_ref.probe.verdict import PixelVerdict, as_text
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.report.builtin_scenes import shown_path
from mitsuba_ref.report.reproducers import write_reproducer


def run(args: argparse.Namespace) -> int:
    """Print the pixel's verdict and its evidence; 1 if nothing explains the pixel or the candidate's answer."""
    scene = load_scene_or_original(args)
    candidate = requested_candidate(args)  # its errors come before any work
    variants.variant_for(has_quadrics=True)  # raises before any work without Mitsuba
    with error_prefix(args.scene):
        found, probed = probe_with_evidence(scene, args.x, args.y, candidate, args.timeout, args.bounces)
    try:
        if args.save:
            save(args, probed, about_candidate(args, found))
    finally:  # last, since a reader of the pipe may close it early
        text = as_text(found, shown_path(args.scene), brief=args.brief)
        print(json.dumps(found.to_dict(), indent=2) if args.json else text)
    return OK if found.ok else DIFFERENCES


def about_candidate(args: argparse.Namespace, found: PixelVerdict) -> list[str]:
    """Comment lines on the candidate's answer, for a scene file about our caster and Mitsuba."""
    if found.candidate is None:
        return []
    words = found.candidate.problem or found.candidate.why
    summary = f"{found.candidate.verdict}: {words}".splitlines()[0]
    again = shlex.join(["mitsuba-ref", "probe", "THIS-FILE", "0", "0", *candidate_words(args)])
    return [f"Candidate: {printable(summary)}", *(f"           {printable(line)}" for line in again.splitlines())]


def save(args: argparse.Namespace, probed: Crash | ProbeEvidence, more: Sequence[str]) -> None:
    """Write the reproducer, and report on standard error whether it shows the same. more: its comment lines."""
    source = f"{shown_path(args.scene)}, pixel ({args.x}, {args.y})"
    if isinstance(probed, Crash):
        print(f"{args.save}: not written: Mitsuba gave no answer to reproduce", file=sys.stderr)
        return
    with error_prefix(source):
        same = write_reproducer(Path(args.save), *probed, 0, source, more)
    alone = "shows the same" if same else "does NOT show the same by itself, as its head states"
    print(f"{args.save}: written; it {alone}", file=sys.stderr)

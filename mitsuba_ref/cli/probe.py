"""`mitsuba-ref probe`: explain one pixel by every answer at it."""

import json
import sys
from argparse import Namespace
from pathlib import Path

from caster.description.errors import error_prefix
from caster.system.process import DIFFERENCES, OK
from mitsuba_ref.cli.options import load_scene_or_original, requested_candidate
from mitsuba_ref.probe.pixel import ProbeEvidence, probe_with_evidence
from mitsuba_ref.probe.verdict import as_text
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.report.builtin_scenes import shown_path
from mitsuba_ref.report.reproducers import write_reproducer


def run_probe(args: Namespace) -> int:
    """Print the pixel's verdict and its evidence; 1 if nothing explains the pixel or the candidate's answer."""
    scene = load_scene_or_original(args)
    candidate = requested_candidate(args)  # its errors come before any work
    variants.variant_for(has_quadrics=True)  # raises before any work without Mitsuba
    with error_prefix(args.scene):
        found, probed = probe_with_evidence(scene, args.x, args.y, candidate, args.timeout, args.bounces)
    try:
        if args.save:
            save(args, probed)
    finally:  # last, since a reader of the pipe may close it early
        text = as_text(found, shown_path(args.scene), brief=args.brief)
        print(json.dumps(found.to_dict(), indent=2) if args.json else text)
    return OK if found.ok else DIFFERENCES


def save(args: Namespace, probed: Crash | ProbeEvidence) -> None:
    """Write the reproducer, and report on standard error whether it shows the same."""
    source = f"{shown_path(args.scene)}, pixel ({args.x}, {args.y})"
    if isinstance(probed, Crash):
        print(f"{args.save}: not written: Mitsuba gave no answer to reproduce", file=sys.stderr)
        return
    with error_prefix(source):
        same = write_reproducer(Path(args.save), *probed, 0, source)
    alone = "shows the same" if same else "does NOT show the same by itself, as its head states"
    print(f"{args.save}: written; it {alone}", file=sys.stderr)

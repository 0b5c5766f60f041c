"""A verdict for the terminal: one row a scene, and where to look where one fails."""

from collections.abc import Iterator
from urllib.parse import quote

from mitsuba_ref.error_model.intersections import K
from mitsuba_ref.error_model.tolerances import LARGEST_Z
from mitsuba_ref.judge.known_defects import defect_name
from mitsuba_ref.judge.verdict import (
    AGREE,
    CLASSES,
    EXPLAINED,
    OUT_OF_DOMAIN,
    REFERENCE_WRONG,
    TIE,
    UNDECIDED,
    UNLISTED,
    WRONG,
    Failure,
    SceneCheck,
    SceneVerdict,
    Verdict,
)
from mitsuba_ref.report.failure_groups import group_lines, simplest_failing
from mitsuba_ref.report.replay import replay

WORDS_SHOWN = 12  # lines of what Mitsuba said when it ended without an answer

# The heads of the columns, in two lines; 100 characters hold a row whose scene has a name of 26.
HEADS = {
    AGREE: ("", "agree"),
    EXPLAINED: ("", "expl."),
    TIE: ("", "tie"),
    REFERENCE_WRONG: ("ref.", "wrong"),
    OUT_OF_DOMAIN: ("out", "dom."),
    WRONG: ("", "wrong"),
    UNDECIDED: ("unde-", "cided"),
}


def table_head(width: int) -> str:
    """The names of the columns, in two lines; width: of the longest scene name."""
    lines = []
    for line, (hit, asked, worst, seconds) in enumerate(
        (("", "exact", "", ""), ("hit", "asked", "worst", "s"))
    ):
        classes = "".join(f" {HEADS[name][line]:>{column_width(name)}}" for name in CLASSES)
        scene = "scene" if line else ""
        lines.append(f"      {scene:<{width}} {hit:>6}{classes} {asked:>5} {worst:>5} {seconds:>5}".rstrip())
    return "\n".join(lines)


def table_row(scene: SceneVerdict, width: int) -> str:
    """PASS or FAIL, how many hit pixels in which class, how many exact arithmetic was asked about, the share of its
    bound that the check uses which came nearest to it, seconds, or that the row is kept from an earlier run."""
    mark = "PASS" if scene.ok else "FAIL"
    classes = "".join(f" {scene.counts[name]:>{column_width(name)}}" for name in CLASSES)
    check, ratio = scene.worst
    worst = f"{ratio:.2f}" if check and scene.counts[AGREE] else "-"
    left = f"{mark}  {scene.name:<{width}} {scene.hit_pixels:>6}{classes}"
    seconds = f"{'kept':>5}" if scene.kept else f"{scene.seconds:5.1f}"
    return f"{left} {scene.adjudicated:>5} {worst:>5} {seconds}"


def worst_words(scene: SceneVerdict) -> str:
    """Which check came nearest to its bound among the pixels that agree, and how near."""
    check, ratio = scene.worst
    return f"{check} {ratio:.2f} of its bound" if check and scene.counts[AGREE] else "-"


def column_width(name: str) -> int:
    """Characters of the column of a class."""
    return 6 if name == AGREE else max(5, *map(len, HEADS[name]))


def failure_text(scene: SceneVerdict, report: str = "") -> str:
    """How many, how far, where to look, and the next command. report: the HTML report's file, if there is one."""
    return "\n".join(_failure_lines(scene, report))


def _failure_lines(scene: SceneVerdict, report: str) -> Iterator[str]:
    if scene.problem:
        yield from _problem_lines(scene)
    elif not scene.has_evidence and not scene.failing:
        yield f"FAIL  {scene.name}  {_lack_of_evidence(scene)}"
    for check in scene.checks:
        if not check.ok:
            yield check_failure(scene, check)
    if scene.failures:
        first = scene.failures[0]
        worst = "" if scene.candidate else "worst "
        yield (
            f"FAIL  {scene.name}  {first.check}: {_failing(scene)} of {scene.hit_pixels} hit pixels, "
            f"{worst}{first.ratio:.3g}x its bound at ({first.x}, {first.y})"
        )
        for finding in scene.findings:
            yield f"      {finding.pixels} pixels, first ({finding.x}, {finding.y}): {finding.what}"
        yield from _witness_lines(scene, first, report)
        yield from (f"      note:      {note}" for note in scene.notes)


def check_failure(scene: SceneVerdict, check: SceneCheck) -> str:
    """What is said of a check that is made once a scene, and fails."""
    return "\n".join(
        [
            f"FAIL  {scene.name}  {check.name}: {check.ratio:.3g}x its bound; {check.what}",
            f"      replay:    {replay(scene)}",
        ]
    )


def pixel_failure(scene: SceneVerdict, check: str) -> str:
    """What is said of the pixels that fail one check."""
    worst = scene.worst_by[check]
    head = (
        f"FAIL  {scene.name}  {check}: {scene.failing_by[check]} of {scene.hit_pixels} hit pixels, "
        f"worst {worst.ratio:.3g}x its bound at ({worst.x}, {worst.y})"
    )
    return "\n".join([head, *_witness_lines(scene, worst)])


def _witness_lines(scene: SceneVerdict, worst: Failure, report: str = "") -> Iterator[str]:
    yield f"      {'candidate:' if scene.candidate else 'ours:     '} {worst.subject}"
    yield f"      reference: {worst.reference}"
    yield f"      exact:     {worst.exact}"
    yield f"      why:       {worst.reason}"
    if report:
        yield f"      look:      {link(report, scene, (worst.x, worst.y))}"
    yield f"      replay:    {replay(scene, (worst.x, worst.y))}"


def _failing(scene: SceneVerdict) -> str:
    """How many pixels of which class fail."""
    counts = {
        WRONG: scene.counts[WRONG],
        "undecided": scene.counts[UNDECIDED],
        "reference wrong in no known way": scene.cases.get(UNLISTED, 0),
    }
    return ", ".join(f"{count} {what}" for what, count in counts.items() if count)


def _lack_of_evidence(scene: SceneVerdict) -> str:
    if not scene.hit_pixels:
        return "no pixel hits anything, so nothing was compared"
    wrong = scene.counts[REFERENCE_WRONG]
    if wrong > scene.evidence:
        return (
            f"too little evidence: the reference is wrong at {wrong} pixels and right at {scene.evidence}, so it "
            f"says nothing about {'the candidate' if scene.candidate else 'ours'} here"
        )
    return f"too little evidence: {scene.evidence} pixels agree or tie, {scene.excused} are only excused"


def _problem_lines(scene: SceneVerdict) -> Iterator[str]:
    first, *rest = scene.problem.splitlines()
    yield f"FAIL  {scene.name}  {first}"
    yield from (f"      {line}" for line in rest[:WORDS_SHOWN])
    if scene.candidate:
        yield f"      replay:    {replay(scene)}"


def link(report: str, scene: SceneVerdict, pixel: tuple[int, int]) -> str:
    """A pixel in the HTML report, for the address line of a browser."""
    return f"{report}#s={quote(scene.name)}&x={pixel[0]}&y={pixel[1]}"


def summary_text(verdict: Verdict, seconds: float) -> str:
    """All scenes in a few lines."""
    passed = sum(scene.ok for scene in verdict.scenes)
    counts = verdict.counts
    total = sum(counts.values()) or 1
    shares = [
        f"{counts[name]} {name.replace('_', ' ')} ({percent_text(counts[name], total)})" for name in CLASSES
    ]
    lines = [
        f"{verdict.asked} scenes: {passed} pass, {len(verdict.scenes) - passed} fail"
        f"{_not_run(verdict)}, in {seconds:.1f} s",
        *_first_look(verdict),
        f"hit pixels: {', '.join(shares[:3])},",
        f"            {', '.join(shares[3:5])},",
        f"            {', '.join(shares[5:])}",
        f"exact:      {verdict.adjudicated} pixels were decided by exact arithmetic, "
        f"in {sum(scene.exact_seconds for scene in verdict.scenes if not scene.kept):.1f} s",
        *candidate_lines(verdict),
        *_error_lines(verdict),
        *_case_lines(verdict),
        *_stored_lines(verdict),
        *_kept_lines(verdict),
    ]
    lines += [
        f"note:       {scene.name} allows {_allowed(scene)}" for scene in verdict.scenes if scene.allowed
    ]
    return "\n".join([*lines, *(f"reference:  {versions}" for versions in verdict.versions)])


def _first_look(verdict: Verdict) -> Iterator[str]:
    """Of several that fail: what they share, the simplest, and the command for its worst pixel."""
    yield from group_lines(verdict.scenes)
    first = simplest_failing(verdict.scenes)
    if first is not None:
        pixel = (first.failures[0].x, first.failures[0].y) if first.failures else None
        yield f"            {replay(first, pixel)}"


def candidate_lines(verdict: Verdict) -> Iterator[str]:
    """Who was judged, by which arithmetic's bounds, and what was not judged: missing evidence is said."""
    if not verdict.candidate:
        return
    precisions = sorted({scene.precision for scene in verdict.scenes} - {""})
    held = f", held to the bounds of {' and '.join(precisions)}" if precisions else ""
    yield f"candidate:  {verdict.candidate}{held}"
    names = dict.fromkeys(name for scene in verdict.scenes for name in scene.unjudged)
    if names:
        yield f"not judged: {', '.join(name.replace('_', ' ') for name in names)}"
    for note in dict.fromkeys(note for scene in verdict.scenes if scene.ok for note in scene.notes):
        yield f"note:       {note}"


def _error_lines(verdict: Verdict) -> Iterator[str]:
    """How much of its bound t needed at most, of the K roundings that are allowed, and which scene leans most."""
    found = [(scene.name, scene.statistics) for scene in verdict.scenes if scene.statistics is not None]
    if any(errors.pixels for _, errors in found):
        name, largest = max(found, key=lambda item: item[1].k_t.largest)
        leaning, bias = max(found, key=lambda item: abs(item[1].z))
        yield (
            f"errors:     of t at most {largest.k_t.largest:.2f} of {K:g} roundings ({name}); "
            f"bias at most |z| {abs(bias.z):.1f} of {LARGEST_Z:g} ({leaning})"
        )


def _case_lines(verdict: Verdict) -> Iterator[str]:
    """Where the reference is wrong, and how; what is not listed comes first."""
    for case, count in sorted(verdict.cases.items(), key=lambda item: item[0] != UNLISTED):
        if case == UNLISTED:
            yield (
                f"UNLISTED:   {count} pixels where the reference is wrong in no known way: a new defect of Mitsuba, "
                "or of what it was handed"
            )
        else:
            yield f"ref. wrong: {count} pixels of case {case}, {defect_name(int(case))}"


def _stored_lines(verdict: Verdict) -> Iterator[str]:
    stored = sum(len(scene.reproducers) for scene in verdict.scenes)
    if stored:
        left = sum(scene.not_stored for scene in verdict.scenes)
        more = f"; {left} more pixels are like them (mitsuba-ref probe SCENE X Y --save FILE)" if left else ""
        yield f"stored:     {stored} scenes of one ray each{more}"


def _kept_lines(verdict: Verdict) -> Iterator[str]:
    """A result of an earlier run is never shown as one of this run."""
    kept = sum(scene.kept for scene in verdict.scenes)
    if kept:
        yield (
            f"kept:       {kept} scenes were not judged now: an earlier run judged the same scene by the same code, "
            "variant and options"
        )
    if verdict.shard:
        yield f"shard:      {verdict.shard}, {verdict.asked} of {len(verdict.selected)} scenes"


def _allowed(scene: SceneVerdict) -> str:
    return ", ".join(f"{share:g} of the bound of {name}" for name, share in scene.allowed.items())


def _not_run(verdict: Verdict) -> str:
    left = verdict.asked - len(verdict.scenes)
    return f", {left} not judged" if left else ""


def percent_text(count: int, total: int) -> str:
    """A percentage that says 100 only when it is all."""
    percent = 100.0 * count / total
    return f"{percent:.4f} %" if 0 < count < total else f"{percent:.0f} %"

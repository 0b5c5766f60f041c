"""Verdicts for the terminal: one row per scene, failures with the next command, and a summary."""

import re
from collections.abc import Iterator, Sequence
from itertools import chain
from math import isfinite
from textwrap import wrap
from urllib.parse import quote

from caster.system.terminal import BELOW_NAME, LINE_CHARACTERS, folded, printable
from mitsuba_ref.error_model.tolerances import MEASURED_FOR
from mitsuba_ref.judge.classification import EXACT
from mitsuba_ref.judge.defect_lookup import defect_name
from mitsuba_ref.judge.diagnosis import SAME_SYMPTOM
from mitsuba_ref.judge.verdict import (
    AGREE,
    CLASSES,
    EXPECTED,
    REFERENCE_WRONG,
    UNDECIDED,
    UNLISTED,
    UNSUPPORTED,
    WRONG,
    SceneCheck,
    SceneVerdict,
    Verdict,
)
from mitsuba_ref.report.output import percent, plural

LEGEND = "hit, agree: pixels; worst: the largest error as a share of its bound; s: seconds"
COLUMNS = ("hit", "agree", "worst", "s", "other pixels")


def table_head(width: int) -> str:
    """A legend and the titles of the columns. width: of the longest scene name."""
    return f"{LEGEND}\n{_line('', 'scene', width, COLUMNS)}"


def table_row(scene: SceneVerdict, width: int) -> str:
    """The row of a scene. It is printed before later ones are known, so other classes have no columns of their own.

    Instead of seconds, a result of an earlier run has "kept".
    """
    check, ratio = scene.worst
    worst = f"{ratio:.2f}" if check and scene.counts[AGREE] else "-"
    seconds = "kept" if scene.kept else f"{scene.seconds:.1f}"
    classes = [f"{count} {name}" for name, count in spoken_counts(scene).items() if name != AGREE]
    covered = [scene.coverage.brief] if scene.coverage and scene.coverage.partial else []
    others = ", ".join([*covered, *classes]) or ("no answer" if scene.problem else "")
    pixels = ("-", "-") if scene.problem else (str(scene.hit_pixels), str(scene.counts[AGREE]))
    first = mark_of(scene), printable(scene.name, keep=""), width
    numbers = *pixels, worst, seconds
    row, below = _line(*first, (*numbers, others)), [*scene.notes] if scene.bounce else []
    if len(row) > LINE_CHARACTERS:
        row, below = _line(*first, numbers), [others, *below]
    lines = (wrap(text, LINE_CHARACTERS, initial_indent=BELOW_NAME, subsequent_indent=BELOW_NAME) for text in below)
    return "\n".join([row, *chain.from_iterable(lines)])


def _line(mark: str, name: str, width: int, cells: Sequence[str]) -> str:
    numbers = "".join(f"{cell:>{wide}} " for cell, wide in zip(cells, (6, 6, 5, 5), strict=False))
    return f"{mark:<5} {name:<{width}} {numbers}{''.join(cells[4:])}".rstrip()


def spoken_counts(*scenes: SceneVerdict) -> dict[str, int]:
    """Pixels of each class that occurs, for readers; those with the symptom of wrong ones are called wrong as well."""
    counts = {name: sum(counts_shown(scene)[name] for scene in scenes) for name in CLASSES}
    alike = sum(scene.not_adjudicated for scene in scenes)
    looked_at = f" ({counts[WRONG] - alike} of them looked at)" if alike else ""
    names = {name: name.replace("_", " ") + (looked_at if name == WRONG else "") for name in CLASSES}
    return {names[name]: count for name, count in counts.items() if count}


def counts_shown(scene: SceneVerdict) -> dict[str, int]:
    """Pixels of each class; those with the symptom of wrong ones, which were not adjudicated, count as wrong."""
    alike = scene.not_adjudicated
    return scene.counts | {WRONG: scene.counts[WRONG] + alike, UNDECIDED: scene.counts[UNDECIDED] - alike}


def mark_of(scene: SceneVerdict) -> str:
    """PASS, FAIL, SKIP if the candidate declines the scene, or KNOWN for a known failure."""
    if scene.waived:
        return "SKIP" if scene.waived == UNSUPPORTED else "KNOWN"
    return "PASS" if scene.ok else "FAIL"


def failure_text(scene: SceneVerdict, report: str = "") -> str:
    """Number of failing pixels, the worst of them, where to look, and the next command. report: the report's file."""
    lines: list[str] = []
    notes = [f"      note:      {note}" for note in scene.notes]
    if scene.problem:
        first, *rest = scene.problem.splitlines()
        lines += [f"FAIL  {scene.name}  {first}", *(f"      {line}" for line in rest)]
        lines += [f"      replay:    {scene.replay}"] if scene.candidate else []
    elif not scene.has_evidence and not scene.failing:
        lines += [f"FAIL  {scene.name}  {_lack_of_evidence(scene)}", *notes]
    for check in broken_checks(scene):
        beyond = f"{check.ratio:.3g}x its bound; " if isfinite(check.ratio) else ""
        lines += [f"FAIL  {scene.name}  {check.name}: {beyond}{check.what}", f"      replay:    {scene.replay}"]
    if scene.failures:
        worst = scene.failures[0]
        far = f"{'' if scene.candidate else 'worst '}{worst.ratio:.3g}x its bound at"
        at = f"{far if worst.ratio > 0.0 and isfinite(worst.ratio) else 'such as'} {scene.place(worst.x, worst.y)}"
        counts = f"{worst.check}: {_failing(scene)} of {scene.hit_pixels} hit pixels, {at}"
        causes = [finding.text for finding in scene.findings[:1]]
        lines += (
            [f"FAIL  {scene.name}  {causes[0]}", f"      {counts}"] if causes else [f"FAIL  {scene.name}  {counts}"]
        )
        for place, finding in enumerate(scene.findings) if len(scene.findings) > 1 else ():
            alike = f" and {finding.alike} more ({SAME_SYMPTOM})" if finding.alike else ""
            head = f"      {finding.pixels} pixels{alike}, first {scene.place(finding.x, finding.y)}: "
            lines.append(head + (finding.what if place else "as above"))
            more = (finding.where, finding.remedy) if place else ()  # the first line has those of the first
            lines += [f"        {each}" for each in more if each]
        lines += [
            f"      {'candidate:' if scene.candidate else 'ours:     '} {worst.subject}",
            f"      reference: {worst.reference}",
            f"      exact:     {worst.exact}",
        ]
        lines += [] if worst.reason in "".join(causes) else [f"      why:       {worst.reason}"]
        lines += [f"      look:      {report}#s={quote(scene.name)}&x={worst.x}&y={worst.y}"] if report else []
        lines += [f"      replay:    {worst.replay}", *notes]
    return "\n".join(lines)


def broken_checks(found: SceneVerdict | Verdict) -> list[SceneCheck]:
    return [check for check in found.checks if not check.ok]


def _failing(scene: SceneVerdict) -> str:
    """Failing pixels by class, as text."""
    counts = spoken_counts(scene) | {"reference wrong in no known way": scene.cases.get(UNLISTED, 0)}
    fails = (WRONG, UNDECIDED, "reference wrong in no")
    return ", ".join(f"{count} {what}" for what, count in counts.items() if count and what.startswith(fails))


def _lack_of_evidence(scene: SceneVerdict) -> str:
    if not scene.hit_pixels:
        return "no pixel hits anything, so nothing was compared"
    wrong = scene.counts[REFERENCE_WRONG]
    if wrong > scene.evidence:
        return (
            f"too little evidence: the reference is wrong at {wrong} pixels and right at {scene.evidence}, so it "
            f"is no evidence about {'the candidate' if scene.candidate else 'ours'} here"
        )
    return f"too little evidence: {scene.evidence} pixels agree or tie, {scene.excused} are only excused"


def summary_text(verdict: Verdict, seconds: float) -> str:
    """Summary of all scenes in a few lines."""
    lines = [f"{outcome_text(verdict)}, in {seconds:.1f} s", *waiver_lines(verdict)]
    counts = {AGREE: 0} | spoken_counts(*verdict.scenes)
    total = sum(counts.values()) or 1
    shares = [f"{count} {name} ({percent(count, total)})" for name, count in counts.items()]
    if not all(scene.problem for scene in verdict.scenes):
        lines.append(f"hit pixels: {', '.join(shares)}")
        lines.append(f"exact:      {verdict.adjudicated} pixels were adjudicated by exact arithmetic")
    versions = (f"reference:  {each}" for each in verdict.versions)
    return "\n".join([*lines, *candidate_lines(verdict), *_note_lines(verdict), *versions])


MAX_COVERAGE_LINES = 6  # of one scene
WAIVER_WORDS = {UNSUPPORTED: "declined by the candidate", EXPECTED: "known failures"}


def failing_scenes(scenes: Sequence[SceneVerdict]) -> list[SceneVerdict]:
    """The scenes by which a run fails."""
    return [scene for scene in scenes if not (scene.ok or scene.waived)]


def outcome_text(verdict: Verdict) -> str:
    """How many scenes pass, fail, are waived and were not judged."""
    passed, left = sum(scene.ok for scene in verdict.scenes), verdict.scene_count - len(verdict.scenes)
    words = [f"{plural(verdict.scene_count, 'scene')}: {passed} pass", f"{len(failing_scenes(verdict.scenes))} fail"]
    words += [f"{count} {WAIVER_WORDS[why]}" for why, count in verdict.waived.items()]
    return ", ".join([*words, f"{left} not judged"] if left else words)


def waiver_lines(verdict: Verdict) -> Iterator[str]:
    """Waived scenes, known failures that are fixed, and whether too few scenes were judged."""
    for scene in verdict.scenes:
        if scene.waived:
            words = scene.problem.partition("\n")[0] if scene.problem else f"{', '.join(sorted(failing_checks(scene)))}"
            yield f"{mark_of(scene).lower() + ':':<11} {scene.name}: {words}"
    if verdict.fixed:
        names = ", ".join(verdict.fixed)
        yield f"fixed:      {names}: listed by --expected as failing, and now right: take them out of the list"
    if verdict.too_few:
        judged = len(verdict.scenes) - verdict.waived.get(UNSUPPORTED, 0)
        yield f"FAIL        {judged} scenes judged, expected at least {max(verdict.min_scenes, 1)} (--min-scenes)"


def failures_text(verdict: Verdict, report: str = "") -> str:
    """What several failing scenes have in common, then each by itself; "" where none fails."""
    texts, said = [], dict[str | frozenset[SceneCheck], str]()
    for scene in failing_scenes(verdict.scenes):
        broken = frozenset(broken_checks(scene))
        first = scene.name if scene.failures else said.setdefault(scene.problem or broken, scene.name)
        words = scene.problem.partition("\n")[0] or ", ".join(sorted(check.name for check in broken))
        alike = f"FAIL  {scene.name}  {words}: as in {first}"
        texts.append(alike if first != scene.name else failure_text(scene, report))
    return "\n\n".join(filter(None, ["\n".join(group_lines(verdict.scenes)), *texts]))


def short_text(verdict: Verdict) -> str:
    """The outcome, the names of failing scenes, and the simplest of them, in some ten lines of 80 characters."""
    failing = failing_scenes(verdict.scenes)
    lines = [f"{outcome_text(verdict)}{': ' if failing else ''}{', '.join(scene.name for scene in failing)}"]
    lines += [f"FAIL  {check.name}: {check.what}" for check in broken_checks(verdict)]
    for scene in [simplest_failing(verdict.scenes) or failing[0]] if failing else ():
        # without bits and the ray, which the replay prints
        lines.append(re.sub(r" 0x[\w.+-]+|, along o .*", "", failure_text(scene)))
    return folded("\n".join(lines))


def candidate_lines(verdict: Verdict) -> Iterator[str]:
    """The candidate, the precision of its bounds, and the quantities that it does not give."""
    if not verdict.candidate:
        return
    precisions = sorted({scene.precision for scene in verdict.scenes} - {""})
    held = f", held to the bounds of {' and '.join(precisions)}" if precisions else ""
    yield f"candidate:  {verdict.candidate}{held}"
    for check in verdict.checks:
        yield f"{'note:' if check.ok else 'FAIL':<11} {check.name}: {check.what}"
    names = dict.fromkeys(name for scene in verdict.scenes for name in scene.unjudged)
    if names:
        yield f"not judged: {', '.join(name.replace('_', ' ') for name in names)}"
    judged = (
        scene for scene in verdict.scenes if scene.ok and not scene.bounce
    )  # a bounce has its notes below its row
    for note in dict.fromkeys(note for scene in judged for note in scene.notes):
        yield f"note:       {note}"


def _note_lines(verdict: Verdict) -> Iterator[str]:
    """Pixels where the reference is wrong, by known defect, unlisted ones first; and limits of the run."""
    for case, count in sorted(verdict.cases.items(), key=lambda item: item[0] != UNLISTED):
        if case == UNLISTED:
            yield (
                f"UNLISTED:   {count} pixels where the reference is wrong in no known way: a new defect of Mitsuba, "
                "or of the scene it was given"
            )
        else:
            yield f"ref. wrong: {count} pixels of case {case}, {defect_name(int(case))}"
    if verdict.unmeasured:
        known = "; ".join(f"{what} {', '.join(names)}" for what, names in MEASURED_FOR.items())
        yield f"unknown:    {', '.join(verdict.unmeasured)}: bounds and known defects were measured for {known}"
    scenes = verdict.scenes
    if any(not (scene.candidate or scene.thorough or scene.problem) for scene in scenes):
        yield "left out:   tests of our caster beyond the judged films, which --thorough makes"
    if stored := sum(len(scene.reproducers) for scene in scenes):
        left = sum(scene.not_stored for scene in scenes)
        more = f"; {left} more pixels are like them (mitsuba-ref probe SCENE X Y --save FILE)" if left else ""
        yield f"stored:     {stored} scenes of one ray each{more}"
    if kept := sum(scene.kept for scene in scenes):
        yield (
            f"kept:       {kept} scenes were not judged now: an earlier run judged the same scene by the same code, "
            "variant and options"
        )
    if verdict.shard:
        yield f"shard:      {verdict.shard}, {verdict.scene_count} of {len(verdict.selected)} scenes"
    for scene in scenes:
        if scene.coverage and scene.ok and not scene.candidate:
            lines = scene.coverage.lines()
            yield from (f"note:       {scene.name}: {line}" for line in lines[:MAX_COVERAGE_LINES])
            if len(lines) > MAX_COVERAGE_LINES:
                yield f"note:       {scene.name}: and {len(lines) - MAX_COVERAGE_LINES} more (verdict.json has all)"
        if scene.allowed:
            allowed = ", ".join(f"{share:g} of the bound of {name}" for name, share in scene.allowed.items())
            yield f"note:       {scene.name} allows {allowed}"


# ---- what failing scenes have in common ----

MIN_FAILING_SCENES = 2  # of which something can be said together
NO_ANSWER = "no comparison"


def failing_checks(scene: SceneVerdict) -> frozenset[str]:
    """The checks that a scene fails; `exact`, which accompanies most others, only if it fails alone."""
    if scene.problem:
        return frozenset([NO_ANSWER])
    named = {*scene.failing_by, *(check.name for check in broken_checks(scene))}
    named |= {failure.check for failure in scene.failures}  # of a candidate, which are not counted by check
    return frozenset(named - {EXACT} or named)


def simplest_failing(scenes: Sequence[SceneVerdict]) -> SceneVerdict | None:
    """The failing scene with the fewest primitives, then shapes, then pixels; None below MIN_FAILING_SCENES."""
    failing = failing_scenes(scenes)
    known = [scene for scene in failing if scene.composition.primitives]
    if len(failing) < MIN_FAILING_SCENES or not known:
        return None
    return min(known, key=lambda s: (s.composition.primitives, sum(s.composition.shapes.values()), s.pixels, s.name))


def group_lines(scenes: Sequence[SceneVerdict]) -> Iterator[str]:
    """What failing scenes have in common, and the simplest of them; nothing below MIN_FAILING_SCENES."""
    failing = failing_scenes(scenes)
    sharing: dict[str, list[SceneVerdict]] = {}
    for scene in failing:
        for finding in scene.findings:
            sharing.setdefault(finding.what, []).append(scene)
        for check in broken_checks(scene):
            sharing.setdefault(f"{check.name}: {check.what.splitlines()[0]}", []).append(scene)
    for what, those in sorted(sharing.items(), key=lambda item: -len(item[1])):
        if len(those) >= MIN_FAILING_SCENES:
            kinds = ", ".join(sorted({kind for scene in those for kind in scene.composition.shapes}))
            shapes = f" (shapes: {kinds})" if kinds else ""
            yield f"cause:      in {len(those)} of {len(failing)} that fail: {what}{shapes}"
    fails: dict[str, list[bool]] = {}  # type of shape -> whether each judged scene with it fails
    for scene in scenes:
        for kind in () if scene.waived else scene.composition.shapes:
            fails.setdefault(kind, []).append(not scene.ok)
    if len(failing) >= MIN_FAILING_SCENES and len(fails) > 1:
        order = sorted(fails, key=lambda kind: (-sum(fails[kind]) / len(fails[kind]), -len(fails[kind]), kind))
        words = ", ".join(f"{kind} {sum(fails[kind])} of {len(fails[kind])}" for kind in order)
        yield f"by shape:   scenes that fail: {words}"
    if first := simplest_failing(scenes):
        size = f"{plural(first.composition.primitives, 'primitive')}, {first.pixels} pixels"
        yield f"look first: {first.name}, the simplest of them ({size})"
        yield f"            {first.failures[0].replay if first.failures else first.replay}"

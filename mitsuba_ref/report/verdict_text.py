"""Verdicts for the terminal: one row per scene, failures with the next command, and a summary."""

from collections.abc import Iterator, Sequence
from statistics import median
from textwrap import wrap
from urllib.parse import quote

from mitsuba_ref.error_model.tolerances import LARGEST_Z, K
from mitsuba_ref.judge.classification import EXACT
from mitsuba_ref.judge.defect_lookup import defect_name
from mitsuba_ref.judge.diagnosis import NOT_ADJUDICATED
from mitsuba_ref.judge.verdict import (
    AGREE,
    BIAS_OF_POSITION,
    CLASSES,
    EXPECTED,
    REFERENCE_WRONG,
    UNDECIDED,
    UNLISTED,
    UNSUPPORTED,
    WRONG,
    Failure,
    SceneCheck,
    SceneVerdict,
    Verdict,
)
from mitsuba_ref.report.reproducers import replay
from mitsuba_ref.report.results import Column, format_table, percent

MAX_PROBLEM_LINES = 12  # of the output of Mitsuba, where it ended without an answer

TABLE_CHARACTERS = 80  # of a row; counts that do not fit go into a line of their own
LEGEND = "pixels that hit and that agree; worst: their largest error, over its bound"


def table_columns(width: int) -> tuple[Column, ...]:
    """Columns of the table of scenes. width: of the longest scene name."""
    counts = (Column(title, "right", 6) for title in ("hit", "agree"))
    rest = (Column(title, "right", 5) for title in ("worst", "s"))
    return Column("", width=5), Column("scene", width=width), *counts, *rest, Column("other pixels")


def table_head(width: int) -> str:
    """A legend and the titles of the columns. width: of the longest scene name."""
    return f"{LEGEND}\n{format_table(table_columns(width), [], gap=1)}"


def table_row(scene: SceneVerdict, width: int) -> str:
    """The row of a scene: mark, pixels that hit and that agree, their largest error over its bound, seconds or "kept"
    for a result of an earlier run, and the other classes that occur. A row is printed before later ones are known, so
    these classes have no columns."""
    check, ratio = scene.worst
    worst = f"{ratio:.2f}" if check and scene.counts[AGREE] else "-"
    counts = str(scene.hit_pixels), str(scene.counts[AGREE])
    seconds = "kept" if scene.kept else f"{scene.seconds:.1f}"
    others = [f"{scene.counts[name]} {class_text(name)}" for name in CLASSES[1:] if scene.counts[name]]
    cells = mark_of(scene), scene.name, *counts, worst, seconds
    row = format_table(table_columns(width), [(*cells, ", ".join(others))], header=False, gap=1)
    if len(row) <= TABLE_CHARACTERS:
        return row
    row = format_table(table_columns(width), [(*cells, "")], header=False, gap=1)
    return "\n".join([row, *wrap(", ".join(others), TABLE_CHARACTERS, initial_indent=INDENT, subsequent_indent=INDENT)])


INDENT = 6 * " "  # below the name of a scene


def class_text(name: str) -> str:
    """A class of pixels for readers."""
    return name.replace("_", " ")


def mark_of(scene: SceneVerdict) -> str:
    """PASS, FAIL, SKIP if the candidate declines the scene, or KNOWN for a known failure."""
    if scene.waived:
        return "SKIP" if scene.waived == UNSUPPORTED else "KNOWN"
    return "PASS" if scene.ok else "FAIL"


def worst_words(scene: SceneVerdict) -> str:
    """The check with the largest error over its bound among agreeing pixels, as text."""
    check, ratio = scene.worst
    return f"{check} {ratio:.2f} of its bound" if check and scene.counts[AGREE] else "-"


def failure_text(scene: SceneVerdict, report: str = "") -> str:
    """Number of failing pixels, the worst of them, where to look, and the next command. report: the report's file."""
    return "\n".join(_failure_lines(scene, report))


def _failure_lines(scene: SceneVerdict, report: str) -> Iterator[str]:
    if scene.problem:
        yield from _problem_lines(scene)
    elif not scene.has_evidence and not scene.failing:
        yield f"FAIL  {scene.name}  {_lack_of_evidence(scene)}"
        yield from (f"      note:      {note}" for note in scene.notes)
    for check in scene.checks:
        if not check.ok:
            yield check_failure(scene, check)
    if scene.failures:
        first = scene.failures[0]
        worst = "" if scene.candidate else "worst "
        counts = (
            f"{first.check}: {_failing(scene)} of {scene.hit_pixels} hit pixels, "
            f"{worst}{first.ratio:.3g}x its bound at {scene.place(first.x, first.y)}"
        )
        if scene.findings:
            yield f"FAIL  {scene.name}  {scene.findings[0].text}"
            yield f"      {counts}"
        else:
            yield f"FAIL  {scene.name}  {counts}"
        for place, finding in enumerate(scene.findings):
            yield f"      {finding.pixels} pixels, first {scene.place(finding.x, finding.y)}: {finding.what}"
            more = (finding.where, finding.remedy) if place else ()  # the first line has those of the first
            yield from (f"        {each}" for each in more if each)
        yield from _witness_lines(scene, first, report)
        yield from (f"      note:      {note}" for note in scene.notes)


def check_failure(scene: SceneVerdict, check: SceneCheck) -> str:
    """Text of a scene check that fails."""
    return "\n".join(
        [
            f"FAIL  {scene.name}  {check.name}: {check.ratio:.3g}x its bound; {check.what}",
            f"      replay:    {replay(scene)}",
        ]
    )


def pixel_failure(scene: SceneVerdict, check: str) -> str:
    """Text of the pixels that fail one check."""
    worst = scene.worst_by[check]
    head = (
        f"FAIL  {scene.name}  {check}: {scene.failing_by[check]} of {scene.hit_pixels} hit pixels, "
        f"worst {worst.ratio:.3g}x its bound at {scene.place(worst.x, worst.y)}"
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
    """Failing pixels by class, as text."""
    counts = {
        WRONG: scene.counts[WRONG],
        "not adjudicated": scene.not_adjudicated,
        "undecided": scene.counts[UNDECIDED] - scene.not_adjudicated,
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
            f"is no evidence about {'the candidate' if scene.candidate else 'ours'} here"
        )
    return f"too little evidence: {scene.evidence} pixels agree or tie, {scene.excused} are only excused"


def _problem_lines(scene: SceneVerdict) -> Iterator[str]:
    first, *rest = scene.problem.splitlines()
    yield f"FAIL  {scene.name}  {first}"
    yield from (f"      {line}" for line in rest[:MAX_PROBLEM_LINES])
    if scene.candidate:
        yield f"      replay:    {replay(scene)}"


def link(report: str, scene: SceneVerdict, pixel: tuple[int, int]) -> str:
    """Address of a pixel in the HTML report."""
    return f"{report}#s={quote(scene.name)}&x={pixel[0]}&y={pixel[1]}"


def summary_text(verdict: Verdict, seconds: float) -> str:
    """Summary of all scenes in a few lines."""
    counts = verdict.counts
    total = sum(counts.values()) or 1
    shares = [
        f"{counts[name]} {class_text(name)} ({percent(counts[name], total)})"
        for name in CLASSES
        if counts[name] or name == AGREE
    ]
    lines = [
        f"{outcome_text(verdict)}, in {seconds:.1f} s",
        *waiver_lines(verdict),
        *wrap(f"hit pixels: {', '.join(shares)}", TABLE_CHARACTERS, subsequent_indent=12 * " "),
        f"exact:      {verdict.adjudicated} pixels were adjudicated by exact arithmetic, "
        f"in {sum(scene.exact_seconds for scene in verdict.scenes if not scene.kept):.1f} s",
        *candidate_lines(verdict),
        *_error_lines(verdict),
        *_case_lines(verdict),
        *_left_out_lines(verdict),
        *_stored_lines(verdict),
        *_kept_lines(verdict),
    ]
    for scene in verdict.scenes:
        if scene.allowed:
            allowed = ", ".join(f"{share:g} of the bound of {name}" for name, share in scene.allowed.items())
            lines.append(f"note:       {scene.name} allows {allowed}")
    return "\n".join([*lines, *(f"reference:  {versions}" for versions in verdict.versions)])


def _left_out_lines(verdict: Verdict) -> Iterator[str]:
    if any(not (scene.candidate or scene.thorough or scene.problem) for scene in verdict.scenes):
        yield "left out:   tests of our caster beyond the judged films, which --thorough makes"


WAIVER_WORDS = {UNSUPPORTED: "declined by the candidate", EXPECTED: "known failures"}


def failing_scenes(scenes: Sequence[SceneVerdict]) -> list[SceneVerdict]:
    """The scenes by which a run fails."""
    return [scene for scene in scenes if not (scene.ok or scene.waived)]


def outcome_text(verdict: Verdict) -> str:
    """How many scenes pass, fail, are waived and were not judged."""
    passed, left = sum(scene.ok for scene in verdict.scenes), verdict.scene_count - len(verdict.scenes)
    words = [f"{verdict.scene_count} scenes: {passed} pass", f"{len(failing_scenes(verdict.scenes))} fail"]
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
    common = [*group_lines(verdict.scenes)]
    if first := simplest_failing(verdict.scenes):
        pixel = (first.failures[0].x, first.failures[0].y) if first.failures else None
        common.append(f"            {replay(first, pixel)}")
    texts = [failure_text(scene, report) for scene in failing_scenes(verdict.scenes)]
    return "\n\n".join(filter(None, ["\n".join(common), *texts]))


def candidate_lines(verdict: Verdict) -> Iterator[str]:
    """The candidate, the precision of its bounds, and the quantities that it does not give."""
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
    """The largest error of t in roundings, the largest bias, and the offset of t by the CPU."""
    found = [(scene.name, scene.statistics) for scene in verdict.scenes if scene.statistics is not None]
    if any(errors.pixels for _, errors in found):
        name, largest = max(found, key=lambda item: item[1].k_t.largest)
        leaning, bias = max(found, key=lambda item: abs(item[1].z))
        yield (
            f"errors:     of t at most {largest.k_t.largest:.2f} of {K:g} roundings ({name}); "
            f"bias at most |z| {abs(bias.z):.1f} of {LARGEST_Z:g} ({leaning})"
        )
    kinds = [kind for _, errors in found for kind in errors.biases if kind.enough_groups]
    off = [kind.t_bias for kind in kinds if kind.quantity == BIAS_OF_POSITION]
    if off:
        yield (
            f"machine:    Mitsuba's t of triangles is off by {median(off):+.2f} roundings on average: "
            "how its CPU inverts numbers, and no fault"
        )


def _case_lines(verdict: Verdict) -> Iterator[str]:
    """Pixels where the reference is wrong, by known defect; unlisted ones first."""
    for case, count in sorted(verdict.cases.items(), key=lambda item: item[0] != UNLISTED):
        if case == UNLISTED:
            yield (
                f"UNLISTED:   {count} pixels where the reference is wrong in no known way: a new defect of Mitsuba, "
                "or of the scene it was given"
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
    """The number of results of an earlier run, and the shard."""
    kept = sum(scene.kept for scene in verdict.scenes)
    if kept:
        yield (
            f"kept:       {kept} scenes were not judged now: an earlier run judged the same scene by the same code, "
            "variant and options"
        )
    if verdict.shard:
        yield f"shard:      {verdict.shard}, {verdict.scene_count} of {len(verdict.selected)} scenes"


# ---- what failing scenes have in common ----

MIN_FAILING_SCENES = 2  # of which something can be said together
NO_ANSWER = "no comparison"


def failing_checks(scene: SceneVerdict) -> frozenset[str]:
    """The checks that a scene fails; `exact`, which accompanies most others, only if it fails alone."""
    if scene.problem:
        return frozenset([NO_ANSWER])
    named = {*scene.failing_by, *(check.name for check in scene.checks if not check.ok)}
    named |= {failure.check for failure in scene.failures}  # of a candidate, which are not counted by check
    return frozenset(named - {EXACT} or named)


def simplest_failing(scenes: Sequence[SceneVerdict]) -> SceneVerdict | None:
    """The failing scene with the fewest primitives, then shapes, then pixels; None below MIN_FAILING_SCENES."""
    failing = failing_scenes(scenes)
    known = [scene for scene in failing if scene.composition.primitives]
    if len(failing) < MIN_FAILING_SCENES or not known:
        return None
    return min(known, key=lambda s: (s.composition.primitives, sum(s.composition.shapes.values()), s.pixels, s.name))


def _cause_lines(scenes: Sequence[SceneVerdict]) -> Iterator[str]:
    """Causes shared by several failing scenes, most frequent first, with the types of their shapes."""
    failing = failing_scenes(scenes)
    sharing: dict[str, list[SceneVerdict]] = {}
    for scene in failing:
        for finding in scene.findings:
            if finding.what != NOT_ADJUDICATED:
                sharing.setdefault(finding.what, []).append(scene)
    for what, those in sorted(sharing.items(), key=lambda item: -len(item[1])):
        if len(those) >= MIN_FAILING_SCENES:
            kinds = ", ".join(sorted({kind for scene in those for kind in scene.composition.shapes}))
            shapes = f" (shapes: {kinds})" if kinds else ""
            yield f"cause:      in {len(those)} of {len(failing)} that fail: {what}{shapes}"


def _kind_lines(scenes: Sequence[SceneVerdict]) -> Iterator[str]:
    """How many of the scenes with each type of shape fail, if several types and scenes were judged."""
    judged = [scene for scene in scenes if not scene.waived]
    kinds = {kind for scene in judged for kind in scene.composition.shapes}
    fails = {kind: [not scene.ok for scene in judged if kind in scene.composition.shapes] for kind in kinds}
    if sum(not scene.ok for scene in judged) < MIN_FAILING_SCENES or len(fails) < 2:
        return
    order = sorted(fails, key=lambda kind: (-sum(fails[kind]) / len(fails[kind]), -len(fails[kind]), kind))
    words = ", ".join(f"{kind} {sum(fails[kind])} of {len(fails[kind])}" for kind in order)
    yield f"by shape:   scenes that fail: {words}"


def group_lines(scenes: Sequence[SceneVerdict]) -> Iterator[str]:
    """What failing scenes have in common, and the simplest of them; nothing below MIN_FAILING_SCENES."""
    yield from _cause_lines(scenes)
    yield from _kind_lines(scenes)
    first = simplest_failing(scenes)
    if first is not None:
        count = first.composition.primitives
        size = f"{count} primitive{'s' if count > 1 else ''}, {first.pixels} pixels"
        yield f"look first: {first.name}, the simplest of them ({size})"

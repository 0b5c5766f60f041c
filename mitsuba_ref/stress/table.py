"""A sweep as a table: its cells, and the text for a terminal."""

from collections.abc import Iterator

from mitsuba_ref.experiment.results import NOTHING, aligned
from mitsuba_ref.stress.score import Score
from mitsuba_ref.stress.sweeps import SettingResult, SweepResult
from mitsuba_ref.stress.witnesses import SCREEN, WITNESSES, Absent, Witness


def as_text(sweep: SweepResult) -> str:
    """Head, one row a setting, the breakdowns of each witness, and the failures of ours."""
    mark = "PASS" if sweep.ok else "FAIL"
    head = f"{mark}  {sweep.name}: {sweep.title}; {sweep.error}, wrong hits or misses   {sweep.seconds:.1f} s"
    problems = (f"FAIL  {line}" for line in sweep.problems)
    return "\n".join([head, *aligned(rows(sweep)), *footnotes(sweep), *problems])


def shown_witnesses(sweep: SweepResult) -> list[Witness]:
    """The witnesses that have a column: rasterization only where rays share an eye."""
    absent = sweep.absence(SCREEN.key)
    return [witness for witness in WITNESSES if witness is not SCREEN or absent is None]


def rows(sweep: SweepResult) -> list[list[str]]:
    """The head and one row a setting."""
    names = [name for witness in shown_witnesses(sweep) for name in (witness.key, "wrong")]
    head = [sweep.quantity, "rays", "hits", "ties", "bound 64", "bound 32", *names]
    return [head, *(_row(sweep, setting) for setting in sweep.settings)]


def _row(sweep: SweepResult, setting: SettingResult) -> list[str]:
    counts = [f"{setting.x:.4g}", str(setting.rays), str(setting.exact.hits), str(setting.exact.ties)]
    bounds = [_number(setting.bound.float64), _number(setting.bound.float32)]
    scores = (setting.witnesses[witness.key] for witness in shown_witnesses(sweep))
    return [*counts, *bounds, *(cell for score in scores for cell in _score_cells(score))]


def _score_cells(score: Score | Absent) -> list[str]:
    """Largest error, with a ! beyond its bound; wrong masks, and wrong primitives behind a +."""
    if isinstance(score, Absent):
        return [score.status, NOTHING]
    wrong = str(score.wrong_masks) + (f"+{score.wrong_primitives}" if score.wrong_primitives else "")
    return [_number(score.error) + ("!" if score.beyond else ""), wrong]


def _number(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1e}" if value else "0"


def footnotes(sweep: SweepResult) -> Iterator[str]:
    """Where each witness first breaks down; why one is absent."""
    found = [f"{witness.key} {breakdown(sweep, witness.key)}" for witness in shown_witnesses(sweep)]
    yield f"breaks down at: {', '.join(found)}"
    if not sweep.misses:
        yield leaks(sweep)
    for witness in shown_witnesses(sweep):
        if absent := sweep.absence(witness.key):
            yield f"{witness.title}: {absent.status}: {absent.why}"


def breakdown(sweep: SweepResult, key: str) -> str:
    if absent := sweep.absence(key):
        return absent.status
    return " and ".join(f"{x:.4g}" for x in sweep.breakdowns[key]) or "never"


def leaks(sweep: SweepResult) -> str:
    """Rays that leave a closed mesh, all settings together."""
    found = []
    for witness in shown_witnesses(sweep):
        scores = [setting.witnesses[witness.key] for setting in sweep.settings]
        out = sum(score.false_misses for score in scores if isinstance(score, Score))
        absent = sweep.absence(witness.key)
        found.append(f"{witness.key} {absent.status if absent else out}")
    return f"leaks of {sum(setting.rays for setting in sweep.settings)} rays: {', '.join(found)}"

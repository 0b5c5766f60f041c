"""A scene's rows as a table: its cells, and the text for a terminal."""

from mitsuba_ref.bench.result import Row, Run, SceneResult
from mitsuba_ref.bench.work import FILM, SHADING
from mitsuba_ref.experiment.results import NOTHING, aligned, number

COLUMNS = (
    "", "rays", "build ms", "ns/ray", "Mray/s", "x ours", "t: ulps", "t: bounds", "wrong", "wrong at edges", "MB",
)  # fmt: skip


def rows(scene: SceneResult) -> list[list[str]]:
    """The head and a line for each row; one that did not run says why in place of its numbers."""
    return [[*COLUMNS], *(_cells(scene, row) for row in scene.rows)]


def _cells(scene: SceneResult, row: Row) -> list[str]:
    if not row.ran:
        return [row.title, row.why or "did not run"]
    errors = [NOTHING] * 4
    if score := row.score:
        wrong = _masks_text(score.masks, score.beyond), _masks_text(score.edge_masks, score.edge_beyond)
        errors = [number(score.ulps, 2), number(score.bounds, 2), *wrong]
    return [
        f"{row.title} ({row.why})" if row.why else row.title,
        f"{row.size}^2" if scene.asks in (FILM, SHADING) else f"{row.rays:,}",
        number(None if row.build is None else 1e3 * row.build, 1),
        number(row.ns, 2),
        number(row.mrays, 1),
        number(scene.ratio(row.key), 2),
        *errors,
        NOTHING if row.memory is None else f"{row.memory / 2**20:.0f}",
    ]


def _masks_text(masks: int, beyond: int) -> str:
    """Wrong hits and misses, and behind a + hits of another surface."""
    return f"{masks}+{beyond}" if beyond else str(masks)


def as_text(scene: SceneResult) -> str:
    """The table under a line with the scene."""
    head = f"{scene.name}: {scene.title} ({scene.primitives:,} primitives)"
    return "\n".join([head, *(f"  {line}" for line in aligned(rows(scene), left=1))])


def summary(run: Run) -> str:
    """The last line: how much was done."""
    rows = [row for scene in run.scenes for row in scene.rows]
    empty = sum(not row.ran for row in rows)
    rounds = f"medians of {run.settings['alternations']} alternations"
    return f"{len(run.scenes)} of {len(run.asked)} scenes, {len(rows) - empty} rows, {empty} without numbers; {rounds}"

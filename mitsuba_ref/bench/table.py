"""A scene's rows as text and as Markdown; the same cells for both."""

from collections.abc import Sequence

from mitsuba_ref.bench.result import Row, Run, SceneResult
from mitsuba_ref.bench.work import FILM, SHADING

COLUMNS = (
    "", "rays", "build ms", "ns/ray", "Mray/s", "x ours", "t: ulps", "t: bounds", "wrong", "wrong at edges", "MB",
)  # fmt: skip
NOTHING = "-"


def cells(scene: SceneResult) -> list[list[str]]:
    """A line for each row; a row that did not run says why in place of its numbers."""
    return [line(scene, row) for row in scene.rows]


def line(scene: SceneResult, row: Row) -> list[str]:
    if not row.ran:
        return [row.title, row.why or "did not run"]
    score = row.score
    wrong = [NOTHING] * 4
    if score:
        wrong = [
            number(score.ulps, 2),
            number(score.bounds, 2),
            pair(score.masks, score.beyond),
            pair(score.edge_masks, score.edge_beyond),
        ]
    title = row.title if not row.why else f"{row.title} ({row.why})"
    return [
        title,
        rays_text(row, scene),
        number(None if row.build is None else 1e3 * row.build, 1),
        number(row.ns, 2),
        number(row.mrays, 1),
        number(scene.ratio(row.key), 2),
        *wrong,
        NOTHING if row.memory is None else f"{row.memory / 2**20:.0f}",
    ]


def rays_text(row: Row, scene: SceneResult) -> str:
    return f"{row.size}^2" if scene.asks in (FILM, SHADING) else f"{row.rays:,}"


def number(value: float | None, digits: int) -> str:
    """So many digits after the point; of small numbers, two that count."""
    if value is None:
        return NOTHING
    return f"{value:.{digits}f}" if value == 0.0 or abs(value) >= 10.0**-digits else f"{value:.1e}"


def pair(masks: int, beyond: int) -> str:
    """Wrong masks, and behind a + hits of another surface."""
    return f"{masks}+{beyond}" if beyond else str(masks)


def as_text(scene: SceneResult) -> str:
    """The table, columns aligned, under a line that says which scene it is."""
    lines = cells(scene)
    whole = [COLUMNS, *(row for row in lines if len(row) == len(COLUMNS))]
    widths = [max(len(row[i]) for row in whole) for i in range(len(COLUMNS))]
    widths[0] = max(len(row[0]) for row in [COLUMNS, *lines])
    head = f"{scene.name}: {scene.title} ({scene.primitives:,} primitives)"
    return "\n".join([head, *(_aligned(row, widths) for row in [COLUMNS, *lines])])


def _aligned(row: Sequence[str], widths: Sequence[int]) -> str:
    first, *rest = row
    if len(row) < len(COLUMNS):
        return f"  {first:<{widths[0]}}  {' '.join(rest)}"
    return f"  {first:<{widths[0]}}" + "".join(
        f"  {cell:>{width}}" for cell, width in zip(rest, widths[1:], strict=True)
    )


def as_markdown(scene: SceneResult) -> str:
    head = "| " + " | ".join(COLUMNS) + " |"
    rule = "|---|" + "---:|" * (len(COLUMNS) - 1)
    return "\n".join([head, rule, *(_row(row) for row in cells(scene))])


def _row(row: Sequence[str]) -> str:
    padded = [*row, *[""] * (len(COLUMNS) - len(row))]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in padded) + " |"


def summary(run: Run) -> str:
    """The last line: how much was done."""
    rows = [row for scene in run.scenes for row in scene.rows]
    empty = sum(not row.ran for row in rows)
    few = f"; medians of {run.settings['alternations']} alternations"
    return f"{len(run.scenes)} of {len(run.asked)} scenes, {len(rows) - empty} rows, {empty} without numbers{few}"

"""The page of a campaign: the score of each group and module, and every survivor."""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mutants.campaign import SURVIVED

Z = 1.96  # of a two-sided interval of 95 %
HEAD = Path(__file__).with_name("page_head.md")


def interval(killed: int, counted: int) -> tuple[float, float]:
    """The Wilson score interval of a share, at 95 %."""
    if not counted:
        return 0.0, 1.0
    p, z2 = killed / counted, Z * Z
    middle = (p + z2 / (2 * counted)) / (1 + z2 / counted)
    half = Z / (1 + z2 / counted) * math.sqrt(p * (1 - p) / counted + z2 / (4 * counted * counted))
    return max(0.0, middle - half), min(1.0, middle + half)


def score(rows: Sequence[dict[str, Any]], known: dict[str, str]) -> dict[str, Any]:
    """Counts of outcomes; equivalents among the survivors count neither as killed nor as run."""
    counts = Counter(row["status"] for row in rows)
    equal = sum(row["status"] in SURVIVED and row["key"] in known for row in rows)
    killed, counted = counts["killed"] + counts["timeout"], len(rows) - equal
    low, high = interval(killed, counted)
    return {
        "run": len(rows), "killed": killed, "timeout": counts["timeout"], "equivalent": equal,
        "survived": counted - killed, "score": killed / counted if counted else math.nan, "low": low, "high": high,
    }  # fmt: skip


def _line(name: str, exist: int, found: dict[str, Any]) -> str:
    share = f"{found['score']:.1%}" if found["run"] else ""
    between = f"{found['low']:.0%} to {found['high']:.0%}" if found["run"] else ""
    columns = (exist, found["run"], found["killed"], found["timeout"], found["equivalent"], found["survived"])
    return f"| {name} | {' | '.join(map(str, columns))} | {share} | {between} |"


COLUMNS = "exist | run | killed | of them by time | equivalent | survived | score | 95 % interval"


def page(result: dict[str, Any], known: dict[str, str]) -> str:
    outcomes, lines = result["outcomes"], [HEAD.read_text(encoding="utf-8").rstrip(), ""]
    lines += [f"| group | {COLUMNS} |", "|---" * 9 + "|"]
    for group, modules in result["populations"].items():
        rows = [row for row in outcomes if row["group"] == group]
        lines.append(_line(group, sum(modules.values()), score(rows, known)))
    lines += ["", "## Modules", "", f"| module | {COLUMNS} |", "|---" * 9 + "|"]
    for modules in result["populations"].values():
        for module, exist in modules.items():
            rows = [row for row in outcomes if row["module"] == module]
            if rows:
                lines.append(_line(f"`{module}`", exist, score(rows, known)))
    lines += ["", "## Survivors", "", "| where | operator | change | why |", "|---|---|---|---|"]
    for row in sorted(outcomes, key=lambda row: (row["module"], row["line"], row["new"])):
        if row["status"] in SURVIVED:
            why = f"equivalent: {known[row['key']]}" if row["key"] in known else f"open: {row['status']}"
            change = f"`{_short(row['old'])}` to `{_short(row['new'])}`"
            place = f"`{row['module']}`, `{row['where'] or 'module'}`"
            lines.append(f"| {place} | {row['operator']} | {change} | {why} |")
    return "\n".join(lines) + "\n"


def _short(code: str) -> str:
    text = " ".join(code.split()).replace("|", "\\|")
    return text if len(text) <= 70 else f"{text[:40]} ... {text[-25:]}"


def write_page(result: dict[str, Any], known: dict[str, str], path: Path) -> None:
    path.write_text(page(result, known), encoding="utf-8")

"""What of the scenes' records goes into a report of one file, when not all of it does."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

ABOUT = "about"  # the part without which no other is of use

# Of each part: the element around it, and its name among those that are left out.
AROUND = 200

Sizes = Mapping[str, Mapping[str, int]]  # scene -> part -> bytes
Chosen = set[tuple[str, str]]  # scene, part


def choose(rows: Sequence[Mapping[str, Any]], sizes: Sizes, room: int, layers: Sequence[str]) -> Chosen:
    """Parts that fit into `room` bytes: all of the failing scenes first, then of the others layer by layer."""
    chosen: Chosen = set()
    room -= AROUND * sum(map(len, sizes.values()))
    for scene, part in _in_order(rows, layers):
        size = sizes.get(scene, {}).get(part)
        if size is not None and size <= room and (part == ABOUT or (scene, ABOUT) in chosen):
            chosen.add((scene, part))
            room -= size
    return chosen


def _in_order(rows: Sequence[Mapping[str, Any]], layers: Sequence[str]) -> Iterator[tuple[str, str]]:
    failing = [row["name"] for row in rows if not row["ok"]]
    passing = [row["name"] for row in rows if row["ok"]]
    yield from ((scene, ABOUT) for scene in (*failing, *passing))
    yield from ((scene, layer) for scene in failing for layer in layers)
    yield from ((scene, layer) for layer in layers for scene in passing)


def left_out(sizes: Sizes, chosen: Chosen) -> dict[str, list[str]]:
    """Scene -> its parts that are not there."""
    missing = {
        scene: [part for part in parts if (scene, part) not in chosen] for scene, parts in sizes.items()
    }
    return {scene: parts for scene, parts in missing.items() if parts}


def aside(parts: Mapping[str, str]) -> str:
    """A scene's record until the page is written: a part a line."""
    return "".join(f"{name} {text}\n" for name, text in parts.items())


def elements(folder: Path, rows: Sequence[Mapping[str, Any]], chosen: Chosen) -> Iterator[str]:
    """Inert script elements, one a part, which the page reads when it needs them."""
    for row in rows:
        if not row["file"]:
            continue
        for line in (folder / row["file"]).read_text(encoding="utf-8").splitlines():
            part, text = line.split(" ", 1)
            if (row["name"], part) in chosen:
                scene = quote(row["name"])
                yield f'<script type="application/json" data-scene="{scene}" data-part="{part}">{text}</script>\n'

"""Layered drawings of directed graphs as SVG, after Sugiyama, Tagawa and Toda (1981): layers, crossings, coordinates.

Nothing is random and nothing depends on the order of a set, so that equal graphs give equal bytes.
"""

import html
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from math import log2
from typing import NamedTuple

Edge = tuple[str, str]  # (from, to); drawn downwards, from a layer to one below
Order = list[list[str]]  # the nodes of each layer, from left to right

BOX_HEIGHT = 46.0  # all sizes are in CSS pixels
LAYER_HEIGHT = 118.0
GAP = 26.0  # between neighbours of a layer
MARGIN = 30.0
NAME_SIZE, CAPTION_SIZE, WEIGHT_SIZE = 15, 11, 11  # of letters
LETTER_WIDTH = 0.56  # of the size of a letter, on average, in the sans serif fonts that browsers choose
SWEEPS = 40


class Box(NamedTuple):
    """One node as it is drawn."""

    name: str
    caption: str
    style: str  # class of its rectangle in the style sheet

    @property
    def width(self) -> float:
        letters = max(len(self.name) * NAME_SIZE * 1.08, len(self.caption) * CAPTION_SIZE)
        return round(letters * LETTER_WIDTH + 22.0)


class Point(NamedTuple):
    x: float
    y: float


# --- layers


def longest_path_layers(nodes: Sequence[str], edges: Iterable[Edge]) -> dict[str, int]:
    """The layer of each node: 0 at the top, else one below the lowest node that has an edge to it.

    Raises ValueError for a circle.
    """
    above = defaultdict(list)
    for start, end in edges:
        above[end].append(start)
    layer: dict[str, int] = {}

    def place(node: str, path: tuple[str, ...]) -> int:
        if node in path:
            raise ValueError(f"a circle: {' -> '.join([*path, node])}")
        if node not in layer:
            layer[node] = 1 + max((place(each, (*path, node)) for each in above[node]), default=-1)
        return layer[node]

    for node in nodes:
        place(node, ())
    return layer


def transitive_reduction(edges: Iterable[Edge]) -> list[Edge]:
    """The edges that no longer path stands for, sorted."""
    edges = sorted(set(edges))
    targets = defaultdict(set)
    for start, end in edges:
        targets[start].add(end)
    reached: dict[str, set[str]] = {}

    def reach(node: str) -> set[str]:
        if node not in reached:
            reached[node] = set(targets[node]).union(*(reach(each) for each in sorted(targets[node])))
        return reached[node]

    return [
        (start, end) for start, end in edges if not any(end in reach(other) for other in targets[start] if other != end)
    ]


# --- crossings


def with_bends(layer: Mapping[str, int], edges: Sequence[Edge]) -> tuple[Order, dict[Edge, list[str]]]:
    """(nodes of each layer with a bend wherever an edge passes a layer, the nodes and bends along each edge)."""
    order: Order = [[] for _ in range(max(layer.values(), default=0) + 1)]
    for node, depth in layer.items():
        order[depth].append(node)
    routes = {}
    for start, end in edges:
        bends = [f"{start}\0{end}\0{depth}" for depth in range(layer[start] + 1, layer[end])]
        for depth, bend in enumerate(bends, layer[start] + 1):
            order[depth].append(bend)
        routes[start, end] = [start, *bends, end]
    return order, routes


def fewest_crossings(order: Order, routes: Mapping[Edge, list[str]]) -> Order:
    """The best order of many sweeps that put each node at the middle of its neighbours in the layer before."""
    links = [step for route in routes.values() for step in pairwise(route)]
    above, below = defaultdict(list), defaultdict(list)
    for upper, lower in links:
        above[lower].append(upper)
        below[upper].append(lower)
    best, fewest = order, crossings(order, below)
    for sweep in range(SWEEPS):
        order = [list(each) for each in order]
        downwards = sweep % 2 == 0
        neighbours, depths = (above, range(1, len(order))) if downwards else (below, range(len(order) - 2, -1, -1))
        for depth in depths:
            place = {node: i for i, node in enumerate(order[depth + (-1 if downwards else 1)])}
            now = {node: i for i, node in enumerate(order[depth])}
            middle = {
                node: sum(place[each] for each in neighbours[node]) / len(neighbours[node])
                if neighbours[node]
                else float(now[node])
                for node in order[depth]
            }
            order[depth].sort(key=lambda node: (middle[node], now[node]))
        order = swapped(order, above, below)
        count = crossings(order, below)
        if count < fewest:
            best, fewest = order, count
    return best


def swapped(order: Order, above: Mapping[str, list[str]], below: Mapping[str, list[str]]) -> Order:
    """Neighbours change places as long as that takes crossings away."""
    better = True
    while better:
        better = False
        for depth, layer in enumerate(order):
            for i in range(len(layer) - 1):
                gain = 0
                for neighbours, other in ((above, depth - 1), (below, depth + 1)):
                    if 0 <= other < len(order):
                        place = {node: k for k, node in enumerate(order[other])}
                        left = [place[each] for each in neighbours.get(layer[i], ())]
                        right = [place[each] for each in neighbours.get(layer[i + 1], ())]
                        gain += sum(a > b for a in left for b in right) - sum(a < b for a in left for b in right)
                if gain > 0:
                    layer[i], layer[i + 1] = layer[i + 1], layer[i]
                    better = True
    return order


def crossings(order: Order, below: Mapping[str, list[str]]) -> int:
    """How many pairs of links between neighbouring layers cross."""
    count = 0
    for upper, lower in pairwise(order):
        place = {node: i for i, node in enumerate(lower)}
        ends = [place[each] for node in upper for each in sorted(below.get(node, ()), key=place.__getitem__)]
        count += sum(a > b for i, a in enumerate(ends) for b in ends[i + 1 :])
    return count


# --- coordinates


def coordinates(order: Order, routes: Mapping[Edge, list[str]], width: Mapping[str, float]) -> dict[str, Point]:
    """The middle of each node and bend: near its neighbours, in order, and never closer than GAP."""
    near = defaultdict(list)
    for route in routes.values():
        for upper, lower in pairwise(route):
            weight = 8.0 if "\0" in upper and "\0" in lower else 2.0 if "\0" in upper + lower else 1.0
            near[upper].append((lower, weight))
            near[lower].append((upper, weight))
    x: dict[str, float] = {}
    for layer in order:
        left = 0.0
        for node in layer:
            x[node] = left + width.get(node, 0.0) / 2
            left += width.get(node, 0.0) + GAP
        x |= {node: x[node] - left / 2 for node in layer}
    for sweep in range(SWEEPS):
        for layer in order if sweep % 2 == 0 else order[::-1]:
            wanted = [
                sum(x[each] * weight for each, weight in near[node]) / sum(w for _, w in near[node])
                if near[node]
                else x[node]
                for node in layer
            ]
            x |= dict(zip(layer, spread(wanted, [width.get(node, 0.0) for node in layer]), strict=True))
    left = min((x[node] - width.get(node, 0.0) / 2 for layer in order for node in layer), default=0.0)
    return {
        node: Point(round(x[node] - left + MARGIN, 1), round(MARGIN + BOX_HEIGHT / 2 + depth * LAYER_HEIGHT, 1))
        for depth, layer in enumerate(order)
        for node in layer
    }


def spread(wanted: Sequence[float], widths: Sequence[float]) -> list[float]:
    """The places nearest to those wanted, in the least-squares sense, that keep order and distance."""
    offset = [0.0]
    for a, b in pairwise(widths):
        offset.append(offset[-1] + (a + b) / 2 + GAP)
    pools: list[tuple[float, int]] = []  # (mean, count), pooling adjacent violators
    for place, off in zip(wanted, offset, strict=True):
        mean, count = place - off, 1
        while pools and pools[-1][0] > mean:
            before, members = pools.pop()
            mean, count = (before * members + mean * count) / (members + count), members + count
        pools.append((mean, count))
    return [
        mean + off for (mean, off) in zip([mean for mean, count in pools for _ in range(count)], offset, strict=True)
    ]


# --- SVG


def path_through(points: Sequence[Point]) -> str:
    """A smooth line: vertical where it leaves, passes a layer and arrives."""
    first, *rest = points
    words = [f"M{first.x:g},{first.y:g}"]
    for a, b in pairwise(points):
        half = (b.y - a.y) / 2
        words.append(f"C{a.x:g},{a.y + half:g} {b.x:g},{b.y - half:g} {b.x:g},{b.y:g}")
    return " ".join(words) if rest else ""


def on_curve(a: Point, b: Point, t: float) -> Point:
    """The point of one piece of `path_through`, t from 0 to 1."""
    s, half = 1.0 - t, (b.y - a.y) / 2
    weights = s**3, 3 * s * s * t, 3 * s * t * t, t**3
    xs, ys = (a.x, a.x, b.x, b.x), (a.y, a.y + half, b.y - half, b.y)
    return Point(
        sum(w * v for w, v in zip(weights, xs, strict=True)), sum(w * v for w, v in zip(weights, ys, strict=True))
    )


def text(x: float, y: float, words: str, style: str) -> str:
    return f'<text class="{style}" x="{x:g}" y="{y:g}">{html.escape(words)}</text>'


def line_width(weight: int) -> float:
    return round(1.0 + 0.5 * log2(max(weight, 1)), 2)


STYLE = """
text { font-family: "DejaVu Sans", Verdana, Arial, sans-serif; text-anchor: middle; fill: #1c2733 }
.name { font-size: 15px; font-weight: bold }
.caption { font-size: 11px; fill: #3d4c5c }
.note { font-size: 13px; text-anchor: start; fill: #3d4c5c }
.weight { font-size: 11px; fill: #33414f; stroke: #ffffff; stroke-width: 4px; paint-order: stroke }
rect { stroke-width: 1.5px }
.page { fill: #ffffff }
.first { fill: #e3eefb; stroke: #3b6ea8 }
.second { fill: #e6f4e4; stroke: #4d8a4a }
.arrow { fill: none; stroke: #8a97a5 }
.head { fill: #6b7885 }
"""


class Label(NamedTuple):
    """A weight beside its arrow."""

    at: Point
    words: str

    def overlaps(self, other: "Label") -> bool:
        reach = 3.6 * (len(self.words) + len(other.words)) + 4.0
        return abs(self.at.x - other.at.x) < reach and abs(self.at.y - other.at.y) < 14.0


def drawing(boxes: Sequence[Box], weights: Mapping[Edge, int], notes: Sequence[str]) -> str:
    """The SVG of a graph without circles. weights: of each edge, from the upper box to the lower one; its arrow points
    upwards, to what the lower one needs."""
    edges = list(weights)
    order, routes = with_bends(longest_path_layers([box.name for box in boxes], edges), edges)
    width = {box.name: box.width for box in boxes}
    below = defaultdict(list)
    for route in routes.values():
        for upper, lower in pairwise(route):
            below[upper].append(lower)
    place = coordinates(fewest_crossings(order, routes), routes, width)
    lines = {edge: ends_apart(edge, routes, place, width) for edge in edges}
    right = max(place[box.name].x + box.width / 2 for box in boxes) + MARGIN
    bottom = max(place[box.name].y for box in boxes) + BOX_HEIGHT / 2 + MARGIN
    height = bottom + 20.0 * len(notes) + 4.0
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{right:g}" height="{height:g}" '
        f'viewBox="0 0 {right:g} {height:g}">',
        f"<style>{STYLE}</style>",
        '<defs><marker id="head" class="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" '
        'markerUnits="userSpaceOnUse" orient="auto-start-reverse"><path d="M0,0 L8,4 L0,8 z"/></marker></defs>',
        f'<rect class="page" width="{right:g}" height="{height:g}"/>',
    ]
    for edge, points in lines.items():
        thick = line_width(weights[edge])
        parts.append(
            f'<path class="arrow" stroke-width="{thick:g}" marker-start="url(#head)" d="{path_through(points)}">'
            f"<title>{edge[1]} imports {edge[0]}: {weights[edge]}</title></path>"
        )
    for box in boxes:
        x, y = place[box.name]
        left, top = round(x - box.width / 2, 1), y - BOX_HEIGHT / 2
        parts += [
            f'<rect class="{box.style}" x="{left:g}" y="{top:g}" width="{box.width:g}" height="{BOX_HEIGHT:g}" '
            'rx="6"/>',
            text(x, y - 3, box.name, "name"),
            text(x, y + 14, box.caption, "caption"),
        ]
    for label in labels(lines, weights):
        parts.append(text(label.at.x, label.at.y + 4, label.words, "weight"))
    parts += [text(MARGIN, bottom + 20.0 * i, note, "note") for i, note in enumerate(notes)]
    return "\n".join([*parts, "</svg>", ""])


def ends_apart(
    edge: Edge, routes: Mapping[Edge, list[str]], place: Mapping[str, Point], width: Mapping[str, float]
) -> list[Point]:
    """The points of an arrow, whose ends share their boxes' sides with those of other arrows, in order."""
    start, end = edge
    route = routes[edge]
    leaving = sorted((place[each[1]].x, key) for key, each in routes.items() if key[0] == start)
    arriving = sorted((place[each[-2]].x, key) for key, each in routes.items() if key[1] == end)
    points = [place[each] for each in route]
    for i, ends, box, side in ((0, leaving, start, 0.5), (-1, arriving, end, -0.5)):
        rank = [key for _, key in ends].index(edge)
        share = (rank + 1) / (len(ends) + 1) - 0.5
        at = place[box]
        points[i] = Point(round(at.x + share * (width[box] - 16.0), 1), at.y + side * BOX_HEIGHT)
    return points


def labels(lines: Mapping[Edge, Sequence[Point]], weights: Mapping[Edge, int]) -> list[Label]:
    """A weight on each arrow where no other stands, nearest to the lower end."""
    found: list[Label] = []
    for edge, points in lines.items():
        pieces = list(pairwise(points))[::-1]
        places = [on_curve(a, b, t) for a, b in pieces for t in (0.72, 0.6, 0.82, 0.5, 0.4, 0.3)]
        choices = [Label(Point(round(p.x, 1), round(p.y, 1)), str(weights[edge])) for p in places]
        free = (each for each in choices if not any(each.overlaps(other) for other in found))
        found.append(next(free, choices[0]))
    return found

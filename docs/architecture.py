"""Figures of the import graph of caster and mitsuba_ref, and the picture of its packages, docs/architecture.svg.

    python docs/architecture.py [--json] [--svg FILE]

It needs the standard library alone. A module imports another one where it names it in an import statement at any
depth (in a function or under TYPE_CHECKING as well), by import_module("literal"), or by import_module of a name taken
from a literal of the same module, as registries do. Importing a.b does not count as importing the package a.

Layers: the most modules on a chain of imports, where a circle counts as one module; of packages likewise.
Modules with exactly one importer: those that could be part of that importer. Plain members of a registry, which only
the `__init__` of their own package imports, are counted apart: a registry is the reason for a file of their own.
"""

import argparse
import ast
import json
import os
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from layered_drawing import Box, drawing, transitive_reduction

ROOT = Path(__file__).resolve().parents[1]
ROOT_PACKAGES = ("caster", "mitsuba_ref")
FLAT_IN_ROOT = ("__init__.py", "__main__.py")  # what may lie in a root package itself
MODULES_OF_PACKAGE = 12  # beside sub-packages and __init__

# The packages in the order of the flow of data: each imports only what stands before it. Captions are for the picture.
FLOW = {
    "caster.jit": "compilation and kernel cache",
    "caster.kernels": "intersection in float64 and exactly",
    "caster.aovs": "one file an AOV",
    "caster.description": "fields, transforms, diagnostics",
    "caster.system": "files, terminal, signals",
    "caster.geometry": "meshes, world space, packing",
    "caster.shapes": "one file a kind",
    "caster.cameras": "one file a kind",
    "caster.scene": "model, files, export",
    "caster.rendering": "plan, tiles, hits, AOVs",
    "caster.image": "EXR files and previews",
    "caster.classroom": "scenes of a course",
    "caster.cli": "caster COMMAND",
    "mitsuba_ref.oracle": "exact first hits",
    "mitsuba_ref.error_model": "bounds and tolerances",
    "mitsuba_ref.scene_xml": "Mitsuba's XML",
    "mitsuba_ref.shapes": "XML, bounds, exactness of a kind",
    "mitsuba_ref.cameras": "XML and rays of a kind",
    "mitsuba_ref.hard": "hard scenes and rays",
    "mitsuba_ref.reference": "Mitsuba in a child process",
    "mitsuba_ref.subjects": "who is judged",
    "mitsuba_ref.judge": "the class of each pixel",
    "mitsuba_ref.report": "text, JUnit, images, HTML",
    "mitsuba_ref.probe": "one pixel, all witnesses",
    "mitsuba_ref.exr_compare": "two EXR files",
    "mitsuba_ref.runner": "many scenes, shards, pytest",
    "mitsuba_ref.fuzz": "random scenes",
    "mitsuba_ref.stress": "hard numerics, in steps",
    "mitsuba_ref.bench": "speed",
    "mitsuba_ref.importers": "Mitsuba XML to scenes",
    "mitsuba_ref.cli": "mitsuba-ref COMMAND",
}
HEAVY = 16  # imports; such an arrow is drawn even where a path of others leads to the same package

Graph = Mapping[str, frozenset[str]]  # module -> modules it imports


class Import(NamedTuple):
    """One imported name: `from a import b` is "a.b" from the source "a", whether b is a module or not."""

    name: str
    source: str
    line: int


class Source(NamedTuple):
    """One file of a root package."""

    module: str  # dotted; a package for its __init__.py
    path: Path
    lines: int
    imports: tuple[Import, ...]

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"


def read_sources(root: Path = ROOT) -> list[Source]:
    """All files of the root packages, sorted by path."""
    return [source_of(path, root) for package in ROOT_PACKAGES for path in sorted((root / package).rglob("*.py"))]


def source_of(path: Path, root: Path) -> Source:
    text = path.read_text(encoding="utf-8")
    parts = path.relative_to(root).with_suffix("").parts
    module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
    package = ".".join(parts[:-1])
    return Source(module, path, text.count("\n"), tuple(imports_of(ast.parse(text, str(path)), package)))


# --- imports of one file


def imports_of(tree: ast.Module, package: str) -> Iterator[Import]:
    """Every import: at module level, in functions, for type checkers, relative, and by import_module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = absolute(node, package)
            yield from (Import(f"{source}.{alias.name}", source, node.lineno) for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            yield from (Import(name, name, node.lineno) for name in imported_by_name(node, tree, package))


def absolute(node: ast.ImportFrom, package: str) -> str:
    """The module that `from ... import` names, with leading dots resolved."""
    if not node.level:
        return node.module or ""
    parents = package.split(".")[: len(package.split(".")) - node.level + 1]
    return ".".join([*parents, *([node.module] if node.module else [])])


def imported_by_name(call: ast.Call, tree: ast.Module, package: str) -> Iterator[str]:
    """What a call of import_module may load: its literal, or a prefix with each string in a literal of the file."""
    argument = call.args[0] if call.args else ast.Constant("")
    if isinstance(argument, ast.Constant):
        yield str(argument.value)
        return
    prefix = ""
    if isinstance(argument, ast.JoinedStr):
        first = argument.values[0]
        prefix = str(first.value) if isinstance(first, ast.Constant) else f"{package}."
    for node in ast.walk(tree):
        if isinstance(node, (ast.Tuple, ast.List, ast.Set, ast.Dict)):
            for each in (*ast.iter_child_nodes(node),):
                if isinstance(each, ast.Constant) and isinstance(each.value, str):
                    yield prefix + each.value


# --- the graph


def graph_of(sources: Iterable[Source]) -> dict[str, frozenset[str]]:
    """Module -> modules of the root packages that it imports."""
    sources = list(sources)
    known = {source.module for source in sources}
    return {
        source.module: frozenset(
            target for each in source.imports if (target := longest_known(each.name, known)) is not None
        )
        - {source.module}
        for source in sources
    }


def longest_known(name: str, known: set[str]) -> str | None:
    """The module that an imported name lies in."""
    while name and name not in known:
        name = name.rpartition(".")[0]
    return name or None


def circles(graph: Graph) -> list[tuple[str, ...]]:
    """Strongly connected components of more than one module, largest first (Tarjan, without recursion)."""
    return sorted((each for each in components(graph) if len(each) > 1), key=lambda c: (-len(c), c))


def components(graph: Graph) -> list[tuple[str, ...]]:
    """All strongly connected components, those that are imported before those that import them."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    on_stack: set[str] = set()
    found: list[tuple[str, ...]] = []
    for start in sorted(graph):
        if start in index:
            continue
        work = [(start, iter(sorted(graph[start])))]
        index[start] = low[start] = len(index)
        stack.append(start)
        on_stack.add(start)
        while work:
            node, rest = work[-1]
            for target in rest:
                if target not in index:
                    index[target] = low[target] = len(index)
                    stack.append(target)
                    on_stack.add(target)
                    work.append((target, iter(sorted(graph[target]))))
                    break
                if target in on_stack:
                    low[node] = min(low[node], index[target])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    place = stack.index(node)
                    found.append(tuple(sorted(stack[place:])))
                    on_stack.difference_update(stack[place:])
                    del stack[place:]
    return found


def layers(graph: Graph) -> dict[str, int]:
    """The layer of each module: 1 where it imports none, else one above the highest it imports; a circle has one."""
    layer: dict[str, int] = {}
    for members in components(graph):
        below = {target for module in members for target in graph[module]} - set(members)
        height = 1 + max((layer[target] for target in below), default=0)
        layer |= dict.fromkeys(members, height)
    return layer


def longest_chain(graph: Graph) -> list[str]:
    """One of the longest chains of imports, from the module that imports down to the one that imports nothing."""
    layer = layers(graph)
    members = {module: part for part in components(graph) for module in part}
    chain = [min(graph, key=lambda module: (-layer[module], module))] if graph else []
    while chain and layer[chain[-1]] > 1:
        below = {target for module in members[chain[-1]] for target in graph[module]}
        chain.append(min(each for each in below if layer[each] == layer[chain[-1]] - 1))
    return chain


# --- figures


def figures(root: Path = ROOT) -> dict[str, Any]:
    """All of them, by name; what `--json` prints."""
    sources = read_sources(root)
    graph = graph_of(sources)
    single = modules_with_one_importer(graph)
    members = {module for module, importer in single.items() if importer == module.rpartition(".")[0]}
    names = Counter(source.path.name for source in sources if not source.path.name.startswith("__"))
    return {
        "lines": sum(source.lines for source in sources),
        "files": len(sources),
        "crowded_packages": crowded_packages(sources, root),
        "flat_in_roots": flat_in_roots(sources, root),
        "layers": max(layers(graph).values(), default=0),
        "package_layers": max(layers(graph_of_packages(graph)).values(), default=0),
        "longest_chain": longest_chain(graph),
        "circles": [list(circle) for circle in circles(graph)],
        "against_flow": {f"{a} > {b}": count for (a, b), count in against_flow(graph).items()},
        "one_importer": sorted(single.keys() - members),
        "one_importer_registry_members": sorted(members),
        "repeated_file_names": {name: count for name, count in sorted(names.items()) if count > 1},
    }


def package_of(module: str) -> str:
    """The package of FLOW that a module is part of; "" for the root packages themselves."""
    package = ".".join(module.split(".")[:2])
    return package if package in FLOW else ""


def imports_between(graph: Graph) -> dict[tuple[str, str], int]:
    """(importing package, imported package) -> how many pairs of their modules."""
    pairs = Counter((package_of(module), package_of(target)) for module, targets in graph.items() for target in targets)
    return {pair: count for pair, count in sorted(pairs.items()) if all(pair) and pair[0] != pair[1]}


def graph_of_packages(graph: Graph) -> dict[str, frozenset[str]]:
    """Package of FLOW -> packages that it imports."""
    pairs = imports_between(graph)
    return {package: frozenset(b for a, b in pairs if a == package) for package in FLOW}


def against_flow(graph: Graph) -> dict[tuple[str, str], int]:
    """Those of `imports_between` that import what stands later in FLOW."""
    place = {package: i for i, package in enumerate(FLOW)}
    return {(a, b): count for (a, b), count in imports_between(graph).items() if place[b] > place[a]}


def modules_with_one_importer(graph: Graph) -> dict[str, str]:
    """Module -> its only importer. A plain member of a registry is one whose only importer is its own package."""
    importers = defaultdict(set)
    for module, targets in graph.items():
        for target in targets:
            importers[target].add(module)
    return {module: next(iter(by)) for module, by in sorted(importers.items()) if len(by) == 1}


def crowded_packages(sources: Iterable[Source], root: Path) -> dict[str, int]:
    """Packages with more modules beside sub-packages than MODULES_OF_PACKAGE."""
    counts = Counter(source.path.parent.relative_to(root).as_posix() for source in sources if not source.is_package)
    return {folder: count for folder, count in sorted(counts.items()) if count > MODULES_OF_PACKAGE}


def flat_in_roots(sources: Iterable[Source], root: Path) -> list[str]:
    """Files that lie in a root package itself and are none of FLAT_IN_ROOT."""
    flat = (source.path.relative_to(root) for source in sources)
    return [path.as_posix() for path in flat if len(path.parts) == 2 and path.name not in FLAT_IN_ROOT]


def in_words(found: Mapping[str, Any]) -> str:
    """The figures as a table, and below it what some of them consist of."""
    repeated = found["repeated_file_names"]
    rows = (
        ("product lines", f"{found['lines']:,}"),
        ("product files", f"{found['files']}"),
        (f"packages of more than {MODULES_OF_PACKAGE} modules", f"{len(found['crowded_packages'])}"),
        ("files flat in the root packages", f"{len(found['flat_in_roots'])}"),
        ("import layers of modules", f"{found['layers']}"),
        ("import layers of packages", f"{found['package_layers']}"),
        ("circles of imports", f"{len(found['circles'])}"),
        ("imports against the flow of packages", f"{sum(found['against_flow'].values())}"),
        ("modules with exactly one importer", f"{len(found['one_importer'])}"),
        ("  registry members, imported by their own package alone", f"{len(found['one_importer_registry_members'])}"),
        ("file names that stand more than once", f"{len(repeated)}"),
    )
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:{width}}  {value:>7}" for name, value in rows]
    lines += ["", f"longest chain: {' > '.join(found['longest_chain'])}"]
    lines += [f"circle of {len(circle)}: {' '.join(circle)}" for circle in found["circles"]]
    lines += [f"against the flow: {pair} ({count})" for pair, count in found["against_flow"].items()]
    lines += [f"{folder}: {count} modules" for folder, count in found["crowded_packages"].items()]
    lines += [f"flat: {', '.join(found['flat_in_roots'])}"] if found["flat_in_roots"] else []
    lines += [f"one importer: {', '.join(found['one_importer'])}"]
    lines += [f"repeated: {', '.join(f'{name} ({count})' for name, count in repeated.items())}"]
    return "\n".join(lines)


# --- the picture


def picture(root: Path = ROOT) -> str:
    """The packages in layers, with an arrow for what each imports, as SVG."""
    graph = graph_of(read_sources(root))
    pairs, upward = imports_between(graph), against_flow(graph)
    edges = {(b, a): count for (a, b), count in pairs.items() if (a, b) not in upward}
    shown = set(transitive_reduction(edges)) | {edge for edge, count in edges.items() if count >= HEAVY}
    boxes = [
        Box(package, caption, "first" if package.startswith("caster.") else "second")
        for package, caption in FLOW.items()
    ]
    notes = [
        "Data flow from top to bottom. An arrow points to what is imported; its number counts pairs of modules.",
        f"An arrow of fewer than {HEAVY} is left out where a path of others leads to the same package.",
    ]
    if upward:
        words = [f"{a} > {b} ({count})" for (a, b), count in upward.items()]
        notes.append("Against the flow, and not drawn:")
        notes += [", ".join(words[i : i + 2]) for i in range(0, len(words), 2)]
    return drawing(boxes, {edge: edges[edge] for edge in sorted(shown)}, notes)


def main() -> int:
    parser = argparse.ArgumentParser(description="figures of the import graph of caster and mitsuba_ref")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--svg", metavar="FILE", help="write the picture of the packages instead")
    args = parser.parse_args()
    if args.svg:
        Path(args.svg).write_text(picture(), encoding="utf-8")
        return 0
    found = figures()
    try:
        print(json.dumps(found, indent=1) if args.json else in_words(found), flush=True)
    except BrokenPipeError:  # `| head` has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


if __name__ == "__main__":
    sys.exit(main())

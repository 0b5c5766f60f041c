"""The imports of both packages, and their picture in docs/internals/architecture.md.

    python docs/architecture.py     # renews the picture

It needs only the standard library. A module imports another one by an import statement at any depth (also in a
function or under TYPE_CHECKING), or by import_module("literal"). Importing a.b does not count as importing the package
a.
"""

import ast
from collections.abc import Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/internals/architecture.md"
ROOT_PACKAGES = ("caster", "mitsuba_ref")

# The packages in the order of the flow of data: each imports only what stands before it.
FLOW = (
    "caster.jit",
    "caster.kernels",
    "caster.aovs",
    "caster.description",
    "caster.system",
    "caster.geometry",
    "caster.shapes",
    "caster.cameras",
    "caster.scene",
    "caster.rendering",
    "caster.image",
    "caster.classroom",
    "caster.cli",
    "mitsuba_ref.oracle",
    "mitsuba_ref.error_model",
    "mitsuba_ref.scene_xml",
    "mitsuba_ref.shapes",
    "mitsuba_ref.cameras",
    "mitsuba_ref.hard",
    "mitsuba_ref.reference",
    "mitsuba_ref.subjects",
    "mitsuba_ref.judge",
    "mitsuba_ref.report",
    "mitsuba_ref.probe",
    "mitsuba_ref.exr_compare",
    "mitsuba_ref.runner",
    "mitsuba_ref.fuzz",
    "mitsuba_ref.stress",
    "mitsuba_ref.campaign",
    "mitsuba_ref.bench",
    "mitsuba_ref.cli",
)

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
    imports: tuple[Import, ...]


def read_sources(root: Path = ROOT) -> list[Source]:
    """All files of the root packages, sorted by path."""
    return [source_of(path, root) for package in ROOT_PACKAGES for path in sorted((root / package).rglob("*.py"))]


def source_of(path: Path, root: Path) -> Source:
    text = path.read_text(encoding="utf-8")
    parts = path.relative_to(root).with_suffix("").parts
    module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
    package = ".".join(parts[:-1])
    return Source(module, path, tuple(imports_of(ast.parse(text, str(path)), package)))


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
            names = [str(each.value) for each in node.args[:1] if isinstance(each, ast.Constant)]
            yield from (Import(name, name, node.lineno) for name in names)


def absolute(node: ast.ImportFrom, package: str) -> str:
    """The module that `from ... import` names, with leading dots resolved."""
    if not node.level:
        return node.module or ""
    parents = package.split(".")[: len(package.split(".")) - node.level + 1]
    return ".".join([*parents, *([node.module] if node.module else [])])


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


def circle(graph: Graph) -> tuple[str, ...]:
    """The modules of one circle of imports, sorted; () if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return tuple(sorted(set(error.args[1])))
    return ()


def package_of(module: str) -> str:
    """The package of FLOW that a module is part of; "" for the root packages themselves."""
    package = ".".join(module.split(".")[:2])
    return package if package in FLOW else ""


def graph_of_packages(graph: Graph) -> dict[str, frozenset[str]]:
    """Package of FLOW -> packages that it imports."""
    pairs = {(package_of(module), package_of(target)) for module, targets in graph.items() for target in targets}
    return {package: frozenset(b for a, b in pairs if a == package != b and b) for package in FLOW}


# --- the picture


def picture(sources: Iterable[Source]) -> str:
    """The packages as a Mermaid graph: an arrow for what each imports, unless other arrows lead there as well."""
    graph = graph_of_packages(graph_of(sources))
    reached: dict[str, set[str]] = {}
    for package in FLOW:  # each imports only what stands before it
        reached[package] = set(graph[package]).union(*(reached.get(each, set()) for each in graph[package]))
    lines = ["flowchart TD"]
    for package in FLOW:
        for target in sorted(graph[package]):
            if not any(target in reached[other] for other in graph[package] if other != target):
                lines.append(f"    {target} --> {package}")
    return "\n".join(["```mermaid", *lines, "```"])


def with_picture(page: str, sources: Iterable[Source]) -> str:
    """The page with the picture in place of the one in it."""
    before, _, rest = page.partition("```mermaid\n")
    return before + picture(sources) + rest.partition("```")[2]


def main() -> None:
    PAGE.write_text(with_picture(PAGE.read_text(encoding="utf-8"), read_sources()), encoding="utf-8")


if __name__ == "__main__":
    main()

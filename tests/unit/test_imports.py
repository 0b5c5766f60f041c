"""The import contract. A wrong import is named with its file, its line and the rule it breaks."""

import ast
import functools
import importlib
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import architecture
import pytest
from places import ROOT

STDLIB = frozenset(sys.stdlib_module_names)
TYPING = ("typing", "collections.abc")  # words for the type checker; nothing of them runs per ray
NUMBA_DOOR = "caster.jit.decorators"

# What a kernel is written with.
KERNEL_LANGUAGE = (
    "math",
    "numpy",
    *TYPING,
    "caster.kernels",
    NUMBA_DOOR,
    "caster.jit.simd",
    "caster.jit.kernel_cache.COMPILED",
    "caster.jit.command_list.Column",
)

# What descriptions are made of: the checks of fields, and transforms of geometry to world space.
DESCRIBING = ("caster.description", "caster.geometry", "pydantic")
PLUGGED_IN = {"shapes": DESCRIBING, "cameras": DESCRIBING, "aovs": ()}

# The names that make a kernel of a function; the counts of compiled kernels may be read anywhere.
MADE_BY = ("generic", "generic_inlined", "implement", "inlined", "jit", "optional")
MAKE_KERNELS = tuple(f"{NUMBA_DOOR}.{name}" for name in MADE_BY)

# Both packages in the order of the flow of data: each imports what stands before it.
FLOW = architecture.FLOW


class Rule(NamedTuple):
    """Modules under `where` import nothing of `never`, and if there is an `only`, nothing else.

    except_in: modules that the rule leaves alone; "package.*" is a package with all that is in it.
    """

    where: str
    reason: str
    never: tuple[str, ...] = ()
    only: tuple[str, ...] | None = None  # everything, when None
    except_in: tuple[str, ...] = ()

    def holds_for(self, module: str) -> bool:
        packages = tuple(each.removesuffix(".*") for each in self.except_in if each.endswith(".*"))
        return inside(module, (self.where,)) and module not in self.except_in and not inside(module, packages)


RULES = (
    Rule("caster", "caster does not depend on its judge", never=("mitsuba_ref", "mitsuba", "drjit")),
    Rule("caster", "only caster/image/exr.py imports OpenEXR", never=("OpenEXR",), except_in=("caster.image.exr",)),
    Rule(
        "caster",
        "only caster/image/image_files.py and caster/scene/textures.py import Pillow",
        never=("PIL",),
        except_in=("caster.image.image_files", "caster.scene.textures"),
    ),
    Rule(
        "caster", "only caster/jit imports numba and llvmlite", never=("numba", "llvmlite"), except_in=("caster.jit.*",)
    ),
    Rule(
        "caster.jit",
        "the Numba interface imports the standard library, numpy, numba, llvmlite and itself",
        only=(*STDLIB, "numpy", "numba", "llvmlite", "caster.jit"),
    ),
    Rule("caster.kernels", "a kernel imports math, numpy and kernels", only=KERNEL_LANGUAGE),
    Rule("caster.cli", "commands define no kernel", never=MAKE_KERNELS),
    *(
        Rule(
            f"caster.{kind}",
            f"one of {kind} imports kernels and {' '.join(vocabulary)}, not its siblings",
            only=(*STDLIB, "numpy", "caster.kernels", NUMBA_DOOR, *vocabulary),
            except_in=(f"caster.{kind}",),
        )
        for kind, vocabulary in PLUGGED_IN.items()
    ),
    Rule("mitsuba_ref", "the judge never imports kernels", never=("caster.kernels", "caster.jit")),
    Rule("mitsuba_ref", "only caster imports OpenEXR and numba", never=("OpenEXR", "numba")),
    Rule(
        "mitsuba_ref",
        "only mitsuba_ref/reference/mitsuba_calls.py and file_calls.py import Mitsuba",
        never=("mitsuba", "drjit"),
        except_in=("mitsuba_ref.reference.mitsuba_calls", "mitsuba_ref.reference.file_calls"),
    ),
    Rule(
        "mitsuba_ref", "other ray casters are candidates: no module imports one", never=("open3d", "embreex", "trimesh")
    ),
    Rule(
        "mitsuba_ref.oracle",
        "exact arithmetic shares no code with what it judges",
        only=(*STDLIB, "numpy", "mitsuba_ref.oracle"),
    ),
)


def inside(module: str, packages: tuple[str, ...]) -> bool:
    """Whether `module` is one of `packages` or a part of one."""
    return any(module == package or module.startswith(package + ".") for package in packages)


def breaks(rule: Rule, found: Any) -> bool:
    """Whether `rule` forbids the import, or does not list it."""
    if inside(found.name, rule.never):
        return True
    return rule.only is not None and not inside(found.name, rule.only)


@functools.cache
def tree() -> list[Any]:
    """The sources as they are, read once for all tests."""
    return architecture.read_sources(ROOT)


def broken_rules(root: Path) -> list[str]:
    """One sentence for each import under `root` that a rule forbids, however many names it brings."""
    sources = tree() if root == ROOT else architecture.read_sources(root)
    broken = [
        f"{source.path.relative_to(root)}:{found.line}: imports {found.source}, but {reason}"
        for source in sources
        for found in source.imports
        for reason in reasons_against(source, found, sources)
    ]
    return list(dict.fromkeys(broken))


def reasons_against(source: Any, found: Any, sources: list[Any]) -> Iterator[str]:
    """Why this import may not stand there."""
    for rule in RULES:
        if rule.holds_for(source.module) and breaks(rule, found):
            yield rule.reason
    if is_upward(source.module, found.name):
        yield f"{package_in_flow(found.name)} comes after {package_in_flow(source.module)} in the flow"
    if source.module.partition(".")[0] == "mitsuba_ref" and not is_public(found, sources):
        yield "the judge imports from caster only what a module names in __all__"


# --- the order of packages


def package_in_flow(module: str) -> str:
    """The package of FLOW that a module is part of; "" for the root packages and anything else."""
    return next((package for package in FLOW if inside(module, (package,))), "")


def is_upward(module: str, imported: str) -> bool:
    """Whether the imported package comes after the importing one."""
    importing, target = package_in_flow(module), package_in_flow(imported)
    if not importing or not target:
        return False
    return FLOW.index(target) > FLOW.index(importing)


# --- public names


def is_public(found: Any, sources: list[Any]) -> bool:
    """Whether the judge may import this: not of caster, the package caster, a module with __all__, or a name in one."""
    root, _, rest = found.source.partition(".")
    if root != "caster" or found.name == "caster":
        return True
    modules = {source.module: source for source in sources}
    if not rest:  # `from caster import Scene`, whose __all__ is computed on access
        return found.name not in modules
    if found.source not in modules:
        return True  # which fails at once where it is run
    if found.name.rpartition(".")[2] in (names_in_all(modules[found.source].path) or ()):
        return True
    return found.name in modules and names_in_all(modules[found.name].path) is not None


@functools.cache
def names_in_all(path: Path) -> frozenset[str] | None:
    """What a module lists in __all__; None where it has none."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if isinstance(target, ast.Name) and target.id == "__all__":
            return frozenset(ast.literal_eval(node.value))  # type: ignore[union-attr]
    return None


# --- the tree as it is


def test_every_import_keeps_the_rules():
    broken = broken_rules(ROOT)
    assert not broken, "\n".join(["imports that break a rule:", *broken])


def test_no_modules_import_one_another_in_a_circle():
    """Imports in functions and for type checkers counted."""
    found = architecture.circle(architecture.graph_of(tree()))
    assert not found, f"a circle of imports: {' '.join(found)}"


def test_every_package_has_its_place_in_the_flow():
    folders = {
        f"{package}.{path.name}"
        for package in architecture.ROOT_PACKAGES
        for path in (ROOT / package).iterdir()
        if (path / "__init__.py").is_file()
    }
    assert folders == set(FLOW) and len(set(FLOW)) == len(FLOW)


def test_what_the_rules_name_is_there():
    """A rule about a module that was renamed forbids nothing."""
    modules = {source.module for source in tree()}
    named = {rule.where for rule in RULES} | {each.removesuffix(".*") for rule in RULES for each in rule.except_in}
    listed = {each for rule in RULES for each in rule.only or () if each.startswith(("caster.", "mitsuba_ref."))}
    assert named <= modules
    assert {each for each in listed if each not in modules and each.rpartition(".")[0] not in modules} == set()


MAX_FILES = 275
MAX_MODULES = 12  # of a package, beside sub-packages and __init__


def test_the_tree_stays_within_its_limits_and_the_page_shows_it():
    assert len(tree()) <= MAX_FILES, "fold a fragment into the file of its subject"
    ((largest, count),) = Counter(s.path.parent for s in tree() if s.path.name != "__init__.py").most_common(1)
    assert count <= MAX_MODULES, largest
    page = (ROOT / "docs/internals/architecture.md").read_text(encoding="utf-8")
    assert page == architecture.with_picture(page, tree()), "run python docs/architecture.py"
    folders = re.findall(r"^\| `((?:caster|mitsuba_ref)/\w+)` \|", page, re.MULTILINE)
    assert [folder.replace("/", ".") for folder in folders] == list(FLOW)


# --- planted violations


def plant(root: Path, path: str, source: str) -> list[str]:
    for each in (path, "caster/scene/__init__.py", "caster/scene/model.py"):
        file = root / each
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text('__all__ = ["Scene"]\n' if each != path else source)
    return broken_rules(root)


@pytest.mark.parametrize(
    ("path", "source", "reason"),
    [
        ("caster/rendering/images.py", "def f():\n    from mitsuba import load_file", "does not depend on its judge"),
        ("caster/rendering/images.py", "import importlib\nimportlib.import_module('numba')", "only caster/jit imports"),
        ("caster/kernels/bvh/build.py", "from ...scene import model", "a kernel imports"),
        ("caster/cli/viewing.py", f"from {NUMBA_DOOR} import jit", "define no kernel"),
        ("caster/shapes/disk.py", "from .sphere import Sphere", "not its siblings"),
        (
            "mitsuba_ref/judge/verdict.py",
            "def f():\n    import mitsuba_ref.cli.validate",
            "comes after mitsuba_ref.judge",
        ),
        ("mitsuba_ref/oracle/interface.py", "import flint", "shares no code"),
        ("mitsuba_ref/judge/verdict.py", "from caster.scene.model import Secret", "names in __all__"),
    ],
)
def test_a_planted_import_is_caught_with_its_line_and_rule(tmp_path, path, source, reason):
    broken = plant(tmp_path, path, source)
    line = source.count("\n") + 1
    assert any(each.startswith(f"{path}:{line}: imports ") and reason in each for each in broken), broken


@pytest.mark.parametrize(
    "later",
    ["from caster.b import B", "def f():\n    import caster.b", "if TYPE_CHECKING:\n    from caster.b import B"],
)
def test_a_planted_circle_is_found(tmp_path, later):
    (tmp_path / "caster").mkdir()
    (tmp_path / "caster/a.py").write_text("from caster.c import C\n")
    (tmp_path / "caster/b.py").write_text("from caster.a import A\n")
    (tmp_path / "caster/c.py").write_text(later)
    found = architecture.circle(architecture.graph_of(architecture.read_sources(tmp_path)))
    assert found == ("caster.a", "caster.b", "caster.c")


def test_every_public_name_is_there():
    names = [source.module for source in tree()]
    modules = [importlib.import_module(name) for name in names if not name.endswith("__main__")]
    stated = [(module, name) for module in modules for name in getattr(module, "__all__", ())]
    missing = [f"{module.__name__}.{name}" for module, name in stated if not hasattr(module, name)]
    assert len(stated) > 250 and not missing

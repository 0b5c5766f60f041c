"""Who may import whom. A wrong import is named with its file, its line and the rule it breaks."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from caster.jit.kernel_cache import WITHOUT_KERNELS

ROOT = Path(__file__).resolve().parents[2]
JIT = "caster/jit/decorators.py"
LOADER = "caster.kernels.compiling"
COMPILING = tuple(
    f"caster.kernels.compiling{part}"
    for part in ("", ".arguments", ".kernel_cache", ".machine_code", ".vectors")
)
STDLIB = frozenset(sys.stdlib_module_names)
TYPING = ("typing", "collections.abc")  # words for the type checker; nothing of them runs per ray

# What descriptions are made of: the checks of fields, and placing geometry in the world.
DESCRIBING = (
    "caster.scene.fields",
    "caster.geometry.mesh",
    "caster.geometry.mesh_files",
    "caster.geometry.world_space",
    "caster.geometry.world_space",
    "caster.geometry.procedural",
    "caster.geometry.transform",
    "pydantic",
)
PLUGGED_IN = {
    "shapes": DESCRIBING,
    "cameras": DESCRIBING,
    "aovs": (
        "caster.scene.fields",
        "caster.rendering.view",
        "caster.scene.lights",
    ),  # a view: rays, hits and surfaces of one scene
}

# What the oracle takes from the rest of the tree: the packed arrays' own record, and the registry of its arithmetic.
ORACLE = ("caster.geometry.packing.Packed", "mitsuba_ref.oracle", "mitsuba_ref.shapes.REFERENCES")


# The names that make a kernel of a function; what was done for kernels may be asked by anybody.
MAKE_KERNELS = tuple(
    f"caster.jit.decorators.{name}" for name in ("generic", "generic_inlined", "implement", "inlined", "jit")
)


class Rule(NamedTuple):
    """Modules under `where` import nothing of `never`, and if there is an `only`, nothing else."""

    where: str
    says: str
    never: tuple[str, ...] = ()
    only: tuple[str, ...] | None = None  # everything, when None
    except_in: tuple[str, ...] = ()


RULES = (
    Rule("caster", "caster knows nothing of its judge", never=("mitsuba_ref", "mitsuba", "drjit")),
    Rule(
        "caster",
        "only caster/image/exr.py imports OpenEXR",
        never=("OpenEXR",),
        except_in=("caster.image.exr",),
    ),
    Rule(
        "caster",
        "only caster/image/image_files.py imports Pillow",
        never=("PIL",),
        except_in=("caster.image.image_files",),
    ),
    Rule("caster", f"only {JIT} imports numba", never=("numba",), except_in=("caster.jit.decorators",)),
    Rule(
        "caster.kernels",
        "a kernel imports math, numpy and kernels",
        only=("math", "numpy", *TYPING, "caster.kernels"),
        except_in=("caster.jit.decorators", *COMPILING),
    ),
    Rule(
        "caster.jit.decorators",
        "jit.py imports the standard library, numba and what it is made of",
        only=(*STDLIB, "numba", "caster.kernels.compiling", "caster.jit.simd"),
    ),
    *(
        Rule(f"caster.{folder}", "what kept kernels are not named after has none", never=MAKE_KERNELS)
        for folder in WITHOUT_KERNELS
    ),
    Rule("caster", f"only {LOADER} imports llvmlite", never=("llvmlite",), except_in=COMPILING),
    Rule(
        "caster.kernels.compiling",
        "what jit.py is made of imports the standard library, numpy and llvmlite",
        only=(*STDLIB, "numpy", "llvmlite", "caster.kernels.compiling"),
    ),
    *(
        Rule(
            f"caster.{kind}",
            f"one of {kind} imports kernels and {' '.join(vocabulary)}, not its siblings",
            only=(*STDLIB, "numpy", "caster.kernels", *vocabulary),
            except_in=(f"caster.{kind}",),
        )
        for kind, vocabulary in PLUGGED_IN.items()
    ),
    Rule("mitsuba_ref", "the judge never imports caster.kernels", never=("caster.kernels",)),
    Rule("mitsuba_ref", "OpenEXR and numba are caster's business", never=("OpenEXR", "numba")),
    Rule(
        "mitsuba_ref",
        "only mitsuba_ref/reference/mitsuba_process.py imports Mitsuba",
        never=("mitsuba", "drjit"),
        except_in=("mitsuba_ref.reference.mitsuba_process",),
    ),
    Rule(
        "mitsuba_ref",
        "a peer is imported by its entry alone, in a process of its own",
        never=("open3d", "embreex", "trimesh"),
        except_in=("mitsuba_ref.bench.entries.open3d_peer", "mitsuba_ref.bench.entries.embreex_peer"),
    ),
    Rule(
        "mitsuba_ref.oracle.oracle",
        "an oracle shares no code with what it judges",
        only=(*STDLIB, "numpy", *ORACLE),
    ),
    Rule(
        "mitsuba_ref.oracle",
        "exact arithmetic takes whole numbers, fractions and arrays, and shares no code with what it judges",
        only=(*STDLIB, "numpy", "mitsuba_ref.oracle"),
    ),
)


class Import(NamedTuple):
    """One imported name: `from a import b` is "a.b" from the source "a", whether b is a module or not."""

    name: str
    source: str
    line: int


def inside(module: str, packages: tuple[str, ...]) -> bool:
    """Whether `module` is one of `packages` or a part of one."""
    return any(module == package or module.startswith(package + ".") for package in packages)


def imports_of(tree: ast.Module, package: str) -> Iterator[Import]:
    """Every import, also those in functions, relative ones, and import_module("literal")."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = absolute(node, package)
            yield from (Import(f"{source}.{alias.name}", source, node.lineno) for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            for name in (arg.value for arg in node.args[:1] if isinstance(arg, ast.Constant)):
                yield Import(str(name), str(name), node.lineno)


def absolute(node: ast.ImportFrom, package: str) -> str:
    """The module that `from ... import` names, with leading dots resolved."""
    if not node.level:
        return node.module or ""
    parents = package.split(".")[: len(package.split(".")) - node.level + 1]
    return ".".join([*parents, *([node.module] if node.module else [])])


def breaks(rule: Rule, found: Import) -> bool:
    """Whether `rule` forbids the import, or does not list it."""
    if inside(found.name, rule.never):
        return True
    return rule.only is not None and not inside(found.name, rule.only)


def broken_rules(root: Path) -> list[str]:
    """One sentence for each import under `root` that a rule forbids, however many names it brings."""
    broken = [
        f"{path.relative_to(root)}:{found.line}: imports {found.source}, but {rule.says}"
        for package in ("caster", "mitsuba_ref")
        for path in sorted((root / package).rglob("*.py"))
        for found in imports_of(ast.parse(path.read_text(), str(path)), package_of(path, root))
        for rule in rules_for(name_of(path, root))
        if breaks(rule, found)
    ]
    return list(dict.fromkeys(broken))


def rules_for(module: str) -> list[Rule]:
    return [rule for rule in RULES if inside(module, (rule.where,)) and module not in rule.except_in]


def name_of(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def package_of(path: Path, root: Path) -> str:
    return ".".join(path.relative_to(root).parent.parts)


def plant(root: Path, path: str, source: str) -> list[str]:
    file = root / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(source)
    return broken_rules(root)


def test_every_import_keeps_the_rules():
    broken = broken_rules(ROOT)
    assert not broken, "\n".join(["imports that break a rule:", *broken])


def test_the_walk_reads_the_whole_tree():
    """A checker that looks into an empty folder is content with everything."""
    assert (ROOT / JIT).is_file()
    jit = ast.parse((ROOT / JIT).read_text())
    assert "numba" in {found.name for found in imports_of(jit, "caster.kernels")}


@pytest.mark.parametrize(
    ("path", "source", "says"),
    [
        ("caster/render.py", "import mitsuba_ref", "knows nothing of its judge"),
        ("caster/render.py", "def f():\n    from mitsuba import load_file", "knows nothing of its judge"),
        ("caster/render.py", "import OpenEXR", "only caster/image/exr.py"),
        ("caster/cli/commands/render.py", "from PIL import Image", "only caster/image/image_files.py"),
        ("caster/render.py", "from numba import njit", "only " + JIT),
        ("caster/render.py", "import importlib\nimportlib.import_module('numba')", "only " + JIT),
        ("caster/kernels/bvh/traversal.py", "import numba.extending", "only " + JIT),
        ("caster/kernels/bvh/traversal.py", "import os", "a kernel imports"),
        ("caster/kernels/bvh/traversal.py", "from ..scene import Scene", "a kernel imports"),
        ("caster/jit/decorators.py", "from caster.scene.files import Scene", "jit.py imports"),
        ("caster/rendering/images.py", "import llvmlite.binding", "only " + LOADER),
        ("caster/cli/commands/info.py", "from caster.jit.decorators import jit", "not named after"),
        (
            "caster/jit/arguments.py",
            "from caster.kernels.math.vec import dot",
            "what jit.py is made of",
        ),
        ("caster/shapes/disk.py", "from caster.shapes.sphere import Sphere", "not its siblings"),
        ("caster/shapes/disk.py", "from .sphere import Sphere", "not its siblings"),
        ("caster/cameras/fisheye.py", "import caster.shapes", "not its siblings"),
        ("caster/aovs/depth.py", "from caster import scene", "not its siblings"),
        ("mitsuba_ref/reference/xml_writer.py", "from caster import kernels", "never imports caster.kernels"),
        (
            "mitsuba_ref/reference/xml_writer.py",
            "from caster.kernels.math.vec import dot",
            "never imports caster.kernels",
        ),
        (
            "mitsuba_ref/reference/xml_writer.py",
            "import mitsuba as mi",
            "only mitsuba_ref/reference/mitsuba_process.py",
        ),
        ("mitsuba_ref/reference/session.py", "import drjit", "only mitsuba_ref/reference/mitsuba_process.py"),
        ("mitsuba_ref/render.py", "import OpenEXR", "caster's business"),
        ("mitsuba_ref/oracle/oracle.py", "from caster.geometry.mesh import Mesh", "shares no code"),
        ("mitsuba_ref/oracle/oracle.py", "from caster.geometry.packing import joined", "shares no code"),
        (
            "mitsuba_ref/oracle/oracle.py",
            "from mitsuba_ref.error_model.bracket import Nearby",
            "shares no code",
        ),
        (
            "mitsuba_ref/oracle/exact_numbers.py",
            "from caster.geometry.packing import Packed",
            "shares no code",
        ),
        (
            "mitsuba_ref/oracle/exact_numbers.py",
            "from mitsuba_ref.error_model.intersections import dot",
            "shares no code",
        ),
        ("mitsuba_ref/oracle/exact_numbers.py", "import flint", "shares no code"),
    ],
)
def test_a_planted_import_is_caught_with_its_line_and_rule(tmp_path, path, source, says):
    (broken, *_) = plant(tmp_path, path, source) or ["nothing"]
    line = source.count("\n") + 1
    assert broken.startswith(f"{path}:{line}: imports ") and says in broken


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("caster/image/exr.py", "import OpenEXR"),
        ("caster/jit/decorators.py", "import os\nimport numba.extending"),
        (
            "caster/kernels/bvh/traversal.py",
            "import math\nfrom typing import NamedTuple\nfrom .vec import dot",
        ),
        ("caster/shapes/__init__.py", "from caster.shapes.sphere import Sphere"),
        (
            "caster/shapes/disk.py",
            "from caster.scene.fields import Shape\nfrom caster.kernels.math.vec import dot",
        ),
        ("caster/cli/commands/info.py", "from caster.jit.decorators import WORK"),
        ("mitsuba_ref/reference/mitsuba_process.py", "import drjit\nimport mitsuba"),
        (
            "mitsuba_ref/reference/xml_writer.py",
            "from caster import Scene\nfrom caster.shapes.disk import Disk",
        ),
        (
            "mitsuba_ref/oracle/oracle.py",
            "import fractions\nfrom mitsuba_ref.oracle.exact_numbers import Root",
        ),
        ("mitsuba_ref/oracle/primitive_index.py", "import math\nimport numpy as np"),
    ],
)
def test_an_import_the_rules_allow_is_left_alone(tmp_path, path, source):
    assert plant(tmp_path, path, source) == []


SLOW = {"numba", "PIL", "llvmlite", "mitsuba", "drjit"}
HELP = """
import importlib, sys
command, sys.argv = sys.argv[1], [sys.argv[2], "--help"]
try:
    importlib.import_module(command).main()
except SystemExit as stop:
    assert not stop.code, f"--help ended with {stop.code}"
print("\\nloaded:", *sorted({name.partition(".")[0] for name in sys.modules}))
"""


@pytest.mark.parametrize(("module", "command"), [("caster", "caster"), ("mitsuba_ref", "mitsuba-ref")])
def test_help_imports_neither_numba_nor_mitsuba(module, command):
    main = ROOT / module / "__main__.py"
    assert main.is_file(), f"{main.relative_to(ROOT)} is missing: the command {command} has no main()"
    run = subprocess.run(
        [sys.executable, "-c", HELP, f"{module}.__main__", command], cwd=ROOT, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    answer, _, loaded = run.stdout.partition("\nloaded:")
    assert "usage" in answer.lower()
    assert not SLOW & set(loaded.split()), f"{command} --help loads {', '.join(SLOW & set(loaded.split()))}"

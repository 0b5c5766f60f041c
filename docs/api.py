"""Writes docs/api.md: programs, and each public name in a few words. `make site` has all of their documentation."""

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import caster
import mitsuba_ref
from mitsuba_ref import strategies

HEAD = """# API

<!-- written by `python docs/api.py` from the docstrings; change those -->

The names of `import caster` and `import mitsuba_ref`. Everything else may change without notice.
"""
LISTED = (
    "`help(caster.cast)` prints all about a name in Python; so does the API page of the site that `make site` builds.\n"
)
ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = ROOT / "docs/programs"
GROUPS = (
    ("caster", caster, caster.__all__),
    ("mitsuba_ref", mitsuba_ref, mitsuba_ref.__all__),
    ("mitsuba_ref.strategies", strategies, ("scenes", "rays")),
)
# Kinds of values, with their meaning behind them.
VALUES = [ROOT / "caster/description/fields.py", ROOT / "caster/scene/model.py"]
VALUE = re.compile(
    r"^ *([A-Z]\w+) = Annotated\[(?:[^#\n]|\n(?=[ \]]))*?\]  # (.+)$", re.MULTILINE
)  # a kind of values, and its meaning


def page() -> str:
    """docs/api.md."""
    return _page(lambda package, name, value: f"- `{called(name, value)}`: {summary(value)}", LISTED)


def reference() -> str:
    """The same page for the site: mkdocstrings puts the documentation of each name in."""
    return _page(directive)


def _page(entry: Callable[[str, str, Any], str], more: str = "") -> str:
    parts = [HEAD, "## Programs\n", *map(program, sorted(PROGRAMS.glob("*.py"))), more]
    for package, module, names in GROUPS:
        parts += [f"## {package}\n", f"{inspect.getdoc(module)}\n"]
        parts += [*(entry(package, name, getattr(module, name)) for name in names if not name.startswith("_")), ""]
    found = [pair for path in VALUES for pair in VALUE.findall(path.read_text(encoding="utf-8"))]
    return "\n".join([*parts, "## Values of fields\n", *(f"- `{name}`: {words}" for name, words in found), ""])


def directive(package: str, name: str, value: Any) -> str:
    """Of a class or function where it is defined; of a constant, its value."""
    if not hasattr(value, "__qualname__"):
        return f"### {package}.{name}\n\n{summary(value)}\n"
    lines = f"::: {value.__module__}.{value.__qualname__}", "    options:", f"      heading: {package}.{name}"
    return "\n".join([*lines, f"      toc_label: {name}", ""])


def program(path: Path) -> str:
    """A whole program, under its first line. They run in tests/unit/test_programs.py and tests/reference."""
    title, _, text = path.read_text(encoding="utf-8").partition("\n")
    return f"{title.removeprefix('# ')}\n\n```python\n{text}```\n"


def called(name: str, value: Any) -> str:
    """A function with its parameters and their defaults; the name of anything else."""
    if not inspect.isfunction(value):
        return name
    given = inspect.signature(value)
    plain = [each.replace(annotation=inspect.Parameter.empty) for each in given.parameters.values()]
    return f"{name}{given.replace(parameters=plain, return_annotation=inspect.Signature.empty)}"


def summary(value: Any) -> str:
    """The first paragraph of a docstring; the value of a constant."""
    text = inspect.getdoc(value) if hasattr(value, "__qualname__") else ", ".join(value)
    return " ".join((text or "").partition("\n\n")[0].split())


if __name__ == "__main__":
    target = Path(__file__).with_name("api.md")
    target.write_text(page(), encoding="utf-8")
    print(f"{target}: {len(caster.__all__) + len(mitsuba_ref.__all__)} names")

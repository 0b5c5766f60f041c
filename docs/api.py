"""Writes docs/api.md: the public names of both packages, from their signatures and docstrings."""

import ast
import importlib
import inspect
import textwrap
from pathlib import Path
from typing import Any

import caster
import mitsuba_ref
from mitsuba_ref import strategies

HEAD = """# API

<!-- written by `python docs/api.py` from the docstrings; change those -->

The names of `import caster` and `import mitsuba_ref`. Everything else may change without notice.
"""
GROUPS = (
    (
        "Casting and rendering",
        ("load_scene", "render", "cast", "occluded", "Hits", "read_exr", "write_exr", "SceneError"),
    ),
    ("Scenes", ("Scene", "Film", "Shading", "Check", "Diffuse")),
)
REGISTRIES = (
    ("Shapes", "caster.shapes", "SHAPES"),
    ("Cameras", "caster.cameras", "CAMERAS"),
    ("Lights", "caster.scene.model", "LIGHTS"),
)


def page() -> str:
    parts = [HEAD, "## caster\n", paragraphs(caster.__doc__)]
    for title, names in GROUPS:
        parts += [f"### {title}\n", *(entry("caster", name, getattr(caster, name)) for name in names)]
    for title, module, registry in REGISTRIES:
        entries = getattr(importlib.import_module(module), registry)
        parts += [f"### {title}\n", *(entry("caster", each.__name__, each) for each in entries)]
    parts += ["## mitsuba_ref\n", paragraphs(mitsuba_ref.__doc__)]
    parts += [entry("mitsuba_ref", name, getattr(mitsuba_ref, name)) for name in mitsuba_ref.__all__]
    parts += ["## mitsuba_ref.strategies\n", paragraphs(strategies.__doc__)]
    parts += [entry("mitsuba_ref.strategies", name, getattr(strategies, name)) for name in ("scenes", "rays")]
    return "\n".join(parts)


def entry(package: str, name: str, value: Any) -> str:
    """One name: how it is called, and what its docstring says."""
    members = "\n".join(member_lines(value)) if inspect.isclass(value) else ""
    about = f"{called(name, value)}{paragraphs(value.__doc__)}{members}"
    return f"#### `{package}.{name}`\n\n{about.rstrip()}\n"


def called(name: str, value: Any) -> str:
    """The signature as code; of a description, its fields and their defaults."""
    fields = getattr(value, "model_fields", None)
    if fields is not None:
        words = [each if field.is_required() else f"{each}={shown(field)}" for each, field in fields.items()]
        return code(f"{name}({', '.join(words)})")
    if inspect.isfunction(value):
        return code(f"{name}{signature(value)}")
    return ""


def shown(field: Any) -> str:
    default = field.get_default(call_default_factory=True)
    return f"{type(default).__name__}()" if hasattr(type(default), "model_fields") else repr(default)


def signature(function: Any) -> str:
    """As it is written."""
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    assert isinstance(node, ast.FunctionDef)
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"({ast.unparse(node.args)}){returns}"


def code(text: str) -> str:
    return f"```\n{text}\n```\n\n"


def member_lines(value: type) -> list[str]:
    """What a class has beside its fields: public properties and methods with docstrings of their own."""
    lines = []
    bases = [base for base in reversed(value.__mro__) if base.__module__ == value.__module__]
    for name, member in [pair for base in bases for pair in vars(base).items()]:
        thing = member.fget if isinstance(member, property) else member
        thing = getattr(thing, "func", thing)  # a cached property
        if not name.startswith(("_", "model_")) and inspect.isfunction(thing) and thing.__doc__:
            about = inspect.cleandoc(thing.__doc__).replace("\n\n", "\n").replace("\n", " ")
            heading = name if isinstance(member, property) or thing is not member else f"{name}{signature(thing)}"
            lines.append(f"- `{heading}`: {about}")
    return [*lines, ""] if lines else []


def paragraphs(doc: str | None) -> str:
    return f"{inspect.cleandoc(doc or '')}\n\n"


if __name__ == "__main__":
    target = Path(__file__).with_name("api.md")
    target.write_text(page(), encoding="utf-8")
    print(f"{target}: {len(caster.__all__) + len(mitsuba_ref.__all__)} names")

"""Writes docs/api.md: the public names of both packages, from their signatures and docstrings."""

import ast
import importlib
import inspect
import re
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
        ("load_scene", "render", "Aovs", "cast", "occluded", "Hits", "read_exr", "Exr", "write_exr", "SceneError"),
    ),
    ("Scenes", ("Scene", "Film", "Shading", "Check", "Diffuse")),
)
PROGRAMS = Path(__file__).with_name("programs")
REGISTRIES = (
    ("Shapes", "caster.shapes", "SHAPES"),
    ("Cameras", "caster.cameras", "CAMERAS"),
    ("Lights", "caster.scene.model", "LIGHTS"),
)


# Kinds of fields, by the names that caster/description/fields.py and the descriptions give them. Numbers are float64.
KINDS = {
    "Vec3": "3 numbers",
    "UnitVec3": "3 numbers, made unit length",
    "Vec2": "2 numbers",
    "Number": "number",
    "Positive": "number > 0",
    "NonNegative": "number >= 0",
    "RGB": "3 numbers >= 0",
    "Reflectance": "3 numbers from 0 to 1",
    "FieldOfView": "number, 0 to 180, both excluded",
    "WideFieldOfView": "number, 0 (excluded) to 360",
    "Flag": "bool",
    "Name": "text",
    "str": "text",
    "Points": "(n, 3) numbers",
    "UVs": "(n, 2) numbers",
    "Faces": "(m, 3) whole numbers",
    "Lengths": "(n,) numbers > 0",
    "Pixels": "whole number, 1 to 65536",
    "Window": "4 whole numbers x0, y0, x1, y1",
    "Transform": "a step, or a list of steps: translate, rotate, scale, look_at, matrix",
    "PartCount": "whole number, 3 to 4096",
    "Film": "`caster.Film`",
    "AnyCamera": "a camera",
    "Shading": "`caster.Shading`",
    "tuple[Number, Number]": "2 numbers",
    "tuple[Vec3, Vec3, Vec3]": "3 points of 3 numbers",
    "tuple[UnitVec3, UnitVec3, UnitVec3]": "3 vectors of 3 numbers, made unit length",
    "tuple[Vec2, Vec2, Vec2]": "3 pairs of numbers",
    "tuple[AnyLight, ...]": "lights",
    "tuple[AnyShape, ...]": "shapes",
    "dict[Name, AnyMaterial]": "`caster.Diffuse`, `caster.Mirror` or `caster.Glass` by name",
    "dict[str, Check]": "`caster.Check` by AOV",
}
LENGTHS, PIXELS, DEGREES = "scene units", "pixels", "degrees"
UNITS = {
    **dict.fromkeys(("Film.width", "Film.height", "Film.crop"), PIXELS),
    **dict.fromkeys(("Camera.eye", "Camera.look_at", "ClippedCamera.near", "ClippedCamera.far"), LENGTHS),
    **dict.fromkeys(("Sphere.center", "Sphere.radius", "Cylinder.p0", "Cylinder.p1", "Cylinder.radius"), LENGTHS),
    **dict.fromkeys(("SphereCloud.centers", "SphereCloud.radii", "SphereCloud.radius"), LENGTHS),
    **dict.fromkeys(("Plane.offset", "Plane.point", "Triangle.vertices", "Mesh.vertices", "Point.position"), LENGTHS),
    **dict.fromkeys(("Torus.major_radius", "Torus.minor_radius", "Heightfield.size", "Heightfield.amplitude"), LENGTHS),
    **dict.fromkeys(("Orthographic.width", "Ray.origin"), LENGTHS),
    "Ray.t_max": "lengths of direction",
    **dict.fromkeys(("Pinhole.fov", "Fisheye.fov"), DEGREES),
    "Pinhole.principal_point": "fractions of the film",
    "Point.intensity": "W/sr",
    "Directional.irradiance": "W/m^2",
    "Ambient.radiance": "W/(m^2 sr)",
    "Check.ratio": "multiples of the bound",
}
SHARED = {"Shape": "Every shape has", "Camera": "Every camera but `Ray` has"}


def page() -> str:
    parts = [HEAD, "## Programs\n", *map(program, sorted(PROGRAMS.glob("*.py")))]
    parts += ["## caster\n", paragraphs(caster.__doc__)]
    for title, names in GROUPS:
        parts += [f"### {title}\n", *(entry("caster", name, getattr(caster, name)) for name in names)]
    for title, module, registry in REGISTRIES:
        entries = getattr(importlib.import_module(module), registry)
        parts.append(f"### {title}\n")
        base = next((base for base in entries[0].__mro__ if base.__name__ in SHARED), None)
        if base is not None:
            parts += [SHARED[base.__name__] + "\n", "\n".join(field_lines(base))]
        parts += [entry("caster", each.__name__, each) for each in entries]
    parts += ["## mitsuba_ref\n", paragraphs(mitsuba_ref.__doc__)]
    parts += [entry("mitsuba_ref", name, getattr(mitsuba_ref, name)) for name in mitsuba_ref.__all__]
    parts += ["## mitsuba_ref.strategies\n", paragraphs(strategies.__doc__)]
    parts += [entry("mitsuba_ref.strategies", name, getattr(strategies, name)) for name in ("scenes", "rays")]
    return "\n".join(parts)


def program(path: Path) -> str:
    """A whole program, under its first line. They run in tests/unit/test_programs.py and tests/reference."""
    title, _, text = path.read_text(encoding="utf-8").partition("\n")
    return f"{title.removeprefix('# ')}\n\n```python\n{text}```\n"


def entry(package: str, name: str, value: Any) -> str:
    """One name: how it is called, and what its docstring says."""
    members = "\n".join([*field_lines(value), *member_lines(value)]) if inspect.isclass(value) else ""
    about = f"{called(name, value)}{paragraphs(value.__doc__)}{members}"
    return f"#### `{package}.{name}`\n\n{about.rstrip()}\n"


def called(name: str, value: Any) -> str:
    """The signature as code; of a description, its fields and their defaults."""
    fields = getattr(value, "model_fields", None)
    if fields is not None:
        own = [each for each in fields if each in value.__annotations__ and each != "type"]
        order = [*own, *(each for each in fields if each not in (*own, "type"))]
        words = [each if fields[each].is_required() else f"{each}={shown(fields[each])}" for each in order]
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


def field_lines(value: type) -> list[str]:
    """The fields that a class adds to the shared ones, with shape, type, unit and default, from its source."""
    lines = []
    for base in reversed(value.__mro__):
        inherits = hasattr(value, "model_fields") and base.__name__ not in SHARED
        if base is value or (inherits and base.__module__.startswith("caster.")):
            source = textwrap.dedent(inspect.getsource(base)).splitlines()
            (node,) = ast.parse("\n".join(source)).body
            assert isinstance(node, ast.ClassDef)
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                    comment = source[(field.end_lineno or 0) - 1][field.end_col_offset :].partition("# ")[2]
                    lines += field_line(value, base, field.target.id, ast.unparse(field.annotation), comment)
    return [*lines, ""] if lines else []


def field_line(value: Any, base: type, name: str, annotation: str, comment: str) -> list[str]:
    """One line, or none of a class variable, a private field, and the type that the class stands for."""
    if name.startswith("_") or name == "type" or "ClassVar" in annotation:
        return []
    fields = getattr(value, "model_fields", None)
    if fields is None:
        return [f"- `{name}: {annotation}`{f': {comment}' if comment else ''}"]
    kind = described(annotation.removesuffix(" | None"))
    unit = UNITS.get(f"{base.__name__}.{name}", "")
    default = "required" if fields[name].is_required() else f"default `{shown(fields[name])}`"
    return [f"- `{name}`: {', '.join(filter(None, [kind, unit, default]))}"]


def described(annotation: str) -> str:
    """A written type in words."""
    if annotation.startswith("Literal["):
        return "one of " + annotation[8:-1].replace("'", "`")
    if annotation.startswith("Annotated[int"):
        limits = dict(re.findall(r"([gl]e)=(\d+)", annotation))
        return (
            f"whole number, {limits['ge']} to {limits['le']}" if "le" in limits else f"whole number >= {limits['ge']}"
        )
    if annotation.startswith("Annotated["):
        return described(annotation[10:].partition(",")[0].removesuffix(" | None"))
    return KINDS[annotation]


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

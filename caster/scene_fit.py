"""How the elements of a scene fit together, also while some of them are wrong in themselves."""

from collections.abc import Iterator, Mapping
from typing import Any

from caster.problems import PLURAL, Path, item_of
from caster.wording import show, suggestion

Found = Iterator[tuple[Path, str]]  # a path, and what to say after its name


def find_misfits(data: Any) -> Found:
    """Unknown materials, names given twice, checks of no AOV; in a Scene or in what is to become one."""
    yield from _unknown_materials(data)
    yield from _repeated_names(data)
    yield from _unknown_checks(data)


def _elements(data: Any, key: str) -> tuple[str, Any]:
    """(how the data spells the key, what it holds)"""
    spelled = key if item_of(data, key) is not None else PLURAL[key]
    return spelled, item_of(data, spelled)


def _texts(data: Any, key: str) -> Iterator[tuple[Path, str]]:
    """(path, text) of a key of each shape; "" where it is no text."""
    spelled, shapes = _elements(data, "shape")
    for i, shape in enumerate(shapes if isinstance(shapes, (list, tuple)) else ()):
        value = item_of(shape, key)
        yield (spelled, i, key), value if isinstance(value, str) else ""


def _unknown_materials(data: Any) -> Found:
    table = _elements(data, "material")[1]
    known = [str(name) for name in table] if isinstance(table, Mapping) else []
    for path, material in _texts(data, "material"):
        if material and material not in known:
            way_out = suggestion(material, known) or f"; add a table [material.{material}]"
            yield path, f"must be one of the materials of this scene, got {show(material)}{way_out}"


def _repeated_names(data: Any) -> Found:
    first: dict[str, int] = {}
    for i, (path, own) in enumerate(_texts(data, "name")):
        name = own or f"shape-{i}"
        if name in first:
            yield path, f"must be another than that of shapes[{first[name]}], got {show(name)} again"
        first.setdefault(name, i)


def _unknown_checks(data: Any) -> Found:
    spelled, checks = _elements(data, "check")
    if not isinstance(checks, Mapping) or not checks:
        return
    from caster.aovs import BY_NAME  # which imports the scene

    for name in map(str, checks):
        if name not in BY_NAME:
            yield (spelled, name), f"unknown AOV{suggestion(name, BY_NAME)} (known: {', '.join(BY_NAME)})"
